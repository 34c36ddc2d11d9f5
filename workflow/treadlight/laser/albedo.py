"""Where the line is if an edge of the albedo runs along it, inside the stripe.

Every centroid goes to the brighter half there, by up to half the line's width. The logarithm of a
Gaussian stripe is a parabola, and such an edge a step in it at one of the few pixels, whose own
light says nothing: it may lie on both sides. Speckle fits nothing of this and stays as it is.
"""

import math

import numpy as np

# Light further out is haze and reflection.
_REACH_SIGMA = 3.5
# Pixels below this many standard deviations of the noise have no logarithm to speak of.
_LIT_SIGMA = 3.0
# How far a stripe's logarithm may be off a parabola: 2 % of the light.
_SHAPE_ERROR = 0.02
# A parabola with a step leaves at most this variance per degree of freedom, and one without a step
# so many times as much.
_FITS, _PROVEN = 4.0, 9.0
# Its width is the line's within this factor, and its top within so many sigmas of the peak.
_WIDTH_FACTOR, _FARTHEST_SIGMA = 1.5, 1.5
# Constant, slope, curvature; the step, its place and the light of the pixel there.
_PLAIN_UNKNOWNS, _UNKNOWNS = 3, 6
# An edge along the line goes on: of so many rows about a row's own more than half show one.
_ROWS = 5


def places_at_edges(
    intensity: np.ndarray, u: np.ndarray, sigma_px: float, noise: float
) -> tuple[np.ndarray, np.ndarray]:
    """Places of the line where an edge of the albedo is proven to run along it.

    Some 100 operations per pixel of the stripe.

    Parameters
    ----------
    intensity : (lines, width) float32
    u : (lines,) float32
        The line's peak, px; NaN where none is to be looked at.
    sigma_px : float
        Width of the line in this image.
    noise : float
        As in `LineModel`.

    Returns
    -------
    place, std : (lines,) float64
        And its standard deviation, px; NaN where no edge is proven.
    """
    place, std = np.full((2, len(u)), np.nan)
    x, y, weight = _stripes(intensity, u, sigma_px, noise)
    rows = np.flatnonzero(_are_smooth(y, weight, sigma_px))
    step, scale = _steps(x[rows], y[rows], weight[rows])
    rows, step, scale = rows[step > 0], step[step > 0], scale[step > 0]
    top, variance = _tops(x[rows], y[rows], weight[rows], step)
    found = np.isfinite(top)
    place[rows[found]] = u[rows[found]] + sigma_px * top[found]
    std[rows[found]] = sigma_px * np.sqrt((scale * variance)[found])
    alone = np.convolve(np.isfinite(place), np.ones(_ROWS), "same") < 0.5 * _ROWS
    place[alone], std[alone] = np.nan, np.nan
    return place, std


