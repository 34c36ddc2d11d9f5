"""Laser points that the slopes of a view connect, and what the slopes miss of their rise."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from treadlight.geometry import CylinderGrid
from treadlight.integrate.gather import ViewField
from treadlight.integrate.laser import LaserCells

# Steeper cells are walls of something, and cells much less certain than usual stand beside them;
# so do their neighbours.
_WALL_SLOPE = 0.35
_UNSURE = 9.0
_MARGIN_CELLS = 1
_LEAST_GOOD = 0.5
_Z_LAGS = (0.5, 1 / 6)
# Fewer tell nothing.
LEAST_PAIRS = 100


@dataclass(frozen=True)
class Pairs:
    """Pairs of laser points in one view, along one axis of the grid.

    Attributes
    ----------
    axis : int
        0: neighbouring sections at one z; 1: places of one section.
    start, end : (k,) int
        Indices of the points.
    middle : (row, column), (k,) int each
        The place halfway, row in the view.
    rise : (k,) float
        The laser's height difference, mm.
    excess : (k,) float
        The same less the integral of the slopes between the points, mm.
    length : (k,) float
        mm.
    noise : (k,) float
        Variance of `rise`, mm2.
    """

    axis: int
    start: np.ndarray
    end: np.ndarray
    middle: tuple[np.ndarray, np.ndarray]
    rise: np.ndarray
    excess: np.ndarray
    length: np.ndarray
    noise: np.ndarray

    def select(self, mask: np.ndarray) -> "Pairs":
        """Some of the pairs, by a mask (k,) or their indices."""
        middle = self.middle[0][mask], self.middle[1][mask]
        rest = (x[mask] for x in (self.rise, self.excess, self.length, self.noise))
        return Pairs(self.axis, self.start[mask], self.end[mask], middle, *rest)

    def chained(self) -> tuple[np.ndarray, np.ndarray]:
        """Indices of pairs and of those that go on where they end."""
        order = np.argsort(self.start, kind="stable")
        place = np.searchsorted(self.start[order], self.end)
        beyond = order[np.minimum(place, len(order) - 1)]
        first = np.flatnonzero(self.start[beyond] == self.end) if len(order) else order
        return first, beyond[first]


def laser_pairs(
    field: ViewField, laser: LaserCells, steps: np.ndarray, spacing: float, grid: CylinderGrid
) -> list[Pairs]:
    """Laser points that the slopes of a view connect, along theta and along z.

    Parameters
    ----------
    field : ViewField
        k rows.
    laser : LaserCells
    steps : (n, m) bool
        Where the first surface has a step: no path may cross it.
    spacing : float
        Distance of sections, cells along theta.
    grid : CylinderGrid
    """
    n = grid.shape[0]
    local = (laser.row - field.rows[0]) % n if grid.periodic else laser.row - field.rows[0]
    inside = np.flatnonzero((local >= 0) & (local < len(field.rows)))
    own, row = laser.select(inside), local[inside]
    paths = _Paths(field, steps[field.rows], grid)
    found = []
    for axis, (a, b) in enumerate([_theta_pairs(row, own, spacing), _z_pairs(row, own, spacing)]):
        excess, length = paths.excess(a, b, row, own, axis)
        known = np.isfinite(excess)
        a, b = a[known], b[known]
        middle = (row[a] + row[b]) // 2, (own.column[a] + own.column[b]) // 2
        found.append(
            Pairs(
                axis,
                inside[a],
                inside[b],
                middle,
                own.value[b] - own.value[a],
                excess[known],
                length[known],
                own.std[a] ** 2 + own.std[b] ** 2,
            )
        )
    return found


class _Paths:
    """Mean slopes along rows and columns, over the cells that can be trusted.

    Sipes and slots that the first surface does not know are bridged: the tread stands equally
    high on both sides.
    """

    def __init__(self, field: ViewField, steps: np.ndarray, grid: CylinderGrid):
        slope = field.slope
        self.spacing = (grid.step_theta * grid.nominal_radius_mm, grid.step_z)
        self._steps = [np.cumsum(steps, axis=k, dtype=np.int32) for k in range(2)]
        with np.errstate(invalid="ignore"):
            good = (np.abs(slope) < _WALL_SLOPE).all(axis=0)
            usual = np.nanmedian(field.variance, axis=(1, 2)) if good.any() else np.ones(2)
            good &= (field.variance < _UNSURE * usual[:, None, None]).all(axis=0)
        good = ndimage.binary_erosion(good, iterations=_MARGIN_CELLS)
        self._good = [np.cumsum(good, axis=k, dtype=np.int32) for k in range(2)]
        self._sums = [
            np.cumsum(np.where(good, slope[k].astype(np.float64), 0.0), axis=k) for k in range(2)
        ]

    def excess(
        self, a: np.ndarray, b: np.ndarray, row: np.ndarray, laser: LaserCells, axis: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Laser's height difference of pairs less the slopes' along z, then theta; lengths, mm.

        NaN where the path crosses a step or finds too few slopes.
        """
        corner = row[a], laser.column[b]
        total = self._between(0, corner, (row[b], laser.column[b]))
        total += self._between(1, (row[a], laser.column[a]), corner)
        cells = (row[b] - row[a]) if axis == 0 else (laser.column[b] - laser.column[a])
        return laser.value[b] - laser.value[a] - total, cells * self.spacing[axis]

    def _between(self, k: int, start: tuple, end: tuple) -> np.ndarray:
        cells = end[k] - start[k]
        count = self._good[k][end] - self._good[k][start]
        total = self._sums[k][end] - self._sums[k][start]
        with np.errstate(divide="ignore", invalid="ignore"):
            rise = np.where(cells == 0, 0.0, total / count * cells * self.spacing[k])
        enough = (np.abs(count) >= _LEAST_GOOD * np.abs(cells)) & (
            self._steps[k][start] == self._steps[k][end]
        )
        return np.where(enough, rise, np.nan)


def _theta_pairs(
    row: np.ndarray, laser: LaserCells, spacing: float
) -> tuple[np.ndarray, np.ndarray]:
    """Points of neighbouring sections in one column."""
    order = np.lexsort((row, laser.column))
    a, b = order[:-1], order[1:]
    gap = row[b] - row[a]
    near = (laser.column[a] == laser.column[b]) & (gap > 0.25 * spacing) & (gap < 3 * spacing)
    return a[near], b[near]


def _z_pairs(row: np.ndarray, laser: LaserCells, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Points of one section a half and a sixth (for grooves) of the sections' distance apart."""
    order = np.lexsort((laser.column, laser.section))
    starts, ends = [order[:0]], [order[:0]]
    for lag in sorted({max(2, round(share * spacing)) for share in _Z_LAGS}):
        a, b = order[:-lag], order[lag:]
        gap = laser.column[b] - laser.column[a]
        near = (laser.section[a] == laser.section[b]) & (gap > 0.5 * lag) & (gap < 2 * lag)
        starts.append(a[near])
        ends.append(b[near])
    return np.concatenate(starts), np.concatenate(ends)
