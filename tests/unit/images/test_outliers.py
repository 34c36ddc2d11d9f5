"""Outliers are found at the stated rate of false alarms, and do not hide each other."""

import numpy as np
import pytest

from treadlight.images.outliers import low_outliers


@pytest.mark.parametrize("n", [8, 16, 32])
def test_normal_values_give_an_outlier_as_often_as_was_asked(rng, n):
    alarms = sum(bool(low_outliers(rng.normal(3, 2, n).tolist(), 0.05)) for _ in range(2000))
    assert alarms / 2000 == pytest.approx(0.05, abs=0.02)


def test_two_clusters_give_none(rng):
    for _ in range(200):
        rings = np.concatenate([rng.normal(0.6, 0.05, 8), rng.normal(1.0, 0.05, 8)])
        assert low_outliers(rings.tolist(), 0.01) == []


def test_outliers_do_not_mask_each_other(rng):
    values = rng.normal(0, 1, 16)
    values[[3, 11, 12]] -= 30
    assert sorted(low_outliers(values.tolist(), 1e-3)) == [3, 11, 12]


@pytest.mark.parametrize("values", [[], [1.0], [1.0, 5.0], [2.0] * 9])
def test_few_or_equal_values_have_none(values):
    assert low_outliers(values, 0.01) == []
