"""How a turn is cut into sectors."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from treadlight.geometry import CylinderGrid
from treadlight.integrate import sectors_of


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
