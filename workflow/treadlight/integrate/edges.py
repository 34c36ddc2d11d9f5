"""Edges of the grid: what photometry says of the height difference between neighbouring cells."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from treadlight.compiling import kernel
from treadlight.geometry import CylinderGrid
from treadlight.integrate.gather import ViewField
from treadlight.threads import by_ranges
from treadlight.tread.robust import robust_square

# Slopes around a cell that differ this many times as much as they usually do are no texture.
_TEXTURE = 4.0


@dataclass(frozen=True)
class Photometry:
    """All views merged on the grid (n, m).

    Attributes
    ----------
    slope : (2, n, m) float32
        dr / (r dtheta) and dr / dz, mm per mm; NaN where no view has one.
    variance : (2, n, m) float32
    material : (3, n, m) float32
        k_d, k_s, alpha.
    flags : (3, n, m) float32
        Share of pixels that have each of `gather.FLAGS`.
    """

    slope: np.ndarray
    variance: np.ndarray
    material: np.ndarray
    flags: np.ndarray


def merge_views(fields: Iterable[ViewField], grid: CylinderGrid) -> Photometry:
    """Views blended by their information times their `blend`, so that no seam shows.

    The merged information is that of the views, each counted by its blend relative to the
    largest one in the cell.
    """
    n, m = grid.shape
    slope, information = np.zeros((2, 2, n, m), np.float32)
    material, flags = np.zeros((2, 3, n, m), np.float32)
    lit, largest = np.zeros((2, n, m), np.float32)
    seen = np.zeros(n, np.float32)
    sums = slope, information, material, flags, lit, largest, seen
    for field in fields:
        known = field.slope, field.variance, field.material, field.flags, field.blend
        by_ranges(_add_view, len(field.rows), 1, field.rows, *known, *sums)
    by_ranges(_to_means, n, 1, *sums)
    return Photometry(slope, information, material, flags)


@kernel
def _add_view(
    first, last, rows, slope, variance, material, flags, blend, sum_slope, information,
    sum_material, sum_flags, lit, largest, seen,
):  # fmt: skip
    for k in range(first, last):
        i, share = rows[k], blend[k]
        seen[i] += share
        for c in range(3):
            for j in range(lit.shape[1]):
                sum_flags[c, i, j] += share * flags[c, k, j]
        for j in range(lit.shape[1]):
            if not np.isfinite(slope[0, k, j]):
                continue
            for c in range(2):
                weight = share / variance[c, k, j]
                sum_slope[c, i, j] += weight * slope[c, k, j]
                information[c, i, j] += weight
            for c in range(3):
                sum_material[c, i, j] += share * material[c, k, j]
            lit[i, j] += share
            largest[i, j] = max(largest[i, j], share)


@kernel
def _to_means(first, last, slope, information, material, flags, lit, largest, seen):
    """From sums to means, in place; information becomes the means' variance."""
    for i in range(first, last):
        for j in range(lit.shape[1]):
            known = lit[i, j] > 0
            for c in range(2):
                slope[c, i, j] = slope[c, i, j] / information[c, i, j] if known else np.nan
                information[c, i, j] = largest[i, j] / information[c, i, j] if known else np.nan
            for c in range(3):
                material[c, i, j] = material[c, i, j] / lit[i, j] if known else np.nan
                flags[c, i, j] = flags[c, i, j] / seen[i] if seen[i] > 0 else 0


@dataclass(frozen=True)
class Edges:
    """Height differences to the next cell: index 0 along theta, 1 along z.

    Attributes
    ----------
    step : (2, n, m) float32
        Expected difference, mm.
    weight : (2, n, m) float32
        1 / variance, mm^-2; 0 where there is no edge (after the last column; after the last
        row of an open grid).
    photometric : (2, n, m) bool
        Whether the difference comes from normals on both sides; else it is the first surface's.
    mixed : (2, n, m) float32
        Part of a photometric edge's variance along theta, mm^2, that comes from pixels that see two
        slopes, as those of what stands across a groove. 0 along z: grooves' walls are steps.
    """

    step: np.ndarray
    weight: np.ndarray
    photometric: np.ndarray
    mixed: np.ndarray


