import numpy as np
import pytest

from treadlight.geometry import CylinderGrid
from treadlight.tread import FLOOR, OTHER, OUTSIDE, TOP, find_regions


def measured(tread, grid, rng, noise=0.15, missing=0.1):
    r = tread.radius(grid.theta, grid.z) + noise * rng.standard_normal(grid.shape)
    r[rng.random(grid.shape) < missing] = np.nan
    return r


@pytest.mark.parametrize("name", ["whole", "sector", "coarse"])
@pytest.mark.parametrize("count", [0, 1, 2, 3, 5])
def test_all_grooves_are_found_where_they_are(treads, grids, rng, count, name):
    tread, grid = treads[count], grids[name]
    regions = find_regions(measured(tread, grid, rng), grid)
    assert len(regions.grooves) == count
    assert len(regions.ribs) == count + 1
    for (low, high), (centre, half, _) in zip(regions.grooves, tread.grooves, strict=True):
        assert abs(low - (centre - half)) <= grid.step_z
        assert abs(high - (centre + half)) <= grid.step_z


def test_regions_are_numbered_by_increasing_z(treads, grids, rng):
    regions = find_regions(measured(treads[3], grids["sector"], rng), grids["sector"])
    z = regions.z
    for numbers in (regions.groove_of_column, regions.rib_of_column, regions.floor_of_column):
        assert np.all(np.diff(numbers[numbers > 0]) >= 0)
    assert regions.rib_of_column[np.argmin(np.abs(z + 80))] == 1
    assert regions.groove_of_column[np.argmin(np.abs(z))] == 2


def test_classes_tell_tops_floors_bars_and_lateral_grooves(treads, grids, rng):
    grid, tread = grids["sector"], treads[3]
    truth = tread.radius(grid.theta, grid.z)
    regions = find_regions(measured(tread, grid, rng), grid)
    classes = regions.classify(truth, grid.theta)
    height = truth - tread.floor(grid.z) - tread.runout(grid.theta, grid.z)
    assert np.mean(classes[np.isclose(height, 8.0)] == TOP) > 0.97
    assert np.all(classes[np.isclose(height, 1.0)] == OTHER)
    bars = np.isclose(height, 1.6)
    assert bars.any()
    assert np.all(classes[bars] != FLOOR)
    floors = np.isclose(height, 0.0) & (regions.floor_of_column > 0)
    assert np.mean(classes[floors] == FLOOR) > 0.97
    assert abs(regions.depth_mm - 8.0) < 0.2
    assert abs(regions.noise_mm - 0.15) < 0.05


def test_missing_cells_are_no_top_and_no_floor(treads, grids, rng):
    grid = grids["sector"]
    r = measured(treads[1], grid, rng)
    classes = find_regions(r, grid).classify(r, grid.theta)
    assert not np.isin(classes[np.isnan(r)], (TOP, FLOOR)).any()


def test_the_shoulder_is_neither_rib_nor_groove(treads, rng):
    from dataclasses import replace

    grid = CylinderGrid.sector((0.0, 1.0), (-100.0, 100.0), 1.0, 305.0)
    tread = replace(treads[3], shoulder=True)
    regions = find_regions(measured(tread, grid, rng), grid)
    assert len(regions.grooves) == 3
    assert abs(regions.ribs[0][0] + 83.5) < 2.5
    assert abs(regions.ribs[-1][1] - 83.5) < 2.5
    r = tread.radius(grid.theta, grid.z)
    assert np.all(regions.classify(r, grid.theta)[:, grid.z < -90] == OUTSIDE)


def test_worn_tread_of_two_millimetres_still_has_its_grooves(treads, grids, rng):
    grid = grids["whole"]
    r = measured(treads[3], grid, rng, noise=0.1)
    crown = find_regions(r, grid).crown
    worn = np.minimum(r, crown - 6.0 + treads[3].runout(grid.theta, grid.z))
    assert len(find_regions(worn, grid).grooves) == 3


def test_nothing_measured_is_no_region(grids):
    grid = grids["sector"]
    regions = find_regions(np.full(grid.shape, np.nan), grid)
    assert regions.grooves == ()
    assert regions.ribs == ()
    assert np.isnan(regions.depth_mm)
    assert np.all(regions.classify(np.full(grid.shape, np.nan), grid.theta) == OUTSIDE)


def test_regions_carry_over_to_finer_columns(treads, grids, rng):
    coarse = grids["coarse"]
    regions = find_regions(measured(treads[3], coarse, rng), coarse)
    fine = np.arange(-85.0, 85.0, 0.2)
    moved = regions.on_columns(fine)
    assert moved.grooves == regions.grooves
    inside = np.abs(fine) < 3.0
    assert np.all(moved.groove_of_column[inside] == 2)
    assert np.all(moved.floor_of_column[np.abs(fine) < 1.0] == 2)
    assert np.isfinite(moved.floor[moved.floor_of_column > 0]).all()
