"""How pixels lie side by side in the kernels of `map_kernels` and `map_starts`, and their powers.

Every loop runs over `LANES` pixels of one LED, without a branch or a library call, over rows whose
places in flat arrays are constants, so that the compiler sees that no two overlap, and vectorises.
"""

import math

import numpy as np

from treadlight.compiling import kernel
from treadlight.photometric.lanes import exp2

LANES = 64
LEAST_NH = np.float32(0.02)
LN2, LOG2E = np.float32(math.log(2.0)), np.float32(1 / math.log(2.0))
# Powers of two below this are nothing in single precision.
DARKEST = np.float32(-40.0)
ZERO, ONE = np.float32(0.0), np.float32(1.0)


def rows(count: int) -> range:
    """Where the rows of a flat array of rows begin."""
    return range(0, count * LANES, LANES)


# One LED: light vector, halfway vector, intensity, its variance where it is dark (infinite where
# the LED is not usable), 1 / its standard deviation with the model's misfit, and 1 / intensity
# where that is above three standard deviations of the dark, else 0.
LX, LY, LZ, HX, HY, HZ, LIGHT, DARK, SHARP, BRIGHT = rows(10)
LED = 10 * LANES


@kernel(inline="always")
def exp(x):
    """e^x for |x| <= 1 to 1e-6."""
    y = exp2(np.float32(-abs(x)) * LOG2E)
    return y if x < 0 else ONE / y


@kernel(inline="always")
def either(first, new, old):
    """`new` where `first`, else `old`: a sum, since a choice becomes a branch around the store."""
    return (new if first else ZERO) + (ZERO if first else old)
