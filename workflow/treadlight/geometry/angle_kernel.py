"""Angles in kernels."""

import numpy as np

from treadlight.compiling import kernel


@kernel(inline="always")
def wrapped(angle):
    """`axis.wrap_angle` of one angle."""
    turn = angle + np.pi
    return turn - np.floor(turn / (2 * np.pi)) * (2 * np.pi) - np.pi
