"""The whole integration of one capture: sections, views and first surface in, profile out."""

from collections.abc import Collection, Iterable, Iterator, Sequence
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
from treadlight.integrate.gather import View, ViewField
from treadlight.integrate.laser import held_out, laser_cells
from treadlight.integrate.normals import normal_residual, solved_slopes, surface_normals
from treadlight.integrate.relief import Upsampled, height_around, relief, smooth_cells
from treadlight.integrate.slots import ClosedTread
from treadlight.integrate.uncertainty import HeldOut

# How far, cells, a step is felt through a pixel's resolution.
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
        Median and 95th percentile of the angle between photometric and integrated normals, rad,
        of a million cells at the most.
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
    slope = solved_slopes(found.top, found.uncut, grid)
    near = ndimage.maximum_filter(found.steps | inside, 2 * _PIXEL_REACH + 1, mode=grid.filter_mode)
    return Profile(
        r=r,
        r_std=std,
        normal=surface_normals(slope, near & _seen(closed, grid), r, grid),
        laser=laser,
        step=found.steps | (closed.reach & ~inside),
        held_out=found.proof,
        laser_points=len(found.laser.value),
        normal_residual=normal_residual(slope, found.photometry.slope),
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
    top = surface + relief(surface, smooth, height, photometry, up, grid)
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
    uncut = np.ones((2, *grid.shape), bool)
    uncut[0, -1], uncut[1, :, -1] = grid.periodic, False
    slope = solved_slopes(top, uncut, grid)
    blurred = up.near(found.steps | inside, _PIXEL_REACH) & up.nearest(_seen(closed, cells))
    return Profile(
        r=r,
        r_std=up.linear(std),
        normal=surface_normals(slope, blurred, r, grid),
        laser=mask,
        step=up.nearest(found.steps | (closed.reach & ~inside)),
        held_out=found.proof,
        laser_points=int(counted[laser.row].sum()),
        normal_residual=normal_residual(slope[:, core], photometry.slope[:, core]),
        **_seen_fields(photometry),
    )


def _seen_by_pixels(
    found: Found, views: Sequence[View], up: Upsampled, surface: np.ndarray, grid: CylinderGrid
) -> Photometry:
    """What views see on a surface (n, m), without slopes in slots."""
    slots = ndimage.maximum_filter(found.closed.slots.mask, 3, mode=found.grid.filter_mode)
    closed = up.nearest(slots)

    def fields() -> Iterator[ViewField]:
        for view, blend in zip(views, found.blends, strict=True):
            (field,) = placed_fields([view], surface, grid)
            if field is not None:
                share = up.along(blend)[field.rows].astype(np.float32)
                yield outside(replace(field, blend=share), closed)

    return merge_views(fields(), grid)


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


def _seen(closed: ClosedTread, grid: CylinderGrid) -> np.ndarray:
    """Cells of the tread and of slots' floors, not of their walls."""
    lowest = ndimage.minimum_filter(closed.opening, 3, mode=grid.filter_mode)
    return ~closed.slots.mask | (lowest == 1)
