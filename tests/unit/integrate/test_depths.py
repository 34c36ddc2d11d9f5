"""How deep slots are: wide ones whose floors sections reach, narrow ones whose lips they hit."""

import numpy as np
import pytest

from treadlight.geometry import CylinderGrid
from treadlight.integrate.depths import slot_depths
from treadlight.integrate.laser import LaserCells
from treadlight.integrate.patches import find_patches

RADIUS = 300.0
STEP = 0.5
TREAD_MM = 8.0
NARROW, WIDE = 2, 8
FLOOR_MM = 6.0
HANGING_MM = 1.2


@pytest.fixture(scope="module")
def grid():
    return CylinderGrid(np.arange(200) * STEP / RADIUS, np.arange(60) * STEP, RADIUS)


@pytest.fixture(scope="module")
def slots(grid):
    """Five narrow ones across columns 5 to 24, five wide ones across columns 35 to 54."""
    mask = np.zeros(grid.shape, bool)
    for k in range(5):
        mask[20 + 40 * k : 20 + 40 * k + NARROW, 5:25] = True
        mask[20 + 40 * k : 20 + 40 * k + WIDE, 35:55] = True
    return find_patches(mask, grid)


def points(rows, columns, depth):
    count = len(rows)
    return LaserCells(
        np.asarray(rows), np.asarray(columns), RADIUS - np.asarray(depth, float),
        np.full(count, 0.05), np.zeros(count, int),
    )  # fmt: skip


def depths(slots, grid, laser):
    top = np.full(grid.shape, RADIUS)
    deep = top[laser.row, laser.column] - laser.value > 0.5
    met = np.ones(slots.count, bool)
    return slot_depths(slots, met, top, laser, deep, 1.0, TREAD_MM, grid)


def test_points_on_the_floor_say_how_deep_it_is_and_how_deep_its_like(grid, slots):
    columns = np.arange(36, 54)
    laser = points(np.full(18, 24), columns, np.full(18, FLOOR_MM))
    depth, std = depths(slots, grid, laser)
    np.testing.assert_allclose(depth[20:28, 35:55], FLOOR_MM)
    np.testing.assert_allclose(depth[60:68, 35:55], FLOOR_MM)
    assert std[24, 40] == pytest.approx(0.05)
    assert np.isnan(depth[:20]).all()


def test_points_at_the_walls_of_a_wide_slot_do_not_hide_that_its_floor_is_reached(grid, slots):
    """Two of three points lie between floor and lip, where lines share a wall's pull."""
    columns = np.tile(np.arange(36, 54), 3)
    rows = np.repeat([20, 27, 24], 18)
    below = np.repeat([0.2, 0.3, FLOOR_MM - 1], 18)
    laser = points(rows, columns, below)
    top = np.full(grid.shape, RADIUS)
    met = np.ones(slots.count, bool)
    depth, _ = slot_depths(slots, met, top, laser, below > 0.5, 4.0, TREAD_MM, grid)
    np.testing.assert_allclose(depth[20:28, 35:55], FLOOR_MM - 1)


def test_points_that_hang_between_lips_and_floor_reached_nothing(grid, slots):
    """In one of the narrow slots most points lie deep, in all of them together few do."""
    columns = np.arange(6, 24)
    rows = np.repeat([20, 60, 100, 140], 18)
    depth = np.zeros((4, 18))
    depth[0, :12] = HANGING_MM
    laser = points(rows, np.tile(columns, 4), depth.ravel())
    found, std = depths(slots, grid, laser)
    width_mm = NARROW * STEP
    for row in (20, 60, 180):
        assert found[row, 10] == pytest.approx((width_mm + TREAD_MM) / 2)
        assert std[row, 10] == pytest.approx((TREAD_MM - width_mm) / np.sqrt(12))


def test_as_many_points_at_the_lips_as_deep_decide_nothing(grid, slots):
    """Twelve of 23 hang in narrow cuts: one more or less, and a kind of cut would be flat."""
    columns = np.concatenate([np.arange(6, 24), np.arange(6, 11)])
    rows = np.repeat([20, 60], [18, 5])
    laser = points(rows, columns, np.where(np.arange(23) < 12, HANGING_MM, 0.0))
    found, _ = depths(slots, grid, laser)
    np.testing.assert_allclose(found[20:22, 5:25], (NARROW * STEP + TREAD_MM) / 2)
