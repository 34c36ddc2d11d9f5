"""Where a bright line crosses each row of an image, to a fraction of a pixel."""

import numpy as np
from scipy.ndimage import gaussian_filter1d

# A crossing counts where it stands this many noise standard deviations over its row.
_MIN_CONTRAST = 5.0
_FWHM_PER_SIGMA = 2.3548
_MIN_SIGMA_PX = 0.7


def line_centres(
    intensity: np.ndarray, allowed: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Centre of the brightest line in each row.

    The centre is the zero crossing of the row's convolution with a Gaussian's derivative as
    wide as the line itself (Steger 1998), which a symmetric line cannot move.

    Parameters
    ----------
    intensity : (h, w) float32
        Linear.
    allowed : (h, w) bool
        Where the line's centre may lie.

    Returns
    -------
    u : (h,) float64
        Column, pixels. NaN where the row has no line.
    strength : (h,) float64
        Peak over the row's background after smoothing, as `intensity`.
    sigma_px : float
        Standard deviation of the line's profile, pixels: the median row's.
    """
    background = np.median(intensity, axis=1, keepdims=True)
    signal = intensity.astype(np.float64) - background
    sigma = _line_sigma(signal, allowed)
    smooth = gaussian_filter1d(signal, sigma, axis=1)
    peak = np.argmax(np.where(allowed, smooth, -np.inf), axis=1)
    rows = np.arange(len(signal))
    slope = gaussian_filter1d(signal, sigma, axis=1, order=1)
    u = _zero_crossing(slope, peak)
    strength = smooth[rows, peak]
    noise = _noise(smooth)
    good = allowed[rows, peak] & (strength > _MIN_CONTRAST * noise)
    return np.where(good, u, np.nan), strength, sigma


def _line_sigma(signal: np.ndarray, allowed: np.ndarray) -> float:
    """Width of the line from its half-maximum runs in the rows where it is strongest."""
    inside = np.where(allowed, signal, 0)
    peaks = inside.max(axis=1)
    strong = peaks > 0.5 * np.percentile(peaks, 95)
    if not strong.any():
        return _MIN_SIGMA_PX
    width = np.sum(inside[strong] > 0.5 * peaks[strong, None], axis=1)
    return max(float(np.median(width)) / _FWHM_PER_SIGMA, _MIN_SIGMA_PX)


def _noise(smooth: np.ndarray) -> float:
    """Standard deviation of the background, from the median absolute value; never zero."""
    spread = 1.4826 * float(np.median(np.abs(smooth - np.median(smooth))))
    return max(spread, 1e-6)


def _zero_crossing(slope: np.ndarray, peak: np.ndarray) -> np.ndarray:
    """Where the slope falls through zero within a pixel of `peak`, linearly interpolated."""
    rows, width = np.arange(len(slope)), slope.shape[1]
    left = np.where(slope[rows, peak] > 0, peak, peak - 1)
    inside = (left >= 0) & (left + 1 < width)
    left = np.clip(left, 0, width - 2)
    before, after = slope[rows, left], slope[rows, left + 1]
    crosses = inside & (before > 0) & (after <= 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(crosses, left + before / (before - after), np.nan)
