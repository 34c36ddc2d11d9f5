"""How uncertain integrals of slopes are, and how far their errors go together.

What is left of the slopes' bias is common to many cells, and no pixel's covariance knows of it. The
laser's sections do.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from treadlight.geometry import CylinderGrid
from treadlight.integrate.gather import ViewField, slope_variance
from treadlight.integrate.laser import LaserCells
from treadlight.integrate.pairs import LEAST_PAIRS, Pairs, laser_pairs
from treadlight.tread.robust import MEDIAN_COST, TUKEY, robust_square

# Neighbours further apart than this many times what the laser's share have nothing in common.
_REACH_SHARED = 4.0
# Pairs come in two usual lengths, and a few are longer, across a section that has no point because
# there is a slot: of the longer usual ones.
_LONG = 0.5
_SURE_SIGMA = 2.0


def with_path_variance(
    fields: Sequence[ViewField],
    laser: LaserCells,
    steps: np.ndarray,
    shared_rows: float,
    spacing: float,
    grid: CylinderGrid,
) -> list[ViewField]:
    """The views with the variance that their slopes' integrals ask for, where that is more.

    What is left of the bias is correlated over many cells. As independent noise of the cells it
    must have the same variance over the distance of two sections: that is what decides between
    slopes and laser. One for all views: of a single one's pairs the laser's noise, several times
    larger, leaves too little to tell.

    Parameters
    ----------
    fields, laser, steps, spacing, grid
        See `laser_pairs`.
    shared_rows : float
        How many neighbouring points of a section share their errors.
    """
    if not fields:
        return []
    sides = (grid.step_theta * grid.nominal_radius_mm, grid.step_z)
    pairs = [laser_pairs(field, laser, steps, spacing, grid) for field in fields]
    more = np.zeros(2, np.float32)
    for axis, side in enumerate(sides):
        own = [each[axis] for each in pairs]
        said = np.concatenate(
            [f.variance[axis][p.middle] for f, p in zip(fields, own, strict=True)]
        )
        variance = _path_variance(own, shared_rows, side)
        if variance is not None:
            more[axis] = max(0.0, variance - float(np.nanmedian(said)))
    level = more[:, None, None]
    return [replace(f, variance=f.variance + slope_variance(f.slope, level)) for f in fields]


def shared_columns(
    fields: Sequence[ViewField],
    laser: LaserCells,
    steps: np.ndarray,
    shared_rows: float,
    spacing: float,
    grid: CylinderGrid,
) -> float:
    """How many neighbouring paths along theta share their errors, at least 1.

    Noise that the model of the light leaves, texture and what a pixel smooths lie in patches:
    the sum of the covariances of what neighbouring paths miss of the laser's rise, less what the
    laser's own errors share, over the paths' own variance.

    Parameters
    ----------
    fields, laser, steps, spacing, grid
        See `laser_pairs`.
    shared_rows : float
        How many neighbouring points of a section share their errors.
    """
    reach = math.ceil(_REACH_SHARED * shared_rows)
    together, alone = 0.0, 0.0
    for field in fields:
        pairs = laser_pairs(field, laser, steps, spacing, grid)[0]
        if len(pairs.excess) < LEAST_PAIRS:
            continue
        noise = _laser_variance([pairs], shared_rows)
        covariance = _covariances(pairs, laser, reach, grid)
        together += len(pairs.excess) * (
            covariance[0] + 2 * covariance[1:].sum() - noise * shared_rows
        )
        alone += len(pairs.excess) * (covariance[0] - noise)
    return float(max(1.0, together / alone)) if alone > 0 else 1.0


def _path_variance(pairs: Sequence[Pairs], shared_rows: float, side: float) -> float | None:
    """Variance of a cell's slope under which the slopes' integrals miss the laser as they do.

    Over two gaps, where the laser's errors count half and no longer go together. None where too
    few pairs tell.

    Parameters
    ----------
    pairs : sequence of Pairs
        Of all views, along one axis.
    shared_rows : float
        How many neighbouring points of a section share their errors.
    side : float
        Of the cells along it, mm.
    """
    length = np.concatenate([p.length for p in pairs])
    if len(length) < LEAST_PAIRS:
        return None
    usual = [p.select(p.length > _LONG * np.percentile(length, 75)) for p in pairs]
    two = _two_gaps(usual)
    if len(two) < LEAST_PAIRS:
        return None
    missed = robust_square(two) - _laser_variance(usual, shared_rows)
    gap = float(np.median(np.concatenate([p.length for p in usual])))
    return missed / (2 * gap * side)


def _covariances(pairs: Pairs, laser: LaserCells, reach: int, grid: CylinderGrid) -> np.ndarray:
    """Of what pairs along theta miss, with those up to `reach` columns on, (reach + 1,) mm2."""
    usual = np.abs(pairs.excess) < TUKEY * np.sqrt(robust_square(pairs.excess))
    rows, row = np.unique(laser.section[pairs.start], return_inverse=True)
    m = grid.shape[1]
    miss = np.full((len(rows), m + reach), np.nan)
    miss[row[usual], pairs.middle[1][usual]] = pairs.excess[usual]
    return np.array([np.nanmean(miss[:, :m] * miss[:, d : m + d]) for d in range(reach + 1)])


def _two_gaps(pairs: Sequence[Pairs]) -> np.ndarray:
    """What pairs in a row (of some views) miss together, mm."""
    return np.concatenate([p.excess[a] + p.excess[b] for p in pairs for a, b in [p.chained()]])


def _laser_variance(pairs: Sequence[Pairs], shared_rows: float) -> float:
    """Variance of what pairs (of some views) miss by the laser's errors, mm2.

    As the points claim, unless pairs in a row prove that it is less: over two gaps a path misses
    the laser by its own errors twice, by the laser's, of the points at its ends, once.
    """
    claimed = float(np.median(np.concatenate([p.noise for p in pairs])))
    two = _two_gaps(pairs)
    if len(two) < LEAST_PAIRS:
        return claimed
    one = robust_square(np.concatenate([p.excess for p in pairs]))
    shown = max(2 * one - robust_square(two), 0.0)
    scatter = 2 * one * np.sqrt(2 * MEDIAN_COST * shared_rows / len(two))
    return shown if shown + _SURE_SIGMA * scatter < claimed else claimed
