"""Wear as the radial difference of two aligned captures, with its uncertainty."""

import numpy as np
from scipy import ndimage

from treadlight.compiling import kernel
from treadlight.geometry import CylinderGrid
from treadlight.geometry.axis import wrap_angle
from treadlight.threads import by_ranges
from treadlight.wear.alignment import Alignment
from treadlight.wear.motion import Motion
from treadlight.wear.relief import smooth

# Texture is no slope: as in evaluation.md, walls are judged after this Gaussian.
_SLOPE_SIGMA_MM = 0.5
# 27 degrees: steeper than any tread or shoulder, so a wall or its foot as it was measured; a
# radial difference there says how the wall sits, not what wore.
_WALL_SLOPE = 0.5
# A wall's edge and foot are rounded.
_WALL_MARGIN_MM = 0.3
# Rows of interpolation on either side.
_MARGIN = 4
# Rows beyond a block that its slopes need.
HALO_MM = 4 * _SLOPE_SIGMA_MM


def rows_needed(motion: Motion, theta: np.ndarray, z: np.ndarray, grid: CylinderGrid) -> np.ndarray:
    """Rows of a capture's grid that come to lie on some rows of the first capture's.

    Parameters
    ----------
    theta : (n,) float
        Wanted rows, rad, increasing.
    z : (m,) float
        Wanted columns, mm.
    grid : CylinderGrid
        The capture's.

    Returns
    -------
    (k,) int
        Consecutive; on a whole turn they may be negative or pass its end (to be taken modulo).
        Empty where an open grid has nothing there.
    """
    corner_theta, corner_z = np.meshgrid(theta[[0, len(theta) // 2, -1]], z[[0, -1]])
    radius = np.full(corner_theta.shape, grid.nominal_radius_mm)
    found = motion.undo(corner_theta, corner_z, radius)[0]
    # Off-centres and tilts shift corners by fractions of a degree from the plain rotation.
    skew = np.abs(wrap_angle(found - (corner_theta - motion.values[0]))).max()
    low = theta[0] - motion.values[0] - skew - grid.theta[0]
    length = theta[-1] - theta[0] + 2 * skew
    low -= 2 * np.pi * np.floor(low / (2 * np.pi))
    first = int(np.floor(low / grid.step_theta)) - _MARGIN
    last = int(np.ceil((low + length) / grid.step_theta)) + _MARGIN
    if grid.periodic:
        return np.arange(first, last + 1)
    turn = round(2 * np.pi / grid.step_theta)
    rows = np.concatenate([np.arange(first - k * turn, last - k * turn + 1) for k in (0, 1)])
    rows = rows[(rows >= 0) & (rows < grid.shape[0])]
    # Rows on both sides of the gap between a sector's ends: all between them, too.
    return np.arange(rows.min(), rows.max() + 1) if len(rows) > 2 else np.arange(0)


def difference(
    first: np.ndarray,
    first_std: np.ndarray,
    moved: np.ndarray,
    moved_std: np.ndarray,
    alignment: Alignment,
    grid: CylinderGrid,
) -> tuple[np.ndarray, np.ndarray]:
    """Wear between two aligned surfaces, and its standard uncertainty.

    The variance is the sum of both radii's, of the alignment's (by its covariance, in
    the radius and, times the slope, along the surface) and of a position known to the cell
    only, times the slope. On walls and just beside them, where the difference says how
    the wall sits and nothing of wear, both are NaN.

    Parameters
    ----------
    first, first_std, moved, moved_std : (n, m) float
        Radii and their uncertainties, mm, on equal cells; NaN = missing.
    alignment : Alignment
        Of the moved one.
    grid : CylinderGrid
        Of these rows, with HALO_MM of rows on either side for the slopes.

    Returns
    -------
    wear, wear_std : (n, m) float32
        mm, positive where material went.
    """
    slopes = [
        [smooth(r, grid, _SLOPE_SIGMA_MM, order) for order in ((1, 0), (0, 1))]
        for r in (first, moved)
    ]
    along, across = (np.fmax(np.abs(a), np.abs(b)) for a, b in zip(*slopes, strict=True))
    steepness = np.nan_to_num(np.hypot(along, across), nan=np.inf)
    margin = [2 * round(_WALL_MARGIN_MM / side) + 1 for side in _sides_mm(grid)]
    steepness = ndimage.maximum_filter(steepness, margin, mode="nearest")
    variance = np.empty(grid.shape)
    by_ranges(
        _alignment_variance,
        grid.shape[0],
        1,
        grid.theta,
        grid.z,
        np.nan_to_num(slopes[0][0]),
        np.nan_to_num(slopes[0][1]),
        float(alignment.motion.values[0]),
        grid.nominal_radius_mm,
        alignment.covariance,
        variance,
    )
    cells = np.square(_sides_mm(grid)) / 12
    # Twice: either surface's wall sits on its own cell.
    place = 2 * (cells[0] * np.nan_to_num(along) ** 2 + cells[1] * np.nan_to_num(across) ** 2)
    wear = np.where(steepness < _WALL_SLOPE, first - moved, np.nan)
    std = np.sqrt(first_std**2 + moved_std**2 + variance + place)
    return wear.astype(np.float32), np.where(np.isfinite(wear), std, np.nan).astype(np.float32)


def _sides_mm(grid: CylinderGrid) -> tuple[float, float]:
    return grid.step_theta * grid.nominal_radius_mm, grid.step_z


@kernel(allocates=True)
def _alignment_variance(
    first, last, theta, z, slope_theta, slope_z, rotation, radius, covariance, variance
):
    """Variance of r' at equal (theta, z) from the motion's covariance; see Motion.jacobian."""
    for i in range(first, last):
        cos, sin = np.cos(theta[i]), np.sin(theta[i])
        cos_0, sin_0 = np.cos(theta[i] - rotation), np.sin(theta[i] - rotation)
        row = np.empty(7)
        for j in range(z.size):
            p, q = slope_theta[i, j], slope_z[i, j]
            row[0] = -p * radius
            row[1] = -q
            row[2] = -z[j] * sin_0 + p * z[j] * cos_0 - q * radius * sin_0
            row[3] = z[j] * cos_0 + p * z[j] * sin_0 + q * radius * cos_0
            row[4] = cos + p * sin
            row[5] = sin - p * cos
            row[6] = 1.0
            total = 0.0
            for a in range(7):
                for b in range(7):
                    total += row[a] * covariance[a, b] * row[b]
            variance[i, j] = total
