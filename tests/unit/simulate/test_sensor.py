"""The sensor's noise, black level and saturation."""

import numpy as np
import pytest

from treadlight.simulate import sensor


def test_mean_is_linear_in_light_and_variance_is_that_of_photons(rng):
    pattern = np.zeros((300, 300), np.float32)
    gain = (sensor.WHITE_LEVEL - sensor.BLACK_LEVEL) / 15_000
    for light in (0.0, 0.1, 0.6):
        counts = sensor.expose(np.full((300, 300), light, np.float32), pattern, rng)
        electrons = (counts.astype(float) - sensor.BLACK_LEVEL) / gain
        assert electrons.mean() == pytest.approx(15_000 * light, abs=1.5)
        rounding = (16 / gain) ** 2 / 12
        assert electrons.var() == pytest.approx(15_000 * light + 16 + rounding, rel=0.03)


def test_frames_hold_twelve_bits_and_saturate_at_the_white_level(rng):
    light = np.linspace(0, 2, 10_000, dtype=np.float32).reshape(100, 100)
    counts = sensor.expose(light, np.zeros((100, 100), np.float32), rng)
    assert np.all(counts % 16 == 0)
    assert counts.max() == sensor.WHITE_LEVEL
    assert np.all(counts[60:] == sensor.WHITE_LEVEL)


def test_dark_frame_shows_the_fixed_pattern(rng):
    pattern = sensor.fixed_pattern(1, (80, 60))
    dark = sensor.dark_frame(pattern, rng).astype(float)
    assert dark.mean() == pytest.approx(sensor.BLACK_LEVEL, abs=1)
    assert np.corrcoef(dark.ravel(), pattern.ravel())[0, 1] > 0.9
    assert np.array_equal(pattern, sensor.fixed_pattern(1, (80, 60)))


def test_blur_keeps_the_light(rng):
    image = rng.uniform(0, 1, (40, 50)).astype(np.float32)
    image[:5] = image[-5:] = image[:, :5] = image[:, -5:] = 0
    assert sensor.blur(image).sum() == pytest.approx(image.sum(), rel=1e-5)
