"""What can be asked of the simulator."""

from dataclasses import dataclass, replace
from typing import Any

from treadlight.errors import ConfigError

# Along the tire's axis the image spans the whole tread with some background, as on the
# dissertation's rig; the pixel on the tread follows from the number of pixels.
FIELD_ALONG_AXIS_MM = 240.0
NOMINAL_RADIUS_MM = 355.0
TREAD_WIDTH_MM = 200.0


@dataclass(frozen=True)
class SimulationSettings:
    """A rendered archive: one rig, its calibration, and tires at several mileages.

    Attributes
    ----------
    size_px : (int, int)
        Width and height of every image, 128x192 to 7680x7680.
    sector_deg : float or None
        The part of the circumference that a measurement covers; None is the whole turn.
    sections : int
        Laser sections over the sector or turn (a whole turn gets three more past its end).
    views : int or None
        Fields of view under the LEDs; None takes as many as cover the sector with overlap.
    leds : int
        On two rings, the outer one first.
    mileages : tuple of float
        Miles, ascending; one measurement of each tire at each of them.
    tires : int
    seed : int
        Everything random follows from it: same settings, same bytes.
    scan : str
        ``rows``: the tire's axis runs along the image columns; ``columns``: along the rows.
    wear_mm_per_100mi : float
        Mean loss of the block tops in 100 miles, mm; it varies over ribs and theta.
    """

    size_px: tuple[int, int] = (192, 288)
    sector_deg: float | None = None
    sections: int = 120
    views: int | None = None
    leds: int = 16
    mileages: tuple[float, ...] = (100.0, 200.0, 300.0)
    tires: int = 1
    seed: int = 1
    scan: str = "rows"
    wear_mm_per_100mi: float = 0.12

    def __post_init__(self) -> None:
        _require(min(self.size_px) >= 96 and max(self.size_px) <= 7680, "size", "96 to 7680 px")
        sector = 360.0 if self.sector_deg is None else self.sector_deg
        _require(5 <= sector <= 360, "sector-deg", "5 to 360 degrees")
        _require(self.sections >= 0, "sections", "0 or more")
        _require(self.views is None or self.views >= 0, "views", "0 or more")
        _require(1 <= self.leds <= 256, "leds", "1 to 256")
        ascending = list(self.mileages) == sorted(set(self.mileages)) and self.mileages
        _require(bool(ascending) and min(self.mileages) >= 0, "mileages", "ascending, from 0")
        _require(self.tires >= 1, "tires", "1 or more")
        _require(self.seed >= 0, "seed", "0 or more")
        _require(self.scan in ("rows", "columns"), "scan", "rows or columns")
        _require(self.views != 0 or self.sections > 0, "sections", "above 0 where views is 0")

    @property
    def whole_turn(self) -> bool:
        return self.sector_deg is None or self.sector_deg >= 360

    @property
    def along_px(self) -> int:
        """Pixels along the tire's axis."""
        return self.size_px[1 if self.scan == "rows" else 0]

    @property
    def across_px(self) -> int:
        """Pixels along the direction of travel."""
        return self.size_px[0 if self.scan == "rows" else 1]

    @property
    def pixel_mm(self) -> float:
        """The pixel on the tread."""
        return FIELD_ALONG_AXIS_MM / self.along_px


def _require(good: bool, name: str, must: str) -> None:
    if not good:
        raise ConfigError(f"--{name} of simulate must be {must}.")


PRESETS = {
    "demo": SimulationSettings(),
    "tiny": SimulationSettings(
        size_px=(128, 192), sector_deg=44.0, sections=12, views=2, mileages=(100.0, 200.0)
    ),
    "sample": SimulationSettings(
        size_px=(512, 768), sector_deg=81.0, sections=45, views=3, mileages=(100.0, 200.0)
    ),
}


def preset(name: str, **changes: Any) -> SimulationSettings:
    """A preset with some settings changed; None leaves a setting as it is."""
    given = {key: value for key, value in changes.items() if value is not None}
    return replace(PRESETS[name], **given)
