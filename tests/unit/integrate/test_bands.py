"""How the rows of a turn are cut into bands, and laid together again."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from treadlight.geometry import CylinderGrid
from treadlight.integrate import FLAGS, Joined, Profile, bands_of, quality_flags
from treadlight.integrate.uncertainty import HeldOut

HELD = HeldOut(10, 0.0, 0.1, 0.1, 0.0)


@st.composite
def grids(draw):
    n, m = draw(st.integers(20, 900)), draw(st.integers(3, 40))
    if draw(st.booleans()):
        theta = -np.pi + np.arange(n) * (2 * np.pi / n)
    else:
        theta = 0.3 + np.arange(n) * 0.001
    return CylinderGrid(theta, np.arange(float(m)), 300.0)


@given(grids(), st.integers(1, 12), st.integers(1, 40_000))
def test_every_row_is_in_one_core(grid, width, most_pixels):
    n = grid.shape[0]
    core = np.zeros(n, int)
    for band in bands_of(grid, width, most_pixels):
        np.add.at(core, band.rows[band.core], 1)
        assert len(np.unique(band.rows)) == len(band.rows)
        away = band.grid.theta - grid.theta[band.rows]
        np.testing.assert_allclose(np.sin(away / 2), 0, atol=1e-9)
    assert (core == 1).all()


@pytest.mark.parametrize("n", range(20, 90))
def test_parts_that_come_near_the_whole_turn_keep_their_rows(n):
    grid = CylinderGrid(-np.pi + np.arange(n) * (2 * np.pi / n), np.arange(4.0), 300.0)
    for band in bands_of(grid, 2, 1):
        away = band.grid.theta - grid.theta[band.rows]
        np.testing.assert_allclose(np.sin(away / 2), 0, atol=1e-9)


@pytest.mark.parametrize(("width", "most_pixels"), [(1, 1), (3, 10**9)])
def test_pixels_that_are_cells_or_few_are_one_band(width, most_pixels):
    grid = CylinderGrid.whole_turn((0.0, 20.0), 1.0, 300.0)
    (band,) = bands_of(grid, width, most_pixels)
    assert band.grid is grid
    assert band.grid.periodic


def profile_of_level(shape, r, points):
    zeros, none = np.zeros(shape), np.zeros(shape, bool)
    normal = np.zeros((*shape, 3), np.float32)
    normal[..., 0] = 1
    return Profile(
        zeros + r, zeros + 0.02, normal, np.full((3, *shape), r), none, ~none, none, none, none,
        HELD, points, (0.01 * points, 0.05),
    )  # fmt: skip


def test_every_flag_is_the_bit_of_its_name():
    """One cell of each kind, in the order of FLAGS, and a dark one that is interpolated."""
    none = np.zeros((1, 8), bool)
    masks = {
        name: none.copy() for name in ("laser", "photometric", "shadowed", "saturated", "step")
    }
    for name, mask in masks.items():
        mask[0, FLAGS.index(name)] = True
    masks["shadowed"][0, 7] = True
    profile = profile_of_level((1, 8), 100.0, 1)
    r = np.where(np.arange(8) == FLAGS.index("refused"), np.nan, profile.r)
    flags = quality_flags(replace(profile, r=r, **masks))[0]
    interpolated = 1 << FLAGS.index("interpolated")
    alone = [1 << k for k in range(7)] + [1 << FLAGS.index("shadowed")]
    lit = [name in ("laser", "photometric", "refused") for name in FLAGS] + [False]
    assert flags.tolist() == [
        b if known else b | interpolated for b, known in zip(alone, lit, strict=True)
    ]


@pytest.mark.parametrize("periodic", [True, False])
def test_cores_are_laid_side_by_side_with_the_figures_of_all(periodic):
    theta = -np.pi + np.arange(480) * (2 * np.pi / 480 if periodic else 0.001)
    grid = CylinderGrid(theta, np.arange(5.0), 300.0)
    whole, expected = Joined(grid.shape, np.empty), np.full(480, np.nan)
    bands = list(bands_of(grid, 5, 1))
    for k, band in enumerate(bands):
        whole.add(profile_of_level(band.grid.shape, 100.0 + k, k + 1), band)
        expected[band.rows[band.core]] = 100.0 + k
    found = whole.profile(HELD)
    assert len(bands) > 5
    np.testing.assert_array_equal(found.r, expected[:, None] + np.zeros(5))
    np.testing.assert_array_equal(found.material[2], found.r.astype(np.float32))
    assert found.photometric.all()
    assert found.held_out == HELD
    points = np.arange(1, len(bands) + 1)
    assert found.laser_points == points.sum()
    rows = [len(band.rows[band.core]) for band in bands]
    assert found.normal_residual[0] == pytest.approx(0.01 * np.average(points, weights=rows))
