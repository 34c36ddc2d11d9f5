"""Slots and sipes: cuts across a rib, which the sections meet too rarely to draw them.

The first surface knows a slot only where a section crosses it, as a block half the sections'
distance wide. Photometry knows its outline: inside, shadows of walls that the surface does not
have break the reflection model, and its walls tilt the normals of the pixels that see them; into
a sipe hardly any light falls, and the laser's line breaks where it crosses one. So the tread is
integrated with its cuts closed, and the slots are then cut into it as deep as the sections that
met them say.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from treadlight.geometry import CylinderGrid
from treadlight.integrate.cues import Cues, dark_lines, read_cues
from treadlight.integrate.gaps import hidden_cuts, looked_at
from treadlight.integrate.gather import ViewField
from treadlight.integrate.laser import LaserCells
from treadlight.integrate.patches import Patches, find_patches, kinds_of, way_out
from treadlight.tread.robust import row_medians

# Around a cell of a cut this share of the pixels does not fit the model; in it, the greater part.
_POOR_SHARE = 0.35
_MOSTLY = 0.5
# Mean of (slope's deviation / its usual deviation)^2, both slopes, over nine cells: 2 on a smooth
# tread, where it exceeds this in one cell of a hundred.
_TILTED = 5.0
# Over 4 standard deviations in both slopes of nine cells: never noise. What is tilted and nowhere
# as much as this, and fits the model, is relief that photometry measures.
_SURELY_TILTED = 40.0
# Of one cell alone: five standard deviations in both slopes.
_WALL_TILTED = 50.0
# A point this many standard deviations off the sections beside it is not on the tread; beside
# a cut, where the line lies partly in it, half as many tell.
_OFF_SIGMA = 4.0
_BESIDE_SIGMA = 2.0
_BESIDE_CELLS = 1.5
# A cut is drawn where the camera looks into it, aside of its floor by up to half its depth.
_ASIDE = 0.5
# Sections on either side that tell where the tread is.
_SECTIONS = 3
_LEAST_CALM = 3
# Of the tread's depth: what is deeper is a groove's floor or wall.
_GROOVE_DEPTH = 0.25
# Of the way from a dark line's edge to where it is darkest.
_MIDDLE = 0.9
# Of the rows that are seen: what fills more of a column runs around the tire, as a groove's lip or
# the rim of what is seen.
_AROUND = 0.5
# Blocks repeat around a tire about so often: a cut is a small part of it, a lip nearly all.
_PITCH_MM = 35.0
# A lip and its blur are half as wide.
_LIP_CELLS = 7
# Of a slot's cells: less is tilted tread with some shadow.
_SEEN_SHARE = 0.25


@dataclass(frozen=True)
class ClosedTread:
    """The first surface with its cuts closed.

    Attributes
    ----------
    r : (n, m) float64
        mm.
    bridged : (n, m) bool
        Cells interpolated across cuts.
    reach : (n, m) bool
        Cells in or beside a cut, whose normals are not the tread's.
    slots : Patches
        Cuts that the camera looks into.
    opening : (n, m) float32
        Share of the way from a slot's lip (0) to its floor (1).
    met : (slots.count,) bool
        Slots that sections fell into, or into their like.
    on_tread, in_slot : (k,) bool
        Of the laser points. What is neither lies on an edge, or is a ghost.
    unknown : (n, m) bool
        Cells that neither a view nor a section says anything of.
    """

    r: np.ndarray
    bridged: np.ndarray
    reach: np.ndarray
    slots: Patches
    opening: np.ndarray
    met: np.ndarray
    on_tread: np.ndarray
    in_slot: np.ndarray
    unknown: np.ndarray


def close_cuts(
    fields: Sequence[ViewField],
    start: np.ndarray,
    std: float,
    laser: LaserCells,
    depth: Callable[[np.ndarray], np.ndarray],
    spacing: float,
    shared_rows: float,
    grid: CylinderGrid,
) -> ClosedTread:
    """Find the cuts and interpolate the first surface across them.

    Parameters
    ----------
    fields : sequence of ViewField
    start : (n, m) float
        First surface, complete, mm.
    std : float
        Its usual standard deviation, mm.
    laser : LaserCells
    depth : function of a surface (n, m)
        How deep it lies below the tread's outline: 0 on tops, 1 on groove floors.
    spacing, shared_rows : float
        Distance of sections, cells along theta; see `LaserSections`.
    grid : CylinderGrid
    """
    cues = read_cues(fields, spacing, grid)
    lost = _lost(laser, std, grid)
    lines = _cut_lines(cues.dark, laser, lost, grid)
    broken = _breaks(cues, grid) | (lines > 0)
    seen = _seen_rows(cues.dark)
    over = _bridge(start, broken, seen, std, laser, depth, grid)
    nowhere = np.zeros(grid.shape, bool)

    def crossing(cut: np.ndarray) -> np.ndarray:
        # A slot's mouth goes on through the lip.
        mouth = ndimage.maximum_filter1d(_briefly(cut, seen, grid), _LIP_CELLS, axis=1)
        return cut & (mouth | (lines > 0))

    slots, met = _slots(cues, lines, nowhere, crossing(over.cut), laser, lost, grid)
    looked = looked_at(fields, spacing, grid)
    below = _tread_level(over.r, looked, grid)[laser.row, laser.column] - laser.value
    hidden, unknown = hidden_cuts(
        slots.mask & looked,
        looked,
        laser,
        below > _OFF_SIGMA * np.hypot(std, laser.std),
        _ribs(depth(start)),
        std,
        spacing,
        shared_rows,
        grid,
    )
    if hidden.any():
        broken |= ndimage.maximum_filter(hidden, 3, mode=grid.filter_mode)
        over = _bridge(start, broken, seen, std, laser, depth, grid)
        slots, met = _slots(cues, lines, hidden, crossing(over.cut), laser, lost, grid)
    below = over.r[laser.row, laser.column] - laser.value
    deep = below > _OFF_SIGMA * np.hypot(std, laser.std)
    return ClosedTread(
        over.r,
        over.bridged,
        ndimage.maximum_filter(over.cut, 3, mode=grid.filter_mode),
        slots,
        _opening(slots.mask, ~over.tread, lines, grid),
        met,
        over.on_tread,
        deep & slots.mask[laser.row, laser.column],
        unknown,
    )


@dataclass(frozen=True)
class _Bridged:
    """A surface (n, m) with cuts closed; the interpolated cells, cuts and tread; points (k,).

    Not all cuts are interpolated across: see `_briefly`.
    """

    r: np.ndarray
    bridged: np.ndarray
    cut: np.ndarray
    tread: np.ndarray
    on_tread: np.ndarray


def _bridge(
    start: np.ndarray,
    broken: np.ndarray,
    seen: np.ndarray,
    std: float,
    laser: LaserCells,
    depth: Callable[[np.ndarray], np.ndarray],
    grid: CylinderGrid,
) -> _Bridged:
    """The surface without what breaks its tread, (n, m) bool, in the rows seen, (n,) bool."""
    patches = find_patches(broken, grid)
    count = len(laser.value)
    sections = _completed(laser, start, std, grid)
    off = _off_tread(sections, patches, np.median(depth(start), axis=0), std, grid)
    # What the first surface says where no point is tells of slots, not where the tread is.
    kept = off | (np.arange(len(off)) < count)
    sections, off = sections.select(kept), off[kept]
    # Along a groove's lip there is nothing to interpolate from: most of its column is broken.
    closed, _ = _interpolated(start, _briefly(patches.mask, seen, grid), off, sections, grid)
    # Grooves that run around the tire are drawn well by the sections: they stay.
    tread = depth(closed) < _GROOVE_DEPTH
    cut = find_patches(patches.mask & tread, grid).mask
    crossing = _briefly(cut, seen, grid)
    closed, bridged = _interpolated(start, crossing, off, sections, grid)
    return _Bridged(closed, bridged, cut, tread, ~off[:count])


def _ribs(depth: np.ndarray) -> list[slice]:
    """Columns between the grooves around the tire, from the depth (n, m) of all."""
    runs = ndimage.find_objects(ndimage.label(np.median(depth, axis=0) < _GROOVE_DEPTH)[0])
    return [columns for (columns,) in runs]


def _tread_level(r: np.ndarray, looked: np.ndarray, grid: CylinderGrid) -> np.ndarray:
    """The closed surface, along theta interpolated over the rows where no view looks."""
    level, rows = r.copy(), np.arange(len(r))
    period = len(r) if grid.periodic else None
    for j in np.flatnonzero(looked.any(axis=0) & ~looked.all(axis=0)):
        known = np.flatnonzero(looked[:, j])
        level[:, j] = np.interp(rows, known, r[known, j], period=period)
    return level


def _lost(laser: LaserCells, std: float, grid: CylinderGrid) -> np.ndarray:
    """Points (k,) far off their column of the sections beside, or far less sure than usual.

    In a narrow cut the line breaks: part of it lies on the lips, part is lost, and the middle of
    what is left is moved either way.
    """
    everywhere = np.ones(len(laser.value), bool)
    away = np.abs(_median_along(laser, everywhere, grid) - laser.value)
    return (away > _OFF_SIGMA * std) | (laser.std > _OFF_SIGMA * std)


def _cut_lines(
    dark: np.ndarray, laser: LaserCells, lost: np.ndarray, grid: CylinderGrid
) -> np.ndarray:
    """`dark_lines` without those where the sections find the tread, or found nothing alike.

    Rubber is about as dark as matter gets: what is much darker is a hole or dirt, and the
    sections know which.
    """
    lines = dark_lines(dark, grid)
    lines *= _across(lines > 0, _seen_rows(dark))
    patches = find_patches(lines > 0, grid)
    kept = patches.select(_lost_share(patches, laser, lost, grid) > _MOSTLY)
    return np.where(kept.mask, lines, 0)


def _seen_rows(dark: np.ndarray) -> np.ndarray:
    return (dark != 0).any(axis=1)


def _across(mask: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """The mask (n, m) without columns that it fills for the greater part of the rows seen (n,)."""
    return mask & (np.count_nonzero(mask[seen], axis=0) <= _AROUND * np.count_nonzero(seen))


def _briefly(mask: np.ndarray, seen: np.ndarray, grid: CylinderGrid) -> np.ndarray:
    """The part of a mask (n, m) that has tread beside it along theta, in the rows seen (n,).

    Neither a groove's lip all around nor, from slot to slot, a part of it: over a tread's pitch
    it fills most of its column.
    """
    size = 2 * round(_PITCH_MM / 2 / (grid.step_theta * grid.nominal_radius_mm)) + 1
    mode = "wrap" if grid.periodic else "constant"
    inside, every = (
        ndimage.uniform_filter1d(x.astype(np.float32), size, axis=0, mode=mode)
        for x in (mask, np.ones((len(mask), 1)))
    )
    return _across(mask, seen) & (inside < _AROUND * every)


def _lost_share(
    patches: Patches, laser: LaserCells, lost: np.ndarray, grid: CylinderGrid
) -> np.ndarray:
    """Share (count,) of the points in each patch that are lost; NaN where nothing tells.

    A point counts as much as it lies inside: a section that brushes a cut's rim runs over its lip,
    and says little of the cut. That of all patches of its like counts as one more in the middle.
    """
    label = patches.label[laser.row, laser.column]
    inside = np.minimum(way_out(patches.mask, grid), max(grid.shape))
    middle = np.ones(patches.count + 1)
    middle[1:] = ndimage.maximum(inside, patches.label, np.arange(1, patches.count + 1))
    weight = inside[laser.row, laser.column] / middle[label]
    points = np.bincount(label, weight, minlength=patches.count + 1)[1:]
    gone = np.bincount(label, weight * lost, minlength=patches.count + 1)[1:]
    kinds = kinds_of(patches)
    total, missed = points.copy(), gone.copy()
    for k in range(patches.count):
        alike = kinds.alike(k) & (points > 0)
        if alike.any():
            total[k] += 1
            missed[k] += gone[alike].sum() / points[alike].sum()
    return np.where(total > 0, missed / np.where(total > 0, total, 1), np.nan)


def _slots(
    cues: Cues,
    lines: np.ndarray,
    hidden: np.ndarray,
    cut: np.ndarray,
    laser: LaserCells,
    lost: np.ndarray,
    grid: CylinderGrid,
) -> tuple[Patches, np.ndarray]:
    """Cuts with their outlines as the camera sees them, and whether sections fell in, (count,).

    Walls are tilted, what lies between them does not fit or is dark. The `hidden` ones (n, m) are
    known from their like.
    """
    seen = (cues.poor > _MOSTLY) | (lines > 0) | hidden
    outline = (seen | (cues.tilted > _WALL_TILTED)) & cut
    mode = grid.filter_mode
    filled = ndimage.minimum_filter(ndimage.maximum_filter(outline, 3, mode=mode), 3, mode=mode)
    patches = find_patches(filled & cut, grid)
    share = _lost_share(patches, laser, lost, grid)
    met = (share > _MOSTLY) | (patches.share((lines > 0) | hidden) > _SEEN_SHARE)
    kept = (patches.share(seen) > _SEEN_SHARE) & (met | np.isnan(share))
    return patches.select(kept), met[kept]


def _completed(laser: LaserCells, start: np.ndarray, std: float, grid: CylinderGrid) -> LaserCells:
    """The points, and behind them the first surface where a section has none.

    Deep in a slot the line is lost in some columns, where the first surface holds what it took
    from the columns beside.
    """
    row, column, section = [], [], []
    for number in np.unique(laser.section):
        own = laser.section == number
        columns, first = np.unique(laser.column[own], return_index=True)
        missing = np.setdiff1d(np.arange(columns[0], columns[-1] + 1), columns)
        rows = laser.row[own][first]
        if grid.periodic:
            rows = np.unwrap(rows, period=grid.shape[0])
        row.append(np.rint(np.interp(missing, columns, rows)).astype(int) % grid.shape[0])
        column.append(missing)
        section.append(np.full(len(missing), number))
    if not row:
        return laser
    place = np.concatenate(row), np.concatenate(column)
    return LaserCells(
        np.concatenate([laser.row, place[0]]),
        np.concatenate([laser.column, place[1]]),
        np.concatenate([laser.value, start[place]]),
        np.concatenate([laser.std, np.full(len(place[0]), std)]),
        np.concatenate([laser.section, *section]),
    )


def _opening(
    inside: np.ndarray, groove: np.ndarray, lines: np.ndarray, grid: CylinderGrid
) -> np.ndarray:
    """Share (n, m) of the way from a slot's lip to its floor.

    The narrow cuts show how far from its lip a wall is seen, blurred and leaning as it is: they
    are darkest where their two walls meet. Into the wide ones light falls, and no darkness tells.
    Towards a groove a slot is open.
    """
    away = way_out(inside | groove, grid)
    middle = away[inside & (lines > _MIDDLE)]
    wall = max(1.0, float(np.median(middle))) if middle.size else 1.0
    leaning = np.clip((away - 0.5) / wall, 0, 1)
    opening = np.where((lines > 0) & (away <= wall), lines**2, leaning)
    return np.where(inside, opening, 0).astype(np.float32)


def _breaks(cues: Cues, grid: CylinderGrid) -> np.ndarray:
    """Cells (n, m) whose normals are not the tread's: in cuts and beside them.

    Thresholds with hysteresis (Canny 1986): a patch of tilted cells counts if it is surely
    tilted somewhere, or does not fit.
    """
    poor, tilted = (
        ndimage.uniform_filter(cue, 3, mode=grid.filter_mode) for cue in (cues.poor, cues.tilted)
    )
    poor = poor > _POOR_SHARE
    broken = find_patches(poor | (tilted > _TILTED), grid)
    return broken.select(broken.share(poor | (tilted > _SURELY_TILTED)) > 0).mask


def _off_tread(
    laser: LaserCells, broken: Patches, depth: np.ndarray, std: float, grid: CylinderGrid
) -> np.ndarray:
    """Points (k,) in or at a cut that are far off the same column of the sections beside it.

    Where wide slots come in quick succession most sections meet one: those that pass by all cuts
    say where the tread is. Not so in grooves around the tire, by the usual `depth` (m,) of their
    columns: there a wear bar may be all that looks like tread, and no cut is beside their floors.
    What a section finds above the whole width of one is a bar, whose ramps look like a cut's walls.
    """
    if not broken.count:
        return np.zeros(len(laser.value), bool)
    away = way_out(~broken.mask, grid)[laser.row, laser.column]
    groove = depth > 1 - _GROOVE_DEPTH
    depth = depth[laser.column]
    calm = (away > _BESIDE_CELLS) | (depth > _GROOVE_DEPTH)
    # Nothing stands out of the tread: at a lip the few that lie beside no cut may lie in a groove.
    every = np.ones(len(laser.value), bool)
    tread = np.maximum(*(_median_along(laser, some, grid) for some in (calm, every)))
    height = laser.value - tread
    usual = np.hypot(std, laser.std)
    deviation = np.where(_on_bars(laser, height > _OFF_SIGMA * usual, groove), 0, np.abs(height))
    aside = _BESIDE_CELLS + _ASIDE * deviation / grid.step_z
    beside = away <= _BESIDE_CELLS
    unsure = (laser.std > _OFF_SIGMA * std) & (depth < 1 - _GROOVE_DEPTH)
    off = (deviation > _OFF_SIGMA * usual) & (away <= aside)
    return off | (beside & (unsure | (deviation > _BESIDE_SIGMA * usual)))


def _on_bars(laser: LaserCells, risen: np.ndarray, groove: np.ndarray) -> np.ndarray:
    """Points (k,) in a groove (m,) bool that their section finds `risen` (k,) over most of it."""
    run = ndimage.label(groove)[0][laser.column]
    group = laser.section * (len(groove) + 1) + run
    share = np.bincount(group, risen) / np.maximum(np.bincount(group), 1)
    return (run > 0) & (share[group] > _MOSTLY)


def _median_along(laser: LaserCells, calm: np.ndarray, grid: CylinderGrid) -> np.ndarray:
    """Median (k,) of each point's column over the nearest calm points (k,) on either side.

    Over all where a column has hardly any calm ones.
    """
    median = np.empty(len(laser.value))
    order, bounds = _by_column(laser, grid)
    for j in range(grid.shape[1]):
        points = order[bounds[j] : bounds[j + 1]]
        if len(points):
            chosen = np.flatnonzero(calm[points])
            if len(chosen) < _LEAST_CALM:
                chosen = np.arange(len(points))
            near = _nearest(chosen, len(points), grid.periodic)
            values = np.append(laser.value[points], np.nan)
            median[points] = row_medians(values[near])[0]
    return median


def _nearest(chosen: np.ndarray, count: int, periodic: bool) -> np.ndarray:
    """Of `count` points in a row, the nearest chosen ones to each on either side, and itself.

    (count, k) indices; -1 where there is none, or it is not chosen itself.
    """
    number = np.arange(count)
    left = np.searchsorted(chosen, number, "left")[:, None]
    right = np.searchsorted(chosen, number, "right")[:, None]
    side = min(_SECTIONS, max(1, (len(chosen) - 1) // 2)) if periodic else _SECTIONS
    step = np.arange(side)
    index = np.concatenate([left - 1 - step, right + step], axis=1)
    if periodic:
        near = chosen[index % len(chosen)]
    else:
        inside = (index >= 0) & (index < len(chosen))
        near = np.where(inside, chosen[np.clip(index, 0, len(chosen) - 1)], -1)
    return np.concatenate([near, np.where(left < right, number[:, None], -1)], axis=1)


def _interpolated(
    start: np.ndarray, mask: np.ndarray, off: np.ndarray, laser: LaserCells, grid: CylinderGrid
) -> tuple[np.ndarray, np.ndarray]:
    """The surface without a mask and without what points `off` the tread made of it.

    Between the two points on the tread on either side of one of those, and across the mask, the
    surface is interpolated along theta. Returns it and the interpolated cells.
    """
    n = grid.shape[0]
    closed, bridged = start.astype(np.float64), mask.copy()
    order, bounds = _by_column(laser, grid)
    touched = np.union1d(laser.column[off], np.flatnonzero(mask.any(axis=0)))
    for j in touched:
        points = order[bounds[j] : bounds[j + 1]]
        bridged[_between(laser.row[points], off[points], n, grid.periodic), j] = True
        known = np.flatnonzero(~bridged[:, j])
        if len(known):
            period = n if grid.periodic else None
            closed[:, j] = np.interp(np.arange(n), known, start[known, j], period=period)
    return closed, bridged


def _by_column(laser: LaserCells, grid: CylinderGrid) -> tuple[np.ndarray, np.ndarray]:
    """Order of the points by column and row, and where each column starts in it."""
    order = np.lexsort((laser.row, laser.column))
    return order, np.searchsorted(laser.column[order], np.arange(grid.shape[1] + 1))


def _between(row: np.ndarray, off: np.ndarray, n: int, periodic: bool) -> np.ndarray:
    """Rows that lie between points on the tread with points `off` it among them."""
    on = row[~off]
    if not len(on):
        return np.zeros(0, int)
    before, after = (on[-1] - n, on[0] + n) if periodic else (-1, n)
    ends = np.concatenate([[before], on, [after]])
    gaps = np.unique(np.searchsorted(on, row[off]))
    return (
        np.concatenate([np.zeros(0, int), *(np.arange(ends[k] + 1, ends[k + 1]) for k in gaps)]) % n
    )
