"""Patches and distances on a whole turn."""

import numpy as np
import pytest

from treadlight.geometry import CylinderGrid
from treadlight.integrate.patches import find_patches, way_out


@pytest.fixture
def turn():
    return CylinderGrid(2 * np.pi * np.arange(60) / 60 - np.pi, 0.3 * np.arange(40), 100.0)


def test_the_way_out_passes_the_end_of_a_turn(turn):
    mask = np.zeros(turn.shape, bool)
    mask[20:30] = True
    across = np.roll(mask, 32, axis=0)
    np.testing.assert_array_equal(way_out(across, turn), np.roll(way_out(mask, turn), 32, axis=0))
    assert way_out(across, turn).max() == 5


def test_there_may_be_no_way_out(turn):
    assert np.isinf(way_out(np.ones(turn.shape, bool), turn)).all()


def test_a_patch_passes_the_end_of_a_turn_but_not_the_rims_of_the_tread(turn):
    mask = np.zeros(turn.shape, bool)
    mask[-4:, 10:14] = mask[:4, 13:17] = True
    assert find_patches(mask, turn).count == 1
    apart = np.zeros(turn.shape, bool)
    apart[-4:, -4:] = apart[:4, :4] = True
    assert find_patches(apart, turn).count == 2
