"""Areal parameters of ISO 25178-2 on a scale-limited surface, from what is known of it."""

from dataclasses import dataclass

import numpy as np
from scipy import fft, ndimage

# Gaussian of ISO 16610-61: half of a wave of the nesting index passes.
_SIGMA_PER_INDEX = np.sqrt(np.log(2) / 2) / np.pi
# A filtered value needs this share of the filter's weight on known cells.
_LEAST_WEIGHT = 0.5
# Decay of the autocorrelation for Sal and Str (ISO 25178-3).
_DECAY = 0.2
_DIRECTIONS = 360
_LEAST_CELLS = 100


@dataclass(frozen=True)
class ArealParameters:
    """ISO 25178-2, in mm where they are lengths.

    Attributes
    ----------
    sa, sq, sz : float
        Arithmetic mean height, root mean square height, maximum height, mm.
    ssk, sku : float
        Skewness, kurtosis.
    sdq : float
        Root mean square gradient.
    sdr : float
        Developed interfacial area ratio, as a share (0.01 = 1 %).
    sal : float
        Autocorrelation length, mm; NaN where the autocorrelation nowhere falls to 0.2.
    str_ : float
        Texture aspect ratio; NaN where it does not fall to 0.2 in every direction.
    """

    sa: float
    sq: float
    sz: float
    ssk: float
    sku: float
    sdq: float
    sdr: float
    sal: float
    str_: float


def scale_limited(
    height: np.ndarray, steps_mm: tuple[float, float], s_filter_mm: float, l_filter_mm: float
) -> np.ndarray:
    """The S-L surface: S-filter, F-operation (plane), L-filter.

    Both filters are areal Gaussians (ISO 16610-61) normalised over the known cells.

    Parameters
    ----------
    height : (n, m) float
        mm; NaN = missing, and missing afterwards.
    steps_mm : (float, float)
        Cell size along both axes.
    s_filter_mm, l_filter_mm : float
        Nesting indices.

    Returns
    -------
    (n, m) float64
    """
    fine = _gaussian(np.asarray(height, np.float64), steps_mm, s_filter_mm)
    flat = fine - _plane(fine)
    return flat - _gaussian(flat, steps_mm, l_filter_mm)


def _gaussian(
    values: np.ndarray, steps_mm: tuple[float, float], nesting_index_mm: float
) -> np.ndarray:
    known = np.isfinite(values)
    sigmas = [_SIGMA_PER_INDEX * nesting_index_mm / step for step in steps_mm]
    weight = ndimage.gaussian_filter(known.astype(np.float64), sigmas, mode="constant")
    total = ndimage.gaussian_filter(np.where(known, values, 0.0), sigmas, mode="constant")
    inside = ndimage.gaussian_filter(np.ones_like(total), sigmas, mode="constant")
    enough = known & (weight >= _LEAST_WEIGHT * inside)
    return np.where(enough, total / np.maximum(weight, 1e-9), np.nan)


def _plane(values: np.ndarray) -> np.ndarray:
    i, j = np.indices(values.shape)
    known = np.isfinite(values)
    basis = np.column_stack([np.ones(values.size), i.ravel(), j.ravel()])
    if known.sum() < 3:
        return np.zeros_like(values)
    found = np.linalg.lstsq(basis[known.ravel()], values[known], rcond=None)[0]
    return (basis @ found).reshape(values.shape)


