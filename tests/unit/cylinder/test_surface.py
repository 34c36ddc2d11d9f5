import dataclasses

import numpy as np
import pytest

from treadlight.cylinder import SURFACE_FLAGS, Extent, choose_grid, first_surface, lay_surface
from treadlight.cylinder.smoothing import shared_rows
from treadlight.cylinder.surface import fill_columns
from treadlight.geometry import CylinderGrid
from treadlight.spool import Spool

NOMINAL = 300.0
LASER, INTERPOLATED, EXTRAPOLATED, STEP, NOMINAL_FLAG = (1 << k for k in range(5))
TURN = np.radians(np.arange(0, 360, 2.0))


def on(grid, surface):
    return surface(grid.theta[:, None], grid.z[None, :])


def away_from_walls(grid):
    return np.abs(np.abs(grid.z - 12) - 5) > 1.0


def test_whole_turn_is_complete_sharp_and_less_noisy_than_its_points(sections_of, grooved, rng):
    found = sections_of(grooved, TURN, noise=0.1, rng=rng)
    grid = choose_grid(found, [], 1.0, NOMINAL, 80.0)
    surface = first_surface(found, grid, 0.6)
    error = (surface.r - on(grid, grooved))[:, away_from_walls(grid)]
    assert np.isfinite(surface.r).all()
    assert abs(np.mean(error)) < 0.01
    assert np.std(error) < 0.07
    assert np.abs(error).max() < 0.5


def test_r_std_covers_the_errors(sections_of, grooved, rng):
    found = sections_of(grooved, TURN, noise=0.1, rng=rng)
    grid = choose_grid(found, [], 1.0, NOMINAL, 80.0)
    surface = first_surface(found, grid, 0.6)
    share = np.abs(surface.r - on(grid, grooved)) / surface.r_std
    share = share[:, away_from_walls(grid)]
    assert 0.6 < np.mean(share < 1) < 0.85
    assert np.mean(share < 2) > 0.9


def test_whole_turn_does_not_know_where_it_begins(sections_of, grooved):
    """Turning the tire by a whole number of cells rolls the surface."""
    n = round(2 * np.pi * NOMINAL)
    shift = 700 * 2 * np.pi / n

    def turned(theta, z):
        return grooved(theta - shift, z)

    found = sections_of(grooved, TURN)
    grid = choose_grid(found, [], 1.0, NOMINAL, 80.0)
    moved = dataclasses.replace(
        sections_of(turned, TURN), theta=found.theta + shift, r=found.r.copy()
    )
    a, b = first_surface(found, grid, 0.6), first_surface(moved, grid, 0.6)
    np.testing.assert_allclose(np.roll(a.r, 700, axis=0), b.r, atol=1e-3)
    np.testing.assert_allclose(np.roll(a.r_std, 700, axis=0), b.r_std, atol=1e-3)


def test_laser_cells_lie_along_the_sections_only(sections_of, grooved):
    found = sections_of(grooved, TURN)
    grid = choose_grid(found, [], 1.0, NOMINAL, 80.0)
    surface = first_surface(found, grid, 0.6)
    share = np.isfinite(surface.laser_r).mean()
    assert share == pytest.approx(len(TURN) / len(grid.theta), rel=0.02)
    held = np.isfinite(surface.laser_r)
    np.testing.assert_array_equal(surface.r[held], surface.laser_r[held])
    assert np.array_equal(surface.quality == LASER, held)


def test_groove_edges_stay_within_a_row(sections_of, grooved):
    found = sections_of(grooved, TURN)
    grid = choose_grid(found, [], 0.5, NOMINAL, 80.0)
    surface = first_surface(found, grid, 0.6)
    wrong = np.abs(surface.r - on(grid, grooved)) > 1
    assert np.all(np.abs(np.abs(grid.z[wrong.any(axis=0)] - 12) - 5) <= 0.5)
    assert surface.r[:, np.abs(grid.z - 12) < 4].max() < NOMINAL - 7


