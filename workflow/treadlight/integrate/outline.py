"""The outlines of tops and of groove floors: what its neighbours say of a place's height.

A block that one or two sections cross is known no better than their speckle, a tenth of a
millimetre over a few points; but tops lie on one smooth surface of revolution to some hundredths,
and so do floors. How smooth it is and how far places stray from it the sections themselves tell:
what two of them find alike is the tread, what they do not is noise.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from treadlight.geometry import CylinderGrid
from treadlight.integrate.laser import LaserCells

# Half-widths (Gaussian sigma) of the smoothing that are tried: sections along theta, mm along z.
_ALONG = (np.inf, 16.0, 8.0, 4.0, 2.0, 1.0)
_ACROSS_MM = (np.inf, 40.0, 20.0, 10.0)
_BIN_MM = 5.0
# Points further off than this many robust standard deviations lie on edges and in cuts.
_CLIP = 3.0
_MAD_TO_STD = 1.4826
# A Gaussian of this many sections hardly reaches the next one.
_ONE_SECTION = 0.5
_LEAST_POINTS = 5
_LEAST_PAIRS = 20
# Sections further apart than this many usual distances are no neighbours.
_NEIGHBOURS = 1.5
# A place this many standard deviations off is worn in its own way (Tukey's biweight).
_TUKEY = 4.685


@dataclass(frozen=True)
class Outline:
    """Where a class of cells should be, and how strongly.

    Attributes
    ----------
    r : (n, m) float64
        mm.
    weight : (n, m) float64
        mm^-2; 0 off the class and where nothing is known.
    """

    r: np.ndarray
    weight: np.ndarray

    @classmethod
    def none(cls, grid: CylinderGrid) -> Self:
        """Nothing is known of any cell."""
        return cls(np.zeros(grid.shape), np.zeros(grid.shape))


def fit_outline(
    laser: LaserCells, members: np.ndarray, runout: np.ndarray, grid: CylinderGrid
) -> Outline:
    """Fit the outline of a class of cells to the laser points on them.

    A profile along z plus the runout, plus a smooth function of both, whose smoothness follows
    from leave-one-section-out cross-validation. Single places stray from it with the covariance
    of what neighbouring sections find of neighbouring tiles, each as long as two sections are
    apart: their noise is independent. Places within a tile stray together, tiles do not. Where a
    section finds a tile far off, it is worn in its own way and the outline says nothing.

    Parameters
    ----------
    laser : LaserCells
    members : (n, m) bool
        The class: tops, or floors.
    runout : (n, m) float
        mm.
    grid : CylinderGrid

    Returns
    -------
    Outline
        `Outline.none` where too few sections cross the class to tell.
    """
    laser = laser.select(members[laser.row, laser.column])
    if len(np.unique(laser.section)) < 2:
        return Outline.none(grid)
    flat = laser.value - runout[laser.row, laser.column]
    profile = _column_medians(flat, laser.column, grid.shape[1])
    table = _Table.of(laser, flat - profile[laser.column], grid)
    smooth = table.smoothed(*table.best_widths())
    left = table.without(smooth)
    variance = left.strays()
    if variance is None:
        return Outline.none(grid)
    target = runout + profile + table.on_grid(smooth, grid)
    cells = table.spacing * table.bins_per_tile * table.bin_columns
    inside = members & np.isfinite(target)
    weight = np.where(inside, table.on_grid(left.usual(), grid) / (variance * cells), 0.0)
    return Outline(np.where(inside, target, 0.0), weight)


def _column_medians(values: np.ndarray, column: np.ndarray, count: int) -> np.ndarray:
    order = np.argsort(column, kind="stable")
    bounds = np.searchsorted(column[order], np.arange(count + 1))
    found = np.full(count, np.nan)
    for j in range(count):
        inside = order[bounds[j] : bounds[j + 1]]
        if len(inside) >= _LEAST_POINTS:
            found[j] = np.median(values[inside])
    return found


@dataclass(frozen=True)
class _Table:
    """Means and counts of points by section, in order of theta, and bin of z: (s, b)."""

    mean: np.ndarray
    count: np.ndarray
    row: np.ndarray
    spacing: float
    bin_columns: int
    bins_per_tile: int
    periodic: bool

    @classmethod
    def of(cls, laser: LaserCells, values: np.ndarray, grid: CylinderGrid) -> Self:
        spread = _MAD_TO_STD * float(np.nanmedian(np.abs(values)))
        known = np.abs(values) < _CLIP * spread
        numbers, place = np.unique(laser.section, return_inverse=True)
        row = np.array([np.median(laser.row[place == k]) for k in range(len(numbers))])
        order = np.argsort(row, kind="stable")
        place = np.argsort(order, kind="stable")[place]
        columns = max(1, round(_BIN_MM / grid.step_z))
        shape = len(numbers), -(-grid.shape[1] // columns)
        index = place[known] * shape[1] + laser.column[known] // columns
        count = np.bincount(index, minlength=shape[0] * shape[1]).reshape(shape)
        total = np.bincount(index, values[known], minlength=count.size).reshape(shape)
        spacing = max(1.0, float(np.median(np.diff(row[order]))))
        tile_mm = spacing * grid.step_theta * grid.nominal_radius_mm
        bins = max(1, round(tile_mm / (columns * grid.step_z)))
        mean = total / np.maximum(count, 1)
        return cls(mean, count.astype(float), row[order], spacing, columns, bins, grid.periodic)

    def without(self, values: np.ndarray) -> Self:
        """The table less values (s, b)."""
        return type(self)(
            self.mean - values,
            self.count,
            self.row,
            self.spacing,
            self.bin_columns,
            self.bins_per_tile,
            self.periodic,
        )

    def smoothed(self, along: float, across_mm: float, left_out: float = 0.0) -> np.ndarray:
        """Weighted means over a Gaussian, (s, b), less a share of each section itself."""
        across = _kernel(self.count.shape[1], across_mm / _BIN_MM, False)
        theta = _kernel(len(self.count), along, self.periodic)
        theta -= left_out * np.eye(len(theta))
        count = theta @ self.count @ across
        total = theta @ (self.mean * self.count) @ across
        return np.where(count > 1e-6, total / np.maximum(count, 1e-6), 0.0)

    def best_widths(self) -> tuple[float, float]:
        """The widths under which the other sections predict each one best."""

        def miss(widths: tuple[float, float]) -> float:
            return float(np.sum(self.count * (self.mean - self.smoothed(*widths, 1.0)) ** 2))

        return min(((along, across) for along in _ALONG for across in _ACROSS_MM), key=miss)

    def strays(self) -> float | None:
        """Variance with which tiles stray together, mm^2; None where too few tell.

        Never below its own standard error.
        """
        starts = np.arange(0, self.mean.shape[1], self.bins_per_tile)
        count = np.add.reduceat(self.count, starts, axis=1)
        mean = np.add.reduceat(self.count * self.mean, starts, axis=1) / np.maximum(count, 1)
        mean = np.where(count >= _LEAST_POINTS, mean, np.nan)
        near = np.diff(self.row) < _NEIGHBOURS * self.spacing
        one, other = mean[1:][near], mean[:-1][near]
        pairs = one * other, one[:, 1:] * other[:, :-1], one[:, :-1] * other[:, 1:]
        product = np.concatenate([p[np.isfinite(p)] for p in pairs])
        if len(product) < _LEAST_PAIRS:
            return None
        error = float(np.std(product)) / np.sqrt(len(product))
        return max(float(np.mean(product)), error)

    def usual(self) -> np.ndarray:
        """1 where a tile is about zero, 0 where it is far off (Tukey's biweight), (s, b)."""
        tile = self.smoothed(_ONE_SECTION, 0.5 * self.bins_per_tile * _BIN_MM)
        spread = _MAD_TO_STD * float(np.median(np.abs(tile[self.count > 0]))) + 1e-9
        return np.clip(1 - (tile / (_TUKEY * spread)) ** 2, 0, None) ** 2

    def on_grid(self, values: np.ndarray, grid: CylinderGrid) -> np.ndarray:
        """Values (s, b) interpolated on the grid, (n, m)."""
        centre = (np.arange(values.shape[1]) + 0.5) * self.bin_columns - 0.5
        rows, columns = np.arange(grid.shape[0]), np.arange(grid.shape[1])
        period = grid.shape[0] if grid.periodic else None
        along = np.stack([np.interp(rows, self.row, c, period=period) for c in values.T])
        low = np.clip(np.searchsorted(centre, columns) - 1, 0, max(len(centre) - 2, 0))
        if len(centre) < 2:
            return np.repeat(along.T, grid.shape[1], axis=1)
        part = np.clip((columns - centre[low]) / self.bin_columns, 0, 1)
        return along[low].T * (1 - part) + along[low + 1].T * part


def _kernel(count: int, sigma: float, periodic: bool) -> np.ndarray:
    """Gaussian of the distance, (count, count), 1 at 0."""
    distance = np.abs(np.subtract.outer(np.arange(count), np.arange(count))).astype(float)
    if periodic:
        distance = np.minimum(distance, count - distance)
    return np.exp(-0.5 * (distance / sigma) ** 2)
