"""Cells between sections that disagree."""

import numpy as np
import pytest

from treadlight.geometry import CylinderGrid
from treadlight.integrate.gaps import undecided
from treadlight.integrate.laser import LaserCells

STD = 0.05


def sections(rows, heights, columns=4):
    count = len(rows) * columns
    return LaserCells(
        np.repeat(rows, columns), np.tile(np.arange(columns), len(rows)),
        300.0 + np.repeat(heights, columns), np.full(count, STD), np.repeat(rows, columns),
    )  # fmt: skip


@pytest.fixture
def sector():
    return CylinderGrid(np.arange(60) * 0.001, np.arange(4) * 0.3, 300.0)


def test_the_middle_third_between_a_slot_and_the_tread_is_undecided(sector):
    found = undecided(sections([0, 12, 24, 36], [0, 0.1, -6, -6.1]), STD, sector)
    np.testing.assert_array_equal(np.flatnonzero(found[:, 0]), np.arange(16, 21))
    assert (found == found[:, :1]).all()


def test_noise_is_no_disagreement(sector, rng):
    heights = rng.normal(0, STD, 20).clip(-2 * STD, 2 * STD)
    assert not undecided(sections(np.arange(20) * 3, heights), STD, sector).any()


def test_a_whole_turn_goes_on_across_its_end():
    n = 60
    turn = CylinderGrid(-np.pi + np.arange(n) * 2 * np.pi / n, np.arange(4) * 0.3, 300.0)
    found = undecided(sections([6, 30, 54], [-6, 0, 0]), STD, turn)
    np.testing.assert_array_equal(np.flatnonzero(found[:, 0]), [0, 1, 2, *range(14, 23), 58, 59])


def test_a_stray_point_is_no_lip(sector):
    laser = sections([0, 12, 24, 36], [0, 0, 0, 0])
    laser.value[5] -= 3
    assert not undecided(laser, STD, sector).any()


def test_a_column_with_one_point_or_none_says_nothing(sector):
    assert not undecided(sections([5], [0], columns=1), STD, sector).any()
