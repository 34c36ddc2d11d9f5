"""Normals of the integrated surface: its own, and beside steps those that a pixel would see."""

import numpy as np

from treadlight.compiling import kernel
from treadlight.geometry import CylinderGrid
from treadlight.integrate.kernels import least_rows
from treadlight.threads import by_ranges

# A pixel's resolution, cells.
_PIXEL_SIGMA = 0.7
_RADIUS = 3
# Quantiles are told to a thousandth by so many.
_MOST_ANGLES = 1_000_000


def solved_slopes(r: np.ndarray, uncut: np.ndarray, grid: CylinderGrid) -> np.ndarray:
    """dr / (r dtheta) and dr / dz of heights, from the edges on either side that are not cut.

    Parameters
    ----------
    r : (n, m) float64
        mm; NaN where it is not known.
    uncut : (2, n, m) bool
    grid : CylinderGrid

    Returns
    -------
    (2, n, m) float32
        NaN where both sides are cut.
    """
    slope = np.empty((2, *r.shape), np.float32)
    steps = grid.step_theta, grid.step_z
    by_ranges(_slopes, len(r), least_rows(r), np.float64(r), uncut, *steps, slope)
    return slope


@kernel
def _slopes(first, last, r, uncut, step_theta, step_z, slope):
    n, m = r.shape
    for i in range(first, last):
        up, down = (i if i > 0 else n) - 1, i + 1 if i < n - 1 else 0
        for j in range(m):
            rise, count = _rise(r[up, j], r[i, j], r[down, j], uncut[0, up, j], uncut[0, i, j])
            slope[0, i, j] = rise / (count * step_theta * r[i, j])
        for j in range(m):
            left, right = (j if j > 0 else m) - 1, j + 1 if j < m - 1 else 0
            rise, count = _rise(r[i, left], r[i, j], r[i, right], uncut[1, i, left], uncut[1, i, j])
            slope[1, i, j] = rise / (count * step_z)


@kernel(inline="always")
def _rise(before, here, behind, whole_before, whole_behind):
    """Over the edges beside a cell that are not cut and lead to what is known; how many."""
    low, high = here - before, behind - here
    one = whole_before and np.isfinite(low)
    two = whole_behind and np.isfinite(high)
    rise = (low if one else 0.0) + (high if two else 0.0)
    # NaN where it is 0 / 0.
    return rise, (1.0 if one else 0.0) + (1.0 if two else 0.0)


def surface_normals(
    slope: np.ndarray, blurred: np.ndarray, r: np.ndarray, grid: CylinderGrid
) -> np.ndarray:
    """Unit normals of solved slopes, in a mask those of the heights at a pixel's resolution.

    Once through the grid; 7 by 7 cells around each are weighted row by row and then column by
    column, some 60 operations.

    Parameters
    ----------
    slope : (2, n, m) float32
    blurred : (n, m) bool
    r : (n, m) float64
        mm; NaN where it is not known: those around are weighted alone.
    grid : CylinderGrid

    Returns
    -------
    (n, m, 3) float32
        Components r, theta, z.
    """
    normal = np.empty((*r.shape, 3), np.float32)
    away = np.arange(-_RADIUS, _RADIUS + 1)
    weights = np.exp(-0.5 * (away / _PIXEL_SIGMA) ** 2)
    weights = (weights / weights.sum()).astype(np.float32)
    # Single precision tells what is a tread's depth off one of its heights.
    level = float(np.nan_to_num(r.flat[np.argmax(np.isfinite(r))]))
    given = slope, blurred, np.float64(r), level, weights
    steps = grid.periodic, grid.step_theta, grid.step_z
    by_ranges(_normals, len(r), least_rows(r), *given, *steps, normal)
    return normal


@kernel(allocates=True)
def _normals(
    first, last, slope, blurred, r, level, weights, periodic, step_theta, step_z, normal
):  # fmt: skip
    n, m = r.shape
    size = len(weights)
    radius = size // 2
    single = normal.dtype.type
    padded = np.zeros((2, m + 2 * radius), normal.dtype)
    # Of a ring of rows: what is known, and its weight, across z; then along theta as well.
    across = np.zeros((size, 2, m), normal.dtype)
    both = np.zeros((3, m), normal.dtype)
    weight = np.zeros(m, normal.dtype)
    for ahead in range(first - radius - 1, last + radius + 1):
        _blur_row(r[_row(ahead, n, periodic)], level, weights, padded, across[ahead % size])
        middle = ahead - radius
        if middle < first - 1:
            continue
        out = both[middle % 3]
        out[:], weight[:] = 0, 0
        for k in range(size):
            row, share = across[(middle - radius + k) % size], weights[k]
            for j in range(m):
                out[j] += share * row[0, j]
                weight[j] += share * row[1, j]
        own = r[_row(middle, n, periodic)]
        for j in range(m):
            out[j] = out[j] / weight[j] if np.isfinite(own[j]) else single(np.nan)
        i = middle - 1
        if i < first:
            continue
        before = i - 1 if periodic or i > 0 else i
        behind = i + 1 if periodic or i < n - 1 else i
        length = (behind - before) * step_theta
        low, here, high = both[before % 3], both[i % 3], both[behind % 3]
        for j in range(m):
            p, q = slope[0, i, j], slope[1, i, j]
            if blurred[i, j]:
                left, right = max(j - 1, 0), min(j + 1, m - 1)
                along = (high[j] - low[j]) / (length * (here[j] + level))
                aside = (here[right] - here[left]) / ((right - left) * step_z)
                if np.isfinite(along):
                    p = along
                if np.isfinite(aside):
                    q = aside
            upright = 1 / np.sqrt(1 + p * p + q * q)
            normal[i, j, 0] = upright
            normal[i, j, 1] = -p * upright
            normal[i, j, 2] = -q * upright


@kernel(inline="always")
def _row(i, n, periodic):
    return i % n if periodic else min(max(i, 0), n - 1)


@kernel
def _blur_row(r, level, weights, padded, out):
    """Weighted sums across z of what is known over a level, and of its weight; on at the rim."""
    m, radius = len(r), len(weights) // 2
    for j in range(m):
        known = np.isfinite(r[j])
        padded[0, radius + j] = r[j] - level if known else 0.0
        padded[1, radius + j] = 1.0 if known else 0.0
    for k in range(radius):
        for c in range(2):
            padded[c, k] = padded[c, radius]
            padded[c, radius + m + k] = padded[c, radius + m - 1]
    out[:] = 0
    for c in range(2):
        for k in range(len(weights)):
            for j in range(m):
                out[c, j] += weights[k] * padded[c, j + k]


def normal_residual(solved: np.ndarray, photometric: np.ndarray) -> tuple[float, float]:
    """Median and 95th percentile of the angle between two fields of slopes (2, n, m), rad.

    Of every so many rows that a million cells are left; NaN where they share none.
    """
    every = max(1, solved[0].size // _MOST_ANGLES)
    cosine = np.einsum(
        "...k,...k",
        *(_normals_of(slope[:, every // 2 :: every]) for slope in (solved, photometric)),
        dtype=np.float64,
    )
    cosine = cosine[np.isfinite(cosine)]
    if not cosine.size:
        return np.nan, np.nan
    median, high = np.percentile(np.arccos(np.clip(cosine, -1, 1)), [50, 95])
    return float(median), float(high)


def _normals_of(slope: np.ndarray) -> np.ndarray:
    normal = np.stack([np.ones_like(slope[0]), -slope[0], -slope[1]], axis=-1)
    return normal / np.linalg.norm(normal, axis=-1, keepdims=True)