def build_edges(
    slope: np.ndarray,
    variance: np.ndarray,
    mixed: np.ndarray,
    surface: np.ndarray,
    first_step: np.ndarray,
    first_std: np.ndarray,
    grid: CylinderGrid,
) -> Edges:
    """Edges from slopes on the cells; from the first surface where a side has no slope.

    A photometric edge is the mean slope of its two cells times the distance of their centres
    (along theta at the surface's radius, because p is strictly d ln r / dtheta). Its variance is
    that of one cell's slope, not half of it: along a path every cell counts once.

    Parameters
    ----------
    slope, variance : (2, n, m) float
    mixed : (2, n, m) float
        More variance; see `mixed_variance`.
    surface : (n, m) float
        Complete first surface, mm.
    first_step, first_std : (2, n, m) float
        Its differences to the next cell and their standard deviations, mm; NaN where unknown.
    grid : CylinderGrid
    """
    step = np.zeros(slope.shape, np.float32)
    weight = np.zeros(slope.shape, np.float32)
    photometric = np.zeros(slope.shape, bool)
    loose = np.zeros(slope.shape, np.float32)
    rules = (True, grid.periodic, grid.step_theta), (False, False, grid.step_z)
    for k, rule in enumerate(rules):
        known = slope[k], variance[k], mixed[k], surface, first_step[k], first_std[k]
        found = step[k], weight[k], photometric[k], loose[k]
        by_ranges(_fill, len(surface), 1, *known, *rule, *found)
    return Edges(step, weight, photometric, loose)


def mixed_variance(slope: np.ndarray, grid: CylinderGrid) -> np.ndarray:
    """What no pixel's covariance knows: of two slopes that it sees it shows more of the brighter.

    Of a ramp a few cells wide up to two thirds are lost so, all along it. Where slopes around a
    cell differ more than the tread's texture does, they are as uncertain as they differ.

    Parameters
    ----------
    slope : (2, n, m) float32
    grid : CylinderGrid

    Returns
    -------
    (2, n, m) float32
    """
    mixed = np.zeros(slope.shape, np.float32)
    for axis, values in enumerate(slope):
        known = np.isfinite(values)
        if known.any():
            apart, below = (
                ndimage.maximum_filter(np.where(known, x, -np.inf), 3, mode=grid.filter_mode)
                for x in (values, -values)
            )
            apart += below
            excess = apart - _TEXTURE * np.median(apart[known])
            mixed[axis] = np.where(known, np.maximum(excess, 0) ** 2, 0)
    return mixed


@kernel
def _fill(
    first, last, slope, variance, mixed, surface, first_step, first_std, along_theta, periodic,
    spacing, step, weight, known, loose,
):  # fmt: skip
    n, m = surface.shape
    for i in range(first, last):
        for j in range(m):
            a = i + 1 if along_theta else i
            b = j if along_theta else j + 1
            if a == n:
                if not periodic:
                    continue
                a -= n
            if b == m:
                continue
            length = spacing
            if along_theta:
                length = spacing * 0.5 * (surface[i, j] + surface[a, b])
            mean = 0.5 * (slope[i, j] + slope[a, b])
            if np.isfinite(mean):
                step[i, j] = length * mean
                more = 0.5 * (mixed[i, j] + mixed[a, b])
                spread = 0.5 * (variance[i, j] + variance[a, b]) + more
                weight[i, j] = 1 / (length * length * spread)
                loose[i, j] = length * length * more if along_theta else 0
                known[i, j] = True
            elif np.isfinite(first_step[i, j]):
                step[i, j] = first_step[i, j]
                weight[i, j] = 1 / first_std[i, j] ** 2


def curl_scale(slope: np.ndarray, variance: np.ndarray, grid: CylinderGrid) -> float:
    """How much larger the slopes' noise is than said: ratio of standard deviations.

    A surface has no curl, so the sum of the edges around each square of four cells is noise.
    The median of its square over the variance predicted is robust against the squares that a
    step crosses. 1 where there are no squares.
    """
    x, z = grid.step_theta * grid.nominal_radius_mm, grid.step_z
    p, q = slope
    across = p[:-1, :-1] + p[1:, :-1] - p[:-1, 1:] - p[1:, 1:]
    along = q[1:, :-1] + q[1:, 1:] - q[:-1, :-1] - q[:-1, 1:]
    spread = [v[:-1, :-1] + v[1:, :-1] + v[:-1, 1:] + v[1:, 1:] for v in variance]
    ratio = (x * across + z * along) / np.sqrt(x * x * spread[0] + z * z * spread[1])
    ratio = ratio[np.isfinite(ratio)]
    if not ratio.size:
        return 1.0
    return float(np.sqrt(robust_square(ratio)))
