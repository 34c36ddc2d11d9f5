"""Slots and sipes: cuts across a rib, which the sections meet too rarely to draw them.

The first surface knows a slot only where a section crosses it, as a block half the sections'
distance wide. Photometry knows its outline: inside, shadows of walls that the surface does not
have break the reflection model, and its walls tilt the normals of the pixels that see them. So
the tread is integrated with its cuts closed, and the slots are then cut into it as deep as the
sections that met them say.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from treadlight.geometry import CylinderGrid
from treadlight.integrate.gather import POOR_FIT, ViewField
from treadlight.integrate.laser import LaserCells

# A cell belongs to a slot where this share of the pixels around it does not fit the model.
_POOR_SHARE = 0.35
# Mean of (slope's deviation / its usual deviation)^2, both slopes, over nine cells: 2 on a smooth
# tread, where it exceeds this in one cell of a hundred.
_TILTED = 5.0
# Over 4 standard deviations in both slopes of nine cells: never noise. What is tilted and nowhere
# as much as this, and fits the model, is relief that photometry measures.
_SURELY_TILTED = 40.0
_MOST_TILTED = 100.0
# Steeper cells are walls of something, not tread with a deviation.
_WALL_SLOPE = 0.35
_ROUNDS = 4
_TUKEY = 3.0
_NEIGHBOURS = np.ones((3, 3), bool)
# Fewer cells are noise.
_LEAST_CELLS = 8
# A point this many standard deviations off the sections beside it is not on the tread; beside
# a cut, where the line lies partly in it, half as many tell.
_OFF_SIGMA = 4.0
_BESIDE_SIGMA = 2.0
_BESIDE_CELLS = 1.5
# A cut is drawn where the camera looks into it, aside of its floor by up to half its depth.
_ASIDE = 0.5
# Sections on either side that tell where the tread is.
_SECTIONS = 3
# Of the tread's depth: what is deeper is a groove's floor or wall.
_GROOVE_DEPTH = 0.25
# The depth of a cell is the median of this many points next to it in the same slot.
_NEAREST = 15
_LEAST_POINTS = 5
# Cuts of one kind are about equally wide: at most this many times.
_SAME_WIDTH = 2.0
_MAD_TO_STD = 1.4826


@dataclass(frozen=True)
class Patches:
    """Connected cells of the grid (n, m), numbered from 1.

    Attributes
    ----------
    label : (n, m) int32
        Number of the patch, 0 outside.
    count : int
    """

    label: np.ndarray
    count: int

    @property
    def mask(self) -> np.ndarray:
        """Cells inside, (n, m) bool."""
        return self.label > 0


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
    on_tread, in_slot : (k,) bool
        Of the laser points. What is neither lies on an edge, or is a ghost.
    """

    r: np.ndarray
    bridged: np.ndarray
    reach: np.ndarray
    slots: Patches
    on_tread: np.ndarray
    in_slot: np.ndarray


