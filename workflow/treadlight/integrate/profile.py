"""The whole integration of one capture: sections, views and first surface in, profile out."""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from treadlight.geometry import CylinderGrid
from treadlight.integrate.binning import views_for_cells
from treadlight.integrate.case import (
    FirstSurface,
    Found,
    LaserSections,
    outside,
    placed_fields,
    prepare,
    solve_case,
)
from treadlight.integrate.cells import sampled, solved_grid, thinned, width_of_cells
from treadlight.integrate.edges import Photometry, merge_views
from treadlight.integrate.gather import View
from treadlight.integrate.laser import held_out, laser_cells
from treadlight.integrate.relief import Upsampled, add_relief, height_around, smooth_cells
from treadlight.integrate.slots import ClosedTread
from treadlight.integrate.uncertainty import HeldOut

# A pixel's resolution, cells, and how far a step is felt through it.
_PIXEL_SIGMA = 0.7
_PIXEL_REACH = 3


@dataclass(frozen=True)
class Profile:
    """What the integration found on the grid (n, m); lengths mm.

    Attributes
    ----------
    r, r_std : (n, m) float64
        NaN where nothing supports a value.
    normal : (n, m, 3) float32
        Unit normal of the integrated surface, components r, theta, z. Beside steps and cuts that
        of the surface at a pixel's resolution: a lip leans. In narrow cuts, where nobody sees
        the walls, that of the tread over them.
    material : (3, n, m) float32
        k_d, k_s, alpha.
    laser, photometric, step : (n, m) bool
        Cells with a laser point, with a slope, beside a step.
    shadowed, saturated : (n, m) bool
    held_out : HeldOut
    laser_points : int
        Those points, of all lines.
    normal_residual : (2,) float
        Median and 95th percentile of the angle between photometric and integrated normals, rad.
    """

    r: np.ndarray
    r_std: np.ndarray
    normal: np.ndarray
    material: np.ndarray
    laser: np.ndarray
    photometric: np.ndarray
    step: np.ndarray
    shadowed: np.ndarray
    saturated: np.ndarray
    held_out: HeldOut
    laser_points: int
    normal_residual: tuple[float, float]


def integrate_capture(
    views: Iterable[View],
    sections: LaserSections,
    surface: FirstSurface,
    grid: CylinderGrid,
    held_out_every: int,
    instead: Iterable[View] | None = None,
) -> Profile:
    """Heights from slopes, laser sections and the first surface, with their uncertainty.

    All in memory; see `solve_capture` and `profile_of`.

    Parameters
    ----------
    views : iterable of View
        May be empty (laser only).
    sections : LaserSections
        May hold no point (photometric only: the shape about the first surface's level).
    surface : FirstSurface
        On the grid.
    grid : CylinderGrid
    held_out_every : int
        Every n-th section stays out of the first solve; 0 = none.
    instead : iterable of View, optional
        Normals that the solve takes instead of the views', which still tell where cuts are.
    """
    views, instead = list(views), None if instead is None else list(instead)
    width = width_of_cells(grid, grid.shape[0] * grid.shape[1])
    cells = solved_grid(grid, width)
    place = np.ix_(*sampled(grid, cells))
    first = FirstSurface(surface.r[place], surface.r_std[place])
    coarse = views_for_cells(views, cells)
    other = None if instead is None else views_for_cells(instead, cells)
    found = solve_capture(coarse, thinned(sections, width), first, cells, held_out_every, other)
    return profile_of(found, views if instead is None else instead, sections, grid)


def solve_capture(
    views: Collection[View],
    sections: LaserSections,
    surface: FirstSurface,
    cells: CylinderGrid,
    held_out_every: int,
    instead: Collection[View] | None = None,
) -> Found:
    """The surface of a capture on cells that may be wider than its pixels.

    Solved twice: without the held-out sections, to compare with them, and then with all, since a
    block that a single section crosses would lose its height with it. The figures of the
    comparison are so on the safe side. For each the views (or those instead) are gone through.

    Parameters
    ----------
    views : collection of View
        With pixels no finer than cells need; see `binning.views_for_cells`.
    sections : LaserSections
        With about a line for each column of cells.
    surface : FirstSurface
        On the cells.
    held_out_every, instead
        See `integrate_capture`.
    """
    out = held_out(len(sections.r), held_out_every)
    again = views if instead is None else instead
    # Nothing here holds the first placing's fields while the second ones are solved.
    return solve_case(prepare(views, sections, surface, cells, instead), again, out)


