"""Where no view looks: cuts known from their like, and cells that nothing says anything of."""

from collections.abc import Sequence

import numpy as np
from scipy import ndimage

from treadlight.geometry import CylinderGrid
from treadlight.integrate.gather import ViewField
from treadlight.integrate.laser import LaserCells
from treadlight.integrate.patches import find_patches
from treadlight.integrate.repeats import repeated

# Neighbours that differ by more standard deviations stand on either side of a lip.
_APART_SIGMA = 4.0
# A lip is evenly likely anywhere between two sections: in the middle third of the way neither of
# them is twice as likely to be right.
_EVEN = (1 / 3, 2 / 3)
# As likely as this a cut is sure, and the tread where it is as unlikely.
_SURELY = 0.95
# Of the sections' distance: the blur of an edge whose place the repeats do not agree about.
_NARROW = 1 / 6
# Fewer neighbouring columns are stray points.
_LEAST_COLUMNS = 3


def hidden_cuts(
    cuts: np.ndarray,
    looked: np.ndarray,
    laser: LaserCells,
    deep: np.ndarray,
    ribs: Sequence[slice],
    std: float,
    spacing: float,
    shared_rows: float,
    grid: CylinderGrid,
) -> tuple[np.ndarray, np.ndarray]:
    """Cells (n, m) in cuts that no view looks at, and cells of which nobody knows.

    A cut is surely one somewhere, and as likely as not at its edges. Doubt that is narrow along
    theta is about the place of an edge, which is somewhere in it; other doubt is doubt.

    Parameters
    ----------
    cuts, looked, laser, deep, ribs, spacing, shared_rows, grid
        See `repeated`.
    std : float
        Usual standard deviation of the first surface, mm.
    """
    likely = repeated(cuts, looked, laser, deep, ribs, spacing, shared_rows, grid)
    hidden = find_patches(likely > 0.5, grid)
    hidden = hidden.select(hidden.share(likely > _SURELY) > 0)
    doubt = (likely > 1 - _SURELY) & (likely < _SURELY)
    wide = (1 + round(spacing * _NARROW), 1)
    doubt = ndimage.grey_opening(doubt.astype(np.uint8), wide, mode=grid.filter_mode) > 0
    alone = np.isnan(likely) & ~looked
    if alone.any():
        doubt |= alone & undecided(laser, std, grid)
    return hidden.mask & ~doubt, doubt


def undecided(laser: LaserCells, std: float, grid: CylinderGrid) -> np.ndarray:
    """Cells (n, m) between sections that disagree, where neither is twice as likely to be right.

    Parameters
    ----------
    laser : LaserCells
    std : float
        Usual standard deviation of the first surface, mm.
    grid : CylinderGrid
    """
    n, m = grid.shape
    mask = np.zeros((n, m), bool)
    order = np.lexsort((laser.row, laser.column))
    bounds = np.searchsorted(laser.column[order], np.arange(m + 1))
    variance = laser.std**2 + std**2
    for j in range(m):
        points = order[bounds[j] : bounds[j + 1]]
        row = laser.row[points]
        if grid.periodic and len(points) > 1:
            points, row = np.append(points, points[0]), np.append(row, row[0] + n)
        off = np.abs(np.diff(laser.value[points]))
        apart = off > _APART_SIGMA * np.sqrt(variance[points[1:]] + variance[points[:-1]])
        for k in np.flatnonzero(apart):
            gap = row[k + 1] - row[k]
            first, last = np.ceil(row[k] + _EVEN[0] * gap), np.floor(row[k] + _EVEN[1] * gap)
            mask[np.arange(first, last + 1, dtype=int) % n, j] = True
    return ndimage.binary_opening(mask, np.ones((1, _LEAST_COLUMNS)))


def looked_at(fields: Sequence[ViewField], spacing: float, grid: CylinderGrid) -> np.ndarray:
    """Cells (n, m) with a slope, and those in cuts and at walls between them.

    Parameters
    ----------
    fields : sequence of ViewField
    spacing : float
        Distance of sections, cells along theta.
    grid : CylinderGrid
    """
    sloped = np.zeros(grid.shape, bool)
    for field in fields:
        sloped[field.rows] |= np.isfinite(field.slope[0])
    # What is no wider than two thirds of the sections' distance; nothing beyond the views' ends.
    size = 2 * round(spacing / 3) + 1
    spread = ndimage.maximum_filter(sloped, size, mode=grid.filter_mode)
    return ndimage.minimum_filter(spread, size, mode=grid.filter_mode)
