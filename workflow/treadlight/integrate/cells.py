"""The cells that heights are solved in: as wide as sections and cues of cuts can tell anything.

Pixels may be much finer. What they add is relief, which needs no section: see `relief`.
"""

from dataclasses import replace

import numpy as np

from treadlight.geometry import CylinderGrid
from treadlight.geometry.axis import wrap_angle
from treadlight.integrate.case import LaserSections

# The narrowest cuts that are made in treads are about as wide; the line of a laser is wider.
_WIDTH_MM = 1 / 3
# Points of neighbouring lines further apart than this many standard deviations lie on either side
# of an edge: their mean lies on neither.
_SAME_SIGMA = 4.0


def width_of_cells(grid: CylinderGrid, most_cells: int) -> int:
    """Pixels of a grid along the side of a cell that is solved, at least 1.

    Wider where there would be more than `most_cells`.
    """
    n, m = grid.shape
    finest = min(grid.step_theta * grid.nominal_radius_mm, grid.step_z)
    width = max(1, int(_WIDTH_MM / finest))
    while -(-n // width) * -(-m // width) > most_cells and width < min(n, m) // 2:
        width += 1
    return width


def solved_grid(grid: CylinderGrid, width: int) -> CylinderGrid:
    """The grid of cells about `width` pixels wide that covers a grid; itself for a width of 1."""
    if width == 1:
        return grid
    theta = _wider(grid.theta, grid.step_theta, width, grid.periodic)
    z = _wider(grid.z, grid.step_z, width, False)
    return CylinderGrid(theta - theta[0] + wrap_angle(theta[0]), z, grid.nominal_radius_mm)


def _wider(centres: np.ndarray, step: float, width: int, closed: bool) -> np.ndarray:
    count = max(2, round(len(centres) / width) if closed else -(-len(centres) // width))
    wide = step * len(centres) / count if closed else step * width
    return centres[0] + (wide - step) / 2 + wide * np.arange(count)


def sampled(grid: CylinderGrid, cells: CylinderGrid) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of a grid next to the centres of the cells that are solved."""
    row, column = grid.index(cells.theta, cells.z)
    rows, columns = (
        np.clip(np.rint(x).astype(int), 0, count - 1)
        for x, count in zip((row, column), grid.shape, strict=True)
    )
    return rows, columns


def thinned(sections: LaserSections, width: int) -> LaserSections:
    """One point for every `width` neighbouring lines of a section: the mean of those alike.

    Parameters
    ----------
    sections : LaserSections
    width : int
    """
    count, lines = sections.r.shape
    if width == 1 or lines < width:
        return sections
    groups = -(-lines // width)
    spare = ((0, 0), (0, groups * width - lines))
    r, theta, z, std = (
        np.pad(x.astype(float), spare, constant_values=np.nan).reshape(count * groups, width)
        for x in (sections.r, sections.theta, sections.z, sections.r_std)
    )
    # One of the points, not the mean of two: a wall may lie between them.
    known = np.count_nonzero(np.isfinite(r), axis=1)
    middle = np.sort(r, axis=1)[np.arange(len(r)), known // 2][:, None]
    with np.errstate(invalid="ignore", divide="ignore"):
        weight = np.where(np.abs(r - middle) <= _SAME_SIGMA * std, 1 / std**2, 0.0)
        total = weight.sum(axis=1)
        # A section may lie across the turn's end.
        first = theta[np.arange(len(theta)), np.argmax(weight > 0, axis=1)]
        away = wrap_angle(theta - first[:, None])
        r, away, z = (np.where(weight > 0, weight * x, 0).sum(axis=1) / total for x in (r, away, z))
        kept = np.count_nonzero(weight, axis=1)
        # Points that share their errors are together as uncertain as one.
        alone = np.maximum(kept / sections.shared_rows, 1)
        spread = np.sqrt(kept / total / alone)
    r, theta, z, std = (x.reshape(count, groups) for x in (r, wrap_angle(first + away), z, spread))
    shared = max(1.0, sections.shared_rows / width)
    return replace(sections, r=r, theta=theta, z=z, r_std=std, shared_rows=shared)