def test_missing_sections_are_bridged_up_to_three_spacings_then_nan(sections_of, grooved, rng):
    keep = np.delete(TURN[:60], np.r_[20, 40:46])
    found = sections_of(grooved, keep)
    found.r[:] += 0.2 * rng.standard_normal((len(keep), 1))
    grid = choose_grid(found, [], 1.0, NOMINAL, 80.0)
    surface = first_surface(found, grid, 0.6)
    row = grid.index(-np.array([TURN[20], TURN[42]]), np.zeros(2))[0].round().astype(int)
    assert np.isfinite(surface.r[row[0]]).all()
    assert np.isnan(surface.r[row[1], ::10]).all()
    beside = grid.index(-np.array([TURN[19]]), np.zeros(1))[0].round().astype(int)[0]
    assert surface.r_std[row[0], 20] > surface.r_std[beside, 20]


def test_view_carries_the_surface_where_no_section_reaches(sections_of, grooved, rng):
    found = sections_of(grooved, TURN[:20])
    found.r[:] += 0.05 * rng.standard_normal((20, 1))
    view = Extent(-np.radians(80), np.radians(60), -40.0, 40.0)
    grid = choose_grid(found, [view], 1.0, NOMINAL, 80.0)
    surface = lay_surface(found, [view], grid, 0.6)
    assert np.isfinite(surface.r).all()
    far = grid.index(-np.radians(70), 0.0)[0].round().astype(int)
    assert np.all(surface.quality[far] & EXTRAPOLATED)
    error = (surface.r[far] - grooved(grid.theta[far], grid.z))[away_from_walls(grid)]
    assert np.abs(error).max() < 0.5
    assert np.median(surface.r_std[far]) > 3 * np.median(surface.r_std[grid.shape[0] // 2 :])


def test_slot_that_one_section_met_reaches_a_quarter_of_the_way(sections_of):
    found = sections_of(lambda theta, z: np.full(np.shape(z), NOMINAL), TURN[:30])
    found.r[15, 60:80] -= 7
    grid = choose_grid(found, [], 0.5, NOMINAL, 80.0)
    surface = first_surface(found, grid, 0.6)
    z = np.argmin(np.abs(grid.z - found.z[15, 70]))
    deep = surface.r[:, z] < NOMINAL - 3
    width = deep.sum() * grid.step_theta
    assert width == pytest.approx(0.5 * np.radians(2), rel=0.15)
    assert np.all(surface.quality[deep, z] & (STEP | LASER))
    assert surface.r_std[deep, z].max() > 1


@pytest.mark.parametrize("last", [0, 29])
def test_slot_that_the_last_section_met_does_not_go_on_beyond_it(sections_of, last):
    """But for a quarter of the way to the next section, as between two."""
    found = sections_of(lambda theta, z: np.full(np.shape(z), NOMINAL), TURN[:30])
    found.r[last, 60:80] -= 7
    view = Extent(-np.radians(62), np.radians(66), -40.0, 40.0)
    grid = choose_grid(found, [view], 0.5, NOMINAL, 80.0)
    surface = lay_surface(found, [view], grid, 0.6)
    z = np.argmin(np.abs(grid.z - found.z[last, 70]))
    deep = surface.r[:, z] < NOMINAL - 3
    assert deep.sum() * grid.step_theta == pytest.approx(0.5 * np.radians(2), rel=0.15)
    assert np.isfinite(surface.r[:, z]).all()
    np.testing.assert_allclose(surface.r[~deep, z], NOMINAL, atol=0.01)


def test_columns_in_which_no_section_agrees_go_on_as_the_nearest(sections_of):
    found = sections_of(lambda theta, z: np.full(np.shape(z), NOMINAL), TURN[:30])
    found.r[:, 60:80] += 10.0 * np.arange(30)[:, None]
    view = Extent(-np.radians(62), np.radians(66), -40.0, 40.0)
    grid = choose_grid(found, [view], 0.5, NOMINAL, 80.0)
    surface = lay_surface(found, [view], grid, 0.6)
    z = np.argmin(np.abs(grid.z - found.z[0, 70]))
    # Theta runs against the encoder.
    ends = surface.r[[20, -20], z]
    np.testing.assert_allclose(ends, [NOMINAL + 290, NOMINAL], atol=0.1)


def test_a_surface_laid_some_columns_at_a_time_in_a_file_is_the_same(
    sections_of, grooved, rng, monkeypatch, tmp_path
):
    found = sections_of(grooved, TURN[:20], noise=0.1, rng=rng)
    found.r[:, 50:60] = np.nan
    view = Extent(-np.radians(80), np.radians(60), -40.0, 40.0)
    grid = choose_grid(found, [view], 1.0, NOMINAL, 80.0)
    whole = lay_surface(found, [view], grid, 0.6)
    monkeypatch.setattr("treadlight.cylinder.surface._COLUMNS", 7)
    parts = lay_surface(found, [view], grid, 0.6, Spool(tmp_path))
    for name in ("r", "r_std", "laser_r", "quality"):
        np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))


