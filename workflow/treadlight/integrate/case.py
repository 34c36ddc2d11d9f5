"""What the solves of one capture share, the solves, and what they leave."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from treadlight import tread
from treadlight.geometry import CylinderGrid
from treadlight.integrate import prior
from treadlight.integrate.bias import lean_of_ribs, remove_bias
from treadlight.integrate.confirm import confirm
from treadlight.integrate.depths import slot_depths
from treadlight.integrate.edges import (
    Photometry,
    build_edges,
    curl_scale,
    merge_views,
    mixed_variance,
)
from treadlight.integrate.gather import View, ViewField, ViewNormals, view_field
from treadlight.integrate.laser import LaserCells, laser_cells
from treadlight.integrate.path_errors import shared_columns, with_path_variance
from treadlight.integrate.sight import bridged_surface, seen_on
from treadlight.integrate.slots import ClosedTread, close_cuts
from treadlight.integrate.solve import Problem, Solution, integrate
from treadlight.integrate.uncertainty import (
    HeldOut,
    compare_held_out,
    coverage_factor,
    sampled_std,
)

# An edge that keeps less than this share of its weight is a step.
_STEP_SHARE = 0.05
_CLEAR_CELLS = 3
# Fewer sections do not tell the tread from what they met.
_LEAST_SPACINGS = 3


@dataclass(frozen=True)
class LaserSections:
    """Laser points (section, line): r mm, theta rad, z mm, r_std mm; encoder (section,) rad.

    `shared_rows` neighbouring lines share one error (speckle, smoothing): a mean over n of them is
    known as well as one over n / shared_rows.
    """

    r: np.ndarray
    theta: np.ndarray
    z: np.ndarray
    r_std: np.ndarray
    encoder: np.ndarray
    shared_rows: float


@dataclass(frozen=True)
class FirstSurface:
    """r, r_std (n, m), mm; NaN where nothing supports a value."""

    r: np.ndarray
    r_std: np.ndarray


@dataclass(frozen=True)
class Case:
    """What the solves of a capture share; lengths mm.

    Attributes
    ----------
    fields : list of ViewField
        Without the slopes beside cuts.
    laser : LaserCells
        All points.
    closed : ClosedTread
    first : FirstSurface
        Bridged across cuts.
    first_edges : prior.FirstEdges
    outline : (n, m) float64
        mm; see `prior.outline`.
    depth : (n, m) float32
        See `_relative_depth`.
    walls : (n, m) bool
        Steps of the first surface.
    tread_depth : float
        Of the grooves, mm; NaN where there is none.
    spacing, shared_rows : float
        Distance of sections, cells along theta; see `LaserSections`.
    usual_std, noise : float
        Standard deviation of the first surface, and of an edge from cell to cell.
    rib_of_column : (m,) int
        0 in grooves.
    leans : list of (m,) float64
        What the slopes along z of each field lack; see `lean_of_ribs`.
    blends : list of (n,) float64
        Of each view that was given; see `ViewField`. 0 in rows that it does not see.
    """

    grid: CylinderGrid
    fields: list[ViewField]
    laser: LaserCells
    closed: ClosedTread
    first: FirstSurface
    first_edges: prior.FirstEdges
    outline: np.ndarray
    depth: np.ndarray
    walls: np.ndarray
    tread_depth: float
    spacing: float
    shared_rows: float
    usual_std: float
    noise: float
    rib_of_column: np.ndarray
    leans: list[np.ndarray]
    blends: list[np.ndarray]

    def solve(self, laser: LaserCells) -> "Solved":
        """Heights from these laser points and the views, whose smooth bias they tell."""
        about = (self.walls, self.spacing, self.grid)
        fields = [remove_bias(f, laser, self.depth, *about) for f in self.fields]
        fields = confirm(fields, laser, self.outline, *about)
        fields = with_path_variance(fields, laser, self.walls, self.shared_rows, *about[1:])
        fields = [_leaning(f, lean) for f, lean in zip(fields, self.leans, strict=True)]
        photometry = merge_views(fields, self.grid)
        problem = self.problem(photometry, laser)
        return Solved(
            photometry,
            problem,
            integrate(problem, self.closed.r, self.usual_std, self.noise),
            shared_columns(fields, laser, self.walls, self.shared_rows, self.spacing, self.grid),
        )

    def placed_on(self, views: Iterable[View], r: np.ndarray) -> "Case":
        """The case with its views placed on solved heights (n, m), mm.

        What stands on a groove's floor between two sections, as a wear bar does, the first surface
        does not know; seen obliquely on a floor, its ramps are a quarter too short or too long.
        Cuts, the laser's points and the outline stay as the first placing left them.
        """
        seen = placed_fields(views, r, self.grid)
        fields = [outside(field, self.closed.reach) for field in seen if field is not None]
        return replace(
            self,
            fields=fields,
            noise=_noise_std(merge_views(fields, self.grid), self.grid),
            leans=[np.zeros(self.grid.shape[1])] * len(fields),
            blends=[_blend_of(field, self.grid) for field in seen],
        )

    def upright(self, r: np.ndarray) -> "Case":
        """The case with ribs set upright that heights (n, m) show to lean."""
        told = self.laser.select(self.closed.on_tread)
        leans = [
            lean_of_ribs(f, told, r, self.rib_of_column, self.shared_rows, self.grid)
            for f in self.fields
        ]
        return replace(self, leans=leans)

    def problem(self, photometry: Photometry, laser: LaserCells) -> Problem:
        start = self.closed.r
        edges = build_edges(
            photometry.slope,
            photometry.variance,
            mixed_variance(photometry.slope, self.grid),
            start,
            self.first_edges.step,
            self.first_edges.std,
            self.grid,
        )
        # Only the level of what all edges are cut around, and no laser point is in, needs the
        # first surface: within the height of the tread.
        low, high = np.percentile(start, [1, 99])
        level = 1 / max(high - low, 1.0) ** 2
        laser = replace(laser, std=laser.std * np.sqrt(self.shared_rows))
        return Problem(edges, laser, start, np.where(np.isfinite(self.first.r), level, 0))


@dataclass(frozen=True)
class Solved:
    """A solve; `shared` as in `shared_columns`."""

    photometry: Photometry
    problem: Problem
    solution: Solution
    shared: float

    def std(self, grid: CylinderGrid) -> np.ndarray:
        """Standard deviation of the heights, (n, m) mm."""
        return sampled_std(self.problem, self.solution, self.shared, grid)


def prepare(
    views: Iterable[View],
    sections: LaserSections,
    surface: FirstSurface,
    grid: CylinderGrid,
    instead: Iterable[View] | None,
) -> Case:
    usual_std = float(np.nanmedian(surface.r_std))
    spacing = prior.section_spacing(sections.encoder, grid)
    surface = _as_usual_beyond(surface, sections, spacing, grid)
    start = prior.complete(surface.r)
    bridged = bridged_surface(start, usual_std, spacing, grid)
    seen = placed_fields(views, bridged, grid)
    blends = [_blend_of(field, grid) for field in seen]
    fields = [field for field in seen if field is not None]
    laser = laser_cells(
        sections.r,
        sections.theta,
        sections.z,
        sections.r_std,
        merge_views(fields, grid).slope,
        grid,
    )
    closed = close_cuts(
        fields,
        start,
        usual_std,
        laser,
        lambda r: _relative_depth(r, tread.find_regions(r, grid), grid),
        spacing,
        sections.shared_rows,
        grid,
    )
    if instead is not None:
        seen = placed_fields(instead, bridged, grid)
        fields = [field for field in seen if field is not None]
    fields = [outside(f, closed.reach) for f in fields]
    # Two sections' errors are spread over the cells between them.
    bridge_std = usual_std * np.sqrt(2 / spacing)
    unsure = closed.bridged | (closed.reach & np.isfinite(surface.r))
    first = FirstSurface(
        np.where(unsure, closed.r, surface.r), np.where(unsure, bridge_std, surface.r_std)
    )
    first = replace(first, r=np.where(closed.unknown, np.nan, first.r))
    regions = tread.find_regions(closed.r, grid)
    outline = prior.outline(closed.r, regions, grid)
    drift = prior.drift_rate(laser.select(closed.on_tread), outline, regions, spacing, grid)
    if drift is None:
        drift = bridge_std**2 / grid.step_z
    return Case(
        grid,
        fields,
        laser,
        closed,
        first,
        prior.first_edges(closed.r, first.r_std, closed.reach, outline, drift, grid),
        outline,
        _relative_depth(closed.r, regions, grid),
        prior.step_height(closed.r, np.full(start.shape, usual_std), grid) > 0,
        regions.depth_mm,
        spacing,
        sections.shared_rows,
        usual_std,
        _noise_std(merge_views(fields, grid), grid),
        regions.rib_of_column,
        [np.zeros(grid.shape[1])] * len(fields),
        blends,
    )


def _as_usual_beyond(
    surface: FirstSurface, sections: LaserSections, spacing: float, grid: CylinderGrid
) -> FirstSurface:
    """The outline where the first surface goes on beyond the first or last section as that one is.

    That may lie in a slot.
    """
    beyond = prior.beyond_sections(
        np.where(np.isfinite(sections.r), sections.theta, np.nan), spacing, grid
    )
    within = np.flatnonzero(~beyond)
    if not beyond.any() or len(within) < _LEAST_SPACINGS * spacing:
        return surface
    inner, start = grid.part(within), prior.complete(surface.r)[within]
    usual = prior.outline(start, tread.find_regions(start, inner), inner)
    nearest = np.clip(np.arange(len(beyond)) - within[0], 0, len(within) - 1)
    r = np.where(beyond[:, None] & np.isfinite(surface.r), usual[nearest], surface.r)
    return replace(surface, r=r)


def placed_fields(
    views: Iterable[View], surface: np.ndarray, grid: CylinderGrid
) -> list[ViewField | None]:
    """Views where they see a surface (n, m), mm; None for each that sees nothing of the grid."""
    return [view_field(_placed(view, surface, grid), grid) for view in views]


def _placed(view: View, surface: np.ndarray, grid: CylinderGrid) -> Iterator[ViewNormals]:
    for block in view.blocks(grid):
        for part in block.blocks(grid):
            yield seen_on(part, surface, grid)


def _blend_of(field: ViewField | None, grid: CylinderGrid) -> np.ndarray:
    blend = np.zeros(grid.shape[0])
    if field is not None:
        blend[field.rows] = field.blend
    return blend


def _leaning(field: ViewField, lean: np.ndarray) -> ViewField:
    """The field with this much (m,) more slope along z."""
    slope = field.slope.copy()
    slope[1] += lean.astype(slope.dtype)
    return replace(field, slope=slope)


@dataclass(frozen=True)
class Found:
    """What the solves leave, of whose matrices nothing is needed any more; lengths mm.

    Attributes
    ----------
    grid : CylinderGrid
    blends : list of (n,) float64
        See `Case`.
    top, std : (n, m) float
        Closed surface, NaN where nothing supports it.
    depth, depth_std : (n, m) float
        Of slots below it.
    steps : (n, m) bool
        Cells beside a cut edge.
    uncut : (2, n, m) bool
        Edges that hold their cells together.
    """

    grid: CylinderGrid
    blends: list[np.ndarray]
    top: np.ndarray
    std: np.ndarray
    depth: np.ndarray
    depth_std: np.ndarray
    steps: np.ndarray
    uncut: np.ndarray
    photometry: Photometry
    closed: ClosedTread
    laser: LaserCells
    proof: HeldOut


def solve_case(case: Case, views: Iterable[View], out: np.ndarray) -> Found:
    """Heights from all sections, after a proof by those of a mask (s,).

    `views` are those of the case, which are placed anew on what the proof found.
    """
    grid, closed, laser = case.grid, case.closed, case.laser
    proof, factor, first_r = _prove(case, out)
    case = case.placed_on(views, first_r).upright(first_r)
    solved = case.solve(laser.select(closed.on_tread))
    photometry, solution = solved.photometry, solved.solution
    std = (factor * solved.std(grid)).astype(np.float32)
    known = np.isfinite(photometry.slope[0]) | np.isfinite(case.first.r)
    depth = slot_depths(
        closed.slots,
        closed.met,
        solution.r,
        laser,
        closed.in_slot,
        case.shared_rows,
        case.tread_depth,
        grid,
    )
    return Found(
        grid,
        case.blends,
        np.where(known, solution.r, np.nan),
        std,
        *depth,
        _steps(solution, grid),
        (solution.share >= _STEP_SHARE) & (solved.problem.edges.weight > 0),
        photometry,
        closed,
        laser,
        proof,
    )


def _prove(case: Case, out: np.ndarray) -> tuple[HeldOut, float, np.ndarray]:
    """Heights without the sections of a mask (s,), what these say, the factor they ask for."""
    tread_points = case.laser.select(case.closed.on_tread)
    out = out[tread_points.section]
    # The first surface knows the held-out sections: only where it counts for nothing against the
    # slopes is the comparison with them a proof.
    lit = np.zeros(case.grid.shape, bool)
    for field in case.fields:
        lit[field.rows] |= np.isfinite(field.slope[0])
    held = tread_points.select(out & lit[tread_points.row, tread_points.column])
    if not len(held.value):
        r = case.solve(tread_points).solution.r if case.fields else case.closed.r
        return compare_held_out(case.closed.r, held), 1.0, r
    solved = case.solve(tread_points.select(~out))
    solution = solved.solution
    # At a wall a laser point and a cell are not the same place.
    clear = _clear(_steps(solution, case.grid) | case.walls, case.grid)
    held = held.select(clear[held.row, held.column])
    factor = coverage_factor(solution.r, lambda: solved.std(case.grid), held, case.shared_rows)
    return compare_held_out(solution.r, held), factor, solution.r


def outside(field: ViewField, mask: np.ndarray) -> ViewField:
    """The field without its slopes in a mask (n, m)."""
    return replace(field, slope=np.where(mask[field.rows], np.float32(np.nan), field.slope))


def _noise_std(photometry: Photometry, grid: CylinderGrid) -> float:
    """Usual standard deviation of an edge from cell to cell, mm: as said, or more by the curl."""
    if not np.isfinite(photometry.variance).any():
        return grid.step_z
    usual = float(np.sqrt(np.nanmedian(photometry.variance))) * grid.step_z
    return usual * max(1.0, curl_scale(photometry.slope, photometry.variance, grid))


def _relative_depth(surface: np.ndarray, regions: tread.Regions, grid: CylinderGrid) -> np.ndarray:
    """How deep a surface lies below the tread's outline: 0 on tops, 1 on groove floors."""
    if not np.isfinite(regions.depth_mm) or regions.depth_mm <= 0:
        return np.zeros(surface.shape, np.float32)
    depth = regions.crown + regions.runout.radius(grid.theta, grid.z) - surface
    return np.clip(np.nan_to_num(depth / regions.depth_mm), 0, 1).astype(np.float32)


def _steps(solution: Solution, grid: CylinderGrid) -> np.ndarray:
    """Cells on either side of a cut edge."""
    cut = solution.share < _STEP_SHARE
    if not grid.periodic:
        cut[0, -1] = False
    cut[1, :, -1] = False
    return cut[0] | np.roll(cut[0], 1, axis=0) | cut[1] | np.roll(cut[1], 1, axis=1)


def _clear(steps: np.ndarray, grid: CylinderGrid) -> np.ndarray:
    """Cells with no step within a few cells."""
    return ~ndimage.maximum_filter(steps, 2 * _CLEAR_CELLS + 1, mode=grid.filter_mode)
