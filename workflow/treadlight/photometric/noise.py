"""How noisy a frame is where it is dark, from the frame itself."""

import numpy as np

_MAD_TO_STD = 1.4826
# A second difference of white noise has six times its variance.
_SECOND_DIFFERENCE = np.sqrt(6.0)
_DARK_SHARE = 10


def dark_noise(frame: np.ndarray) -> float:
    """Standard deviation of a frame's intensity where there is little light.

    The median absolute second difference along the rows, over the darkest tenth of the pixels:
    differences cancel what is smooth, the median what is not noise. Never below a 1/sqrt(12) of
    the smallest step between two intensities there, which is what quantisation adds.

    Parameters
    ----------
    frame : (h, w) float32
        Linear intensity; NaN where saturated.

    Returns
    -------
    float
        In the unit of the frame; 0 for a frame without contrast.
    """
    second = frame[:, :-2] - 2 * frame[:, 1:-1] + frame[:, 2:]
    level = frame[:, 1:-1]
    known = np.isfinite(second)
    if not known.any():
        return 0.0
    dark = known & (level <= np.percentile(level[known], _DARK_SHARE))
    spread = _MAD_TO_STD * float(np.median(np.abs(second[dark]))) / _SECOND_DIFFERENCE
    steps = np.diff(np.unique(level[dark]))
    quantisation = float(steps.min()) / np.sqrt(12) if steps.size else 0.0
    return max(spread, quantisation)
