import numpy as np
import pytest

from treadlight import tread
from treadlight.geometry import Axis, Camera, CylinderGrid, Rig
from treadlight.integrate import prior
from treadlight.integrate.confirm import confirm
from treadlight.integrate.edges import curl_scale, merge_views
from treadlight.integrate.gather import ViewField, ViewNormals, view_field
from treadlight.integrate.laser import LaserCells, held_out, laser_cells
from treadlight.integrate.quality import frame_std
from treadlight.integrate.uncertainty import compare_held_out, coverage_factor


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
    field = view_field([view_at(theta, z, (0.3, -0.2))], grid)
    np.testing.assert_allclose(field.slope[0], 0.3, atol=1e-6)
    np.testing.assert_allclose(field.slope[1], -0.2, atol=1e-6)
    factor = 1 + 0.09 + 0.04
    np.testing.assert_allclose(field.variance[0], 1.09**2 * factor * 0.0004, rtol=1e-5)
    np.testing.assert_allclose(field.variance[1], 1.04**2 * factor * 0.0004, rtol=1e-5)


def test_a_view_over_the_seam_of_a_whole_turn_stays_in_one_piece():
    grid = CylinderGrid(-np.pi + np.arange(180) * (2 * np.pi / 180), np.arange(0, 5, 0.5), 100.0)
    rows = np.arange(170, 195)
    theta, z = np.meshgrid(grid.theta[0] + rows * grid.step_theta, grid.z, indexing="ij")
    field = view_field(
        [view_at(np.where(theta > np.pi, theta - 2 * np.pi, theta), z, (0, 0))], grid
    )
    assert set(field.rows[:25]) == set(rows % 180)
    assert len(field.rows) <= 26
    assert np.isfinite(field.slope[0][:25]).all()


def test_pixels_between_a_turns_last_row_and_its_first_are_shared_by_both():
    grid = CylinderGrid(-np.pi + np.arange(180) * (2 * np.pi / 180), np.arange(0, 5, 0.5), 100.0)
    theta, z = np.meshgrid([np.pi - 0.5 * grid.step_theta], grid.z, indexing="ij")
    field = view_field([view_at(theta, z, (0.3, 0))], grid)
    known = dict(zip(field.rows.tolist(), np.isfinite(field.slope[0]).all(axis=1), strict=True))
    assert known[179]
    assert known[0]


def test_a_view_beside_the_grid_gives_nothing():
    grid = sector()
    theta, z = np.meshgrid(grid.theta + 1.0, grid.z, indexing="ij")
    assert view_field([view_at(theta, z, (0, 0))], grid) is None


def test_a_view_beside_the_columns_gives_nothing():
    grid = sector()
    theta, z = np.meshgrid(grid.theta, grid.z + 100.0, indexing="ij")
    assert view_field([view_at(theta, z, (0, 0))], grid) is None


def test_views_are_merged_by_their_information_times_their_blend():
    grid = sector()
    one, other = (np.full((3, 2, *grid.shape), value, np.float32) for value in (1.0, 3.0))
    rows = np.arange(grid.shape[0])

    def field(values, variance, blend):
        flags = np.stack([values[0, 0]] * 3) / 10
        share = np.full(len(rows), blend, np.float32)
        spread = np.full((2, *grid.shape), variance, np.float32)
        return ViewField(rows, values[0], spread, values[:, 0], flags, share)

    merged = merge_views([field(one, 0.01, 0.25), field(other, 0.04, 0.75)], grid)
    information = 0.25 / 0.01 + 0.75 / 0.04
    slope = (0.25 / 0.01 * 1 + 0.75 / 0.04 * 3) / information
    np.testing.assert_allclose(merged.slope, slope, rtol=1e-6)
    # Each view's information counts by its blend relative to the largest one.
    np.testing.assert_allclose(merged.variance, 0.75 / information, rtol=1e-6)
    np.testing.assert_allclose(merged.material, 2.5, rtol=1e-6)
    np.testing.assert_allclose(merged.flags, 0.25, rtol=1e-6)


def test_what_an_open_grid_cuts_off_a_view_counts_in_its_blend():
    whole = CylinderGrid.sector((0.0, 0.4), (-10.0, 10.0), 0.5, 100.0)
    theta, z = np.meshgrid(whole.theta[10:60] + 0.001, whole.z, indexing="ij")
    view = view_at(theta, z, (0.0, 0.0))
    complete = view_field([view], whole)
    part = view_field([view], whole.part(np.arange(40, 80)))
    inside = np.searchsorted(complete.rows, 40 + part.rows)
    np.testing.assert_allclose(part.blend, complete.blend[inside], atol=1e-6)


