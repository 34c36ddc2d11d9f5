import numpy as np
import pytest

from treadlight.export import (
    block_sides,
    coarser,
    coarser_grid,
    height_picture,
    to_cartesian,
    triangles,
)
from treadlight.geometry import CylinderGrid


@pytest.fixture
def turn():
    return CylinderGrid.whole_turn((-10.0, 10.0), 0.5, 50.0)


def area_and_volume(points, corners):
    a, b, c = (points[corners[:, k]] for k in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
    return area, np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6


def test_a_whole_turn_closes_and_its_faces_look_outward(turn):
    r = np.full(turn.shape, 50.0)
    vertices, corners = triangles(np.isfinite(r), whole_turn=True)
    points = to_cartesian(r, turn.theta, turn.z).reshape(-1, 3)[vertices]
    area, volume = area_and_volume(points, corners)
    height = turn.z[-1] - turn.z[0]
    assert len(corners) == 2 * turn.shape[0] * (turn.shape[1] - 1)
    assert area == pytest.approx(2 * np.pi * 50 * height, rel=1e-3)
    # An open cylinder's flux of the place vector is two thirds of pi r2 h, positive = outward.
    assert volume == pytest.approx(2 / 3 * np.pi * 50**2 * height, rel=1e-3)


def test_a_sector_stays_open_and_missing_cells_have_no_faces():
    known = np.ones((5, 4), bool)
    assert len(triangles(known, whole_turn=False)[1]) == 2 * 4 * 3
    known[2, 1] = False
    vertices, corners = triangles(known, whole_turn=False)
    assert len(vertices) == 19
    assert len(corners) == 2 * (12 - 4)
    assert corners.max() == 18


def test_coarser_cells_are_means_where_half_is_known(turn, rng):
    values = rng.normal(size=turn.shape)
    values[:2, :2] = np.nan
    values[2, 0] = np.nan
    sides = block_sides(turn, 0.9)
    assert sides == (2, 2)
    small, grid = coarser(values, sides), coarser_grid(turn, sides)
    assert small.shape == grid.shape
    assert np.isnan(small[0, 0])
    assert small[1, 0] == pytest.approx(np.nanmean(values[2:4, :2]))
    assert grid.theta[1] == pytest.approx(turn.theta[2:4].mean())
    assert block_sides(turn, 0.0) == (1, 1)


def test_a_picture_gives_heights_back_to_half_a_step(rng):
    height = rng.uniform(-3, 9, (30, 20))
    height[3, 4] = np.nan
    picture, low, step = height_picture(height)
    assert picture.shape == (20, 30)
    back = np.where(picture == 0, np.nan, low + (picture.astype(float) - 1) * step)[::-1].T
    assert np.isnan(back[3, 4])
    assert np.nanmax(np.abs(back - height)) <= 0.501 * step
    assert step < 1e-3
    assert height_picture(np.full((2, 2), np.nan))[0].max() == 0
