"""Cuts where no view looks, on a rib whose slots lie at three pitches."""

import numpy as np
import pytest
from scipy import ndimage

from treadlight.geometry import CylinderGrid
from treadlight.integrate.gaps import hidden_cuts
from treadlight.integrate.laser import LaserCells
from treadlight.integrate.repeats import repeated

COLUMNS, WIDTH, SPACING = 40, 8, 36
PITCHES = (50, 60, 70)
HIDDEN = slice(700, 820)
RIB = [slice(0, COLUMNS)]


def rib(pitches, n, slant=1.0, width=WIDTH):
    """Slots (n, columns), each where the one before ends and a pitch on."""
    row = np.arange(n)[:, None] - slant * np.arange(COLUMNS)
    starts = np.cumsum(pitches) - 100
    return ((row[..., None] >= starts) & (row[..., None] < starts + width)).any(axis=-1)


def grid_of(n, periodic=False):
    step = 2 * np.pi / n if periodic else 0.001
    start = -np.pi if periodic else 0.0
    return CylinderGrid(start + np.arange(n) * step, np.arange(COLUMNS) * 0.3, 300.0)


def points(cuts, rng, deceiving=0.02):
    """Sections of a rib, and which of their points lie below the tread."""
    rows = np.arange(SPACING // 2, len(cuts), SPACING)
    row, column = np.repeat(rows, COLUMNS), np.tile(np.arange(COLUMNS), len(rows))
    deep = cuts[row, column] ^ (rng.random(len(row)) < deceiving)
    laser = LaserCells(
        row, column, 300.0 - 6.0 * deep, np.full(len(row), 0.05), np.repeat(rows, COLUMNS)
    )
    return laser, deep


def looked_at(n, hidden=HIDDEN):
    looked = np.ones((n, COLUMNS), bool)
    looked[hidden] = False
    return looked


@pytest.fixture
def cuts(rng):
    return rib(rng.choice(PITCHES, 30), 1500)


def likely(cuts, looked, laser, deep, grid):
    return repeated(cuts & looked, looked, laser, deep, RIB, SPACING, 2.0, grid)


def test_slots_go_on_where_no_view_looks(cuts, rng):
    looked = looked_at(len(cuts))
    found = likely(cuts, looked, *points(cuts, rng), grid_of(len(cuts)))
    assert np.isnan(found[looked]).all()
    hidden, true = found[~looked], cuts[~looked]
    assert true[hidden > 0.95].mean() > 0.9
    assert (hidden > 0.5)[true].mean() > 0.8
    assert true[hidden < 0.05].mean() < 0.02


def test_slots_go_on_where_views_see_each_a_little_aside(rng):
    """Edges that are off by up to two cells make no place unlikely."""
    missed = []
    for _ in range(20):
        pitches = rng.choice(PITCHES, 30)
        starts, aside = np.cumsum(pitches), rng.integers(-2, 3, len(pitches))
        true, seen = (rib(np.diff(s, prepend=0), 1500, width=4) for s in (starts, starts + aside))
        looked = looked_at(len(true))
        laser, deep = points(true, rng)
        cut, unknown = hidden_cuts(
            seen & looked, looked, laser, deep, RIB, 0.05, SPACING, 2.0, grid_of(len(true))
        )
        near = ndimage.binary_dilation(cut | unknown, np.ones((5, 1)))
        missed.append((true & ~near)[~looked].sum() / true[~looked].sum())
    assert np.mean(missed) < 0.07


def test_a_likelihood_is_the_share_that_is_true(rng):
    """Calibrated: of the cells said to be in a cut with 20 to 80 %, about so many are."""
    told, true = [], []
    for _ in range(6):
        cuts = rib(rng.choice(PITCHES, 30), 1500, slant=0.2)
        looked = looked_at(len(cuts))
        told.append(likely(cuts, looked, *points(cuts, rng), grid_of(len(cuts)))[~looked])
        true.append(cuts[~looked])
    told, true = np.concatenate(told), np.concatenate(true)
    between = (told > 0.2) & (told < 0.8)
    assert between.sum() > 100
    assert abs(true[between].mean() - told[between].mean()) < 0.2


def test_a_whole_turn_goes_on_across_its_end(rng):
    cuts = (np.arange(1440)[:, None] - np.arange(COLUMNS)) % 60 < WIDTH
    looked = looked_at(1440, np.r_[0:50, 1400:1440])
    found = likely(cuts, looked, *points(cuts, rng), grid_of(1440, periodic=True))
    np.testing.assert_array_equal(found[~looked] > 0.5, cuts[~looked])


def test_where_views_look_nowhere_nothing_repeats(cuts, rng):
    looked = np.zeros(cuts.shape, bool)
    assert np.isnan(likely(cuts, looked, *points(cuts, rng), grid_of(len(cuts)))).all()


def test_what_sections_contradict_is_no_cut(cuts, rng):
    """Where no view looks the rib is plain: the sections say so, and no slot is put there."""
    true = cuts & looked_at(len(cuts))
    laser, deep = points(true, rng, deceiving=0.0)
    cut, _ = hidden_cuts(
        true, looked_at(len(cuts)), laser, deep, RIB, 0.05, SPACING, 2.0, grid_of(len(cuts))
    )
    assert cut.sum() < 0.01 * cut[HIDDEN].size


def test_no_slot_is_put_where_the_pattern_is_another(rng):
    """Slots the other way round repeat nowhere: better nothing known than a wrong slot."""
    cuts = rib(rng.choice(PITCHES, 30), 1500)
    looked = looked_at(len(cuts))
    cuts[HIDDEN] = cuts[HIDDEN, ::-1]
    laser, deep = points(cuts, rng)
    cut, unknown = hidden_cuts(
        cuts & looked, looked, laser, deep, RIB, 0.05, SPACING, 2.0, grid_of(len(cuts))
    )
    assert cut.sum() < 0.01 * cut[HIDDEN].size
    assert unknown.sum() > 0.05 * cut[HIDDEN].size


def test_doubt_goes_on_across_the_end_of_a_whole_turn(monkeypatch, rng):
    """Nine rows as likely in a cut as not, on either side of the end: all are doubtful."""
    n = 1440
    likely = np.full((n, COLUMNS), np.nan)
    likely[np.r_[0:4, n - 5 : n]] = 0.5
    monkeypatch.setattr("treadlight.integrate.gaps.repeated", lambda *_: likely)
    cuts, looked = np.zeros((n, COLUMNS), bool), np.isnan(likely)
    laser, deep = points(cuts, rng)
    _, unknown = hidden_cuts(
        cuts, looked, laser, deep, RIB, 0.05, SPACING, 2.0, grid_of(n, periodic=True)
    )
    np.testing.assert_array_equal(unknown, ~looked)
