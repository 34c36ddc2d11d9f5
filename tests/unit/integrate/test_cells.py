"""The cells that heights are solved in, and what they take of the sections."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from treadlight.geometry import CylinderGrid
from treadlight.integrate import LaserSections, sampled, solved_grid, thinned, width_of_cells

RADIUS = 300.0


@st.composite
def grids(draw):
    step = draw(st.floats(0.03, 1.0))
    if draw(st.booleans()):
        return CylinderGrid.whole_turn((-5.0, 5.0), step, RADIUS)
    first = draw(st.floats(-np.pi, 3.0))
    return CylinderGrid.sector((first, first + 0.1), (-10.0, 10.0), step, RADIUS)


@pytest.mark.parametrize(
    ("step", "width"), [(0.8, 1), (0.31, 1), (0.17, 1), (0.124, 2), (0.062, 5), (0.031, 10)]
)
def test_cells_are_a_third_of_a_millimetre_wide_or_pixels(step, width):
    grid = CylinderGrid.sector((0.0, 0.1), (-10.0, 10.0), step, RADIUS)
    assert width_of_cells(grid, 10**9) == width


def test_cells_are_wider_where_there_would_be_too_many():
    grid = CylinderGrid.sector((0.0, 0.1), (-10.0, 10.0), 0.1, RADIUS)
    width = width_of_cells(grid, 1000)
    n, m = solved_grid(grid, width).shape
    assert 500 < n * m < 1500


@given(grids(), st.integers(1, 12))
def test_cells_cover_the_pixels(grid, width):
    cells = solved_grid(grid, width)
    assert cells.periodic == grid.periodic
    assert -np.pi <= cells.theta[0] < np.pi
    if width == 1:
        assert cells is grid
    # Of one closed turn no more than a part of a cell is given to all.
    wide = cells.step_theta / grid.step_theta
    assert wide == pytest.approx(width, rel=1e-6 if not grid.periodic else width / len(grid.theta))
    row, column = cells.index(grid.theta, grid.z)
    n, m = cells.shape
    assert (row > -0.51).all()
    assert (row < n + (0 if cells.periodic else -0.49)).all()
    assert (column > -0.51).all()
    assert (column < m - 0.49).all()
    rows, columns = sampled(grid, cells)
    assert (len(rows), len(columns)) == cells.shape
    away = np.sin((grid.theta[rows] - cells.theta) / 2) * 2
    # A last row of cells may lie beyond the last pixel.
    assert (np.abs(away[:-1]) <= 0.51 * grid.step_theta).all()
    assert (np.diff(rows) >= 0).all()


def sections_of(r, theta, z, std, shared_rows):
    return LaserSections(r, theta, z, std, -np.median(theta, axis=1), shared_rows)


def test_thinned_lines_are_means_of_those_alike_across_the_turns_end(rng):
    z = np.broadcast_to(np.arange(40) * 0.1, (3, 40))
    theta = (np.array([0.1, np.pi, 1.0])[:, None] + 1e-4 * np.arange(40) + np.pi) % (
        2 * np.pi
    ) - np.pi
    std = np.full(z.shape, 0.1)
    r = RADIUS + z
    ghosts = r.copy()
    ghosts[:, 7] += 5.0
    ghosts[:, 12] = np.nan
    ghosts[1, 20:24] = np.nan
    found = thinned(sections_of(ghosts, theta, z, std, 1.0), 4)
    assert found.r.shape == (3, 10)
    assert np.isnan(found.r[1, 5])
    known = np.isfinite(found.r)
    assert known.sum() == 29
    # A point stands for those that were taken, at their mean place.
    np.testing.assert_allclose(found.r[known], RADIUS + found.z[known], atol=1e-9)
    mean = theta[0] - 0.1
    expected = 0.1 + np.nanmean(np.where(ghosts[0] < RADIUS + 4.5, mean, np.nan)[:4])
    assert found.theta[0, 0] == pytest.approx(expected, abs=1e-9)
    assert np.abs(np.abs(found.theta[1, known[1]]) - np.pi).max() < 0.005
    assert found.r_std[0, 0] == pytest.approx(0.05)
    assert found.r_std[0, 1] == pytest.approx(0.1 / np.sqrt(3))


@pytest.mark.parametrize(
    ("shared", "std", "left"),
    [(1.0, 0.05, 1.0), (2.0, 0.0707, 1.0), (4.0, 0.1, 1.0), (10.0, 0.1, 2.5)],
)
def test_lines_that_share_their_errors_are_together_no_more_certain(shared, std, left):
    z = np.broadcast_to(np.arange(16) * 0.1, (2, 16))
    flat = np.full(z.shape, RADIUS)
    found = thinned(sections_of(flat, 0.01 * flat / RADIUS, z, flat * 0 + 0.1, shared), 4)
    np.testing.assert_allclose(found.r_std, std, rtol=1e-3)
    assert found.shared_rows == left


def test_nothing_is_thinned_where_cells_are_pixels():
    flat = np.full((2, 16), RADIUS)
    sections = sections_of(flat, flat * 0, flat * 0, flat * 0 + 0.1, 3.0)
    assert thinned(sections, 1) is sections