def close_cuts(
    fields: Sequence[ViewField],
    start: np.ndarray,
    std: float,
    laser: LaserCells,
    depth: Callable[[np.ndarray], np.ndarray],
    spacing: float,
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
    spacing : float
        Distance of sections, cells along theta.
    grid : CylinderGrid
    """
    poor, cut = _breaks(fields, spacing, grid)
    broken = _patches(cut, grid)
    count = len(laser.value)
    sections = _completed(laser, start, std)
    off = _off_tread(sections, broken, std, grid)
    # What the first surface says where no point is tells of slots, not where the tread is.
    kept = off | (np.arange(len(off)) < count)
    sections, off = sections.select(kept), off[kept]
    closed, _ = _interpolated(start, broken.mask, off, sections, grid)
    # Grooves that run around the tire are drawn well by the sections: they stay.
    broken = _patches(broken.mask & (depth(closed) < _GROOVE_DEPTH), grid)
    closed, bridged = _interpolated(start, broken.mask, off, sections, grid)
    slots = _patches(broken.mask & poor, grid)
    below = closed[laser.row, laser.column] - laser.value
    deep = below > _OFF_SIGMA * np.hypot(std, laser.std)
    in_slot = deep & slots.mask[laser.row, laser.column]
    reach = ndimage.maximum_filter(broken.mask, 3, mode=_mode(grid))
    return ClosedTread(closed, bridged, reach, slots, ~off[:count], in_slot)


def _completed(laser: LaserCells, start: np.ndarray, std: float) -> LaserCells:
    """The points, and behind them the first surface where a section has none.

    Deep in a slot the line is lost in some columns, where the first surface holds what it took
    from the columns beside.
    """
    row, column, section = [], [], []
    for number in np.unique(laser.section):
        own = laser.section == number
        columns, first = np.unique(laser.column[own], return_index=True)
        missing = np.setdiff1d(np.arange(columns[0], columns[-1] + 1), columns)
        found = np.interp(missing, columns, laser.row[own][first])
        row.append(np.rint(found).astype(int))
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


def _breaks(
    fields: Sequence[ViewField], spacing: float, grid: CylinderGrid
) -> tuple[np.ndarray, np.ndarray]:
    """Cells of cuts whose pixels do not fit the model, and all cells of cuts: tilted ones too.

    Thresholds with hysteresis (Canny 1986): a patch of tilted cells counts if it is surely
    tilted somewhere, or does not fit.
    """
    poor, tilted = np.zeros(grid.shape, np.float32), np.zeros(grid.shape, np.float32)
    seen = np.zeros((grid.shape[0], 1), np.float32)
    window = 2 * round(spacing / 4) + 1
    for field in fields:
        blend = field.blend[:, None]
        poor[field.rows] += blend * field.flags[POOR_FIT]
        tilted[field.rows] += blend * _tilt(field.slope, window)
        seen[field.rows] += blend
    seen = np.maximum(seen, np.finfo(np.float32).tiny)
    poor, tilted = (
        ndimage.uniform_filter(total / seen, 3, mode=_mode(grid)) for total in (poor, tilted)
    )
    poor = poor > _POOR_SHARE
    broken = _patches(poor | (tilted > _TILTED), grid)
    sure = np.zeros(broken.count + 1, bool)
    sure[broken.label[poor | (tilted > _SURELY_TILTED)]] = True
    sure[0] = False
    cut = sure[broken.label]
    return poor & cut, cut


def _tilt(slope: np.ndarray, window: int) -> np.ndarray:
    """Squared deviations of both slopes (2, k, m) from the tread around, over the usual one."""
    total = np.zeros(slope.shape[1:], np.float32)
    for component in slope:
        known = np.isfinite(component)
        # A shoulder is steep all around the tire, a cut's wall is not.
        component = component - _usual_of_columns(component)
        tread = known & (np.abs(component) < _WALL_SLOPE)
        if not tread.any():
            continue
        deviation = component - _local_mean(component, tread, window)
        usual = _MAD_TO_STD * np.median(np.abs(deviation[tread])) + 1e-12
        total += np.where(known, np.minimum((deviation / usual) ** 2, _MOST_TILTED), 0)
    return total


def _usual_of_columns(values: np.ndarray) -> np.ndarray:
    """Median of each column (m,); 0 where nothing is known."""
    usual = np.zeros(values.shape[1], np.float32)
    seen = np.isfinite(values).any(axis=0)
    usual[seen] = np.nanmedian(values[:, seen], axis=0)
    return usual


def _local_mean(values: np.ndarray, tread: np.ndarray, window: int) -> np.ndarray:
    """Robust mean (Tukey's biweight) over a square window of cells (k, m)."""
    values = np.where(tread, values, 0).astype(np.float32)
    weight, mean = tread.astype(np.float32), np.zeros_like(values)
    for _ in range(_ROUNDS):
        total = ndimage.uniform_filter(weight, window, mode="nearest")
        mean = ndimage.uniform_filter(weight * values, window, mode="nearest")
        mean /= np.maximum(total, 1e-6)
        deviation = np.abs(values - mean)
        usual = _MAD_TO_STD * np.median(deviation[tread]) + 1e-12
        weight = tread * np.maximum(1 - (deviation / (_TUKEY * usual)) ** 2, 0) ** 2
    return mean


def _off_tread(laser: LaserCells, broken: Patches, std: float, grid: CylinderGrid) -> np.ndarray:
    """Points (k,) in or at a cut that are far off the same column of the sections beside it."""
    if not broken.count:
        return np.zeros(len(laser.value), bool)
    deviation = np.abs(laser.value - _median_along(laser, grid))
    usual = np.hypot(std, laser.std)
    away = ndimage.distance_transform_edt(~broken.mask)[laser.row, laser.column]
    aside = _BESIDE_CELLS + _ASIDE * deviation / grid.step_z
    off = (deviation > _OFF_SIGMA * usual) & (away <= aside)
    return off | ((deviation > _BESIDE_SIGMA * usual) & (away <= _BESIDE_CELLS))


def _median_along(laser: LaserCells, grid: CylinderGrid) -> np.ndarray:
    """Median (k,) of each point's column over the sections around it."""
    median = np.empty(len(laser.value))
    order, bounds = _by_column(laser, grid)
    for j in range(grid.shape[1]):
        points = order[bounds[j] : bounds[j + 1]]
        if not len(points):
            continue
        side = min(_SECTIONS, len(points) - 1)
        padded = np.pad(laser.value[points], side, mode="wrap" if grid.periodic else "reflect")
        windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * side + 1)
        median[points] = np.median(windows, axis=1)
    return median


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


def slot_depths(
    slots: Patches, top: np.ndarray, laser: LaserCells
) -> tuple[np.ndarray, np.ndarray]:
    """How deep the slots lie below the closed surface, from the points in them.

    A slot that no section met is as deep as the equally wide ones in its columns.

    Parameters
    ----------
    slots : Patches
    top : (n, m) float
        Closed surface, mm.
    laser : LaserCells
        Points in slots.

    Returns
    -------
    depth, std : (n, m) float64
        mm; NaN outside of slots and where nothing tells how deep one is.
    """
    depth, std = np.full(top.shape, np.nan), np.full(top.shape, np.nan)
    number = slots.label[laser.row, laser.column]
    below = top[laser.row, laser.column] - laser.value
    met, unmet = [], []
    for cells, points in _by_slot(slots, number):
        columns = int(cells[:, 1].min()), int(cells[:, 1].max())
        width = len(cells) / (columns[1] - columns[0] + 1)
        if len(points) < _LEAST_POINTS:
            unmet.append((cells, columns, width))
            continue
        place = np.column_stack([laser.row[points], laser.column[points]])
        near = min(_NEAREST, len(points))
        _, index = cKDTree(place).query(cells, k=near)
        middle = float(np.median(below[points]))
        spread = _MAD_TO_STD * float(np.median(np.abs(below[points] - middle)))
        depth[tuple(cells.T)] = np.median(below[points][index], axis=1)
        std[tuple(cells.T)] = max(spread, float(np.median(laser.std[points])))
        met.append((columns, width, middle, spread))
    for cells, columns, width in unmet:
        alike = [(d, s) for c, w, d, s in met if _overlap(c, columns) and _alike(w, width)]
        if not alike:
            continue
        depths, spreads = np.array(alike).T
        depth[tuple(cells.T)] = np.median(depths)
        std[tuple(cells.T)] = np.hypot(np.std(depths), np.median(spreads))
    return depth, std


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


def _overlap(a: tuple[int, int], b: tuple[int, int]) -> bool:
    """Whether half of the shorter range of columns lies in the other."""
    shared = min(a[1], b[1]) - max(a[0], b[0]) + 1
    return 2 * shared > min(a[1] - a[0], b[1] - b[0]) + 1


def _alike(a: float, b: float) -> bool:
    return max(a, b) <= _SAME_WIDTH * min(a, b)


def _mode(grid: CylinderGrid) -> tuple[str, str]:
    return ("wrap" if grid.periodic else "nearest", "nearest")


def _patches(mask: np.ndarray, grid: CylinderGrid) -> Patches:
    """Connected patches that are no noise; on a whole turn also across its end."""
    label, _ = ndimage.label(mask, _NEIGHBOURS)
    if grid.periodic:
        for shift in (-1, 0, 1):
            _join(label, np.roll(label[-1], shift))
    kept = np.bincount(label.ravel()) >= _LEAST_CELLS
    kept[0] = False
    number = np.where(kept, np.cumsum(kept), 0).astype(np.int32)
    return Patches(number[label], int(kept.sum()))


def _join(label: np.ndarray, last: np.ndarray) -> None:
    """Give patches of the first row the numbers of those that they touch in the last, in place."""
    for j in np.flatnonzero((label[0] > 0) & (last > 0)):
        if label[0, j] != last[j]:
            old = label[0, j]
            last[last == old] = last[j]
            label[label == old] = last[j]


def _by_slot(slots: Patches, number: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Cells (k, 2) and indices of points of each slot."""
    rows, columns = np.nonzero(slots.label)
    label = slots.label[rows, columns]
    order = np.argsort(label, kind="stable")
    cells = np.column_stack([rows, columns])[order]
    starts = np.searchsorted(label[order], np.arange(1, slots.count + 2))
    point_order = np.argsort(number, kind="stable")
    point_starts = np.searchsorted(number[point_order], np.arange(1, slots.count + 2))
    for k in range(slots.count):
        yield (
            cells[starts[k] : starts[k + 1]],
            point_order[point_starts[k] : point_starts[k + 1]],
        )