def test_a_view_in_blocks_is_the_view(monkeypatch):
    grid = CylinderGrid.sector((0.0, 0.4), (-10.0, 10.0), 0.5, 100.0)
    theta, z = np.meshgrid(grid.theta[10:60] + 0.001, grid.z, indexing="ij")
    view = view_at(theta, z, (0.1, 0.2))
    at_once = view_field([view], grid)
    monkeypatch.setattr("treadlight.integrate.gather._BLOCK_PX", 3 * theta.shape[1])
    blocks = list(view.blocks(grid))
    assert len(blocks) > 10
    in_blocks = view_field(blocks, grid)
    for name in ("rows", "slope", "variance", "material", "flags", "blend"):
        np.testing.assert_array_equal(getattr(in_blocks, name), getattr(at_once, name))


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


def test_first_surface_is_unsure_beside_its_steps_and_follows_the_outline_elsewhere():
    """Between steps its own differences are noise: the outline's take their place."""
    grid = sector()
    rng = np.random.default_rng(2)
    outline = 300.0 + 0.1 * grid.z + np.zeros(grid.shape)
    start = outline + rng.normal(0, 0.01, grid.shape)
    start[:, 20:] -= 8.0
    std = np.full(grid.shape, 0.1)
    bridged = np.zeros(grid.shape, bool)
    bridged[10] = True
    found = prior.first_edges(start, std, bridged, outline, 2e-3, grid)
    np.testing.assert_allclose(found.step[1, :9, :16], 0.1 * grid.step_z, rtol=1e-4)
    np.testing.assert_allclose(found.std[1, :9, :16], np.sqrt(2e-3 * grid.step_z), rtol=1e-5)
    along = grid.step_theta * grid.nominal_radius_mm
    np.testing.assert_allclose(found.std[0, :9, :16], np.sqrt(2e-3 * along), rtol=1e-5)
    assert (found.std[1, :, 19:20] > 3).all()
    np.testing.assert_allclose(found.std[1, 10, :16], 0.1, rtol=1e-5)
    np.testing.assert_allclose(found.step[1, 10, :16], np.diff(start[10, :17]), atol=1e-4)


def test_an_edge_to_a_cell_that_nothing_knows_has_no_step():
    grid = sector()
    std = np.full(grid.shape, 0.1)
    std[5, 7] = np.nan
    surface = np.full(grid.shape, 300.0)
    found = prior.first_edges(surface, std, np.zeros(grid.shape, bool), surface, 1e-3, grid)
    unknown = np.isnan(found.step)
    assert unknown[0, 4, 7]
    assert unknown[0, 5, 7]
    assert unknown[1, 5, 6]
    assert unknown[1, 5, 7]
    assert unknown.sum() == 4


def ribbed(grid):
    """Regions of a tread with one groove, its outline, and the sections' columns."""
    surface = 300.0 - 8.0 * (np.abs(grid.z) < 3) + np.zeros(grid.shape)
    regions = tread.find_regions(surface, grid)
    return surface, regions, prior.outline(surface, regions, grid)


