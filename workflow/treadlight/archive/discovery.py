"""The archive: every capture below a folder, and which calibration each measurement takes."""

import fnmatch
import os
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from treadlight.archive.manifest import ID, Capture, read_capture
from treadlight.errors import CaptureError, plain


@dataclass(frozen=True)
class Archive:
    """What an archive folder holds.

    Attributes
    ----------
    measurements, calibrations : dict of str to Capture
        Healthy captures by id, in order of id.
    refused : dict of str to str
        Why each other capture was left out, by id (or folder, where the id is not known).
    calibration_of : dict of str to str
        The calibration that each measurement takes.
    warnings : dict of str to str
        What a measurement's user should know of that choice.
    """

    measurements: dict[str, Capture]
    calibrations: dict[str, Capture]
    refused: dict[str, str]
    calibration_of: dict[str, str]
    warnings: dict[str, str]

    @property
    def tires(self) -> dict[str, list[str]]:
        """Measurements of each tire, in order of mileage, then date, then id."""
        groups: dict[str, list[Capture]] = {}
        for capture in self.measurements.values():
            assert capture.tire is not None
            groups.setdefault(capture.tire.id, []).append(capture)
        return {tire: _in_order(groups[tire]) for tire in sorted(groups)}


def _in_order(captures: list[Capture]) -> list[str]:
    # Mileages of one tire may come in two units: compare in kilometres.
    def key(capture: Capture) -> tuple[float, float, str]:
        factor = 1.609344 if capture.mileage_unit == "mi" else 1.0
        return (capture.mileage or 0.0) * factor, capture.captured_at.timestamp(), capture.id

    return [capture.id for capture in sorted(captures, key=key)]


def find_archive(
    root: Path,
    include: Iterable[str] = ("*",),
    exclude: Iterable[str] = (),
    named_calibrations: dict[str, str] | None = None,
    check: Callable[[Capture], None] | None = None,
) -> Archive:
    """Find and check all captures below a folder.

    Parameters
    ----------
    root : Path
    include, exclude : patterns of capture ids, as in a shell.
    named_calibrations : measurement id to calibration id.
    check : called with each capture; raises CaptureError for one that cannot be used.
    """
    found: dict[str, Capture] = {}
    folders, bad = _capture_folders(root)
    for folder in folders:
        try:
            if not str(folder).isprintable():
                raise CaptureError(
                    f"{folder}: the folder's name cannot be printed. Rename the folder."
                )
            capture = read_capture(folder)
            if not _selected(capture.id, include, exclude):
                continue
            if capture.id in found:
                raise CaptureError(shared_id(capture, found[capture.id]))
            if check:
                check(capture)
            found[capture.id] = capture
        except CaptureError as error:
            bad[folder] = str(error)
    refused = {
        name: bad[folder]
        for folder, name in _names(root, bad, found).items()
        if _selected(name, include, exclude)
    }
    refused |= other_tires(found)
    found = {name: capture for name, capture in found.items() if name not in refused}
    return _with_calibrations(found, refused, named_calibrations or {})


def shared_id(capture: Capture, first: Capture) -> str:
    """That a capture has the id of another."""
    return (
        f"{capture.folder / 'capture.yaml'}: 'capture' is {capture.id!r}, as in {first.folder}. Two"
        " captures cannot share an id. Give one of them another."
    )


def other_tires(found: dict[str, Capture]) -> dict[str, str]:
    """Captures whose tire has another size than most captures under its id."""
    tires: dict[str, list[Capture]] = {}
    for capture in found.values():
        if capture.tire is not None:
            tires.setdefault(capture.tire.id, []).append(capture)
    refused = {}
    for captures in tires.values():
        for name in ("size", "nominal_radius_mm", "tread_width_mm"):
            values = [getattr(capture.tire, name) for capture in captures]
            # Of equally many, the first captures' holds.
            usual = Counter(values).most_common(1)[0][0]
            for capture, value in zip(captures, values, strict=True):
                if value != usual:
                    assert capture.tire is not None
                    other = captures[values.index(usual)]
                    refused[capture.id] = (
                        f"{capture.folder / 'capture.yaml'}: 'tire.{name}' is {value!r}, but"
                        f" {usual!r} in {other.id} of the same tire {capture.tire.id!r}. Correct"
                        " it, or give the other tire an id of its own."
                    )
    return refused


