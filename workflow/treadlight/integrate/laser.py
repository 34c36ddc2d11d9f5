"""Laser points as constraints on the cells of the grid."""

from dataclasses import dataclass

import numpy as np

from treadlight.geometry import CylinderGrid

# Points further off than this many robust standard deviations are no noise.
_CLIP = 3.0
# Autocorrelations count up to the first below this.
_LEAST_CORRELATION = 0.05
_MAX_LAG = 64


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


def points_per_error(laser: LaserCells, r: np.ndarray) -> float:
    """How many neighbouring points of a section share one error: 1 + 2 sum of autocorrelations.

    Speckle and the detection's smoothing make the errors of neighbours alike, so that a mean
    over n points is known as well as one over n / this (Bartlett 1946).
    """
    miss = laser.value - r[laser.row, laser.column]
    spread = 1.4826 * float(np.median(np.abs(miss))) if len(miss) else 0.0
    if spread == 0:
        return 1.0
    line = np.full((int(laser.section.max()) + 1, r.shape[1]), np.nan)
    usual = np.abs(miss) < _CLIP * spread
    line[laser.section[usual], laser.column[usual]] = miss[usual]
    power = np.nanmean(line**2)
    total = 1.0
    for lag in range(1, min(_MAX_LAG, line.shape[1])):
        products = line[:, lag:] * line[:, :-lag]
        if not np.isfinite(products).any():
            break
        correlation = float(np.nanmean(products) / power)
        if correlation < _LEAST_CORRELATION:
            break
        total += 2 * correlation
    return total
