"""A capture's profile, read block by block: full-size captures do not fit into memory together."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from treadlight.geometry import CylinderGrid
from treadlight.wear.alignment import Alignment
from treadlight.wear.difference import HALO_MM, difference, rows_needed
from treadlight.wear.motion import resample
from treadlight.wear.relief import Relief, reduce_rows, reduced_grid, relief_of

# Walls are found to a fiftieth of a cell; finer cells only cost time.
_RELIEF_STEP_MM = 0.3
_ROWS_AT_ONCE = 1024


@dataclass(frozen=True)
class Surface:
    """r(theta, z) of a capture in its own frame.

    Attributes
    ----------
    grid : CylinderGrid
    read : callable
        (start, stop) -> r, r_std of these rows, (stop - start, m) float, mm, NaN = missing.
    """

    grid: CylinderGrid
    read: Callable[[int, int], tuple[np.ndarray, np.ndarray]]

    @classmethod
    def of_arrays(cls, r: np.ndarray, r_std: np.ndarray, grid: CylinderGrid) -> "Surface":
        """A surface that is in memory."""
        return cls(grid, lambda start, stop: (r[start:stop], r_std[start:stop]))

    def rows(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """theta (unwrapped), r and r_std of consecutive rows, modulo the turn if it is whole."""
        count = self.grid.shape[0]
        theta = self.grid.theta[0] + self.grid.step_theta * rows
        parts = []
        start = int(rows[0])
        while start <= rows[-1]:
            stop = min(int(rows[-1]) + 1, (start // count + 1) * count)
            turn = start // count * count
            parts.append(self.read(start - turn, stop - turn))
            start = stop
        r, r_std = (np.concatenate(part) for part in zip(*parts, strict=True))
        return theta, r, r_std


def relief_from(surface: Surface) -> Relief:
    """The relief of a surface, on cells of about 0.3 mm."""
    grid, edges, columns = reduced_grid(surface.grid, _RELIEF_STEP_MM)
    each = max(1, _ROWS_AT_ONCE * (len(edges) - 1) // surface.grid.shape[0])
    parts = []
    for start in range(0, len(edges) - 1, each):
        part = edges[start : start + each + 1]
        values = surface.read(int(part[0]), int(part[-1]))
        parts.append([reduce_rows(v, part - part[0], columns) for v in values])
    r, r_std = (np.concatenate(part) for part in zip(*parts, strict=True))
    return relief_of(r, r_std, grid)


def wear_block(
    first: Surface, current: Surface, alignment: Alignment, start: int, stop: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """r after alignment, wear and its uncertainty on some rows of the first capture's grid.

    Returns
    -------
    r, wear, wear_std : (stop - start, m) float32
        mm; NaN where either capture has nothing, or the capture could not be aligned.
    """
    grid = first.grid
    nothing = np.full((stop - start, grid.shape[1]), np.nan, np.float32)
    if alignment.reason is not None:
        return nothing, nothing, nothing
    halo = int(np.ceil(HALO_MM / (grid.step_theta * grid.nominal_radius_mm)))
    rows = np.arange(start - halo, stop + halo)
    if not grid.periodic:
        rows = rows[(rows >= 0) & (rows < grid.shape[0])]
    theta, r_first, std_first = first.rows(rows)
    wanted = rows_needed(alignment.motion, theta, grid.z, current.grid)
    if len(wanted) < 2:
        return nothing, nothing, nothing
    theta_source, r_source, std_source = current.rows(wanted)
    r, std = resample(
        r_source,
        std_source,
        theta_source,
        current.grid.z,
        alignment.motion,
        theta,
        grid.z,
        grid.nominal_radius_mm,
    )
    local = CylinderGrid(theta, grid.z, grid.nominal_radius_mm)
    wear, wear_std = difference(r_first, std_first, r, std, alignment, local)
    inner = slice(int(np.searchsorted(rows, start)), int(np.searchsorted(rows, stop)))
    return r[inner], wear[inner], wear_std[inner]
