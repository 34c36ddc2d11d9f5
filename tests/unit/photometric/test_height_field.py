"""Series that stand for library calls."""

import math

import numpy as np

from treadlight.photometric.height_field import cos_sin


def test_cosine_and_sine_are_those_of_the_library():
    for phi in np.linspace(-1, 1, 201):
        np.testing.assert_allclose(cos_sin(phi), (math.cos(phi), math.sin(phi)), atol=1e-13)
