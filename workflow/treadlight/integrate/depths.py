"""How deep the slots are: what the sections that reached their floors say."""

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from treadlight.geometry import CylinderGrid
from treadlight.integrate.cues import MAD_TO_STD
from treadlight.integrate.laser import LaserCells
from treadlight.integrate.patches import Kinds, Patches, kinds_of, way_out

# The depth of a cell is the median of this many points next to it in the same slot.
_NEAREST = 60
_LEAST_POINTS = 5
# The floors of a kind of slot are reached where the greater part of the points in it lie deep, by
# two standard deviations of what lies deep and not with equal odds.
_ODDS = 0.5
_SURELY = 2.0


def slot_depths(
    slots: Patches,
    met: np.ndarray,
    top: np.ndarray,
    laser: LaserCells,
    deep: np.ndarray,
    shared_rows: float,
    tread_depth: float,
    grid: CylinderGrid,
) -> tuple[np.ndarray, np.ndarray]:
    """How deep the slots' floors lie below the closed surface, from the points on them.

    A slot whose floor no section reached is as deep as the equally wide ones in its columns. If
    there is none, but sections were lost in it, it is deeper than wide, or light would fall
    in, and no deeper than the grooves: anything between. In a cut narrower than the laser's line
    most points stay on the lips, and the few deep ones hang between lip and floor: they reached
    nothing.

    Parameters
    ----------
    slots : Patches
    met : (slots.count,) bool
        Slots that sections fell into.
    top : (n, m) float
        Closed surface, mm.
    laser : LaserCells
    deep : (k,) bool
        Points in slots and below the tread.
    shared_rows : float
        How many neighbouring lines share their errors: nearer to a wall than half of that a
        point is between the floor and the lip.
    tread_depth : float
        Of the grooves, mm; NaN where there is none.
    grid : CylinderGrid

    Returns
    -------
    depth, std : (n, m) float64
        mm; NaN outside of slots and where nothing tells how deep one is.
    """
    depth, std = np.full(top.shape, np.nan), np.full(top.shape, np.nan)
    inside = way_out(slots.mask, grid)
    widest = 2 * ndimage.maximum(inside, slots.label, np.arange(1, slots.count + 1))
    kinds = kinds_of(slots)
    away = inside[laser.row, laser.column]
    reached = _reached(slots, kinds, laser, deep, away > shared_rows / 2)
    deep = deep & (away > shared_rows / 2)
    laser, away = laser.select(deep), away[deep]
    label = slots.label[laser.row, laser.column]
    order = np.argsort(label, kind="stable")
    starts = np.searchsorted(label[order], np.arange(1, slots.count + 2))
    below = top[laser.row, laser.column] - laser.value
    usual = np.full((slots.count, 2), np.nan)
    cells = list(slots.cells())
    for k, own in enumerate(cells):
        points = order[starts[k] : starts[k + 1]]
        if len(points) < _LEAST_POINTS or not reached[k]:
            continue
        # The walls pull at the line as far as its tails reach: the inner half knows best.
        points = points[away[points] >= np.median(away[points])]
        place = np.column_stack([laser.row[points], laser.column[points]])
        _, index = cKDTree(place).query(own, k=min(_NEAREST, len(points)))
        middle = float(np.median(below[points]))
        spread = MAD_TO_STD * float(np.median(np.abs(below[points] - middle)))
        depth[tuple(own.T)] = np.median(below[points][index], axis=1)
        spread = max(spread, float(np.median(laser.std[points])))
        std[tuple(own.T)] = spread
        usual[k] = middle, spread
    for k in map(int, np.flatnonzero(np.isnan(usual[:, 0]))):
        alike = kinds.alike(k) & np.isfinite(usual[:, 0])
        if alike.any():
            middle = np.median(usual[alike, 0])
            spread = np.hypot(np.std(usual[alike, 0]), np.median(usual[alike, 1]))
        elif met[k]:
            middle, spread = _between(widest[k] * grid.step_z, tread_depth)
        else:
            continue
        depth[tuple(cells[k].T)], std[tuple(cells[k].T)] = middle, spread
    return depth, std


def _reached(
    slots: Patches, kinds: Kinds, laser: LaserCells, deep: np.ndarray, clear: np.ndarray
) -> np.ndarray:
    """Slots (count,) of a kind in which surely the greater part of the points is deep (k,).

    Of those that are clear of the walls (k,), where there are enough.
    """
    label = slots.label[laser.row, laser.column]
    points, found = (
        np.array([np.bincount(label[m], minlength=slots.count + 1)[1:] for m in (clear & own, own)])
        for own in (np.ones(len(deep), bool), deep)
    )
    reached = np.zeros(slots.count, bool)
    for k in range(slots.count):
        kind = kinds.alike(k)
        inner, every = points[:, kind].sum(axis=1)
        which, count = (0, inner) if inner >= _LEAST_POINTS else (1, every)
        margin = _SURELY * np.sqrt(_ODDS * (1 - _ODDS) * count)
        reached[k] = found[which, kind].sum() > _ODDS * count + margin
    return reached


def _between(least: float, most: float) -> tuple[float, float]:
    """Mean and standard deviation of anything between two depths, or up to the second."""
    least = least if least < most else 0.0
    return (least + most) / 2, (most - least) / np.sqrt(12)
