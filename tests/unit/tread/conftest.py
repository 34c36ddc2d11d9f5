"""Synthetic treads on a grid, with known grooves."""

from dataclasses import dataclass

import numpy as np
import pytest

from treadlight.geometry import CylinderGrid


@dataclass(frozen=True)
class Tread:
    """A tread of 8 mm on a carcass of 300 mm radius: half widths and centres of its grooves, mm."""

    grooves: tuple[tuple[float, float, float], ...] = ()
    lateral_share: float = 0.25
    crown_per_mm: float = -4e-4
    offset_mm: tuple[float, float] = (0.4, -0.3)
    tilt_rad: tuple[float, float] = (3e-3, -2e-3)
    shoulder: bool = False

    def floor(self, z):
        return 300.0 + self.crown_per_mm * z**2

    def runout(self, theta, z):
        (a, b), (c, d) = self.offset_mm, self.tilt_rad
        cos, sin = np.cos(theta)[:, None], np.sin(theta)[:, None]
        return (a + c * z) * cos + (b + d * z) * sin

    def radius(self, theta, z):
        depth = np.full((len(theta), len(z)), 8.0)
        pitch = np.mod(theta[:, None] * 300 + 0.2 * z, 30.0)
        depth[pitch < 30.0 * self.lateral_share] = 1.0
        bar = np.mod(np.degrees(theta), 60.0) < 1.5
        for centre, half, deep in self.grooves:
            columns = np.abs(z - centre) < half
            depth[:, columns] = np.where(bar, 1.6, 0.0)[:, None] + (8.0 - deep)
        if self.shoulder:
            depth -= np.maximum(np.abs(z) - 80.0, 0) ** 2 / 20.0
        return self.floor(z) + depth + self.runout(theta, z)


GROOVES = {
    0: (),
    1: ((0.0, 6.0, 8.0),),
    2: ((-30.0, 5.0, 8.0), (30.0, 5.0, 8.0)),
    3: ((-40.0, 4.0, 8.0), (0.0, 6.0, 8.0), (40.0, 4.0, 8.0)),
    5: tuple((float(c), 3.5, 8.0) for c in (-60, -30, 0, 30, 60)),
}


@pytest.fixture
def treads():
    return {count: Tread(grooves) for count, grooves in GROOVES.items()}


def whole(step=2.0):
    return CylinderGrid.whole_turn((-90.0, 90.0), step, 305.0)


def sector(step=1.0, degrees=70.0):
    return CylinderGrid.sector((2.5, 2.5 + np.deg2rad(degrees)), (-90.0, 90.0), step, 305.0)


@pytest.fixture
def grids():
    return {"whole": whole(), "sector": sector(), "coarse": whole(2.5)}
