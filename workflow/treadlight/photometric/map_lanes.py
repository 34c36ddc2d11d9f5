"""How pixels lie side by side in the kernels of `map_kernels` and `map_starts`, and their powers.

Every loop runs over `LANES` pixels of one LED, without a branch or a library call, over rows whose
places in flat arrays are constants, so that the compiler sees that no two overlap, and vectorises.
"""

import math

import numpy as np
from numba import njit

from treadlight.photometric.lanes import exp2

LANES = 32
LEAST_NH = np.float32(0.02)
LN2, LOG2E = np.float32(math.log(2.0)), np.float32(1 / math.log(2.0))
# Powers of two below this are nothing in single precision.
DARKEST = np.float32(-40.0)
ONE = np.float32(1.0)


def rows(count: int) -> range:
    """Where the rows of a flat array of rows begin."""
    return range(0, count * LANES, LANES)


# One LED: light vector, halfway vector, intensity, 1 / its standard deviation.
LX, LY, LZ, HX, HY, HZ, LIGHT, SHARP = rows(8)
LED = 8 * LANES


@njit(cache=True, error_model="numpy", inline="always")
def log2(x):
    """log2 for 0.02 <= x <= 1 to 1e-5: two square roots, then the series of atanh."""
    y = math.sqrt(math.sqrt(x))
    t = (y - ONE) / (y + ONE)
    s = t * t
    p = np.float32(1 / 13) * s + np.float32(1 / 11)
    p = p * s + np.float32(1 / 9)
    p = p * s + np.float32(1 / 7)
    p = p * s + np.float32(1 / 5)
    p = p * s + np.float32(1 / 3)
    p = p * s + ONE
    return np.float32(8.0) * LOG2E * t * p


@njit(cache=True, error_model="numpy", inline="always")
def exp(x):
    """e^x for |x| <= 1 to 1e-6."""
    y = exp2(np.float32(-abs(x)) * LOG2E)
    return y if x < 0 else ONE / y
