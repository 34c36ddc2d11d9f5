import numpy as np
import pytest
from scipy import stats

from treadlight.wear import fit_line


def points(x, y, std=0.0):
    return [(a, b, std) for a, b in zip(x, y, strict=True)]


def test_the_line_is_that_of_scipy(rng):
    x = np.linspace(0, 5, 8)
    y = 2 + 0.3 * x + rng.normal(0, 0.1, 8)
    line, expected = fit_line(points(x, y)), stats.linregress(x, y)
    assert line.slope == pytest.approx(expected.slope)
    assert line.at(0.0) == pytest.approx(expected.intercept)


def test_the_prediction_interval_is_the_textbook_one(rng):
    """Draper and Smith, Applied Regression Analysis, eq. 1.4.12."""
    x = np.array([1.0, 2, 4, 7, 8])
    y = 1 + x + rng.normal(0, 0.2, 5)
    line = fit_line(points(x, y))
    fit = np.polynomial.Polynomial.fit(x, y, 1)
    s = np.sqrt(np.sum((y - fit(x)) ** 2) / 3)
    expected = stats.t.ppf(0.975, 3) * s * np.sqrt(1 + 1 / 5 + (9 - x.mean()) ** 2 / 37.2)
    assert line.prediction_half_width(9.0) == pytest.approx(expected)


def test_nineteen_in_twenty_new_points_fall_into_the_interval(rng):
    x = np.linspace(0, 1, 6)
    inside = []
    for _ in range(2000):
        line = fit_line(points(x, rng.normal(0, 1, 6)))
        inside.append(abs(rng.normal() - line.at(1.3)) < line.prediction_half_width(1.3))
    assert np.mean(inside) == pytest.approx(0.95, abs=0.015)


def test_two_points_take_the_interval_from_their_own_uncertainty():
    line = fit_line([(0.0, 0.0, 0.0), (1.0, 0.1, 0.02)])
    assert line.slope == pytest.approx(0.1)
    expected = stats.norm.ppf(0.975) * 0.02 * np.sqrt(1 + 1 / 2)
    assert line.prediction_half_width(0.5) == pytest.approx(expected)


def test_points_that_agree_better_than_they_claim_keep_their_claim():
    line = fit_line(points([0.0, 1, 2, 3], [0.0, 1, 2, 3], std=0.1))
    assert line.sigma == pytest.approx(0.1)


def test_one_mileage_makes_no_line():
    assert fit_line([]) is None
    assert fit_line([(1.0, 0.0, 0.1), (1.0, 0.1, 0.1)]) is None
