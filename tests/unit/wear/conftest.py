"""A small synthetic tire, known in every point, measured in any mounting."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from treadlight.geometry import CylinderGrid
from treadlight.wear import Motion

RADIUS = 100.0


@dataclass(frozen=True)
class Tire:
    """Radius over (theta, z) in the frame of its first mounting, smooth walls, blocks of unequal
    pitch, two or three grooves; tops lose `wear(theta, z)`."""

    grooves: tuple[float, ...] = (-18.0, 18.0)
    depth: float = 8.0
    blocks: np.ndarray = field(default_factory=lambda: _block_edges())
    texture_mm: float = 0.0

    def radius(self, theta, z, wear=0.0):
        """mm, of broadcast theta (rad) and z (mm)."""
        theta, z = np.broadcast_arrays(theta, z)
        floor = RADIUS - 4e-4 * z**2 + 0.1 * np.cos(theta) + 0.05 * np.sin(2 * theta)
        if self.texture_mm:
            floor = floor + self.texture_mm * _texture(theta * RADIUS, z)
        cut = _groove(theta, z, self.blocks)
        for centre in self.grooves:
            cut = np.maximum(cut, _box(z - centre, 4.0))
        height = self.depth - wear
        # Walls stand where they stood; only what is higher than the worn tread is gone.
        return floor + np.minimum(self.depth * (1 - cut), height)

    def mileage(self, grid, motion=None, wear=0.0):
        """(n, m) radii on a grid of a mounting which `motion` takes into the first one's frame."""
        motion = motion or Motion.none()
        theta, z = np.broadcast_arrays(grid.theta[:, None], grid.z[None, :])
        r = np.full(grid.shape, RADIUS)
        for _ in range(6):
            theta_1, z_1, r_1 = motion.apply(theta, z, r)
            loss = wear(theta_1, z_1) if callable(wear) else wear
            r = r + self.radius(theta_1, z_1, loss) - r_1
        return r


def _texture(arc, z):
    """Waves of 2 to 4 mm in all directions, that close around the tire; of unit variance."""
    rng = np.random.default_rng(6)
    around, along = rng.integers(150, 300, 60) / RADIUS, rng.uniform(-2.5, 2.5, 60)
    waves = zip(around, along, rng.uniform(0, 2 * np.pi, 60), strict=True)
    return sum(np.sin(k * arc + q * z + phase) for k, q, phase in waves) / np.sqrt(30)


def _block_edges():
    pitches = np.random.default_rng(5).choice([10.0, 12.0, 15.0], 50)
    edges = np.cumsum(pitches) / RADIUS
    return edges[edges < 2 * np.pi - 0.1]


def _box(distance, half, wall=1.5):
    """1 inside, 0 outside, a smooth wall of the given width."""
    s = np.clip((half + 0.5 * wall - np.abs(distance)) / wall, 0, 1)
    return s * s * (3 - 2 * s)


def _groove(theta, z, edges):
    """Oblique lateral grooves, 3.5 mm wide, 1 mm short of the floor."""
    angle = np.mod(theta + 0.002 * np.abs(z), 2 * np.pi)
    index = np.clip(np.searchsorted(edges, angle), 1, len(edges) - 1)
    nearest = np.minimum(np.abs(angle - edges[index - 1]), np.abs(angle - edges[index]))
    return 0.875 * _box(nearest * RADIUS, 1.75)


def grid_of(kind, step=0.5):
    if kind == "whole":
        return CylinderGrid.whole_turn((-45.0, 45.0), step, RADIUS)
    low, high = kind
    return CylinderGrid.sector((low, high), (-45.0, 45.0), step, RADIUS)


@pytest.fixture(scope="session")
def tire():
    return Tire()


@pytest.fixture(scope="session")
def make_grid():
    return grid_of


@pytest.fixture(scope="session")
def make_tire():
    return Tire


def remount(rotation=0.0, axial=1.2, tilt=(2e-3, -1.5e-3), offset=(0.2, -0.15), radial=-0.1):
    return Motion(np.array([rotation, axial, *tilt, *offset, radial]))


@pytest.fixture(scope="session")
def make_remount():
    return remount
