"""The line's centre in each row."""

import numpy as np
import pytest

from treadlight.images.line import line_centres


def stripes(centres, sigma, rng, noise=0.01, width=80, peak=0.8, clip=1.0):
    u = np.arange(width)
    lines = peak * np.exp(-0.5 * ((u - centres[:, None]) / sigma) ** 2)
    return np.clip(lines + rng.normal(0, noise, lines.shape), 0, clip).astype(np.float32)


@pytest.mark.parametrize("sigma", [0.8, 2.0, 5.0])
def test_centres_are_unbiased(rng, sigma):
    true = 40 + rng.uniform(-0.5, 0.5, 1500)
    u, strength, found_sigma = line_centres(stripes(true, sigma, rng), np.ones((1500, 80), bool))
    assert np.isfinite(u).all()
    assert abs(np.mean(u - true)) < 0.005
    assert np.std(u - true) < 0.04
    assert found_sigma == pytest.approx(sigma, rel=0.35)
    assert strength.min() > 0.2


def test_saturated_tops_do_not_move_the_centre(rng):
    true = 40 + rng.uniform(-0.5, 0.5, 1500)
    image = stripes(true, 3.0, rng, peak=2.0, clip=1.0)
    u, _, _ = line_centres(image, np.ones(image.shape, bool))
    assert abs(np.mean(u - true)) < 0.01
    assert np.std(u - true) < 0.03


def test_line_outside_the_allowed_part_is_not_taken(rng):
    true = np.full(50, 20.0)
    image = stripes(true, 2.0, rng)
    allowed = np.zeros(image.shape, bool)
    allowed[:, 45:] = True
    assert np.isnan(line_centres(image, allowed)[0]).all()


def test_rows_without_a_line_are_nan(rng):
    image = stripes(np.full(60, 30.0), 2.0, rng)
    image[20:30] = np.clip(rng.normal(0, 0.01, (10, 80)), 0, 1)
    u, _, _ = line_centres(image, np.ones(image.shape, bool))
    assert np.isnan(u[20:30]).sum() >= 9
    assert np.isfinite(np.delete(u, slice(20, 30))).all()
    assert np.isnan(line_centres(np.zeros((5, 40), np.float32), np.ones((5, 40), bool))[0]).all()
