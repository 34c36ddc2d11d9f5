"""capture.yaml and frames.csv: read, checked field by field, never written."""

import os
import re
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any

from treadlight.archive.documents import read_rows, read_yaml
from treadlight.errors import CaptureError

FORMAT = "tread-capture/1"
ID = re.compile(r"(?!\.)[A-Za-z0-9._-]{1,64}\Z")
MAX_SIDE_PX = 65_535
MAX_PIXELS = 1 << 28
MEASUREMENT_KINDS = ("laser", "led", "dark")
CALIBRATION_KINDS = (
    "board",
    "board_laser",
    "axis_board",
    "reference_board",
    "balls",
    "card",
    "dark",
)
# What a row of a kind must give beside its file.
_NEEDS = {
    "laser": ("pose", "encoder_deg"),
    "led": ("pose", "led", "encoder_deg"),
    "board": ("pose",),
    "board_laser": ("pose",),
    "axis_board": ("encoder_deg",),
    "balls": ("led",),
    "card": ("led",),
}
# A hundred turns; a larger angle is a slip of the unit or of the file.
_MAX_ENCODER_DEG = 36_000.0
_MAX_EXPOSURE_S = 1e5
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


@dataclass(frozen=True)
class Encoding:
    """How stored counts relate to light.

    Attributes
    ----------
    size_px : (int, int)
        Width and height.
    curve : str
        ``linear`` or ``srgb``.
    black_level, white_level : float
        Stored counts; at and above the white level a pixel is saturated.
    """

    size_px: tuple[int, int]
    curve: str
    black_level: float
    white_level: float


@dataclass(frozen=True)
class Frame:
    """One row of frames.csv; what does not apply is None."""

    file: str
    kind: str
    pose: int | None
    led: int | None
    encoder_deg: float | None
    exposure_s: float | None
    sha256: str | None


@dataclass(frozen=True)
class Board:
    """A checkerboard: inner corners (columns, rows) and the side of a square."""

    inner_corners: tuple[int, int]
    square_mm: float


@dataclass(frozen=True)
class Balls:
    """The chrome balls; `centre_height_mm` is over the reference plane, towards the camera."""

    count: int
    diameter_mm: float
    centre_height_mm: float


@dataclass(frozen=True)
class Tire:
    """The measured tire; `facts` holds the optional entries as they were written."""

    id: str
    size: str
    nominal_radius_mm: float
    tread_width_mm: float
    facts: dict[str, Any]


@dataclass(frozen=True)
class Capture:
    """One capture: the facts of capture.yaml and the rows of frames.csv.

    Attributes that belong to the other kind of capture are None; `facts` is all of capture.yaml
    as it was written.
    """

    folder: Path
    id: str
    kind: str
    rig: str
    captured_at: datetime
    encoding: Encoding
    laser_scan: str
    laser_channel: str
    leds: int
    frames: tuple[Frame, ...]
    facts: dict[str, Any]
    tire: Tire | None = None
    mileage: float | None = None
    mileage_unit: str | None = None
    board: Board | None = None
    axis_board: Board | None = None
    balls: Balls | None = None
    card_albedo: float | None = None

    def of_kind(self, kind: str) -> tuple[Frame, ...]:
        return tuple(frame for frame in self.frames if frame.kind == kind)

    @cached_property
    def views(self) -> tuple[int, ...]:
        """Field-of-view numbers of the LED frames, ascending."""
        return tuple(sorted({f.pose for f in self.of_kind("led") if f.pose is not None}))

    def view(self, pose: int) -> tuple[Frame, ...]:
        """The LED frames of one field of view, by LED number."""
        frames = [f for f in self.of_kind("led") if f.pose == pose]
        return tuple(sorted(frames, key=lambda f: -1 if f.led is None else f.led))

    def path(self, frame: Frame) -> Path:
        return self.folder / frame.file


