"""Sub-pixel corners: a blurred saddle fitted to the pixels around each.

A corner's neighbourhood is the product of two blurred edges. Fitting that model uses every pixel
that the edges cross at its weight; OpenCV's gradient method (Foerstner and Guelch 1987) weighs
gradients whose places only pixels' differences know, and is some three times less certain.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import erf

_ITERATIONS = 30
_FIRST_DAMPING = 1e-3
# Blur: of a pixel's own width at least, of the window at most.
_LEAST_SOFTNESS_PX = 0.3
_TWO_OVER_ROOT_PI = 2 / np.sqrt(np.pi)


@dataclass(frozen=True)
class Saddles:
    """Fitted corners.

    Attributes
    ----------
    position : (n, 2) float64
        Pixels.
    softness_px : (n,) float64
        An edge is erf(distance / softness).
    """

    position: np.ndarray
    softness_px: np.ndarray


def fit_saddles(image: np.ndarray, start: np.ndarray, half_px: int) -> Saddles:
    """Least-squares saddles at the corners of a board, from a start within a pixel or two.

    I = a + b erf(d1 / s) erf(d2 / s) + g . x, with the distances d1, d2 from two lines through the
    corner, over a disk of pixels; Levenberg-Marquardt on all corners at once. A corner that
    leaves the middle of its disk stays where it started.

    Parameters
    ----------
    image : (h, w) float
        Linear intensity.
    start : (rows, columns, 2) float
        Corners of the board, pixels.
    half_px : int
        Radius of the disk.
    """
    first = start.reshape(-1, 2).astype(np.float64)
    base = np.rint(first).astype(int)
    values, weight, x, y = _disks(image, base, half_px)
    p = np.zeros((len(first), 9))
    p[:, :2] = first - base
    p[:, 2:4] = _line_angles(start)
    linear = _model(p, x, y)[1][..., 5:] * weight[..., None]
    p[:, 5:] = _solve(linear, values * weight, np.full(len(p), 1e-9))
    p = _levenberg_marquardt(p, values, weight, x, y, half_px)
    strayed = np.hypot(*(base + p[:, :2] - first).T) > 0.5 * half_px
    return Saddles(np.where(strayed[:, None], first, base + p[:, :2]), np.exp(p[:, 4]))


def _disks(
    image: np.ndarray, base: np.ndarray, half_px: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Pixels (n, k) around each place, normalised; 1 inside the image, 0 outside; x, y (k,)."""
    span = np.arange(-half_px, half_px + 1)
    y, x = (a.ravel() for a in np.meshgrid(span, span, indexing="ij"))
    disk = np.hypot(x, y) <= half_px + 0.5
    x, y = x[disk], y[disk]
    u, v = base[:, :1] + x, base[:, 1:] + y
    height, width = image.shape
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    values = image[np.clip(v, 0, height - 1), np.clip(u, 0, width - 1)].astype(np.float64)
    spread = values.std(axis=1, keepdims=True)
    values = (values - values.mean(axis=1, keepdims=True)) / np.where(spread > 0, spread, 1.0)
    return values, inside.astype(np.float64), x.astype(np.float64), y.astype(np.float64)


def _line_angles(start: np.ndarray) -> np.ndarray:
    """Angles of the normals of the two lines through each corner, (n, 2) rad."""
    along, down = (np.gradient(start, axis=k).reshape(-1, 2) for k in (1, 0))
    return np.stack([np.arctan2(d[:, 0], -d[:, 1]) for d in (along, down)], axis=1)


def _model(p: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Intensities (n, k) and their derivatives (n, k, 9).

    Parameters (n, 9): corner x and y, angles of both normals, ln softness, mean, contrast,
    gradient x and y.
    """
    dx, dy = x - p[:, :1], y - p[:, 1:2]
    soft = np.exp(p[:, 4:5])
    cosine, sine = np.cos(p[:, 2:4]), np.sin(p[:, 2:4])
    edge, steepness, distance, turn = [], [], [], []
    for k in range(2):
        c, s = cosine[:, k, None], sine[:, k, None]
        at = (dx * c + dy * s) / soft
        distance.append(at)
        turn.append((dy * c - dx * s) / soft)
        edge.append(erf(at))
        steepness.append(_TWO_OVER_ROOT_PI * np.exp(-at * at))
    contrast = p[:, 6:7]
    product = edge[0] * edge[1]
    first, second = contrast * steepness[0] * edge[1], contrast * steepness[1] * edge[0]
    ones = np.ones_like(product)
    jacobian = [
        -(first * cosine[:, :1] + second * cosine[:, 1:]) / soft,
        -(first * sine[:, :1] + second * sine[:, 1:]) / soft,
        first * turn[0],
        second * turn[1],
        -(first * distance[0] + second * distance[1]),
        ones,
        product,
        ones * x,
        ones * y,
    ]
    value = p[:, 5:6] + contrast * product + p[:, 7:8] * x + p[:, 8:9] * y
    return value, np.stack(jacobian, axis=-1)


def _levenberg_marquardt(
    p: np.ndarray, values: np.ndarray, weight: np.ndarray, x: np.ndarray, y: np.ndarray, half: int
) -> np.ndarray:
    limits = np.log([_LEAST_SOFTNESS_PX, half])
    damping = np.full(len(p), _FIRST_DAMPING)
    model, jacobian = _model(p, x, y)
    residual = weight * (values - model)
    cost = np.sum(residual**2, axis=1)
    for _ in range(_ITERATIONS):
        trial = p + _solve(jacobian * weight[..., None], residual, damping)
        trial[:, 4] = np.clip(trial[:, 4], *limits)
        model, slope = _model(trial, x, y)
        miss = weight * (values - model)
        new = np.sum(miss**2, axis=1)
        better = new < cost
        p, cost = np.where(better[:, None], trial, p), np.where(better, new, cost)
        residual = np.where(better[:, None], miss, residual)
        jacobian = np.where(better[:, None, None], slope, jacobian)
        damping = np.where(better, damping / 5, damping * 5)
    return p


def _solve(jacobian: np.ndarray, residual: np.ndarray, damping: np.ndarray) -> np.ndarray:
    """Damped normal equations of each corner: (n, k, m), (n, k), (n,) to (n, m)."""
    normal = np.swapaxes(jacobian, 1, 2) @ jacobian
    diagonal = np.einsum("nii->ni", normal)
    normal = normal + damping[:, None, None] * (diagonal[:, :, None] + 1e-9) * np.eye(
        normal.shape[-1]
    )
    right = np.swapaxes(jacobian, 1, 2) @ residual[..., None]
    return np.linalg.solve(normal, right)[..., 0]
