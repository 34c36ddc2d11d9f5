"""The noise of a frame where it is dark."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from treadlight.photometric.noise import dark_noise

STD = 0.003
SIZE = (300, 400)
RAMP = np.linspace(0, 1, 400)[None, :] ** 2 + np.linspace(0, 0.2, 300)[:, None]


def noisy(rng, light):
    return (light + STD * rng.standard_normal(SIZE)).astype(np.float32)


def texture(rng, sigma_px):
    """Of standard deviation one."""
    pattern = gaussian_filter(rng.standard_normal(SIZE), sigma_px)
    return pattern / pattern.std()


def test_noise_of_an_even_frame_or_a_smooth_one_is_unbiased(rng):
    even = [dark_noise(noisy(rng, 0.2)) for _ in range(10)]
    assert np.mean(even) == pytest.approx(STD, rel=0.05)
    assert np.std(even) < 0.05 * STD
    assert dark_noise(noisy(rng, RAMP)) == pytest.approx(STD, rel=0.08)


@pytest.mark.parametrize("sigma_px", [1, 2])
def test_texture_of_dark_rubber_is_no_noise(rng, sigma_px):
    """Albedo that varies by 15 % from pixel to pixel, under light that falls off to the sides."""
    u, v = np.arange(400), np.arange(300)[:, None]
    light = 0.05 + 0.3 * np.maximum(np.sin(u / 40) + 0.7, 0) * np.maximum(np.cos(v / 60) + 0.5, 0)
    frame = noisy(rng, light * (1 + 0.15 * texture(rng, sigma_px)))
    assert dark_noise(frame) == pytest.approx(STD, rel=0.1)


def test_shadows_tell_the_noise_beside_coarse_texture(rng):
    shadow = gaussian_filter(rng.standard_normal(SIZE), 12) * 42 < -1
    light = np.where(shadow, 0.005, 0.15 * (1 + 0.3 * texture(rng, 0.5)))
    assert 0.03 < shadow.mean() < 0.3
    assert dark_noise(noisy(rng, light)) == pytest.approx(STD, rel=0.25)


@pytest.mark.parametrize(("masked", "within"), [(False, 0.1), (True, 0.2)])
def test_background_tells_the_noise_around_a_textured_object(rng, masked, within):
    """Or, where the background was blanked, the object's least textured parts."""
    v, u = np.mgrid[:300, :400]
    inside = ((u - 200) / 180) ** 2 + ((v - 150) / 135) ** 2 < 1
    light = 0.4 * (1 + 0.3 * texture(rng, 1) * (u > 150))
    frame = noisy(rng, np.where(inside, light, 0.01))
    if masked:
        frame[~inside] = 0
    assert dark_noise(frame) == pytest.approx(STD, rel=within)


def test_what_black_clips_is_not_taken_for_quiet(rng):
    """Half the frame lies half a standard deviation above black, where half the noise is lost."""
    light = np.where(np.arange(400) < 200, 0.5 * STD, 0.1)
    frame = np.maximum(noisy(rng, np.broadcast_to(light, SIZE)), 0)
    assert dark_noise(frame) == pytest.approx(STD, rel=0.1)


def test_quantisation_is_the_least(rng):
    coarse = np.round(RAMP * 255).astype(np.float32)
    assert dark_noise(coarse) >= 1 / np.sqrt(12)
    # Of 0.77 steps: rounding adds a twelfth of a squared step to it.
    stored = np.round(255 * noisy(rng, 0.1 + RAMP))
    assert dark_noise(stored) == pytest.approx(np.hypot(255 * STD, 1 / np.sqrt(12)), rel=0.08)


def test_light_that_varies_without_noise_has_none():
    assert dark_noise(RAMP.astype(np.float32)) < 1e-6


def test_saturated_pixels_are_left_out(rng):
    frame = noisy(rng, RAMP)
    assert dark_noise(np.where(frame > 0.5, np.nan, frame)) == pytest.approx(STD, rel=0.1)


def test_a_frame_without_contrast_or_light_has_none():
    assert dark_noise(np.zeros((20, 20), np.float32)) == 0.0
    assert dark_noise(np.full((20, 20), np.nan, np.float32)) == 0.0
    assert dark_noise(np.ones((7, 7), np.float32)) == 0.0
