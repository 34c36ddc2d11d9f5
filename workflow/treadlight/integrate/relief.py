"""The relief that pixels see on a surface that was solved in wider cells.

Over a cell's width slopes need no section to hold them: noise and bias have no room to add up.
So where the surface of the cells is smooth the pixels follow it, with what their slopes add; at
steps, which cells draw as wide as they are, slopes alone say where walls stand.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from treadlight.geometry import CylinderGrid
from treadlight.integrate.edges import Photometry, build_edges
from treadlight.integrate.laser import LaserCells
from treadlight.integrate.solve import Problem, linear_solve

# Where the slope changes by more than this from cell to cell the surface is not smooth in them.
_BEND = 0.35
# Cells over which slopes carry the heights.
_REACH_CELLS = 1.0
# In the middle of a view at 31 um within 1 um in all but one of a thousand pixels, 13 um in the
# worst one.
_ITERATIONS = 8
# A micron: where there are no slopes the cells' surface is followed.
_LEAST_STD = 1e-3


@dataclass(frozen=True)
class Upsampled:
    """Pixels (n, m) among the cells of a grid (k, l).

    Attributes
    ----------
    row, column : (n,), (m,) float64
        Fractional indices of the cells, up to half a cell beyond the grid's rim.
    cells : CylinderGrid
    """

    row: np.ndarray
    column: np.ndarray
    cells: CylinderGrid

    @classmethod
    def between(cls, cells: CylinderGrid, pixels: CylinderGrid) -> "Upsampled":
        """The pixels of a grid among cells that cover it."""
        return cls(*cells.index(pixels.theta, pixels.z), cells)

    def nearest(self, values: np.ndarray) -> np.ndarray:
        """Of each pixel's own cell, (n, m)."""
        n, m = self.cells.shape
        i, j = (np.rint(x).astype(int) for x in (self.row, self.column))
        i = i % n if self.cells.periodic else np.clip(i, 0, n - 1)
        return values[i[:, None], np.clip(j, 0, m - 1)]

    def linear(self, values: np.ndarray) -> np.ndarray:
        """Bilinear mean of the known cells around, (n, m); NaN where a pixel's own is not known."""
        known = np.isfinite(values)
        if known.all():
            return self._linear(values)
        with np.errstate(divide="ignore", invalid="ignore"):
            mean = self._linear(np.where(known, values, 0)) / self._linear(known.astype(float))
        return np.where(self.nearest(known), mean, np.nan)

    def along(self, values: np.ndarray) -> np.ndarray:
        """Linear mean of what rows of cells have (k,), (n,)."""
        i, below, down = self._rows()
        return values[i] + down * (values[below] - values[i])

    def _linear(self, values: np.ndarray) -> np.ndarray:
        i, below, down = self._rows()
        rows = values[i] + down[:, None] * (values[below] - values[i])
        j = np.clip(np.floor(self.column).astype(int), 0, values.shape[1] - 2)
        return rows[:, j] + (self.column - j) * (rows[:, j + 1] - rows[:, j])

    def _rows(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows of cells before and behind the pixels, and the way between them; on at the rim."""
        n, i = self.cells.shape[0], np.floor(self.row).astype(int)
        if not self.cells.periodic:
            i = np.clip(i, 0, n - 2)
        return i, (i + 1) % n, self.row - i


def smooth_cells(r: np.ndarray, steps: np.ndarray, cells: CylinderGrid) -> np.ndarray:
    """Cells (n, m) in and around which a surface bends little and is not cut."""
    bent = steps.copy()
    for axis, mode in enumerate(cells.filter_mode):
        bend = ndimage.correlate1d(r, [1.0, -2.0, 1.0], axis=axis, mode=mode)
        bent |= np.abs(bend) > _BEND * cells.step_z
    return ~ndimage.maximum_filter(bent, 3, mode=cells.filter_mode)


def height_around(r: np.ndarray, cells: CylinderGrid) -> np.ndarray:
    """How far a surface (n, m) may step within each cell: by as much as between those around."""
    mode = cells.filter_mode
    return ndimage.maximum_filter(r, 3, mode=mode) - ndimage.minimum_filter(r, 3, mode=mode)


def add_relief(
    surface: np.ndarray,
    smooth: np.ndarray,
    height: np.ndarray,
    photometry: Photometry,
    width: float,
    grid: CylinderGrid,
) -> np.ndarray:
    """Heights (n, m) of pixels, mm.

    Least squares of their slopes and of the cells' surface, which counts so much that it bends
    to slopes within about a cell (screened Poisson).

    Parameters
    ----------
    surface : (n, m) float
        Heights of the cells, interpolated, mm.
    smooth : (n, m) bool
        Where they count.
    height : (n, m) float
        How far the surface may step where no slope is known, mm.
    photometry : Photometry
        Slopes of the pixels.
    width : float
        Of a cell, pixels.
    grid : CylinderGrid
        Of the pixels.
    """
    step = np.stack([np.roll(surface, -1, axis=k) - surface for k in range(2)])
    std = np.broadcast_to(np.maximum(height, _LEAST_STD), step.shape)
    # Along a wall slopes are far more certain than up it: they would carry heights out of reach.
    variance = np.broadcast_to(photometry.variance.max(axis=0), step.shape)
    edges = build_edges(
        photometry.slope,
        variance,
        np.broadcast_to(np.float32(0), step.shape),
        surface,
        step.astype(np.float32),
        std.astype(np.float32),
        grid,
    )
    around = sum(edges.weight[k] + np.roll(edges.weight[k], 1, axis=k) for k in range(2))
    pull = np.where(smooth, around / (4 * (_REACH_CELLS * width) ** 2), 0)
    none = np.zeros(0)
    laser = LaserCells(none.astype(int), none.astype(int), none, none, none.astype(int))
    problem = Problem(edges, laser, surface, pull)
    whole = np.ones(edges.weight.shape, np.float32)
    return linear_solve(problem, surface, whole, none, _ITERATIONS)
