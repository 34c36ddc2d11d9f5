"""What the first surface says where no light reaches, and how strongly."""

import numpy as np
from scipy import ndimage

from treadlight.geometry import CylinderGrid

# Half-width of the window in which a step of the first surface may really stand, cells.
_STEP_WINDOW = 2
# The surface's own noise looks like a step of up to this many standard deviations.
_STEP_SIGMA = 4.0


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


def edge_std(start: np.ndarray, std: np.ndarray, grid: CylinderGrid) -> np.ndarray:
    """Standard deviation of the first surface's difference between neighbouring cells, mm.

    Beside a step, whose place between the sections is not known to the cell, it is half the
    step's height.

    Parameters
    ----------
    start : (n, m) float
        Complete first surface, mm.
    std : (n, m) float
        Its standard deviation, mm; NaN where the surface is unknown.
    grid : CylinderGrid
    """
    return np.hypot(np.nan_to_num(std, nan=0.0), 0.5 * step_height(start, std, grid))


def step_height(start: np.ndarray, std: np.ndarray, grid: CylinderGrid) -> np.ndarray:
    """Height of the first surface's step around each cell beyond its noise, (n, m) mm."""
    mode = ("wrap" if grid.periodic else "nearest", "nearest")
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