def read_capture(folder: Path) -> Capture:
    """Read and check the manifest of a capture (no image is opened).

    Raises
    ------
    CaptureError
        One sentence that names file, field and remedy.
    """
    place = _Place(folder)
    for name in ("capture.yaml", "frames.csv"):
        if not place.holds(name):
            raise CaptureError(
                f"{folder / name}: is a link that leaves the capture's folder. Put the file itself"
                " there."
            )
    facts = _Facts(folder / "capture.yaml")
    facts.expect("format", FORMAT)
    kind = facts.choice("kind", ("measurement", "calibration"))
    leds = facts.integer("leds", 0, 4096)
    encoding = Encoding(
        size_px=facts.pair("camera.size_px", 1, MAX_SIDE_PX),
        curve=facts.choice("camera.encoding", ("linear", "srgb")),
        black_level=facts.number("camera.black_level", 0, 65_535),
        white_level=facts.number("camera.white_level", 1, 65_535),
    )
    if encoding.white_level <= encoding.black_level:
        raise facts.error("camera.white_level", encoding.white_level, "above black_level")
    if encoding.size_px[0] * encoding.size_px[1] > MAX_PIXELS:
        must = f"at most {MAX_PIXELS} pixels together"
        raise facts.error("camera.size_px", list(encoding.size_px), must)
    kinds = MEASUREMENT_KINDS if kind == "measurement" else CALIBRATION_KINDS
    common: dict[str, Any] = {
        "folder": folder,
        "id": facts.identifier("capture"),
        "kind": kind,
        "rig": facts.text("rig"),
        "captured_at": facts.moment("captured_at"),
        "encoding": encoding,
        "laser_scan": facts.choice("laser.scan", ("rows", "columns")),
        "laser_channel": facts.choice("laser.channel", ("red", "green", "blue", "mono")),
        "leds": leds,
        "frames": _read_frames(place, kinds, leds),
        "facts": facts.data,
    }
    if kind == "measurement":
        return Capture(**common, **_measurement_facts(facts))
    return Capture(**common, **_calibration_facts(facts, {f.kind for f in common["frames"]}))


def radius_of_size(size: str) -> float | None:
    """Radius (mm) of a new tire by its size designation, such as 215/70R16; None for others."""
    found = re.search(r"(\d{3})/(\d{2,3})\s*[A-Z]{0,2}\s*(\d{2}(?:\.5)?)", size, re.ASCII)
    if found is None:
        return None
    width, aspect, rim = map(float, found.groups())
    return rim * 25.4 / 2 + width * aspect / 100


def _measurement_facts(facts: "_Facts") -> dict[str, Any]:
    known = {"id", "size", "nominal_radius_mm", "tread_width_mm"}
    optional = {k: v for k, v in facts.mapping("tire").items() if k not in known}
    for name, options in (("rolling_direction", ("+theta", "-theta")), ("outboard", ("+z", "-z"))):
        if optional.get(name) is not None:
            facts.choice(f"tire.{name}", options)
    tire = Tire(
        id=facts.identifier("tire.id"),
        size=facts.text("tire.size"),
        nominal_radius_mm=facts.number("tire.nominal_radius_mm", 1, 10_000),
        tread_width_mm=facts.number("tire.tread_width_mm", 1, 10_000),
        facts=optional,
    )
    return {
        "tire": tire,
        "mileage": facts.number("mileage.value", 0, 1e7),
        "mileage_unit": facts.choice("mileage.unit", ("mi", "km")),
    }


