"""A height map as a 16-bit picture."""

import numpy as np

# What is missing is black; the lowest height is one step above.
_STEPS = 65534


def height_picture(height: np.ndarray) -> tuple[np.ndarray, float, float]:
    """Heights as 16-bit grey values: mm = low + (value - 1) * step, 0 = missing.

    Parameters
    ----------
    height : (n, m) float
        Along theta and z, mm; NaN = missing.

    Returns
    -------
    picture : (m, n) uint16
        theta to the right, z up.
    low_mm, step_mm : float
    """
    known = np.isfinite(height)
    low = float(height[known].min()) if known.any() else 0.0
    high = float(height[known].max()) if known.any() else 1.0
    step = max(high - low, 1e-6) / (_STEPS - 1)
    grey = np.where(known, np.round((np.where(known, height, low) - low) / step) + 1, 0)
    return grey.astype(np.uint16).T[::-1], low, step