def _stripes(
    intensity: np.ndarray, u: np.ndarray, sigma_px: float, noise: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Offsets from the peak in sigmas, logarithms of the light, their weights: (lines, n) each."""
    reach = math.ceil(_REACH_SIGMA * sigma_px)
    middle = np.rint(np.nan_to_num(u)).astype(int)[:, None]
    columns = middle + np.arange(-reach, reach + 1)
    inside = (columns >= 0) & (columns < intensity.shape[1]) & np.isfinite(u)[:, None]
    light = intensity[np.arange(len(u))[:, None], np.where(inside, columns, 0)].astype(float)
    lit = inside & (light > max(_LIT_SIGMA * noise, np.finfo(np.float32).tiny))
    light = np.where(lit, light, 1.0)
    weight = np.where(lit, 1 / (_SHAPE_ERROR**2 + (noise / light) ** 2), 0.0)
    x = np.where(lit, (columns - np.nan_to_num(u)[:, None]) / sigma_px, 0.0)
    return x, np.log(light), weight


def _are_smooth(y: np.ndarray, weight: np.ndarray, sigma_px: float) -> np.ndarray:
    """Rows (lines,) whose logarithm bends as a parabola's at most pixels, as under no speckle."""
    lit = weight > 0
    known = lit[:, :-2] & lit[:, 1:-1] & lit[:, 2:]
    bend = np.abs(np.diff(y, 2, axis=1) + sigma_px**-2)
    # Three independent errors make a second difference.
    usual = np.sqrt(6 * _FITS / np.maximum(weight[:, 1:-1], 1.0))
    rough = known & (bend > usual + 0.5 * sigma_px**-2)
    return 2 * np.sum(rough, axis=1) < np.sum(known, axis=1)


def _steps(x: np.ndarray, y: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The pixel at which each row's step is proven to lie, else 0, and the variance left.

    Steps at all pixels are tried at once: what one has in common with anything is a sum over the
    pixels beyond it, and the pixel's own light is a second unknown.
    """
    root = np.sqrt(weight)
    basis, _ = np.linalg.qr(root[..., None] * x[..., None] ** np.arange(3))
    left = root * y
    left = left - (basis @ (np.swapaxes(basis, 1, 2) @ left[..., None]))[..., 0]
    plain = np.sum(left**2, axis=1)
    shared = _beyond(root[..., None] * basis)
    own = root[..., None] * basis
    steps = _beyond(weight) - np.sum(shared**2, axis=2)
    pixel = weight - np.sum(own**2, axis=2)
    both = -np.sum(shared * own, axis=2)
    a, b = _beyond(root * left), root * left
    determinant = steps * pixel - both**2
    # A step that leaves a side with too few pixels is a part of the parabola.
    apart = determinant > 1e-6 * np.maximum(_beyond(weight), 1.0) * np.maximum(weight, 1.0)
    gain = pixel * a**2 - 2 * both * a * b + steps * b**2
    gain = np.where(apart, gain / np.where(apart, determinant, 1.0), 0.0)
    best = np.argmax(gain, axis=1)
    free = np.sum(weight > 0, axis=1) - _UNKNOWNS
    least = np.maximum(plain - np.max(gain, axis=1), 0.0)
    scale = np.maximum(least / np.maximum(free, 1), 1.0)
    proven = (free > 0) & (scale <= _FITS)
    proven &= plain > _PROVEN * scale * (free + _UNKNOWNS - _PLAIN_UNKNOWNS)
    return np.where(proven, best, 0), scale


def _beyond(values: np.ndarray) -> np.ndarray:
    """Sums over the pixels after each, (lines, n, ...)."""
    return np.cumsum(values[:, ::-1], axis=1)[:, ::-1] - values


def _tops(
    x: np.ndarray, y: np.ndarray, weight: np.ndarray, step: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Top of each row's parabola beside a step at pixel `step`, and its variance at scale 1."""
    pixels = np.arange(x.shape[1])
    beyond = pixels > step[:, None]
    weight = np.where(pixels == step[:, None], 0.0, weight)
    design = np.stack([np.ones_like(x), x, x**2, beyond], axis=-1)
    weighted = np.swapaxes(design * weight[..., None], 1, 2)
    covariance = np.linalg.inv(weighted @ design)
    _, slope, curvature, _ = np.moveaxis((covariance @ (weighted @ y[..., None]))[..., 0], 1, 0)
    gradient = np.zeros((len(x), 4))
    gradient[:, 1], gradient[:, 2] = -0.5 / curvature, 0.5 * slope / curvature**2
    variance = np.einsum("vi,vij,vj->v", gradient, covariance, gradient)
    width = np.sqrt(np.maximum(-0.5 / curvature, 0.0))
    top = -0.5 * slope / curvature
    alike = (width > 1 / _WIDTH_FACTOR) & (width < _WIDTH_FACTOR)
    return np.where(alike & (np.abs(top) < _FARTHEST_SIGMA), top, np.nan), variance
