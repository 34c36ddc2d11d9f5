from dataclasses import replace

import numpy as np
import pytest

from treadlight.geometry import CylinderGrid
from treadlight.tread import find_regions, fit_reference


def fitted(tread, grid, rng, noise=0.1, spoil=None):
    r = tread.radius(grid.theta, grid.z) + noise * rng.standard_normal(grid.shape)
    if spoil is not None:
        spoil(r)
    regions = find_regions(r, grid)
    return r, regions, fit_reference(r, np.full(grid.shape, noise), grid, regions)


@pytest.mark.parametrize("name", ["whole", "sector"])
@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_height_is_nil_on_floors_and_the_depth_on_tops(treads, grids, rng, count, name):
    tread, grid = treads[count], grids[name]
    _, _, reference = fitted(tread, grid, rng)
    truth = tread.radius(grid.theta, grid.z)
    height = reference.height(truth, grid.theta, grid.z)
    inside = np.abs(grid.z) < 75
    local = truth - tread.floor(grid.z) - tread.runout(grid.theta, grid.z)
    floors = np.isclose(local, 0.0)
    assert abs(np.median(height[floors])) < 0.01
    assert np.abs(height[floors]).max() < 0.06
    tops = np.isclose(local, 8.0) & inside
    assert abs(np.median(height[tops]) - 8.0) < 0.05


def test_the_tires_own_axis_is_found_on_a_whole_turn(treads, grids, rng):
    tread = treads[3]
    _, _, reference = fitted(tread, grids["whole"], rng)
    np.testing.assert_allclose(reference.runout.offset_mm, tread.offset_mm, atol=0.01)
    np.testing.assert_allclose(reference.runout.tilt_rad, tread.tilt_rad, atol=2e-4)


def test_out_of_round_is_followed_on_a_whole_turn(treads, grids, rng):
    grid = grids["whole"]
    wave = 0.2 * np.cos(3 * grid.theta + 1)[:, None]

    def spoil(r):
        r += wave

    _, _, reference = fitted(treads[3], grid, rng, spoil=spoil)
    expected = treads[3].runout(grid.theta, grid.z) + wave
    found = reference.runout.radius(grid.theta, grid.z)
    assert np.abs(found - expected).max() < 0.02


def test_ghosts_on_a_tenth_of_the_floor_do_not_move_it(treads, grids, rng):
    grid = grids["sector"]

    def spoil(r):
        rows = slice(0, grid.shape[0] // 10)
        r[rows, np.abs(grid.z) < 6] += 3.0

    _r, _, reference = fitted(treads[3], grid, rng, spoil=spoil)
    clean = treads[3].radius(grid.theta, grid.z)
    floors = np.isclose(clean - treads[3].floor(grid.z) - treads[3].runout(grid.theta, grid.z), 0.0)
    height = reference.height(clean, grid.theta, grid.z)[floors]
    assert abs(np.median(height)) < 0.02


def test_a_sector_does_not_blow_up(treads, rng):
    grid = CylinderGrid.sector((0.0, 0.3), (-90.0, 90.0), 1.0, 305.0)
    _, _, reference = fitted(treads[2], grid, rng, noise=0.2)
    assert np.abs(reference.runout.offset_mm).max() < 1.5
    shape = treads[2].floor(grid.z) + treads[2].runout(grid.theta, grid.z)
    floors = np.abs(np.abs(grid.z) - 30) < 4
    error = reference.radius(grid.theta, grid.z) - shape
    assert np.abs(error[:, floors]).max() < 0.1


def test_a_ribs_depth_counts_from_the_groove_that_is_asked_for(treads, grids, rng):
    deep, shallow = (-30.0, 5.0, 8.0), (30.0, 5.0, 6.5)
    tread = replace(treads[0], grooves=(deep, shallow), crown_per_mm=0.0)
    grid = grids["whole"]
    _, _, reference = fitted(tread, grid, rng)
    top = tread.floor(grid.z) + 8.0 + tread.runout(grid.theta, grid.z)
    for groove, depth in ((1, 8.0), (2, 6.5)):
        height = top - reference.radius(grid.theta, grid.z, groove)
        assert np.abs(height - depth).max() < 0.05


def test_without_grooves_the_height_is_unknown_and_a_sentence_says_why(treads, grids, rng):
    grid = grids["sector"]
    r, _, reference = fitted(treads[0], grid, rng)
    assert reference.reason.startswith("No circumferential groove")
    assert np.isnan(reference.height(r, grid.theta, grid.z)).all()


def test_grooves_without_floors_have_their_own_sentence(treads, grids, rng):
    grid = grids["sector"]
    r, regions, _ = fitted(treads[2], grid, rng)
    r[:, regions.groove_of_column > 0] = np.nan
    reference = fit_reference(r, None, grid, regions)
    assert "floors hold no radius" in reference.reason