def profile_of(
    found: Found,
    views: Sequence[View],
    sections: LaserSections,
    grid: CylinderGrid,
    core: slice = slice(None),
) -> Profile:
    """The profile on the grid of the cells, or on pixels that see finer relief.

    Parameters
    ----------
    found : Found
    views : sequence of View
        Those whose slopes were solved, as many as the solve was given.
    sections : LaserSections
        All of their points.
    grid : CylinderGrid
        Of the cells, or of some rows of the pixels.
    core : slice
        Rows whose points count in the profile's figures.
    """
    if grid is found.grid:
        return _profile_of_cells(found)
    return _profile_of_pixels(found, views, sections, grid, core)


def _profile_of_cells(found: Found) -> Profile:
    closed, grid = found.closed, found.grid
    inside, laser = closed.slots.mask, np.zeros(grid.shape, bool)
    laser[found.laser.row, found.laser.column] = True
    r, std = _with_slots(found)
    slope = _solved_slopes(found.top, found.uncut, grid)
    blurred = _near(found.steps | inside, grid) & _seen(closed, grid)
    return Profile(
        r=r,
        r_std=std,
        normal=_surface_normals(slope, blurred, r, grid),
        laser=laser,
        step=found.steps | (closed.reach & ~inside),
        held_out=found.proof,
        laser_points=len(found.laser.value),
        normal_residual=_normal_residual(slope, found.photometry.slope),
        **_seen_fields(found.photometry),
    )


def _profile_of_pixels(
    found: Found,
    views: Sequence[View],
    sections: LaserSections,
    grid: CylinderGrid,
    core: slice,
) -> Profile:
    up, closed, cells = Upsampled.between(found.grid, grid), found.closed, found.grid
    inside = closed.slots.mask
    solid = np.where(np.isfinite(found.top), found.top, closed.r)
    surface = up.linear(solid)
    photometry = _seen_by_pixels(found, views, up, surface, grid)
    smooth, height = smooth_cells(solid, found.steps, cells), height_around(solid, cells)
    width = cells.step_z / grid.step_z
    around = up.nearest(smooth), up.nearest(height)
    top = add_relief(surface, *around, photometry, width, grid)
    r, std = _with_slots(found)
    # What the cells cut into their closed surface.
    r = top - up.linear(solid - r)
    laser = laser_cells(
        sections.r, sections.theta, sections.z, sections.r_std, photometry.slope, grid
    )
    mask = np.zeros(grid.shape, bool)
    mask[laser.row, laser.column] = True
    counted = np.zeros(grid.shape[0], bool)
    counted[core] = True
    steps = up.nearest(found.steps)
    uncut = np.ones((2, *grid.shape), bool)
    uncut[0, -1], uncut[1, :, -1] = grid.periodic, False
    slope = _solved_slopes(top, uncut, grid)
    blurred = _near(steps | up.nearest(inside), grid) & up.nearest(_seen(closed, cells))
    return Profile(
        r=r,
        r_std=up.linear(std),
        normal=_surface_normals(slope, blurred, r, grid),
        laser=mask,
        step=steps | up.nearest(closed.reach & ~inside),
        held_out=found.proof,
        laser_points=int(counted[laser.row].sum()),
        normal_residual=_normal_residual(slope[:, core], photometry.slope[:, core]),
        **_seen_fields(photometry),
    )


def _seen_by_pixels(
    found: Found, views: Sequence[View], up: Upsampled, surface: np.ndarray, grid: CylinderGrid
) -> Photometry:
    """What views see on a surface (n, m), without slopes in slots."""
    slots = ndimage.maximum_filter(found.closed.slots.mask, 3, mode=found.grid.filter_mode)
    closed = up.nearest(slots)
    fields = []
    for view, blend in zip(views, found.blends, strict=True):
        (field,) = placed_fields([view], surface, grid)
        if field is not None:
            share = up.along(blend)[field.rows].astype(np.float32)
            fields.append(outside(replace(field, blend=share), closed))
    return merge_views(fields, grid)