def areal_parameters(surface: np.ndarray, steps_mm: tuple[float, float]) -> ArealParameters | None:
    """Parameters of a scale-limited surface; heights count from its mean.

    Parameters
    ----------
    surface : (n, m) float
        mm; NaN = missing. Differences, areas and correlations use pairs and squares of known
        cells only.
    steps_mm : (float, float)

    Returns
    -------
    ArealParameters or None
        None of fewer than 100 known cells, or of a perfectly even surface.
    """
    known = np.isfinite(surface)
    if known.sum() < _LEAST_CELLS:
        return None
    centred = surface - surface[known].mean()
    heights = centred[known]
    sq = float(np.sqrt(np.mean(heights**2)))
    if sq == 0:
        return None
    lengths = _decay_lengths(centred, steps_mm)
    shortest = float(np.nanmin(lengths)) if np.isfinite(lengths).any() else np.nan
    return ArealParameters(
        sa=float(np.mean(np.abs(heights))),
        sq=sq,
        sz=float(np.ptp(heights)),
        ssk=float(np.mean(heights**3)) / sq**3,
        sku=float(np.mean(heights**4)) / sq**4,
        sdq=_gradient(centred, steps_mm),
        sdr=_developed_share(centred, steps_mm),
        sal=shortest,
        str_=shortest / float(lengths.max()),
    )


def _gradient(z: np.ndarray, steps_mm: tuple[float, float]) -> float:
    squares = (np.diff(z, axis=axis) / step for axis, step in enumerate(steps_mm))
    return float(np.sqrt(sum(np.nanmean(slope**2) for slope in squares)))


def _developed_share(z: np.ndarray, steps_mm: tuple[float, float]) -> float:
    """Area of the squares of four known cells over their projection, less one (ISO eq. D.15).

    A square's area is the mean of its two cuts into triangles.
    """
    a, b = steps_mm
    south, north = np.diff(z, axis=1)[:-1] / b, np.diff(z, axis=1)[1:] / b
    west, east = np.diff(z, axis=0)[:, :-1] / a, np.diff(z, axis=0)[:, 1:] / a
    halves = [np.sqrt(1 + p**2 + q**2) for p in (south, north) for q in (west, east)]
    return float(np.nanmean(sum(halves) / 4)) - 1


def _decay_lengths(centred: np.ndarray, steps_mm: tuple[float, float]) -> np.ndarray:
    """Distance at which the autocorrelation first falls to 0.2, per direction; NaN where never."""
    correlation = _autocorrelation(centred)
    middle = np.array(correlation.shape) // 2
    reach = [size * step for size, step in zip(middle, steps_mm, strict=True)]
    step = 0.25 * min(steps_mm)
    distance = np.arange(0.0, np.hypot(*reach), step)
    found = np.full(_DIRECTIONS, np.nan)
    for k, angle in enumerate(np.arange(_DIRECTIONS) * np.pi / _DIRECTIONS):
        rows = middle[0] + distance * np.sin(angle) / steps_mm[0]
        columns = middle[1] + distance * np.cos(angle) / steps_mm[1]
        inside = (rows <= correlation.shape[0] - 1) & (columns >= 0)
        inside &= columns <= correlation.shape[1] - 1
        values = ndimage.map_coordinates(correlation, [rows[inside], columns[inside]], order=1)
        below = np.flatnonzero(values < _DECAY)
        if len(below):
            last = below[0] - 1
            share = (values[last] - _DECAY) / (values[last] - values[below[0]])
            found[k] = (last + share) * step
    return found


def _autocorrelation(centred: np.ndarray) -> np.ndarray:
    """Over all lags, 1 in the middle: mean product of the pairs that are known, 0 of none."""
    known = np.isfinite(centred)
    shape = [fft.next_fast_len(2 * size) for size in centred.shape]

    def correlate(values: np.ndarray) -> np.ndarray:
        power = np.abs(fft.rfft2(values, shape)) ** 2
        lags = np.roll(fft.irfft2(power, shape), [size - 1 for size in centred.shape], (0, 1))
        return lags[: 2 * centred.shape[0] - 1, : 2 * centred.shape[1] - 1]

    pairs = np.round(correlate(known.astype(np.float64)))
    products = correlate(np.where(known, centred, 0.0))
    mean = np.where(pairs > 0, products / np.maximum(pairs, 1), 0.0)
    return mean / mean[centred.shape[0] - 1, centred.shape[1] - 1]
