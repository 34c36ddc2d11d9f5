"""What wear cannot move: the tread pattern's walls at fixed heights, and the grooves' floors."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from treadlight.geometry import CylinderGrid
from treadlight.tread import FLOOR, GrooveReference, Regions, find_regions, fit_reference

# The band of heights, as shares of the lesser tread depth, in which walls are looked for: above
# the floors' noise, below what can have worn. The wider, the better a wall no wider than a
# cell is placed between cells.
_BAND = (0.1, 0.85)
# Without grooves the band hangs below the tops, where it keeps clear of their texture.
_BAND_BELOW_TOPS_MM = (-2.5, -0.8)
# Of the Gaussian that takes shape out of the floors' texture: waves under some 8 mm are left.
_TEXTURE_MM = 2.0


@dataclass(frozen=True)
class Relief:
    """A capture's profile, coarse enough to hold in memory, ready for alignment.

    Attributes
    ----------
    grid : CylinderGrid
    r : (n, m) float64
        mm; NaN = missing.
    floor : (n, m) bool
        Cells on floors of circumferential grooves.
    regions : Regions
    reference : GrooveReference
    """

    grid: CylinderGrid
    r: np.ndarray
    floor: np.ndarray
    regions: Regions
    reference: GrooveReference


def relief_of(r: np.ndarray, r_std: np.ndarray | None, grid: CylinderGrid) -> Relief:
    """Regions, groove reference and floors of a profile.

    Parameters
    ----------
    r, r_std : (n, m) float
        mm; NaN = missing.
    grid : CylinderGrid
    """
    regions = find_regions(r, grid)
    reference = fit_reference(r, r_std, grid, regions)
    floor = regions.classify(r, grid.theta) == FLOOR
    return Relief(grid, np.asarray(r, np.float64), floor, regions, reference)


def patterns(first: Relief, second: Relief) -> tuple[np.ndarray, np.ndarray]:
    """The tread patterns of two captures: height in a common band, 0 (void) .. 1 (block).

    Heights count from the grooves' floors, which stay where they are: a wall keeps its place in
    the pattern however much of its top has worn. Where a capture has no groove, they count from
    the tops.

    Returns
    -------
    (n, m), (k, l) float64
        On the captures' grids; NaN = missing.
    """
    both = (first, second)
    if all(relief.reference.reason is None for relief in both):
        depth = min(relief.regions.depth_mm for relief in both)
        low, high = (share * depth for share in _BAND)
        heights = [x.reference.height(x.r, x.grid.theta, x.grid.z) for x in both]
    else:
        low, high = _BAND_BELOW_TOPS_MM
        runouts = [x.regions.runout.radius(x.grid.theta, x.grid.z) for x in both]
        heights = [x.r - x.regions.crown - o for x, o in zip(both, runouts, strict=True)]
    one, other = (np.clip((height - low) / (high - low), 0.0, 1.0) for height in heights)
    return one, other


def floor_texture(relief: Relief) -> np.ndarray:
    """What stands out on the grooves' floors along theta: (n, m) mm, NaN elsewhere.

    Along theta alone: what is alike all around, such as a floor's rounded corners, has its place in
    the cells of the grid and would hold the tire there.
    """
    r = np.where(relief.floor, relief.r, np.nan)
    known = np.isfinite(r)
    sigma = _TEXTURE_MM / (relief.grid.step_theta * relief.grid.nominal_radius_mm)
    weight, mean = (
        ndimage.gaussian_filter1d(x, sigma, axis=0, mode=relief.grid.filter_mode[0])
        for x in (known.astype(np.float64), np.where(known, r, 0.0))
    )
    return r - mean / np.maximum(weight, 1e-6)


def smooth(
    values: np.ndarray, grid: CylinderGrid, sigma_mm: float, order: tuple[int, int] = (0, 0)
) -> np.ndarray:
    """Gaussian mean (or derivative per mm) over the known cells (normalised convolution).

    Parameters
    ----------
    values : (n, m) float
        NaN = missing.
    sigma_mm : float
        At least half a cell is used.
    order : derivative along theta and z, 0 or 1.

    Returns
    -------
    (n, m) float64
        NaN where less than half of the kernel's weight is known.
    """
    steps = np.array([grid.step_theta * grid.nominal_radius_mm, grid.step_z])
    sigmas = np.maximum(sigma_mm / steps, 0.5)
    modes = grid.filter_mode
    known = np.isfinite(values)
    filled = np.where(known, values, 0.0)
    weight = ndimage.gaussian_filter(known.astype(np.float64), sigmas, mode=modes)
    mean = ndimage.gaussian_filter(filled, sigmas, mode=modes) / np.maximum(weight, 1e-6)
    if any(order):
        # The kernel's derivative acts on the distance from the mean there, or gaps would count
        # as steps down to zero.
        slope = ndimage.gaussian_filter(filled, sigmas, order=order, mode=modes)
        edge = ndimage.gaussian_filter(known.astype(float), sigmas, order=order, mode=modes)
        mean = (slope - mean * edge) / np.maximum(weight, 1e-6) / float(steps[order.index(1)])
    return np.where(weight > 0.5, mean, np.nan)


def reduced_grid(grid: CylinderGrid, step_mm: float) -> tuple[CylinderGrid, np.ndarray, int]:
    """A coarser grid of about `step_mm`, for `reduce_rows`.

    Returns
    -------
    CylinderGrid
    row_edges : (k + 1,) int
        Coarse row i is made of the rows row_edges[i] .. row_edges[i + 1] - 1. A whole turn stays
        one: where its rows cannot be divided evenly, some blocks have a row more.
    columns : int
        Columns per coarse column; what is left over at the end is dropped.
    """
    rows_each = max(1, int(step_mm / (grid.step_theta * grid.nominal_radius_mm) + 1e-6))
    columns = max(1, int(step_mm / grid.step_z + 1e-6))
    count = grid.shape[0] // rows_each
    end = grid.shape[0] if grid.periodic else count * rows_each
    edges = np.round(np.linspace(0, end, count + 1)).astype(int)
    each = end / count
    theta = grid.theta[0] + (np.arange(count) * each + 0.5 * (each - 1)) * grid.step_theta
    wide = grid.shape[1] // columns
    z = grid.z[: wide * columns].reshape(wide, columns).mean(axis=1)
    return CylinderGrid(theta, z, grid.nominal_radius_mm), edges, columns


def reduce_rows(values: np.ndarray, row_edges: np.ndarray, columns: int) -> np.ndarray:
    """Means over blocks of cells, of the known ones where half of them are; NaN elsewhere.

    Parameters
    ----------
    values : (n, m) float
        NaN = missing.
    row_edges : (k + 1,) int
        Within `values`.
    columns : int
        Per block.

    Returns
    -------
    (k, m // columns) float32
    """
    wide = values.shape[1] // columns
    cut = values[: row_edges[-1], : wide * columns].astype(np.float64)
    known = np.isfinite(cut)
    count, total = (
        np.add.reduceat(part.reshape(len(cut), wide, columns).sum(axis=2), row_edges[:-1], axis=0)
        for part in (known.astype(np.float64), np.where(known, cut, 0.0))
    )
    enough = count >= 0.5 * columns * np.diff(row_edges)[:, None]
    return np.where(enough, total / np.maximum(count, 1), np.nan).astype(np.float32)