def _with_slots(found: Found) -> tuple[np.ndarray, np.ndarray]:
    """Heights and their standard deviation with the slots cut into the closed surface, (n, m)."""
    closed, inside = found.closed, found.closed.slots.mask
    r = np.where(inside, found.top - closed.opening * found.depth, found.top)
    std = np.where(inside, np.hypot(found.std, found.depth_std), found.std)
    return r, np.where(np.isfinite(r), std, np.nan)


def _seen_fields(photometry: Photometry) -> dict[str, np.ndarray]:
    return {
        "material": photometry.material,
        "photometric": np.isfinite(photometry.slope[0]),
        "shadowed": photometry.flags[0] > 0.5,
        "saturated": photometry.flags[1] > 0.5,
    }


def _surface_normals(
    slope: np.ndarray, blurred: np.ndarray, r: np.ndarray, grid: CylinderGrid
) -> np.ndarray:
    """Normals of solved slopes (2, n, m), in a mask (n, m) those of the heights as pixels see."""
    whole = np.where(blurred, _blurred_slopes(r, grid), slope)
    return _normals(np.where(np.isfinite(whole), whole, slope))


def _near(steps: np.ndarray, grid: CylinderGrid) -> np.ndarray:
    """Cells that feel a step through a pixel's resolution."""
    return ndimage.maximum_filter(steps, 2 * _PIXEL_REACH + 1, mode=grid.filter_mode)


def _seen(closed: ClosedTread, grid: CylinderGrid) -> np.ndarray:
    """Cells of the tread and of slots' floors, not of their walls."""
    lowest = ndimage.minimum_filter(closed.opening, 3, mode=grid.filter_mode)
    return ~closed.slots.mask | (lowest == 1)


def _blurred_slopes(r: np.ndarray, grid: CylinderGrid) -> np.ndarray:
    """dr / (r dtheta) and dr / dz of a surface at a pixel's resolution, (2, n, m) float32."""
    known = np.isfinite(r)
    level = float(r[known].mean()) if known.any() else 0.0
    weight, blurred = (
        ndimage.gaussian_filter(x.astype(np.float32), _PIXEL_SIGMA, mode=grid.filter_mode)
        for x in (known, np.where(known, r - level, 0))
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        blurred = np.where(known, blurred / weight, np.float32(np.nan))
    if grid.periodic:
        along = np.gradient(np.pad(blurred, ((1, 1), (0, 0)), mode="wrap"), axis=0)[1:-1]
    else:
        along = np.gradient(blurred, axis=0)
    along /= np.float32(grid.step_theta) * (blurred + np.float32(level))
    return np.stack([along, np.gradient(blurred, np.float32(grid.step_z), axis=1)])


def _solved_slopes(r: np.ndarray, uncut: np.ndarray, grid: CylinderGrid) -> np.ndarray:
    """dr / (r dtheta) and dr / dz of the heights, (2, n, m) float32, from the uncut edges."""
    slope = np.empty((2, *r.shape), np.float32)
    for k in range(2):
        step = (np.roll(r, -1, axis=k) - r).astype(np.float32)
        whole = uncut[k] & np.isfinite(step)
        step = np.where(whole, step, np.float32(0))
        count = whole.astype(np.float32) + np.roll(whole, 1, axis=k)
        with np.errstate(divide="ignore", invalid="ignore"):
            slope[k] = np.where(count > 0, (step + np.roll(step, 1, axis=k)) / count, np.nan)
    slope[0] /= grid.step_theta * r
    slope[1] /= grid.step_z
    return slope


def _normals(slope: np.ndarray) -> np.ndarray:
    """Unit normals (n, m, 3) float32 of slopes (2, n, m)."""
    normal = np.empty((*slope.shape[1:], 3), np.float32)
    normal[..., 0] = 1 / np.sqrt(1 + slope[0] ** 2 + slope[1] ** 2)
    for k in range(2):
        normal[..., k + 1] = -slope[k] * normal[..., 0]
    return normal


def _normal_residual(solved: np.ndarray, photometric: np.ndarray) -> tuple[float, float]:
    """Median and 95th percentile of the angle between two fields of slopes, rad."""
    cosine = np.einsum("...k,...k", _normals(solved), _normals(photometric), dtype=np.float64)
    cosine = cosine[np.isfinite(cosine)]
    if not cosine.size:
        return np.nan, np.nan
    angle = np.arccos(np.clip(cosine, -1, 1))
    median, high = np.percentile(angle, [50, 95])
    return float(median), float(high)
