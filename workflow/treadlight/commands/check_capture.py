"""Say whether captures are complete and readable, and what will be missing.

Reads every image of a capture, or of each capture below a folder. What the capture lacks by
choice is told and does no harm; each damage is one sentence on the error output, and the exit
status is then 1. Nothing is written.

Example: treadlight check archive/t7-00200
"""

import argparse
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from treadlight.commands import common

if TYPE_CHECKING:
    from treadlight.archive import Capture
    from treadlight.images.doubts import Look

_LIT_DARK_LEVEL = 0.25
_TOLD = 20
# Axis and camera: without them a calibration measures nothing.
_CALIBRATION_STEPS: tuple[tuple[str, str, tuple[str, ...]], ...] = (
    ("camera", "calibrate_camera", ()),
    ("laser_plane", "calibrate_laser_plane", ("camera",)),
    ("axis", "calibrate_axis", ("camera",)),
    ("leds", "calibrate_leds", ("camera",)),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "capture", type=Path, nargs="+", help="folder of a capture, or a folder of captures"
    )


def run(args: argparse.Namespace) -> int:
    from treadlight.errors import ConfigError

    faults = 0
    for folder in args.capture:
        if not folder.is_dir():
            raise ConfigError(f"{folder}: is no folder. Name the folder of a capture.")
        faults += _check_folder(folder, args.threads)
    return 1 if faults else 0


def _check_folder(folder: Path, threads: int) -> int:
    """Print what is found; returns the number of faults."""
    from treadlight.archive import find_archive

    if any((folder / name).exists() for name in ("capture.yaml", "frames.csv")):
        return _report(folder, *_check_one(folder, threads))
    archive = find_archive(folder)
    captures = [*archive.calibrations.values(), *archive.measurements.values()]
    if not captures and not archive.refused:
        return _report(folder, [], [f"{folder / 'capture.yaml'}: is not there. Add the capture."])
    count = sum(_report(c.folder, *_check_one(c.folder, threads)) for c in captures)
    return count + _report(folder, [], list(archive.refused.values()))


def _report(folder: Path, notes: list[str], faults: list[str]) -> int:
    from treadlight.errors import plain

    told = _grouped(list(dict.fromkeys(faults)))
    for note in notes:
        print(plain(note))
    for fault in told[:_TOLD]:
        print(plain(fault), file=sys.stderr)
    if len(told) > _TOLD:
        print(plain(f"{folder}: {len(told) - _TOLD} more of these."), file=sys.stderr)
    if notes and not told:
        print(plain(f"{folder}: healthy."))
    return len(told)


def _grouped(faults: list[str]) -> list[str]:
    """One sentence per kind of fault: what several frames share names the first of them."""
    groups: dict[str, list[str]] = {}
    for fault in faults:
        head, _, tail = fault.partition(": ")
        groups.setdefault(tail, []).append(head)
    return [
        f"{heads[0]}{f' and {len(heads) - 1} more' if len(heads) > 1 else ''}: {tail}"
        if tail
        else heads[0]
        for tail, heads in groups.items()
    ]


def _check_one(folder: Path, threads: int) -> tuple[list[str], list[str]]:
    """Notes and faults of one capture."""
    from treadlight.archive import read_capture
    from treadlight.archive.inventory import missing
    from treadlight.errors import CaptureError

    try:
        capture = read_capture(folder)
    except CaptureError as error:
        return [], [str(error)]
    counts = Counter(frame.kind for frame in capture.frames)
    listed = ", ".join(f"{count} {kind}" for kind, count in counts.items())
    notes = [f"{folder}: {capture.kind} {capture.id}, frames: {listed}."]
    notes += [f"{folder}: {sentence}" for sentence in missing(capture)]
    faults = _beside_others(capture)
    looks, unreadable = _look(capture)
    faults += unreadable
    # The stages would stop at these; what they would find besides follows from them.
    if not unreadable:
        faults += _lit_darks(capture)
        if capture.kind == "measurement":
            faults += _odd_measurement(capture, looks, threads)
        else:
            faults += _trial_calibration(capture, threads)
    return notes, faults


def _beside_others(capture: "Capture") -> list[str]:
    """What is wrong between this capture and those in the folders beside it."""
    from treadlight.archive import read_capture
    from treadlight.archive.discovery import other_tires, shared_id
    from treadlight.errors import CaptureError

    others = {}
    for manifest in sorted(capture.folder.resolve().parent.glob("*/capture.yaml")):
        try:
            other = read_capture(manifest.parent)
        except CaptureError:
            continue
        if manifest.parent == capture.folder.resolve():
            continue
        if other.id == capture.id:
            return [shared_id(capture, other)]
        others[other.id] = other
    found = other_tires({capture.id: capture} | others).get(capture.id)
    return [found] if found else []


