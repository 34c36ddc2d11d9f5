"""Slopes and normals of the integrated surface, beside scipy's filters and numpy's gradients."""

import numpy as np
import pytest
from scipy import ndimage

from treadlight import threads
from treadlight.geometry import CylinderGrid
from treadlight.integrate import normals

RADIUS = 300.0
SECTOR = CylinderGrid.sector((0.0, 0.02), (0.0, 5.0), 0.1, RADIUS)
TURN = CylinderGrid.whole_turn((0.0, 5.0), 25.0, RADIUS)
PIXEL_SIGMA = 0.7


def rough(grid, unknown=0.0):
    rng = np.random.default_rng(3)
    r = RADIUS + rng.normal(0, 0.05, grid.shape)
    r[rng.random(grid.shape) < unknown] = np.nan
    return r


def all_edges(grid):
    uncut = np.ones((2, *grid.shape), bool)
    uncut[0, -1], uncut[1, :, -1] = grid.periodic, False
    return uncut


def expected_slopes(r, grid):
    """Central differences, one-sided at open ends."""
    rows = np.pad(r, ((1, 1), (0, 0)), mode="wrap") if grid.periodic else r
    along = np.gradient(rows, axis=0)
    along = along[1:-1] if grid.periodic else along
    return np.stack([along / (grid.step_theta * r), np.gradient(r, grid.step_z, axis=1)])


@pytest.mark.parametrize("grid", [SECTOR, TURN], ids=["sector", "turn"])
def test_slopes_are_central_differences(grid):
    r = rough(grid)
    found = normals.solved_slopes(r, all_edges(grid), grid)
    np.testing.assert_allclose(found, expected_slopes(r, grid), rtol=1e-5, atol=1e-5)


def test_slopes_come_from_the_side_that_is_not_cut():
    r = np.broadcast_to(RADIUS + np.array([0.0, 1.0, 3.0, 7.0]), (6, 4))
    grid = CylinderGrid(np.arange(6) * 0.01, np.arange(4.0), RADIUS)
    uncut = all_edges(grid)
    uncut[1, :, 1] = False
    found = normals.solved_slopes(r, uncut, grid)[1]
    np.testing.assert_allclose(found[0], [1.0, 1.0, 4.0, 4.0])
    uncut[1] = False
    assert np.isnan(normals.solved_slopes(r, uncut, grid)[1]).all()


@pytest.mark.parametrize("unknown", [0.0, 0.2])
@pytest.mark.parametrize("grid", [SECTOR, TURN], ids=["sector", "turn"])
def test_normals_in_the_mask_are_those_of_the_surface_as_a_pixel_sees_it(grid, unknown):
    r = rough(grid, unknown)
    known = np.isfinite(r)
    weight, value = (
        ndimage.gaussian_filter(x, PIXEL_SIGMA, mode=grid.filter_mode)
        for x in (known.astype(float), np.where(known, r - RADIUS, 0))
    )
    blurred = np.where(known, value / weight + RADIUS, np.nan)
    seen = expected_slopes(blurred, grid)
    slope = np.full((2, *grid.shape), 0.5, np.float32)
    mask = np.random.default_rng(4).random(grid.shape) < 0.5
    p, q = np.where(mask & np.isfinite(seen), seen, slope)
    found = normals.surface_normals(slope, mask, r, grid)
    expected = np.stack([np.ones_like(p), -p, -q], axis=-1) / np.sqrt(1 + p * p + q * q)[..., None]
    np.testing.assert_allclose(found, expected, atol=2e-4)


def test_normals_are_the_same_on_any_number_of_cores(monkeypatch):
    """Rows are taken a few at a time, each range with rows around it that are its neighbour's."""
    monkeypatch.setattr(normals, "least_rows", lambda _: 1)
    grid = CylinderGrid.sector((0.0, 0.02), (0.0, 3.0), 0.1, RADIUS)
    r, mask = rough(grid, 0.1), np.ones(grid.shape, bool)
    found = []
    for cores in (1, 3):
        monkeypatch.setattr(threads, "_allowed", cores)
        slope = normals.solved_slopes(r, all_edges(grid), grid)
        found.append(normals.surface_normals(slope, mask, r, grid))
    np.testing.assert_array_equal(*found)


def test_the_residual_is_the_angle_between_both_fields():
    flat, tilted = np.zeros((2, 40, 50)), np.zeros((2, 40, 50))
    tilted[0, :, :40] = np.tan(0.1)
    tilted[1, :, 40:] = np.tan(0.3)
    tilted[:, 3] = np.nan
    assert normals.normal_residual(flat, tilted) == pytest.approx((0.1, 0.3))
    assert np.isnan(normals.normal_residual(flat, np.full_like(flat, np.nan))).all()
