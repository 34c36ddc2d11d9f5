"""Where a view's pixels lie, and which of them a part of the grid has to look at."""

import numpy as np
import pytest

from treadlight.geometry import CylinderGrid
from treadlight.integrate import ASIDE_MM, ViewNormals, angles_of_chunks
from treadlight.integrate.sight import seen_on

RADIUS = 300.0


def view_at(theta, r):
    """Pixels that look at the axis from 600 mm in the direction of theta = 0."""
    shape = (1, len(theta))
    normal = np.zeros((*shape, 3), np.float32)
    normal[..., 0] = 1
    flat, no = np.full(shape, r, np.float32), np.zeros(shape, bool)
    theta = np.asarray(theta, np.float32)[None]
    of_one = np.ones((*shape, 3), np.float32)
    camera = np.array([600.0, 0.0, 0.0])
    return ViewNormals(normal, of_one, flat, theta, 0 * flat, of_one, no, no, no, camera)


@pytest.mark.parametrize("beyond_mm", [-5.0, 0.5 * ASIDE_MM])
def test_pixels_on_a_grid_or_beside_it_are_moved_along_their_rays(beyond_mm):
    grid = CylinderGrid.sector((0.0, 0.1), (-5.0, 5.0), 0.1, RADIUS)
    theta = grid.theta[-1] + beyond_mm / RADIUS
    moved = seen_on(view_at([theta], RADIUS - 8), np.full(grid.shape, RADIUS), grid)
    # The ray meets the higher surface nearer to the camera, which is at theta = 0.
    lower = (RADIUS - 8) * np.array([np.cos(theta), np.sin(theta)])
    ray = lower - [600.0, 0.0]
    share = np.linspace(0.9, 1, 100_001)
    along = np.array([600.0, 0.0]) + share[:, None] * ray
    x, y = along[np.argmin(np.abs(np.hypot(*along.T) - RADIUS))]
    assert moved.r[0, 0] == RADIUS
    assert moved.theta[0, 0] == pytest.approx(np.arctan2(y, x), abs=1e-6)


@pytest.mark.parametrize("beyond_mm", [2 * ASIDE_MM, 40.0])
def test_pixels_far_beyond_an_open_grid_stay_where_they_are(beyond_mm):
    grid = CylinderGrid.sector((0.0, 0.1), (-5.0, 5.0), 0.1, RADIUS)
    theta = np.array([grid.theta[0] - beyond_mm / RADIUS, grid.theta[-1] + beyond_mm / RADIUS])
    view = view_at(theta, RADIUS - 8)
    kept = seen_on(view, np.full(grid.shape, RADIUS), grid)
    np.testing.assert_array_equal(kept.theta, view.theta)
    np.testing.assert_array_equal(kept.r, view.r)
    np.testing.assert_array_equal(kept.normal, view.normal)


@pytest.mark.parametrize("middle", [0.0, np.pi])
def test_squares_of_an_image_know_the_angles_that_they_see(middle):
    u = np.linspace(-0.1, 0.1, 90)
    theta = np.tile(u, (50, 1)) + np.linspace(0, 0.001, 50)[:, None]
    theta = ((theta + middle + np.pi) % (2 * np.pi) - np.pi).astype(np.float32)
    theta[32:, 64:] = np.nan
    theta[3, 5] = np.nan
    at, low, high = angles_of_chunks(theta, 32)
    assert low.shape == high.shape == (2, 3)
    np.testing.assert_allclose(
        (at + low - middle + np.pi) % (2 * np.pi) - np.pi,
        [[u[0], u[32], u[64]], [u[0] + 0.001 * 32 / 49, u[32] + 0.001 * 32 / 49, np.nan]],
        atol=1e-6,
    )
    assert (high - low)[0] == pytest.approx([u[31] - u[0], u[31] - u[0], u[25] - u[0]], abs=2e-3)
    assert np.isnan(high[1, 2])


def test_an_image_that_sees_nothing_has_no_angles():
    _, low, high = angles_of_chunks(np.full((40, 40), np.nan, np.float32), 32)
    assert np.isnan(low).all()
    assert np.isnan(high).all()