def _look(capture: "Capture") -> "tuple[dict[str, Look], list[str]]":
    """Read every frame as the stages do: what each shows, by file, and what cannot be read."""
    from treadlight.errors import CaptureError
    from treadlight.images import FrameReader, check_frame
    from treadlight.images.doubts import look_at

    faults, looks, bits = [], {}, {}
    for frame in capture.frames:
        try:
            bits[frame.file] = check_frame(capture, frame).bits
        except (CaptureError, OSError) as error:
            faults.append(_sentence(error))
    usual = Counter(bits.values()).most_common(1)[0][0] if bits else 0
    faults += [
        f"{capture.folder / file}: has {n} bits, the other images {usual}. Store all alike."
        for file, n in bits.items()
        if n != usual
    ]
    if faults:
        return {}, faults
    try:
        reader = FrameReader(capture)
    except (CaptureError, OSError) as error:
        return {}, [_sentence(error)]
    for frame in common.progress(capture.frames, "Reading images"):
        try:
            looks[frame.file] = look_at(reader.read(frame))
        except (CaptureError, OSError) as error:
            faults.append(_sentence(error))
    return looks, faults


def _sentence(error: Exception) -> str:
    from treadlight.errors import sentence_of

    return sentence_of(error)


def _lit_darks(capture: "Capture") -> list[str]:
    """Dark frames that are lit: what they show is subtracted from every other frame."""
    from treadlight.images import FrameReader

    reader = FrameReader(capture, subtract_dark=False)
    return [
        f"{capture.path(frame)}: is lit, though it is listed as dark. Take it again or drop its"
        " row."
        for frame in capture.of_kind("dark")
        if reader.read(frame).intensity.mean() > _LIT_DARK_LEVEL
    ]


def _odd_measurement(capture: "Capture", looks: "dict[str, Look]", threads: int) -> list[str]:
    from treadlight.commands.detect_laser_pixels import detect_capture
    from treadlight.errors import CaptureError
    from treadlight.images import doubts

    folder = capture.folder
    faults = _size_and_radius(capture)
    patterns = {}
    for number in capture.views:
        frames = capture.view(number)
        found = doubts.doubts_of_view({f.file: looks[f.file] for f in frames}, capture.laser_scan)
        faults += [_named(capture, sentence) for sentence in found.values()]
        good = [f for f in frames if f.file not in found]
        patterns[number] = {f.led: looks[f.file].pattern for f in good if f.led is not None}
    # Which of two is wrong nobody knows before they are explained.
    for number, leds in doubts.views_with_swapped_leds(patterns, lambda _: 0.0).items():
        faults.append(
            f"{folder / 'frames.csv'}: in field of view {number}, or the one it disagrees with, the"
            f" frames of LEDs {' and '.join(map(str, leds))} look exchanged. Correct led."
        )
    laser = capture.of_kind("laser")
    angles = {frame.encoder_deg for frame in laser}
    if len(laser) > 2 and len(angles) == 1:
        faults.append(
            f"{folder / 'frames.csv'}: encoder_deg is {angles.pop()} in all laser frames. Give each"
            " the angle at which it was taken."
        )
    try:
        told = detect_capture(capture, threads, tell_all=True).attrs.get("warnings", ())
    except CaptureError as error:
        told = [str(error)]
    return faults + [_named(capture, sentence) for sentence in told]


def _size_and_radius(capture: "Capture") -> list[str]:
    from treadlight.archive.manifest import radius_of_size

    assert capture.tire is not None
    told, nominal = radius_of_size(capture.tire.size), capture.tire.nominal_radius_mm
    if told is None or abs(told - nominal) <= 0.08 * told:
        return []
    return [
        f"{capture.folder / 'capture.yaml'}: tire.nominal_radius_mm is {nominal:g}, but a tire of"
        f" size {capture.tire.size} has about {told:.0f}. Correct the one that is wrong."
    ]


def _trial_calibration(capture: "Capture", threads: int) -> list[str]:
    """What the calibration's stages refuse or warn of, run into a folder that is then deleted."""
    import importlib
    import tempfile

    from treadlight import store

    faults: list[str] = []
    with tempfile.TemporaryDirectory(prefix="treadlight-check-") as place:
        for name, module, inputs in _CALIBRATION_STEPS:
            command = importlib.import_module(f"treadlight.commands.{module}")
            out = Path(place) / f"{name}.json"
            paths = {part: Path(place) / f"{part}.json" for part in inputs}
            content = _quietly(command.run, capture, out, paths, threads, store.read_json)
            if "refused" in content:
                return [*faults, _named(capture, content["refused"])]
            faults += [_named(capture, warning) for warning in content.get("warnings", ())]
            if name == "axis" and content.get("axis") is None:
                faults.append(
                    f"{capture.folder / 'frames.csv'}: has no frames of kind 'axis_board', without"
                    " which there is no rotation axis and no profile. Add them."
                )
    return faults


def _quietly(
    run_stage: Callable[[argparse.Namespace], int],
    capture: "Capture",
    out: Path,
    inputs: dict[str, Path],
    threads: int,
    read: Callable[[Path], dict[str, Any]],
) -> dict[str, Any]:
    import contextlib
    import io

    args = argparse.Namespace(
        command="check", capture=capture.folder, out=out, code="", settings="{}", threads=threads
    )
    for name, path in inputs.items():
        setattr(args, name, path)
    with contextlib.redirect_stderr(io.StringIO()):
        run_stage(args)
    return read(out)


def _named(capture: "Capture", sentence: str) -> str:
    folder = str(capture.folder)
    if folder in sentence:
        return sentence
    names_frame = any(sentence.startswith(frame.file) for frame in capture.frames)
    return f"{folder}/{sentence}" if names_frame else f"{folder}: {sentence}"