def test_lines_that_no_section_sees_are_filled_along_z(sections_of, grooved):
    found = sections_of(grooved, TURN)
    found.r[:, 50:60] = np.nan
    found.r_std[:, 50:60] = np.nan
    grid = choose_grid(found, [], 1.0, NOMINAL, 80.0)
    surface = first_surface(found, grid, 0.6)
    lost = (grid.z > found.z[0, 51]) & (grid.z < found.z[0, 58])
    assert np.isfinite(surface.r).all()
    assert np.all(surface.quality[:, lost] & EXTRAPOLATED)
    assert np.abs(surface.r - on(grid, grooved))[:, lost].max() < 0.3
    assert surface.r_std[:, lost].min() > 1.5 * np.median(surface.r_std)


def test_doubtful_points_do_not_speak(sections_of, grooved):
    found = sections_of(grooved, TURN)
    found.r[30, 20:40] -= 2
    found.r_std[30, 20:40] = 1.0
    grid = choose_grid(found, [], 1.0, NOMINAL, 80.0)
    surface = first_surface(found, grid, 0.6)
    z = (grid.z > found.z[0, 20]) & (grid.z < found.z[0, 39])
    assert np.abs(surface.r - on(grid, grooved))[:, z].max() < 0.1


def test_without_a_laser_the_surface_is_the_nominal_cylinder_and_says_so(sections_of, grooved):
    view = Extent(-0.2, 0.4, -40.0, 40.0)
    none = sections_of(grooved, [])
    grid = choose_grid(none, [view], 1.0, NOMINAL, 80.0)
    surface = lay_surface(none, [view], grid, 0.6)
    assert np.all(surface.r == NOMINAL)
    assert np.all(surface.r_std == 8.0)
    assert np.all(surface.quality == NOMINAL_FLAG)
    assert SURFACE_FLAGS[4] == "nominal"
    assert np.isnan(surface.laser_r).all()


def test_one_section_alone_gives_a_strip(sections_of, grooved):
    found = sections_of(grooved, [0.0])
    grid = CylinderGrid.sector((-0.1, 0.1), (-40.0, 40.0), 1.0, NOMINAL)
    surface = first_surface(found, grid, 0.6)
    known = np.isfinite(surface.r).any(axis=1)
    assert known.any()
    assert not known.all()


def test_shared_rows_measures_the_smoothing_of_the_noise(sections_of, grooved, rng):
    from scipy.ndimage import gaussian_filter1d

    found = sections_of(lambda theta, z: np.full(np.shape(z), NOMINAL), TURN, noise=0.1, rng=rng)
    smooth = dataclasses.replace(found, r=gaussian_filter1d(found.r, 1.5, axis=1))
    assert shared_rows(found, 1.0) < 2.2
    assert shared_rows(smooth, 1.0) == pytest.approx(2 * np.sqrt(np.pi) * 1.5, rel=0.3)


def test_sections_in_one_cell_are_averaged_by_their_certainty():
    row = np.array([[5.0], [5.2], [20.0]])
    r = np.array([[1.0], [2.0], [1.5]])
    variance = np.array([[1.0], [0.25], [1.0]])
    surface, var, laser, quality = fill_columns(row, r, variance, 30, False, 5.0, 15.0, 9.0, 0.0)
    assert laser[5, 0] == pytest.approx((1.0 + 4 * 2.0) / 5)
    assert surface[5, 0] == laser[5, 0]
    assert var[5, 0] == pytest.approx(0.2)
    assert quality[12, 0] == INTERPOLATED
