import itertools

import numpy as np
import pytest

from treadlight.geometry import CylinderGrid
from treadlight.wear import Alignment, Surface, align, relief_from, wear_block
from treadlight.wear.difference import rows_needed
from treadlight.wear.relief import reduce_rows, reduced_grid, smooth


def surface(r, grid, std=0.02):
    return Surface.of_arrays(r, np.full(grid.shape, std), grid)


@pytest.fixture(scope="module")
def pair(tire, make_grid, make_remount):
    """A tire worn by 0.12 mm, remounted a quarter turn on, 20 um of noise."""
    rng = np.random.default_rng(3)
    grid, motion = make_grid("whole"), make_remount(np.pi / 2)
    first = tire.mileage(grid) + 0.02 * rng.standard_normal(grid.shape)
    later = tire.mileage(grid, motion, 0.12) + 0.02 * rng.standard_normal(grid.shape)
    return surface(first, grid), surface(later, grid), motion


@pytest.fixture(scope="module")
def aligned(pair):
    return align(relief_from(pair[0]), relief_from(pair[1]))


def tops_of(tire, grid):
    height = tire.radius(grid.theta[:, None], grid.z) - tire.radius(
        grid.theta[:, None], grid.z, 8.0
    )
    return height > 7.99


def test_wear_of_a_remounted_tire_is_unbiased(tire, pair, aligned):
    """Mean within 10 um on tops; nil on floors; the spread is the noise's."""
    first, later, _ = pair
    rows = first.grid.shape[0]
    r, wear, _std = wear_block(first, later, aligned, 0, rows)
    tops = tops_of(tire, first.grid) & np.isfinite(wear)
    assert np.mean(tops) > 0.3
    assert abs(np.mean(wear[tops]) - 0.12) < 0.01
    flat = np.hypot(*np.gradient(first.read(0, rows)[0], 0.5)) < 0.1
    assert 0.015 < np.std(wear[tops & flat]) < 0.035
    floors = (np.abs(np.abs(first.grid.z) - 18) < 2) & np.isfinite(wear)
    assert abs(np.mean(wear[floors])) < 0.01
    np.testing.assert_allclose((first.read(0, rows)[0] - r)[tops], wear[tops], atol=1e-4)


def test_wear_std_covers_its_errors(tire, pair, aligned):
    first, later, _ = pair
    _, wear, std = wear_block(first, later, aligned, 0, first.grid.shape[0])
    tops = tops_of(tire, first.grid) & np.isfinite(wear)
    inside = np.abs(wear - 0.12)[tops] < std[tops]
    # Interpolation between cells averages noise, so rather more than 68 % lie inside.
    assert 0.6 < np.mean(inside) < 0.9


def test_walls_have_no_wear(tire, pair):
    first, later, motion = pair
    truth = Alignment(motion, np.zeros((7, 7)))
    _, wear, std = wear_block(first, later, truth, 0, first.grid.shape[0])
    walls = np.abs(np.abs(first.grid.z) - 18 - 4.0) < 0.3
    assert np.isnan(wear[:, walls]).mean() > 0.85
    assert np.array_equal(np.isnan(wear), np.isnan(std))


def test_blocks_join_to_what_one_block_gives(pair):
    first, later, motion = pair
    truth = Alignment(motion, 1e-6 * np.eye(7))
    rows = first.grid.shape[0]
    whole = wear_block(first, later, truth, 0, rows)
    cuts = [0, 300, 301, 900, rows]
    parts = [wear_block(first, later, truth, a, b) for a, b in itertools.pairwise(cuts)]
    for k in range(3):
        joined = np.concatenate([part[k] for part in parts])
        np.testing.assert_allclose(joined, whole[k], atol=2e-4)


def test_what_could_not_be_aligned_or_lies_outside_is_nan(tire, make_grid):
    grid, other = make_grid((0.0, 0.8)), make_grid((2.0, 2.8))
    first, later = surface(tire.mileage(grid), grid), surface(tire.mileage(other), other)
    rows = grid.shape[0]
    for alignment in (Alignment.failed("No."), Alignment.identity()):
        for values in wear_block(first, later, alignment, 0, rows):
            assert values.shape == grid.shape
            assert np.isnan(values).all()


def test_a_wider_alignment_covariance_widens_wear_std(pair):
    first, later, motion = pair
    covariance = np.zeros((7, 7))
    covariance[6, 6] = 0.3**2
    _, _, std = wear_block(first, later, Alignment(motion, covariance), 0, 50)
    assert np.nanmin(std) > 0.3


@pytest.mark.parametrize("rotation", [0.0, 1.0, 3.1, -2.0])
def test_rows_needed_hold_every_cell_of_the_block(rotation, make_grid, make_remount):
    motion = make_remount(rotation)
    first = make_grid("whole", 2.0)
    for grid in (first, make_grid((-3.0, 3.0), 2.0), make_grid((3.0, 4.0), 2.0)):
        theta = first.theta[40:60]
        rows = rows_needed(motion, theta, first.z, grid)
        cells = np.meshgrid(theta, first.z, indexing="ij")
        place = motion.undo(*cells, np.full(cells[0].shape, 101.0))[0]
        wanted = grid.index(place, cells[1])[0]
        inside = (wanted >= 0) & (wanted <= grid.shape[0] - 1) | grid.periodic
        needed = np.unique(np.floor(wanted[inside]).astype(int)) % grid.shape[0]
        assert np.isin(needed, rows % grid.shape[0]).all()
        assert np.all(np.diff(rows) == 1)


def test_reduction_keeps_the_turn_whole_and_the_mean(rng):
    grid = CylinderGrid.whole_turn((-10.0, 10.0), 0.1, 40.03)
    coarse, edges, columns = reduced_grid(grid, 0.3)
    assert coarse.periodic
    assert edges[-1] == grid.shape[0]
    values = np.cos(grid.theta)[:, None] + 0.1 * grid.z
    reduced = reduce_rows(values, edges, columns)
    expected = np.cos(coarse.theta)[:, None] + 0.1 * coarse.z
    np.testing.assert_allclose(reduced, expected, atol=3e-3)
    values[: edges[1] * 2] = np.nan
    assert np.isnan(reduce_rows(values, edges, columns)[0]).all()


def test_smoothing_over_gaps_keeps_a_slope(rng):
    grid = CylinderGrid.sector((0.0, 1.0), (-20.0, 20.0), 0.5, 50.0)
    values = 0.3 * grid.z + 2.0 * (grid.theta * 50.0)[:, None]
    values[rng.random(grid.shape) < 0.2] = np.nan
    inner = (slice(8, -8), slice(8, -8))
    assert abs(np.nanmedian(smooth(values, grid, 1.0, (0, 1))[inner]) - 0.3) < 0.01
    assert abs(np.nanmedian(smooth(values, grid, 1.0, (1, 0))[inner]) - 2.0) < 0.02
