"""How a turn is cut into sectors."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from treadlight.geometry import CylinderGrid
from treadlight.integrate import Joined, Profile, sectors_of
from treadlight.integrate.uncertainty import HeldOut


@st.composite
def grids(draw):
    n, m = draw(st.integers(20, 900)), draw(st.integers(3, 40))
    if draw(st.booleans()):
        theta = -np.pi + np.arange(n) * (2 * np.pi / n)
    else:
        theta = 0.3 + np.arange(n) * 0.001
    return CylinderGrid(theta, np.arange(float(m)), 300.0)


@given(grids(), st.floats(1, 60), st.integers(1, 40_000))
def test_every_row_is_in_one_core_and_all_weights_add_up_to_one(grid, spacing, most_cells):
    n = grid.shape[0]
    core, weight = np.zeros(n, int), np.zeros(n)
    for sector in sectors_of(grid, spacing, most_cells):
        np.add.at(core, sector.rows[sector.core], 1)
        np.add.at(weight, sector.rows, sector.weight)
        assert len(np.unique(sector.rows)) == len(sector.rows)
        away = sector.grid.theta - grid.theta[sector.rows]
        np.testing.assert_allclose(np.sin(away / 2), 0, atol=1e-9)
    assert (core == 1).all()
    np.testing.assert_allclose(weight, 1, atol=1e-5)


@pytest.mark.parametrize("n", range(20, 90))
def test_parts_that_come_near_the_whole_turn_keep_their_rows(n):
    grid = CylinderGrid(-np.pi + np.arange(n) * (2 * np.pi / n), np.arange(4.0), 300.0)
    for sector in sectors_of(grid, 5.0, 1):
        away = sector.grid.theta - grid.theta[sector.rows]
        np.testing.assert_allclose(np.sin(away / 2), 0, atol=1e-9)


def test_a_grid_that_is_small_enough_is_one_sector():
    grid = CylinderGrid.whole_turn((0.0, 20.0), 1.0, 300.0)
    (sector,) = sectors_of(grid, 10.0, grid.shape[0] * grid.shape[1])
    assert sector.grid is grid
    assert sector.grid.periodic


def flat_profile(shape, r, std):
    zeros, none = np.zeros(shape), np.zeros(shape, bool)
    normal = np.zeros((*shape, 3), np.float32)
    normal[..., 0] = 1
    held = HeldOut(10, 0.0, 0.1, 0.1, 0.0)
    return Profile(
        zeros + r, zeros + std, normal, np.full((3, *shape), 0.3), none, ~none, none, none, none,
        held, 10, (0.01, 0.05),
    )  # fmt: skip


def joined(grid, off, std):
    """Sectors whose levels are in turn 100 mm and `off` more."""
    whole = Joined(grid.shape, np.empty)
    for k, sector in enumerate(sectors_of(grid, 20.0, 1)):
        whole.add(flat_profile(sector.grid.shape, 100.0 + off * (k % 2), std), sector)
    return whole.profile()


@pytest.mark.parametrize("periodic", [True, False])
def test_sectors_that_agree_are_faded_into_each_other(periodic):
    theta = -np.pi + np.arange(480) * (2 * np.pi / 480 if periodic else 0.001)
    grid = CylinderGrid(theta, np.arange(5.0), 300.0)
    r = joined(grid, 0.01, 0.02).r
    steps = np.abs(np.diff(np.append(r, r[:1], axis=0) if periodic else r, axis=0))
    assert np.ptp(r) == pytest.approx(0.01)
    assert steps.max() < 0.01 / 15


def test_where_sectors_found_another_cut_one_of_them_counts():
    grid = CylinderGrid(np.arange(480) * 0.001, np.arange(5.0), 300.0)
    r = joined(grid, 1.0, 0.02).r
    assert set(np.unique(r)) == {100.0, 101.0}
    assert np.count_nonzero(np.diff(r[:, 0])) == len(list(sectors_of(grid, 20.0, 1))) - 1
