"""The noise of a frame where it is dark."""

import numpy as np
import pytest

from treadlight.photometric.noise import dark_noise


def frame(rng, std):
    ramp = np.linspace(0, 1, 400)[None, :] ** 2 + np.linspace(0, 0.2, 300)[:, None]
    return (ramp + std * rng.standard_normal((300, 400))).astype(np.float32)


def test_noise_is_found_under_a_gradient(rng):
    assert dark_noise(frame(rng, 0.003)) == pytest.approx(0.003, rel=0.15)


def test_quantisation_is_the_least(rng):
    coarse = np.round(frame(rng, 0) * 50) / 50
    assert dark_noise(coarse.astype(np.float32)) == pytest.approx(0.02 / np.sqrt(12), rel=0.01)


def test_a_frame_without_contrast_or_light_has_none():
    assert dark_noise(np.zeros((20, 20), np.float32)) == 0.0
    assert dark_noise(np.full((20, 20), np.nan, np.float32)) == 0.0
