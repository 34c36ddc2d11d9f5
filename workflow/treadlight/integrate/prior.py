"""What the first surface says where no light reaches, and how strongly."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from treadlight import tread
from treadlight.geometry import CylinderGrid
from treadlight.integrate.laser import LaserCells
from treadlight.tread.robust import MEDIAN_COST, robust_square

# Half-width of the window in which a step of the first surface may really stand, cells.
_STEP_WINDOW = 2
# The surface's own noise looks like a step of up to this many standard deviations.
_STEP_SIGMA = 4.0
# The tread's drift shows over these shares of the sections' distance, where neighbouring points
# of a section no longer share their noise.
_DRIFT_LAGS = (0.25, 0.5, 0.75, 1.0)
_LEAST_PAIRS = 100


def complete(surface: np.ndarray) -> np.ndarray:
    """The surface (n, m), each NaN replaced by the nearest finite cell's value (a start only).

    Raises
    ------
    ValueError
        No cell is finite.
    """
    hole = ~np.isfinite(surface)
    if hole.all():
        raise ValueError("The first surface has no finite cell.")
    if not hole.any():
        return surface.astype(np.float64)
    nearest = ndimage.distance_transform_edt(hole, return_distances=False, return_indices=True)
    return surface[tuple(nearest)].astype(np.float64)


def beyond_sections(theta: np.ndarray, spacing: float, grid: CylinderGrid) -> np.ndarray:
    """Rows (n,) before the first and behind the last section, by more than half their distance.

    None on a whole turn, or without a section.

    Parameters
    ----------
    theta : (s, l) float
        Of the sections' points, rad; NaN where there is none.
    spacing : float
        Distance of sections, cells along theta.
    grid : CylinderGrid
    """
    row, _ = grid.index(theta, np.zeros(1))
    known = np.isfinite(row) & (row > -0.5) & (row < grid.shape[0] - 0.5)
    if grid.periodic or not known.any():
        return np.zeros(grid.shape[0], bool)
    rows = np.arange(grid.shape[0])
    low, high = row[known].min() - spacing / 2, row[known].max() + spacing / 2
    return (rows < low) | (rows > high)


@dataclass(frozen=True)
class FirstEdges:
    """Height differences to the next cell as the first surface has them; index as in `Edges`.

    Attributes
    ----------
    step, std : (2, n, m) float32
        mm; NaN where the first surface knows nothing on either side.
    """

    step: np.ndarray
    std: np.ndarray


def first_edges(
    start: np.ndarray,
    std: np.ndarray,
    bridged: np.ndarray,
    outline: np.ndarray,
    drift: float,
    grid: CylinderGrid,
) -> FirstEdges:
    """Where no light reaches: the outline's slopes on tops and floors, the first surface's steps.

    Between steps the first surface is the sections' noise and what lies between them: there the
    tread follows its outline, from which it drifts like a random walk. At a step, whose place
    between the sections is not known to the cell, the standard deviation is half the height of
    the step.

    Parameters
    ----------
    start : (n, m) float
        Complete first surface, mm.
    std : (n, m) float
        Its standard deviation, mm; NaN where it is unknown.
    bridged : (n, m) bool
        Cells whose `std` says all: interpolated across a cut.
    outline : (n, m) float
        mm.
    drift : float
        mm2 per mm.
    grid : CylinderGrid
    """
    height = step_height(start, std, grid)
    cell_std = np.hypot(std, 0.5 * height)
    calm = np.isfinite(std) & (height == 0) & ~bridged
    step = np.empty((2, *start.shape), np.float32)
    spread = np.empty_like(step)
    for k, length in enumerate((grid.step_theta * grid.nominal_radius_mm, grid.step_z)):
        smooth = calm & np.roll(calm, -1, axis=k)
        for source, where in ((start, ~smooth), (outline, smooth)):
            step[k][where] = (np.roll(source, -1, axis=k) - source)[where]
        spread[k] = np.sqrt(cell_std * np.roll(cell_std, -1, axis=k))
        spread[k][smooth] = np.sqrt(drift * length)
    return FirstEdges(np.where(np.isfinite(spread), step, np.nan).astype(np.float32), spread)


def outline(surface: np.ndarray, regions: tread.Regions, grid: CylinderGrid) -> np.ndarray:
    """The surface of revolution that a complete surface (n, m) follows, with its runout, mm."""
    runout = regions.runout.radius(grid.theta, grid.z)
    return np.median(surface - runout, axis=0) + runout


def drift_rate(
    laser: LaserCells,
    outline: np.ndarray,
    regions: tread.Regions,
    spacing: float,
    grid: CylinderGrid,
) -> float | None:
    """How fast the tread strays from its outline: variance per length, mm2 per mm.

    The variance of the difference of two points of a section grows with their distance, once
    they no longer share their noise: by the drift and by slow errors of the laser, so that the
    tread is never taken for smoother than it is. Robust against cuts. Never below what the
    scatter of the variances would hide. None where too few points tell.

    Parameters
    ----------
    laser : LaserCells
    outline : (n, m) float
        mm.
    regions : tread.Regions
    spacing : float
        Distance of sections, cells along theta.
    grid : CylinderGrid
    """
    if not len(laser.value):
        return None
    line = np.full((int(laser.section.max()) + 1, grid.shape[1]), np.nan)
    line[laser.section, laser.column] = laser.value - outline[laser.row, laser.column]
    # Ribs and floors, each with a number of its own; walls belong to neither.
    part = np.where(regions.rib_of_column > 0, regions.rib_of_column, -regions.floor_of_column)
    lags, variances, errors = [], [], []
    for lag in sorted({max(1, round(share * spacing)) for share in _DRIFT_LAGS}):
        same = (part[lag:] == part[:-lag]) & (part[lag:] != 0)
        rise = (line[:, lag:] - line[:, :-lag])[:, same]
        rise = rise[np.isfinite(rise)]
        if len(rise) < _LEAST_PAIRS:
            continue
        variance = robust_square(rise)
        lags.append(lag * grid.step_z)
        variances.append(variance)
        errors.append(variance * np.sqrt(2 * MEDIAN_COST * lag / len(rise)))
    if len(lags) < 2:
        return None
    away = np.array(lags) - np.mean(lags)
    slope = float(away @ np.array(variances) / (away @ away))
    return max(slope, float(np.sqrt((away**2) @ np.square(errors)) / (away @ away)))


def step_height(start: np.ndarray, std: np.ndarray, grid: CylinderGrid) -> np.ndarray:
    """Height of the first surface's step around each cell beyond its noise, (n, m) mm."""
    mode = grid.filter_mode
    size = 2 * _STEP_WINDOW + 1
    reach = ndimage.maximum_filter(start, size, mode=mode)
    reach -= ndimage.minimum_filter(start, size, mode=mode)
    return np.maximum(reach - _STEP_SIGMA * np.nan_to_num(std, nan=0.0), 0)


def section_spacing(sections: np.ndarray, grid: CylinderGrid) -> float:
    """Median distance of neighbouring sections, cells along theta.

    Parameters
    ----------
    sections : (s,) float
        Encoder angles, rad.
    grid : CylinderGrid
    """
    gaps = np.diff(np.sort(np.asarray(sections, float)))
    gaps = gaps[gaps > 0]
    return max(1.0, float(np.median(gaps)) / grid.step_theta) if gaps.size else 1.0
