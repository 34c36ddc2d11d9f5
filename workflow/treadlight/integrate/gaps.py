"""Where two sections disagree and no view looks: cells that nothing says anything of."""

import numpy as np
from scipy import ndimage

from treadlight.geometry import CylinderGrid
from treadlight.integrate.laser import LaserCells

# Neighbours that differ by more standard deviations stand on either side of a lip.
_APART_SIGMA = 4.0
# A lip is evenly likely anywhere between two sections: in the middle third of the way neither of
# them is twice as likely to be right.
_EVEN = (1 / 3, 2 / 3)
# Fewer neighbouring columns are stray points.
_LEAST_COLUMNS = 3


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
