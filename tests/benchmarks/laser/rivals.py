"""The estimators of the line's place in a row that others use, written plainly.

Each takes intensity (rows, width) and the line's true sigma, px, which only the Gaussian fit's
window and the FIR filter's length make use of, and returns columns (rows,), NaN where it finds
none.
"""

from collections.abc import Callable

import numpy as np
from scipy.ndimage import correlate1d


def half_maximum(intensity: np.ndarray, sigma_px: float) -> np.ndarray:
    """Centroid of what reaches half of the row's maximum (eq. 3.4 of the dissertation)."""
    light = np.where(intensity >= 0.5 * intensity.max(axis=1, keepdims=True), intensity, 0)
    with np.errstate(invalid="ignore"):
        return light @ np.arange(intensity.shape[1]) / light.sum(axis=1)


def parabola(intensity: np.ndarray, sigma_px: float) -> np.ndarray:
    """Vertex of the parabola through the brightest pixel and its neighbours."""
    top = _brightest(intensity)
    rows = np.arange(len(intensity))
    left, middle, right = (intensity[rows, top + k].astype(float) for k in (-1, 0, 1))
    bend = left - 2 * middle + right
    # Three clipped pixels lie level.
    return top + 0.5 * np.divide(left - right, bend, out=np.zeros_like(bend), where=bend < 0)


def gaussian(intensity: np.ndarray, sigma_px: float) -> np.ndarray:
    """Gaussian fitted to what exceeds a fifth of the maximum within two sigmas of it.

    Least squares on the logarithms, weighted by the squared light as its noise wants (Guo, A
    simple algorithm for fitting a Gaussian function, IEEE Signal Processing Magazine 28, 2011).
    """
    top = _brightest(intensity)[:, None]
    offset = np.arange(intensity.shape[1]) - top
    light = intensity.astype(float)
    use = (np.abs(offset) <= np.ceil(2 * sigma_px)) & (
        light > 0.2 * light.max(axis=1, keepdims=True)
    )
    weight = np.where(use, light, 0) ** 2
    logarithm = np.log(np.where(use, light, 1))
    moments = [np.sum(weight * offset**p, axis=1) for p in range(5)]
    normal = np.stack([np.stack(moments[k : k + 3], axis=-1) for k in range(3)], axis=-2)
    right = np.stack([np.sum(weight * logarithm * offset**p, axis=1) for p in range(3)], axis=-1)
    known = use.sum(axis=1) >= 3
    centre = np.full(len(intensity), np.nan)
    _, slope, bend = np.linalg.solve(normal[known], right[known][..., None])[..., 0].T
    # An upright parabola of logarithms has no peak.
    centre[known] = top[known, 0] - np.divide(
        slope, 2 * bend, out=np.full_like(bend, np.nan), where=bend < 0
    )
    return centre


def fir(intensity: np.ndarray, sigma_px: float) -> np.ndarray:
    """Zero crossing of a derivative filter next to the maximum (Blais and Rioux 1986; Forest 2004).

    Minus ones and ones over two sigmas either side, which also is the low pass.
    """
    reach = max(2, round(2 * sigma_px))
    taps = np.concatenate([-np.ones(reach), [0.0], np.ones(reach)])
    slope = correlate1d(intensity.astype(float), taps, axis=1, mode="nearest")
    falling = (slope[:, :-1] > 0) & (slope[:, 1:] <= 0)
    away = np.abs(np.arange(slope.shape[1] - 1) + 0.5 - _brightest(intensity)[:, None])
    place = np.argmin(np.where(falling, away, np.inf), axis=1)
    rows = np.arange(len(slope))
    before, after = slope[rows, place], slope[rows, place + 1]
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(falling.any(axis=1), place + before / (before - after), np.nan)


def _brightest(intensity: np.ndarray) -> np.ndarray:
    return np.clip(np.argmax(intensity, axis=1), 1, intensity.shape[1] - 2)


RIVALS: dict[str, Callable[[np.ndarray, float], np.ndarray]] = {
    "half maximum": half_maximum,
    "parabola": parabola,
    "gaussian": gaussian,
    "fir": fir,
}
