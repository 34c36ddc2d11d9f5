"""Numbers without the bits that only hold noise: they pack into half, and faster."""

import numpy as np

from treadlight.compiling import kernel
from treadlight.threads import by_ranges

_LEAST = 1 << 18


def keep_bits(values: np.ndarray, bits: int) -> None:
    """Round to so many bits of the mantissa, in place: to 2^-(bits + 1) of a value at the most.

    Parameters
    ----------
    values : (...) float32 or float64
        Contiguous. What is not finite stays.
    bits : int
        Fewer than the mantissa's 23, or 52.

    Raises
    ------
    ValueError
        Not contiguous: a defect of the caller.
    """
    if not values.flags.c_contiguous:
        raise ValueError("Values that are not contiguous cannot be rounded in place.")
    info = np.finfo(values.dtype)
    whole = values.view(f"u{values.itemsize}").reshape(-1)
    drop = info.nmant - bits
    ones = whole.dtype.type((1 << drop) - 1)
    exponent = whole.dtype.type(((1 << info.nexp) - 1) << info.nmant)
    half = whole.dtype.type(1 << (drop - 1))
    by_ranges(_round, whole.size, _LEAST, whole, half, ~ones, exponent)


@kernel
def _round(first, last, whole, half, mask, exponent):
    for k in range(first, last):
        if whole[k] & exponent != exponent:
            whole[k] = (whole[k] + half) & mask