def _names(root: Path, bad: Iterable[Path], found: dict[str, Capture]) -> dict[Path, str]:
    """What to call captures whose id is not known: the folder's name, or its path if taken."""
    counts = Counter(folder.name for folder in bad)
    names = {}
    for folder in bad:
        alone = ID.match(folder.name) and folder.name not in found and counts[folder.name] == 1
        path = folder.relative_to(root).as_posix()
        names[folder] = plain(folder.name if alone or folder == root else path)
    return names


def _capture_folders(root: Path) -> tuple[list[Path], dict[Path, str]]:
    """Folders that hold a capture.yaml, and what is wrong with others that look like captures."""
    folders: list[Path] = []
    bad: dict[Path, str] = {}

    def unreadable(error: OSError) -> None:
        folder = Path(error.filename)
        bad[folder] = plain(f"{folder}: cannot be read ({error.strerror}). Mend that.")

    for path, subfolders, files in os.walk(root, onerror=unreadable):
        folder = Path(path)
        if "capture.yaml" in files or "capture.yaml" in subfolders:
            folders.append(folder)
            subfolders.clear()  # a capture holds images, no further captures
        elif "frames.csv" in files and not folder.name.startswith("."):
            bad[folder] = plain(
                f"{folder / 'capture.yaml'}: is not there, though frames.csv is. Add it."
            )
        subfolders.sort()
    return sorted(folders), bad


def _selected(name: str, include: Iterable[str], exclude: Iterable[str]) -> bool:
    def matches(patterns: Iterable[str]) -> bool:
        return any(fnmatch.fnmatchcase(name, pattern) for pattern in patterns)

    return matches(include) and not matches(exclude)


def _with_calibrations(
    found: dict[str, Capture], refused: dict[str, str], named: dict[str, str]
) -> Archive:
    calibrations = {i: c for i, c in sorted(found.items()) if c.kind == "calibration"}
    measurements, calibration_of, warnings = {}, {}, {}
    for name, capture in sorted(found.items()):
        if capture.kind != "measurement":
            continue
        try:
            chosen, warning = choose_calibration(capture, calibrations, named.get(name))
        except CaptureError as error:
            refused[name] = str(error)
            continue
        measurements[name] = capture
        calibration_of[name] = chosen
        if warning:
            warnings[name] = warning
    return Archive(measurements, calibrations, refused, calibration_of, warnings)


def choose_calibration(
    capture: Capture, calibrations: dict[str, Capture], named: str | None = None
) -> tuple[str, str | None]:
    """The calibration that a measurement takes, and a warning where one is due.

    The named one; else the latest of the same rig taken before the capture; else the
    earliest after it, with a warning. Ties go by id.

    Raises
    ------
    CaptureError
        There is none.
    """
    listed = ", ".join(f"{c.id} of rig {c.rig}" for c in calibrations.values()) or "none"
    if named is not None:
        if named not in calibrations:
            raise CaptureError(
                f"config, calibrations.{capture.id}: there is no usable calibration {named!r} in"
                f" the archive. Found: {listed}."
            )
        return named, None
    same_rig = [c for c in calibrations.values() if c.rig == capture.rig]
    if not same_rig:
        raise CaptureError(
            f"{capture.folder / 'capture.yaml'}: no calibration of rig {capture.rig!r} in the"
            f" archive. Found: {listed}. Name one in the config under calibrations, or add a"
            " capture of kind 'calibration'."
        )
    before = [c for c in same_rig if c.captured_at <= capture.captured_at]
    if before:
        latest = max(c.captured_at for c in before)
        return min(c.id for c in before if c.captured_at == latest), None
    earliest = min(c.captured_at for c in same_rig)
    chosen = min(c.id for c in same_rig if c.captured_at == earliest)
    return chosen, f"The calibration {chosen} was taken after this capture."
