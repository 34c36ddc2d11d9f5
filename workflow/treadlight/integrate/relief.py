"""The relief that pixels see on a surface that was solved in wider cells.

Over a cell's width slopes need no section to hold them: noise and bias have no room to add up.
So where the surface of the cells is smooth the pixels follow it, with what their slopes add; at
steps, which cells draw as wide as they are, slopes say where walls stand, and the cells no more
than how high.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from treadlight.compiling import kernel
from treadlight.geometry import CylinderGrid
from treadlight.integrate.edges import Photometry
from treadlight.integrate.kernels import least_rows
from treadlight.integrate.multigrid import Solver, System
from treadlight.threads import by_ranges

# Where the slope changes by more than this from cell to cell the surface is not smooth in them.
_BEND = 0.35
# Cells over which slopes carry the heights.
_REACH_CELLS = 1.0
# At 31 um pixels of smooth cells are within 0.1 um by then, all but one of a thousand within 1 um;
# nine of ten at steps within 1 um.
_ITERATIONS = 5
_TOLERANCE_MM = 2.5e-4
# A wall's pixel lies as far off as cells step to either side of where they draw it.
_MOST_HEIGHTS = 2.0
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
    closed : bool
        Whether the pixels go all around.
    """

    row: np.ndarray
    column: np.ndarray
    cells: CylinderGrid
    closed: bool

    @classmethod
    def between(cls, cells: CylinderGrid, pixels: CylinderGrid) -> "Upsampled":
        """The pixels of a grid among cells that cover it."""
        return cls(*cells.index(pixels.theta, pixels.z), cells, pixels.periodic)

    @property
    def own(self) -> tuple[np.ndarray, np.ndarray]:
        """Row (n,) and column (m,) of each pixel's own cell."""
        n, m = self.cells.shape
        i, j = (np.rint(x).astype(int) for x in (self.row, self.column))
        return i % n if self.cells.periodic else np.clip(i, 0, n - 1), np.clip(j, 0, m - 1)

    def nearest(self, values: np.ndarray) -> np.ndarray:
        """Of each pixel's own cell, (n, m)."""
        i, j = self.own
        return np.take(values[i], j, axis=1)

    def near(self, mask: np.ndarray, reach: int) -> np.ndarray:
        """Pixels with one in a cell of a mask (k, l) at most so many away along both, (n, m)."""
        i, j = self.own
        away = np.arange(-reach, reach + 1)[:, None]
        row, column = np.arange(len(i)) + away, np.arange(len(j)) + away
        row = row % len(i) if self.closed else np.clip(row, 0, len(i) - 1)
        beside = mask[i[row]].any(axis=0)
        found = np.zeros((len(i), len(j)), bool)
        for own in j[np.clip(column, 0, len(j) - 1)]:
            found |= np.take(beside, own, axis=1)
        return found

    def linear(self, values: np.ndarray) -> np.ndarray:
        """Bilinear mean of the known cells around, (n, m); NaN where a pixel's own is not known."""
        out = np.empty((len(self.row), len(self.column)))
        j = np.clip(np.floor(self.column).astype(int), 0, values.shape[1] - 2)
        place = *self._rows(), j, self.column - j, *self.own
        by_ranges(_between, len(out), least_rows(out), np.float64(values), *place, out)
        return out

    def along(self, values: np.ndarray) -> np.ndarray:
        """Linear mean of what rows of cells have (k,), (n,)."""
        i, below, down = self._rows()
        return values[i] + down * (values[below] - values[i])

    def _rows(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows of cells before and behind the pixels, and the way between them; on at the rim."""
        n, i = self.cells.shape[0], np.floor(self.row).astype(int)
        if not self.cells.periodic:
            i = np.clip(i, 0, n - 2)
        return i, (i + 1) % n, self.row - i


@kernel
def _between(first, last, values, above, below, down, left, aside, own_row, own_column, out):
    for i in range(first, last):
        up, low, own, share = values[above[i]], values[below[i]], values[own_row[i]], down[i]
        for j in range(out.shape[1]):
            k, part = left[j], aside[j]
            corners = up[k], up[k + 1], low[k], low[k + 1]
            value = _mixed(_known(corners, corners), share, part)
            weight = _mixed(_known(corners, (1.0, 1.0, 1.0, 1.0)), share, part)
            out[i, j] = value / weight if np.isfinite(own[own_column[j]]) else np.nan


@kernel(inline="always")
def _known(corners, values):
    """Values where corners are known, 0 elsewhere."""
    a, b, c, d = values
    return (
        a if np.isfinite(corners[0]) else 0.0,
        b if np.isfinite(corners[1]) else 0.0,
        c if np.isfinite(corners[2]) else 0.0,
        d if np.isfinite(corners[3]) else 0.0,
    )


@kernel(inline="always")
def _mixed(corners, down, aside):
    left = corners[0] + down * (corners[2] - corners[0])
    right = corners[1] + down * (corners[3] - corners[1])
    return left + aside * (right - left)


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


def relief(
    surface: np.ndarray,
    smooth: np.ndarray,
    height: np.ndarray,
    photometry: Photometry,
    up: Upsampled,
    grid: CylinderGrid,
) -> np.ndarray:
    """What pixels (n, m) rise above the surface of the cells, mm, float32.

    Least squares of their slopes and of the cells' surface, which counts so much that it bends
    to slopes within about a cell (screened Poisson).

    Parameters
    ----------
    surface : (n, m) float64
        Heights of the cells, interpolated, mm.
    smooth : (k, l) bool
        Cells where they count.
    height : (k, l) float
        How far the surface may step where no slope is known, mm; at steps it counts beside a slope,
        and a pixel rises or falls by twice as much at the most.
    photometry : Photometry
        Slopes of the pixels.
    up : Upsampled
        The pixels among the cells.
    grid : CylinderGrid
        Of the pixels.
    """
    w_theta, w_z, data, residual = np.empty((4, *surface.shape), np.float32)
    width = up.cells.step_z / grid.step_z
    height = np.maximum(height, _LEAST_STD)
    known = photometry.slope, photometry.variance, surface, *up.own, smooth, height
    rules = 1 / (4 * (_REACH_CELLS * width) ** 2), grid.step_theta, grid.step_z, grid.periodic
    least = least_rows(surface)
    by_ranges(_equations, len(data), least, *known, *rules, w_theta, w_z, data, residual)
    rise, _ = Solver(System(w_theta, w_z, data)).solve(residual, _TOLERANCE_MM, _ITERATIONS)
    by_ranges(_limit, len(rise), least, *up.own, smooth, height, rise)
    return rise


@kernel
def _limit(first, last, own_row, own_column, smooth, height, rise):
    """Leave pixels near the cells around: slopes may say next to nothing of some at a step."""
    for i in range(first, last):
        row = own_row[i]
        for j in range(len(own_column)):
            column = own_column[j]
            if not smooth[row, column]:
                most = _MOST_HEIGHTS * height[row, column]
                rise[i, j] = min(max(rise[i, j], -most), most)


@kernel(allocates=True)
def _equations(
    first, last, slope, variance, surface, own_row, own_column, smooth, std, pull, step_theta,
    step_z, periodic, w_theta, w_z, data, residual,
):  # fmt: skip
    """The normal equations of what rises above the surface, and what they lack at nothing.

    Once through 24 bytes a pixel that are read and 16 that are written.
    """
    n, m = surface.shape
    # Edges to the row below, of two rows in turns, and from column j - 1 to j.
    weight, flow = np.zeros((2, 2, m))
    aside, flow_aside = np.zeros((2, m + 1))
    for i in range(first - 1, last):
        row = i if i >= 0 else n - 1
        below = row + 1 if row < n - 1 else 0
        own, counts, here = std[own_row[row]], smooth[own_row[row]], i % 2
        if row == n - 1 and not periodic:
            weight[here], flow[here] = 0, 0
        else:
            for j in range(m):
                length = step_theta * 0.5 * (surface[row, j] + surface[below, j])
                step = surface[below, j] - surface[row, j]
                mean = 0.5 * (slope[0, row, j] + slope[0, below, j])
                # Along a wall slopes are far more certain than up it: they would carry heights
                # out of reach.
                spread = max(variance[0, row, j], variance[1, row, j])
                spread += max(variance[0, below, j], variance[1, below, j])
                w, miss = _edge(
                    mean, spread, length, step, own[own_column[j]], counts[own_column[j]]
                )
                weight[here, j], flow[here, j] = w, w * miss
        if i < first:
            continue
        for j in range(m - 1):
            step = surface[i, j + 1] - surface[i, j]
            mean = 0.5 * (slope[1, i, j] + slope[1, i, j + 1])
            spread = max(variance[0, i, j], variance[1, i, j])
            spread += max(variance[0, i, j + 1], variance[1, i, j + 1])
            w, miss = _edge(mean, spread, step_z, step, own[own_column[j]], counts[own_column[j]])
            aside[j + 1], flow_aside[j + 1] = w, w * miss
        # The last column has none to its right.
        aside[m], flow_aside[m] = 0, 0
        above = 1 - here
        for j in range(m):
            around = weight[above, j] + weight[here, j] + aside[j] + aside[j + 1]
            w_theta[i, j], w_z[i, j] = weight[here, j], aside[j + 1]
            data[i, j] = pull * around if counts[own_column[j]] else 0.0
            lack = flow[above, j] - flow[here, j]
            residual[i, j] = lack + flow_aside[j] - flow_aside[j + 1]


@kernel(inline="always")
def _edge(slope, spread, length, step, std, smooth):
    """Weight of an edge, and what it rises by beyond the surface's own step.

    By its slope; at steps by the surface as well, which says more where a slope says next to
    nothing. Where cells are smooth they do not know the texture within them.
    """
    held = 1 / (std * std)
    if not np.isfinite(slope):
        return held, 0.0
    told = 1 / (length * length * 0.5 * spread)
    if smooth:
        return told, length * slope - step
    return told + held, told / (told + held) * (length * slope - step)