@pytest.mark.parametrize("drift", [0.0, 4e-3])
def test_drift_is_what_differences_grow_by_beyond_the_noise(rng, drift):
    """A random walk of so much variance per mm under white noise of 0.1 mm."""
    grid = CylinderGrid.sector((0.0, 1.2), (-60.0, 60.0), 0.5, 300.0)
    surface, regions, outline = ribbed(grid)
    count, columns = 60, grid.shape[1]
    walk = np.cumsum(rng.normal(0, np.sqrt(drift * grid.step_z), (count, columns)), axis=1)
    values = 300.0 + walk + rng.normal(0, 0.1, walk.shape)
    section, column = np.mgrid[:count, :columns]
    row = section * (grid.shape[0] // count)
    values = values + (surface[row, column] - 300.0)
    laser = LaserCells(
        row.ravel(), column.ravel(), values.ravel(), np.full(row.size, 0.1), section.ravel()
    )
    found = prior.drift_rate(laser, outline, regions, 24.0, grid)
    if drift:
        assert found == pytest.approx(drift, rel=0.25)
    else:
        assert 0 < found < 3e-4
    nothing = laser.select(np.zeros(row.size, bool))
    assert prior.drift_rate(nothing, outline, regions, 24.0, grid) is None


def sections_on(surface, grid, count, std, rng):
    """Laser points at every column of evenly spread sections, with white noise."""
    rows = np.linspace(0, grid.shape[0] - 1, count).round().astype(int)
    row, column = (a.ravel() for a in np.meshgrid(rows, np.arange(grid.shape[1]), indexing="ij"))
    section = np.repeat(np.arange(count), grid.shape[1])
    value = surface[row, column] + rng.normal(0, std, row.size)
    return LaserCells(row, column, value, np.full(row.size, std), section)


@pytest.mark.parametrize("real", [True, False])
def test_slow_relief_of_the_slopes_counts_as_far_as_the_sections_confirm_it(rng, real):
    """Waves of 0.15 mm over 16 mm: measured by both, or by the normals alone."""
    grid = CylinderGrid.sector((0.0, 1.0), (-40.0, 40.0), 0.5, 300.0)
    theta, z = np.meshgrid(grid.theta, grid.z, indexing="ij")
    wave = 2 * np.pi / 16
    shape = 0.15 * np.sin(wave * theta * 300) * np.sin(wave * z)
    p = 0.15 * wave * np.cos(wave * theta * 300) * np.sin(wave * z)
    q = 0.15 * wave * np.sin(wave * theta * 300) * np.cos(wave * z)
    field = view_field([view_at(theta, z, (p, q))], grid)
    outline = np.full(grid.shape, 300.0)
    laser = sections_on(outline + real * shape, grid, 38, 0.03, rng)
    walls = np.zeros(grid.shape, bool)
    spacing = grid.shape[0] / 37
    (drawn,) = confirm([field], laser, outline, walls, spacing, grid)
    kept = np.std(drawn.slope[0]) / np.std(field.slope[0])
    assert kept > 0.9 if real else kept < 0.5


def test_a_dent_that_stands_out_of_the_slopes_is_not_drawn_in(rng):
    """Slopes of ten times the usual deviation are no error, even where no section can confirm."""
    grid = CylinderGrid.sector((0.0, 1.0), (-40.0, 40.0), 0.5, 300.0)
    theta, z = np.meshgrid(grid.theta, grid.z, indexing="ij")
    p, q = rng.normal(0, 0.05, (2, *grid.shape))
    dent = (np.abs(theta - 0.5) * 300 < 4) & (np.abs(z) < 4)
    p = np.where(dent, p + 0.2 * np.sign(theta - 0.5), p)
    field = view_field([view_at(theta, z, (p, q))], grid)
    outline = np.full(grid.shape, 300.0)
    laser = sections_on(outline, grid, 38, 0.05, rng)
    walls = np.zeros(grid.shape, bool)
    (drawn,) = confirm([field], laser, outline, walls, grid.shape[0] / 37, grid)
    sign = np.sign(theta - 0.5)
    before, after = (np.mean((f.slope[0] * sign)[dent]) for f in (field, drawn))
    assert after > 0.85 * before


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


def held_out_points(n, std, laser_std, rng):
    """Heights (1, n) off by `std`, and points of every cell off by `laser_std`, as they say."""
    r = rng.normal(0, std, (1, n))
    value = rng.normal(0, laser_std, n)
    zero = np.zeros(n, int)
    return r, LaserCells(zero, np.arange(n), value, np.full(n, laser_std), zero)


def test_held_out_points_ask_for_the_factor_that_they_prove(rng):
    r, held = held_out_points(40_000, 0.06, 0.1, rng)

    def told():
        return np.full(r.shape, 0.02)

    assert coverage_factor(r, told, held, 1.0) == pytest.approx(3, rel=0.15)
    assert coverage_factor(r, told, held, 1000.0) < 2
    assert coverage_factor(r, told, held.select(held.column < 5), 1.0) == 1.0


def test_held_out_points_whose_own_noise_explains_all_ask_for_no_deviation(rng):
    r, held = held_out_points(1000, 0.0, 0.1, rng)
    assert coverage_factor(r, lambda: pytest.fail("asked for"), held, 1.0) == 1.0


def test_held_out_points_that_differ_by_chance_ask_for_nothing(rng):
    """Their own noise is three times that of the heights, whose deviation is told as it is."""
    factors = []
    for _ in range(40):
        r, held = held_out_points(1000, 0.03, 0.1, rng)
        factors.append(coverage_factor(r, lambda r=r: np.full(r.shape, 0.03), held, 1.0))
    assert np.mean(np.array(factors) > 1 + 1e-9) < 0.1


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
