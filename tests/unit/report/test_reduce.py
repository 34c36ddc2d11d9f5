import numpy as np
import pytest

from treadlight.report import block_size, reduce, reduce_map


def reduced(values, limit):
    return reduce_map(lambda rows: values[rows], values.shape, limit)


def test_blocks_hold_the_mean_of_their_cells(rng):
    values = rng.normal(size=(12, 20))
    expected = values.reshape(4, 3, 5, 4).mean(axis=(1, 3))
    assert reduced(values, (4, 5)) == pytest.approx(expected, abs=1e-6)


def test_small_maps_pass_as_they_are(rng):
    values = rng.normal(size=(7, 9)).astype(np.float32)
    values[2, 3] = np.nan
    assert np.array_equal(reduced(values, (100, 100)), values, equal_nan=True)


def test_holes_do_not_pull_the_mean_and_mostly_empty_blocks_are_empty():
    values = np.full((4, 4), 5.0)
    values[:2, :2] = [[5, np.nan], [np.nan, 5]]
    values[2:, 2:] = [[7, np.nan], [np.nan, np.nan]]
    found = reduced(values, (2, 2))
    assert found[0, 0] == 5
    assert np.isnan(found[1, 1])
    assert found[0, 1] == found[1, 0] == 5


def test_the_result_does_not_depend_on_how_rows_are_read(rng, monkeypatch):
    values = rng.normal(size=(101, 33))
    whole = reduced(values, (25, 10))
    monkeypatch.setattr(reduce, "_CELLS", 200)
    assert np.array_equal(reduced(values, (25, 10)), whole)
    assert whole.shape == (21, 9)
    assert block_size(values.shape, (25, 10)) == (5, 4)
