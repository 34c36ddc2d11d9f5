import numpy as np
import pytest

from treadlight.geometry import Axis, Camera, CylinderGrid, Rig
from treadlight.integrate import prior
from treadlight.integrate.edges import curl_scale
from treadlight.integrate.gather import ViewNormals, view_field
from treadlight.integrate.laser import LaserCells, held_out, laser_cells
from treadlight.integrate.quality import frame_std
from treadlight.integrate.uncertainty import (
    compare_held_out,
    coverage_factor,
    points_per_error,
)


def sector():
    return CylinderGrid.sector((0.0, 0.2), (-10.0, 10.0), 0.5, 300.0)


def view_at(theta, z, slope, std=0.02):
    """A view whose pixels have given scene points and one slope everywhere."""
    normal = np.stack([np.ones_like(theta), -slope[0] + 0 * theta, -slope[1] + 0 * theta], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    covariance = np.zeros((*theta.shape, 3))
    covariance[..., [0, 2]] = std**2
    none = np.zeros(theta.shape, bool)
    r = np.full(theta.shape, 300.0)
    return ViewNormals(normal, covariance, r, theta, z, normal, none, none, none)


def test_slopes_and_their_variance_follow_from_the_normal():
    """dp = (1 + p^2) sqrt(1 + p^2 + q^2) dn_theta, to first order."""
    grid = sector()
    theta, z = np.meshgrid(grid.theta, grid.z, indexing="ij")
    field = view_field(view_at(theta, z, (0.3, -0.2)), grid)
    np.testing.assert_allclose(field.slope[0], 0.3, atol=1e-6)
    np.testing.assert_allclose(field.slope[1], -0.2, atol=1e-6)
    factor = 1 + 0.09 + 0.04
    np.testing.assert_allclose(field.variance[0], 1.09**2 * factor * 0.0004, rtol=1e-5)
    np.testing.assert_allclose(field.variance[1], 1.04**2 * factor * 0.0004, rtol=1e-5)


def test_a_view_over_the_seam_of_a_whole_turn_stays_in_one_piece():
    grid = CylinderGrid(-np.pi + np.arange(180) * (2 * np.pi / 180), np.arange(0, 5, 0.5), 100.0)
    rows = np.arange(170, 195)
    theta, z = np.meshgrid(grid.theta[0] + rows * grid.step_theta, grid.z, indexing="ij")
    field = view_field(view_at(np.where(theta > np.pi, theta - 2 * np.pi, theta), z, (0, 0)), grid)
    assert set(field.rows[:25]) == set(rows % 180)
    assert len(field.rows) <= 26
    assert np.isfinite(field.slope[0][:25]).all()


def test_a_view_beside_the_grid_gives_nothing():
    grid = sector()
    theta, z = np.meshgrid(grid.theta + 1.0, grid.z, indexing="ij")
    assert view_field(view_at(theta, z, (0, 0)), grid) is None


def test_laser_points_move_to_cell_centres_along_the_slope():
    grid = sector()
    slope = np.full((2, *grid.shape), 0.1)
    theta = np.array([[grid.theta[4] + 0.3 * grid.step_theta, 5.0]])
    z = np.array([[grid.z[6] - 0.2, 0.0]])
    cells = laser_cells(np.full((1, 2), 300.0), theta, z, np.full((1, 2), 0.1), slope, grid)
    assert (cells.row.tolist(), cells.column.tolist()) == ([4], [6])
    expected = 300.0 - 0.1 * 0.3 * grid.step_theta * 300.0 + 0.1 * 0.2
    assert cells.value[0] == pytest.approx(expected, abs=1e-9)


def test_held_out_sections_have_neighbours_on_both_sides():
    out = held_out(45, 10)
    assert out.sum() == 4
    assert not out[0]
    assert not out[-1]
    assert not held_out(45, 0).any()


def test_curl_tells_noise_that_the_covariance_understates(rng):
    grid = sector()
    slope = rng.normal(0, 0.06, (2, *grid.shape))
    assert curl_scale(slope, np.full(slope.shape, 0.02**2), grid) == pytest.approx(3, rel=0.1)
    assert curl_scale(slope * np.nan, slope**2, grid) == 1.0


def test_first_surface_is_unsure_beside_its_steps_only():
    grid = sector()
    start = np.full(grid.shape, 300.0)
    start[:, 20:] -= 8.0
    std = prior.edge_std(start, np.full(grid.shape, 0.1), grid)
    assert np.allclose(std[:, :16], 0.1)
    assert (std[:, 19:21] > 3).all()


def test_complete_fills_from_the_nearest_cell():
    surface = np.array([[1.0, np.nan, np.nan, 4.0]])
    assert prior.complete(surface).tolist() == [[1, 1, 4, 4]]
    with pytest.raises(ValueError, match="no finite cell"):
        prior.complete(surface * np.nan)


def test_held_out_comparison_takes_the_lasers_own_noise_out(rng):
    n = 4000
    r = rng.normal(0, 0.06, (1, n))
    held = LaserCells(
        np.zeros(n, int), np.arange(n), rng.normal(0.01, 0.1, n), np.full(n, 0.1), np.zeros(n, int)
    )
    found = compare_held_out(r, held)
    assert found.shape_rms == pytest.approx(0.061, rel=0.15)
    assert found.bias == pytest.approx(0.01, abs=0.006)
    # Told 0.02, the truth is 0.06.
    factor = coverage_factor(r, np.full(r.shape, 0.02), held)
    assert factor == pytest.approx(3, rel=0.15)
    assert coverage_factor(r, np.full(r.shape, 0.02), held.select(np.arange(n) < 5)) == 1.0


def test_points_whose_errors_go_together_count_as_fewer(rng):
    """A moving mean over five independent errors: 1 + 2 (0.8 + 0.6 + 0.4 + 0.2) = 5 points."""
    sections, n = 40, 500
    section, column = (a.ravel() for a in np.mgrid[:sections, :n])
    white = rng.normal(0, 0.1, (sections, n + 4))
    alike = np.lib.stride_tricks.sliding_window_view(white, 5, axis=1).mean(axis=2)
    r = np.full((sections, n), 300.0)
    for values, expected in ((white[:, :n], 1), (alike, 5)):
        laser = LaserCells(
            section, column, 300 + values.ravel(), np.full(section.size, 0.1), section
        )
        assert points_per_error(laser, r) == pytest.approx(expected, rel=0.15)
    assert points_per_error(laser.select(np.zeros(section.size, bool)), r) == 1.0


def test_frame_uncertainty_follows_from_the_axis():
    names = tuple(f"axis.{part}.{k}" for part in ("direction", "point") for k in "xyz")
    axis = Axis(np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1000.0]))
    camera = Camera(np.eye(3), np.zeros(5), (10, 10))
    covariance = np.diag([1e-8, 0, 4e-8, 0.01, 0.04, 0.09])
    rig = Rig(camera, axis=axis, covariance_order=names, covariance=covariance)
    found = frame_std(rig)
    assert found["radial_mm"] == pytest.approx(0.3)
    assert found["axial_mm"] == pytest.approx(0.2)
    assert found["tilt_rad"] == pytest.approx(np.sqrt(5e-8))
    assert frame_std(Rig(camera, axis=axis))["radial_mm"] is None
