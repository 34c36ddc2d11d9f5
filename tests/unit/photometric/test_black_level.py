"""What a stack lacks where too high a black level was taken out, and what must not look like it."""

from dataclasses import replace

import numpy as np
import pytest

from treadlight.photometric import map_normals
from treadlight.photometric.black_level import excess_black_level, give_back_black_level


@pytest.fixture
def stack(analytic, rng):
    """Normals up to 50 degrees from the view, and what they show under the rig's rings."""
    height = 1 - rng.uniform(0, 1 - np.cos(np.radians(50)), 1500)
    turn = rng.uniform(0, 2 * np.pi, 1500)
    across = np.sqrt(1 - height**2)
    normals = np.column_stack([height, across * np.cos(turn), across * np.sin(turn)])
    lights = analytic.two_rings()
    clean = analytic.blinn_phong(normals, lights, 0.1, 0.3, 40)
    noisy = clean + 1e-4 * rng.standard_normal(clean.shape)
    return normals, analytic.observe(noisy, lights, noise=1e-4)


def cut(observations, excess):
    return replace(
        observations, intensity=np.maximum(observations.intensity - np.float32(excess), 0)
    )


@pytest.mark.parametrize("excess", [0.005, 0.01])
def test_an_excess_is_found_and_given_back(analytic, stack, excess):
    normals, observations = stack
    lacking = cut(observations, excess)
    found = excess_black_level(lacking)
    assert found == pytest.approx(excess, rel=0.05)
    whole = give_back_black_level(lacking, found)
    assert not whole.usable[lacking.intensity == 0].any()
    error = analytic.degrees_between(map_normals(lacking).normal, normals)
    assert np.nanmedian(error) < 0.1


def test_a_stack_that_lacks_nothing_stays_as_it_is(stack):
    _, observations = stack
    assert excess_black_level(observations) == 0.0
    assert give_back_black_level(observations, 0.0) is observations


def test_light_too_much_is_none_of_its_business(stack):
    """Ambient light, like the tails of a broad gloss, is not taken for a black level."""
    _, observations = stack
    bright = replace(observations, intensity=observations.intensity + np.float32(0.01))
    assert excess_black_level(bright) == 0.0


def test_nothing_lit_says_nothing(stack):
    _, observations = stack
    dark = replace(observations, intensity=np.zeros_like(observations.intensity))
    assert excess_black_level(dark) == 0.0
