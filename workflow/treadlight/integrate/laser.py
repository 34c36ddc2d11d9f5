"""Laser points as constraints on the cells of the grid."""

from dataclasses import dataclass

import numpy as np

from treadlight.geometry import CylinderGrid


@dataclass(frozen=True)
class LaserCells:
    """Laser points at their nearest cells.

    Attributes
    ----------
    row, column : (k,) int
    value : (k,) float64
        Radius at the centre of the cell, mm.
    std : (k,) float64
        mm.
    section : (k,) int
    """

    row: np.ndarray
    column: np.ndarray
    value: np.ndarray
    std: np.ndarray
    section: np.ndarray

    def select(self, mask: np.ndarray) -> "LaserCells":
        """The points of a mask (k,)."""
        return LaserCells(
            self.row[mask], self.column[mask], self.value[mask], self.std[mask], self.section[mask]
        )


def laser_cells(
    r: np.ndarray, theta: np.ndarray, z: np.ndarray, r_std: np.ndarray,
    slope: np.ndarray, grid: CylinderGrid,
) -> LaserCells:  # fmt: skip
    """Points (section, line) brought to the centres of their cells along the local slope.

    Parameters
    ----------
    r, theta, z, r_std : (s, l) float
        mm, rad, mm, mm; NaN where there is no point.
    slope : (2, n, m) float
        dr / (r dtheta) and dr / dz; where it is NaN the point is taken as it is.
    grid : CylinderGrid
    """
    row, column = grid.index(theta, z)
    known = np.isfinite(r) & np.isfinite(row) & np.isfinite(column) & (r_std > 0)
    section = np.broadcast_to(np.arange(len(r))[:, None], r.shape)[known]
    row, column, value, std = row[known], column[known], r[known].astype(float), r_std[known]
    i, j = np.rint(row).astype(int), np.rint(column).astype(int)
    offset = np.stack([(row - i) * grid.step_theta * value, (column - j) * grid.step_z])
    i = i % grid.shape[0] if grid.periodic else i
    inside = (i >= 0) & (i < grid.shape[0]) & (j >= 0) & (j < grid.shape[1])
    i, j, offset = i[inside], j[inside], offset[:, inside]
    local = np.nan_to_num(slope[:, i, j].astype(float))
    value = value[inside] - (local * offset).sum(axis=0)
    return LaserCells(i, j, value, std[inside].astype(float), section[inside])


def held_out(sections: int, every: int) -> np.ndarray:
    """Which of the sections, in order of encoder, stay out of the solve, (sections,) bool.

    The middle one of every `every`, so that neither the first nor the last is taken.
    """
    place = np.arange(sections)
    if every <= 0:
        return np.zeros(sections, bool)
    return (place % every == every // 2) & (place > 0) & (place < sections - 1)
