"""Leaning ribs, and how far errors of slopes go together."""

import numpy as np
import pytest
from scipy import ndimage

from treadlight.geometry import CylinderGrid
from treadlight.integrate.bias import lean_of_ribs
from treadlight.integrate.gather import ViewField
from treadlight.integrate.laser import LaserCells
from treadlight.integrate.multigrid import System
from treadlight.integrate.path_errors import shared_columns, with_path_variance
from treadlight.integrate.solve import perturbation, shared_noise

STEP = 0.3
SPACING = 12
LASER_STD = 0.05
RADIUS = 300.0


@pytest.fixture
def grid():
    return CylinderGrid(
        np.arange(960) * STEP / RADIUS, STEP * np.arange(-30, 31, dtype=float), RADIUS
    )


def view(grid, slope):
    shape = grid.shape
    return ViewField(
        np.arange(shape[0]), slope.astype(np.float32), np.full((2, *shape), 0.02**2, np.float32),
        np.ones((3, *shape), np.float32), np.zeros((3, *shape), np.float32),
        np.ones(shape[0], np.float32),
    )  # fmt: skip


def sections(grid, r, std=LASER_STD):
    """Laser points of every twelfth row."""
    row = np.repeat(np.arange(6, grid.shape[0], SPACING), grid.shape[1])
    column = np.tile(np.arange(grid.shape[1]), grid.shape[0] // SPACING)
    return LaserCells(row, column, r[row, column], np.full(len(row), std), row // SPACING)


@pytest.fixture
def ribs(grid):
    """Two ribs and a groove between them, by column."""
    return np.select([grid.z < -2, grid.z > 2], [1, 2], 0)


def test_a_rib_leans_as_its_sections_say(grid, ribs, rng):
    r = RADIUS + np.where(ribs == 1, 0.02 * grid.z, 0.0) + rng.normal(0, LASER_STD, grid.shape)
    laser = sections(grid, r)
    laser.value[::17] -= 3.0
    flat = np.full(grid.shape, RADIUS)
    lean = lean_of_ribs(view(grid, np.zeros((2, *grid.shape))), laser, flat, ribs, 1.0, grid)
    assert lean[ribs == 1] == pytest.approx(0.02, rel=0.2)
    assert (lean[ribs == 0] == 0).all()
    # What noise can be is shrunk: a standard deviation of the slope is 0.6e-3 here.
    assert np.abs(lean[ribs == 2]).max() < 0.0015


def test_a_lean_that_noise_explains_is_none(grid, ribs, rng):
    """Over many views the usual correction is less than a standard deviation of a line's slope."""
    field, flat = view(grid, np.zeros((2, *grid.shape))), np.full(grid.shape, RADIUS)
    found = []
    for _ in range(40):
        noisy = flat + rng.normal(0, LASER_STD, grid.shape)
        found.append(lean_of_ribs(field, sections(grid, noisy), flat, ribs, 1.0, grid)[0])
    z = np.tile(grid.z[ribs == 1], 80)
    one = LASER_STD / np.sqrt(((z - z.mean()) ** 2).sum())
    assert np.median(np.abs(found)) < 0.5 * one


@pytest.mark.parametrize("shared", [1.0, 4.0])
def test_neighbouring_paths_share_errors_as_far_as_these_reach(grid, shared, rng):
    noise = np.zeros((2, *grid.shape))
    noise[0] = 0.05 * shared_noise(grid.shape, 1, shared, rng)
    fields = [view(grid, noise)]
    laser = sections(grid, np.full(grid.shape, RADIUS), std=1e-4)
    walls = np.zeros(grid.shape, bool)
    found = shared_columns(fields, laser, walls, 3.0, SPACING, grid)
    assert found == pytest.approx(shared, rel=0.3)


def test_a_laser_that_claims_too_much_hides_no_shared_errors(grid, rng):
    """Its claim, eight times its noise, is more than all that paths miss."""
    noise = np.zeros((2, *grid.shape))
    noise[0] = 0.05 * shared_noise(grid.shape, 1, 4.0, rng)
    # Less than what paths miss, so that their number tells the two apart.
    r = RADIUS + rng.normal(0, LASER_STD / 4, grid.shape)
    laser, walls = sections(grid, r, std=2 * LASER_STD), np.zeros(grid.shape, bool)
    found = shared_columns([view(grid, noise)], laser, walls, 1.0, SPACING, grid)
    assert found == pytest.approx(4.0, rel=0.3)


def test_what_the_laser_shares_is_not_the_slopes(grid, rng):
    """Slopes with independent errors, and a laser whose neighbouring points go together."""
    slope = np.zeros((2, *grid.shape))
    slope[0] = rng.normal(0, 0.1, grid.shape)
    speckle = LASER_STD * shared_noise(grid.shape, 1, 4.0, rng)
    laser = sections(grid, RADIUS + speckle)
    walls = np.zeros(grid.shape, bool)
    found = shared_columns([view(grid, slope)], laser, walls, 4.0, SPACING, grid)
    assert found == pytest.approx(1.0, abs=0.5)


def test_views_without_slopes_share_nothing(grid):
    empty = view(grid, np.full((2, *grid.shape), np.nan))
    laser = sections(grid, np.full(grid.shape, RADIUS))
    walls = np.zeros(grid.shape, bool)
    assert shared_columns([empty], laser, walls, 3.0, SPACING, grid) == 1.0


@pytest.mark.parametrize("shared", [1.0, 3.0, 8.0])
def test_shared_noise_has_unit_variance_and_the_sum_of_correlations_asked_for(shared, rng):
    noise = shared_noise((400, 500), 1, shared, rng)
    assert noise.std() == pytest.approx(1.0, rel=0.02)
    # The variance of long means is that sum over their length.
    means = ndimage.uniform_filter1d(noise, 50, axis=1)[:, 25:-25:50]
    assert 50 * means.var() == pytest.approx(shared, rel=0.15)
    along = ndimage.uniform_filter1d(noise, 50, axis=0)[25:-25:50]
    assert 50 * along.var() == pytest.approx(1.0, rel=0.15)


def test_no_more_cells_share_noise_than_there_are(rng):
    noise = shared_noise((4000, 20), 1, 40.0, rng)
    assert noise.std() == pytest.approx(1.0, rel=0.05)
    np.testing.assert_allclose(noise, noise[:, :1] * np.ones(20), atol=1e-4)


@pytest.mark.parametrize("axis", [0, 1])
def test_jumps_share_their_noise_with_those_beside_them_not_with_the_next(axis, rng):
    """Jumps along one axis alone: their differences are the right-hand side."""
    shape, nothing = (300, 300), np.zeros((300, 300))
    weights = [np.ones(shape), nothing] if axis == 0 else [nothing, np.ones(shape)]
    noise = perturbation(System(*weights, nothing), 6.0, rng)
    across = np.mean(noise * np.roll(noise, 1, axis=1 - axis)) / np.mean(noise**2)
    along = np.mean(noise * np.roll(noise, 2, axis=axis)) / np.mean(noise**2)
    assert across > 0.8
    assert abs(along) < 0.05


@pytest.mark.parametrize("over", [1, 6])
def test_slopes_are_as_uncertain_as_their_paths_show_and_no_more(grid, over, rng):
    """Noise as said that is every cell's own, or goes on over six: then paths miss by more."""
    said = 0.02
    noise = rng.normal(0, said, (4, 2, *grid.shape))
    noise = np.sqrt(over) * ndimage.uniform_filter1d(noise, over, axis=2)
    r = RADIUS + rng.normal(0, LASER_STD, grid.shape)
    found = with_path_variance(
        [view(grid, slope) for slope in noise], sections(grid, r), np.zeros(grid.shape, bool),
        1.0, SPACING, grid,
    )  # fmt: skip
    variance = [float(np.median(field.variance[0])) for field in found]
    # One for all views, but for the slopes' own stretch.
    assert variance == pytest.approx([variance[0]] * 4, rel=1e-3)
    assert np.sqrt(variance[0]) == pytest.approx(said * np.sqrt(over), rel=0.15)


def test_paths_tell_their_errors_from_those_of_a_laser_that_claims_too_large_ones(grid, rng):
    """Twice its noise: by its word alone the slopes would have no errors at all."""
    said, over = 0.02, 6
    noise = rng.normal(0, said, (4, 2, *grid.shape))
    noise = np.sqrt(over) * ndimage.uniform_filter1d(noise, over, axis=2)
    fields, walls = [view(grid, slope) for slope in noise], np.zeros(grid.shape, bool)
    r = RADIUS + rng.normal(0, LASER_STD, grid.shape)
    laser = sections(grid, r, std=2 * LASER_STD)
    found = with_path_variance(fields, laser, walls, 1.0, SPACING, grid)
    variance = float(np.median(found[0].variance[0]))
    assert np.sqrt(variance) == pytest.approx(said * np.sqrt(over), rel=0.25)


def test_a_wall_is_as_much_less_certain_as_it_is_steeper(grid, rng):
    """Its variance by (1 + p^2)^2 (1 + p^2 + q^2): what a normal's error makes of the slope."""
    noise = rng.normal(0, 0.1, (2, *grid.shape))
    noise[0, :, :5] += 3.0
    field = view(grid, noise)
    laser = sections(grid, np.full(grid.shape, RADIUS), std=1e-4)
    (found,) = with_path_variance([field], laser, np.zeros(grid.shape, bool), 1.0, SPACING, grid)
    more = found.variance[0] - field.variance[0]
    wall, level = (np.median(more[:, columns]) for columns in (slice(0, 5), slice(10, None)))
    assert wall / level == pytest.approx((1 + 3.0**2) ** 3, rel=0.2)