def _calibration_facts(facts: "_Facts", kinds: set[str]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    if kinds & {"board", "reference_board"}:
        found["board"] = _board(facts, "board")
    if "axis_board" in kinds:
        found["axis_board"] = _board(facts, "axis_board")
    if "balls" in kinds:
        found["balls"] = Balls(
            count=facts.integer("balls.count", 1, 1000),
            diameter_mm=facts.number("balls.diameter_mm", 0.1, 1000),
            centre_height_mm=facts.number("balls.centre_height_mm", -1000, 1000),
        )
    if "card" in kinds:
        found["card_albedo"] = facts.number("card.albedo", 1e-6, 1)
    return found


def _board(facts: "_Facts", name: str) -> Board:
    return Board(
        inner_corners=facts.pair(f"{name}.inner_corners", 3, 1000),
        square_mm=facts.number(f"{name}.square_mm", 0.01, 1000),
    )


class _Facts:
    """Typed access to a YAML mapping by dotted names; each error is a sentence."""

    def __init__(self, path: Path):
        self.path = path
        self.data = read_yaml(path)

    def error(self, name: str, value: Any, must: str) -> CaptureError:
        if value is None:
            return CaptureError(f"{self.path}: '{name}' is missing. It must be {must}.")
        return CaptureError(f"{self.path}: '{name}' is {value!r}. It must be {must}.")

    def get(self, name: str) -> Any:
        node: Any = self.data
        for part in name.split("."):
            node = node.get(part) if isinstance(node, dict) else None
        return node

    def mapping(self, name: str) -> dict[str, Any]:
        value = self.get(name)
        if not isinstance(value, dict):
            raise self.error(name, value, "a mapping")
        return value

    def expect(self, name: str, wanted: str) -> None:
        if self.get(name) != wanted:
            raise self.error(name, self.get(name), repr(wanted))

    def choice(self, name: str, options: tuple[str, ...]) -> str:
        value = self.get(name)
        if value not in options:
            raise self.error(name, value, "one of " + ", ".join(options))
        return str(value)

    def text(self, name: str) -> str:
        value = self.get(name)
        if not isinstance(value, str) or not value.strip():
            raise self.error(name, value, "a text")
        return value

    def identifier(self, name: str) -> str:
        value = self.get(name)
        if not isinstance(value, str) or not ID.match(value):
            rule = "1 to 64 of the characters A-Z a-z 0-9 . _ - and not start with a dot"
            raise self.error(name, value, rule)
        return value

    def number(self, name: str, low: float, high: float) -> float:
        value = self.get(name)
        good = isinstance(value, int | float) and not isinstance(value, bool)
        if not good or not low <= value <= high:
            raise self.error(name, value, f"a number from {low:g} to {high:g}")
        return float(value)

    def integer(self, name: str, low: int, high: int) -> int:
        value = self.get(name)
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
            raise self.error(name, value, f"a whole number from {low} to {high}")
        return value

    def pair(self, name: str, low: int, high: int) -> tuple[int, int]:
        value = self.get(name)
        good = (
            isinstance(value, list)
            and len(value) == 2
            and all(type(v) is int and low <= v <= high for v in value)
        )
        if not good:
            raise self.error(name, value, f"two whole numbers from {low} to {high}")
        return value[0], value[1]

    def moment(self, name: str) -> datetime:
        value = self.get(name)
        if isinstance(value, str):
            try:
                value = datetime.fromisoformat(value)
            except ValueError:
                value = None
        if not isinstance(value, datetime):
            raise self.error(name, self.get(name), "a time such as 2020-01-31T10:00:00Z")
        return value if value.tzinfo else value.replace(tzinfo=UTC)


class _Place:
    """A capture's folder, and what lies in it; each sub-folder is looked up once."""

    def __init__(self, folder: Path):
        self.folder = folder
        self._root = os.path.realpath(folder)
        self._subfolders: dict[str, bool] = {}

    def has_file(self, name: str) -> bool:
        return os.path.isfile(os.path.join(self.folder, name))

    def holds(self, name: str) -> bool:
        """Whether a file that is named from the folder lies in it, links followed."""
        if os.path.islink(os.path.join(self.folder, name)):
            return self._is_inside(name)
        subfolder = os.path.dirname(name)
        if subfolder not in self._subfolders:
            self._subfolders[subfolder] = self._is_inside(subfolder)
        return self._subfolders[subfolder]

    def _is_inside(self, name: str) -> bool:
        return Path(os.path.realpath(os.path.join(self._root, name))).is_relative_to(self._root)


def _read_frames(place: _Place, kinds: tuple[str, ...], leds: int) -> tuple[Frame, ...]:
    path = place.folder / "frames.csv"
    rows = read_rows(path, needed=("file", "kind"))
    frames = tuple(_frame(_Row(path, number, row), place, kinds, leds) for number, row in rows)
    if not frames:
        raise CaptureError(f"{path}: lists no frame. Add one row per image.")
    _check_together(path, frames, rows)
    return frames


class _Row:
    """One row of frames.csv; each error names the row and the field."""

    def __init__(self, path: Path, line: int, cells: dict[str, str]):
        self.path, self.line, self.cells = path, line, cells

    def error(self, name: str, problem: str) -> CaptureError:
        return CaptureError(f"{self.path}, row {self.line}: {name} {problem}")

    def text(self, name: str) -> str:
        return self.cells.get(name, "")

    def integer(self, name: str) -> int | None:
        text = self.text(name)
        if not text:
            return None
        if not re.fullmatch(r"[0-9]{1,9}", text):
            raise self.error(name, f"is {text!r}. It must be a whole number from 0.")
        return int(text)

    def number(self, name: str, low: float, high: float) -> float | None:
        text = self.text(name)
        if not text:
            return None
        if not _NUMBER.fullmatch(text):
            raise self.error(name, f"is {text!r}. It must be a number, or empty if not known.")
        value = float(text)
        if not low <= value <= high:
            must = f"a number from {low:g} to {high:g}, or empty if not known"
            raise self.error(name, f"is {text!r}. It must be {must}.")
        return value


def _frame(row: _Row, place: _Place, kinds: tuple[str, ...], leds: int) -> Frame:
    kind = row.text("kind")
    if kind not in kinds:
        raise row.error("kind", f"is {kind!r}. It must be one of {', '.join(kinds)}.")
    frame = Frame(
        file=_safe_file(row, place),
        kind=kind,
        pose=row.integer("pose"),
        led=row.integer("led"),
        encoder_deg=row.number("encoder_deg", -_MAX_ENCODER_DEG, _MAX_ENCODER_DEG),
        exposure_s=row.number("exposure_s", 0, _MAX_EXPOSURE_S),
        sha256=row.text("sha256").lower() or None,
    )
    for name in _NEEDS.get(kind, ()):
        if getattr(frame, name) is None:
            remedy = "give it, or leave the row out if it is not known"
            raise row.error(name, f"is empty. A frame of kind '{kind}' needs it: {remedy}.")
    if frame.led is not None and frame.led >= leds:
        raise row.error("led", f"is {frame.led}. capture.yaml says leds: {leds}, counted from 0.")
    if frame.exposure_s is not None and frame.exposure_s < 1e-9:
        raise row.error("exposure_s", f"is {frame.exposure_s}. It must be above 0, or empty.")
    if frame.sha256 and not re.fullmatch(r"[0-9a-f]{64}", frame.sha256):
        raise row.error("sha256", f"is {frame.sha256!r}. It must be 64 hex digits, or empty.")
    return frame


def _safe_file(row: _Row, place: _Place) -> str:
    text = row.text("file")
    posix = PurePosixPath(text)
    # What cannot be printed cannot be named in a message, a log or a report either.
    if not text or posix.is_absolute() or ".." in posix.parts or "\\" in text:
        raise row.error("file", f"is {text!r}. It must be a path below the capture's folder.")
    if not text.isprintable():
        raise row.error("file", f"is {text!r}. It must be printable: rename the image.")
    if not place.has_file(text):
        raise row.error("file", f"is {text!r}, which is not there. Add the image or drop the row.")
    if not place.holds(text):
        raise row.error(
            "file",
            f"is {text!r}, a link that leaves the capture's folder. Put the image itself there.",
        )
    return text


def _check_together(
    path: Path, frames: tuple[Frame, ...], rows: list[tuple[int, dict[str, str]]]
) -> None:
    seen: dict[tuple[Any, ...], int] = {}
    encoders: dict[int | None, tuple[float | None, int]] = {}
    for frame, (number, _) in zip(frames, rows, strict=True):
        key: tuple[Any, ...] = (frame.kind, frame.pose, frame.led, frame.encoder_deg)
        if frame.kind in ("laser", "board", "board_laser"):
            key = (frame.kind, frame.pose)
        if frame.kind in ("balls", "card"):
            key = (frame.kind, frame.led)
        if frame.kind == "led":
            key = (frame.kind, frame.pose, frame.led)
            encoder, first = encoders.setdefault(frame.pose, (frame.encoder_deg, number))
            if encoder != frame.encoder_deg:
                raise CaptureError(
                    f"{path}, row {number}: encoder_deg is {frame.encoder_deg}, but row {first} of"
                    f" the same field of view {frame.pose} has {encoder}. All led frames of one"
                    " pose share one angle."
                )
        if frame.kind != "dark" and key in seen:
            raise CaptureError(
                f"{path}, row {number}: repeats row {seen[key]} ({frame.kind}, pose {frame.pose},"
                f" led {frame.led}). Leave one of them out."
            )
        seen[key] = number
