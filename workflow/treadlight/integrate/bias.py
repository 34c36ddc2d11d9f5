"""The smooth bias of photometric slopes, estimated against the laser sections.

Errors of the light model, of the material and interreflection tilt all normals of a region
alike: over the gap between two sections a degree adds up to a fifth of a millimetre, where noise
averages out. The sections say how large it is.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from treadlight.geometry import CylinderGrid
from treadlight.integrate.edges import CHI2_MEDIAN
from treadlight.integrate.gather import ViewField
from treadlight.integrate.laser import LaserCells
from treadlight.tread.robust import solve_robust

# Bias over a view: polynomials of the place in it up to this degree, as many as the points tell.
_MAX_DEGREE = 5
# Neighbouring points of a section share speckle and smoothing: about this many make one.
_CORRELATED_POINTS = 3
_ROUNDS = 12
# Tukey's biweight keeps 95 % efficiency at this many standard deviations.
_TUKEY = 4.685
_LEAST_PAIRS = 100
# Steeper cells are walls of something, and cells much less certain than usual stand beside them;
# so do their neighbours.
_WALL_SLOPE = 0.35
_UNSURE = 9.0
_MARGIN_CELLS = 1
_LEAST_GOOD = 0.5
# Neighbours further apart than this many times what the laser's share have nothing in common.
_REACH_SHARED = 4.0
_Z_LAGS = (0.5, 1 / 6)
# Pairs come in two usual lengths, and a few are longer, across a section that has no point because
# there is a slot: of the longer usual ones.
_LONG = 0.5
# Of a mean of squares taken from their median, against that of the mean: variance.
_MEDIAN_COST = 2.7
_SURE_SIGMA = 2.0


@dataclass(frozen=True)
class Pairs:
    """Pairs of laser points in one view, along one axis of the grid.

    Attributes
    ----------
    axis : int
        0: neighbouring sections at one z; 1: places of one section.
    start, end : (k,) int
        Indices of the points.
    middle : (row, column), (k,) int each
        The place halfway, row in the view.
    rise : (k,) float
        The laser's height difference, mm.
    excess : (k,) float
        The same less the integral of the slopes between the points, mm.
    length : (k,) float
        mm.
    noise : (k,) float
        Variance of `rise`, mm2.
    """

    axis: int
    start: np.ndarray
    end: np.ndarray
    middle: tuple[np.ndarray, np.ndarray]
    rise: np.ndarray
    excess: np.ndarray
    length: np.ndarray
    noise: np.ndarray

    def select(self, mask: np.ndarray) -> "Pairs":
        """Some of the pairs, by a mask (k,) or their indices."""
        middle = self.middle[0][mask], self.middle[1][mask]
        rest = (x[mask] for x in (self.rise, self.excess, self.length, self.noise))
        return Pairs(self.axis, self.start[mask], self.end[mask], middle, *rest)

    def chained(self) -> tuple[np.ndarray, np.ndarray]:
        """Indices of pairs and of those that go on where they end."""
        order = np.argsort(self.start, kind="stable")
        place = np.searchsorted(self.start[order], self.end)
        beyond = order[np.minimum(place, len(order) - 1)]
        first = np.flatnonzero(self.start[beyond] == self.end) if len(order) else order
        return first, beyond[first]


def laser_pairs(
    field: ViewField, laser: LaserCells, steps: np.ndarray, spacing: float, grid: CylinderGrid
) -> list[Pairs]:
    """Laser points that the slopes of a view connect, along theta and along z.

    Parameters
    ----------
    field : ViewField
        k rows.
    laser : LaserCells
    steps : (n, m) bool
        Where the first surface has a step: no path may cross it.
    spacing : float
        Distance of sections, cells along theta.
    grid : CylinderGrid
    """
    n = grid.shape[0]
    local = (laser.row - field.rows[0]) % n if grid.periodic else laser.row - field.rows[0]
    inside = np.flatnonzero((local >= 0) & (local < len(field.rows)))
    own, row = laser.select(inside), local[inside]
    paths = _Paths(field, steps[field.rows], grid)
    found = []
    for axis, (a, b) in enumerate([_theta_pairs(row, own, spacing), _z_pairs(row, own, spacing)]):
        excess, length = paths.excess(a, b, row, own, axis)
        known = np.isfinite(excess)
        a, b = a[known], b[known]
        middle = (row[a] + row[b]) // 2, (own.column[a] + own.column[b]) // 2
        found.append(
            Pairs(
                axis,
                inside[a],
                inside[b],
                middle,
                own.value[b] - own.value[a],
                excess[known],
                length[known],
                own.std[a] ** 2 + own.std[b] ** 2,
            )
        )
    return found


def remove_bias(
    field: ViewField,
    laser: LaserCells,
    depth: np.ndarray,
    steps: np.ndarray,
    spacing: float,
    grid: CylinderGrid,
) -> ViewField:
    """The view's slopes less their smooth bias.

    Slopes stay as they are where too few laser points tell of them.

    Pairs of laser points, neighbouring sections at one z for dr / (r dtheta), places of one
    section half as far apart for dr / dz, are compared with the integral of the slopes between
    them. The mean excess slope of a pair is taken at its middle, and a smooth function is
    fitted robustly: paths across a step that the first
    surface does not know stand out and do not count.

    Parameters
    ----------
    field : ViewField
        k rows.
    laser : LaserCells
    depth : (n, m) float
        How deep the first surface lies below the outline, 0 on tops to 1 on groove floors.
    steps : (n, m) bool
        Where the first surface has a step: no path may cross it.
    spacing : float
        Distance of sections, cells along theta.
    grid : CylinderGrid
    """
    slope = field.slope.copy()
    rows, columns = np.arange(len(field.rows))[:, None], np.arange(grid.shape[1])[None]
    for pairs in laser_pairs(field, laser, steps, spacing, grid):
        if len(pairs.excess) < _LEAST_PAIRS:
            continue
        fit = _best_fit(
            pairs.middle, field, depth, pairs.excess / pairs.length, pairs.length, pairs.axis
        )
        slope[pairs.axis] += _evaluate(fit[0], rows, columns, *fit[1:], field, depth)
    return replace(field, slope=slope)


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
    return [replace(field, variance=field.variance + _of_slopes(more, field)) for field in fields]


def _of_slopes(variance: np.ndarray, field: ViewField) -> np.ndarray:
    """Variance (2, k, m) that errors of level slopes have on the field's own, tilted as far.

    As in `gather.view_field`: a wall's height is much less certain than a tread's.
    """
    squared = np.square(field.slope)
    return variance[:, None, None] * np.square(1 + squared) * (1 + squared.sum(axis=0))


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
    laser's own errors share, over the variance that the slopes along a path claim.

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
        if len(pairs.excess) < _LEAST_PAIRS:
            continue
        noise = _laser_variance([pairs], shared_rows)
        covariance = _covariances(pairs, laser, reach, grid)
        together += len(pairs.excess) * (
            covariance[0] + 2 * covariance[1:].sum() - noise * shared_rows
        )
        alone += len(pairs.excess) * (covariance[0] - noise)
    return float(max(1.0, together / alone)) if alone > 0 else 1.0


def _covariances(pairs: Pairs, laser: LaserCells, reach: int, grid: CylinderGrid) -> np.ndarray:
    """Of what pairs along theta miss, with those up to `reach` columns on, (reach + 1,) mm2."""
    usual = np.abs(pairs.excess) < _TUKEY * np.sqrt(_robust_square(pairs.excess))
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
    if len(two) < _LEAST_PAIRS:
        return claimed
    one = _robust_square(np.concatenate([p.excess for p in pairs]))
    shown = max(2 * one - _robust_square(two), 0.0)
    scatter = 2 * one * np.sqrt(2 * _MEDIAN_COST * shared_rows / len(two))
    return shown if shown + _SURE_SIGMA * scatter < claimed else claimed


def _robust_square(values: np.ndarray) -> float:
    """Mean square, robust against unknown steps."""
    return float(np.median(values**2)) / CHI2_MEDIAN


def _best_fit(
    middle: tuple[np.ndarray, np.ndarray],
    field: ViewField,
    depth: np.ndarray,
    values: np.ndarray,
    length: np.ndarray,
    axis: int,
) -> tuple[np.ndarray, int, bool]:
    """Coefficients, degree and whether grooves have their own plane, by Schwarz's criterion.

    More terms than the points can tell would only carry the laser's noise into the slopes. Across
    a groove (axis 1) paths are too short to tell its own tilt from that of its walls.
    """
    best: tuple[float, np.ndarray, int, bool] | None = None
    count = len(values) / _CORRELATED_POINTS
    for degree in range(_MAX_DEGREE + 1):
        for grooves in (False, True) if axis == 0 else (False,):
            basis = _basis(*middle, degree, grooves, field, depth).T
            if basis.shape[1] > count / 4:
                continue
            coefficients, spread = _robust_fit(basis, values, length)
            score = 2 * count * np.log(spread) + basis.shape[1] * np.log(count)
            if best is None or score < best[0]:
                best = score, coefficients, degree, grooves
    assert best is not None
    return best[1:]


def _evaluate(
    coefficients: np.ndarray,
    row: np.ndarray,
    column: np.ndarray,
    degree: int,
    grooves: bool,
    field: ViewField,
    depth: np.ndarray,
) -> np.ndarray:
    basis = _basis(row, column, degree, grooves, field, depth)
    return np.tensordot(coefficients.astype(np.float32), basis, axes=1)


def _basis(
    row: np.ndarray,
    column: np.ndarray,
    degree: int,
    grooves: bool,
    field: ViewField,
    depth: np.ndarray,
) -> np.ndarray:
    """The smooth functions (f, ...) at cells of the view: Legendre polynomials of the place."""
    x = 2 * row / max(len(field.rows) - 1, 1) - 1 + 0.0 * column
    y = 2 * column / max(depth.shape[1] - 1, 1) - 1 + 0.0 * row
    along, across = (_legendre(v.astype(np.float32), max(degree, 1)) for v in (x, y))
    terms = [along[a] * across[b] for a in range(degree + 1) for b in range(degree + 1 - a)]
    if grooves:
        sunk = depth[field.rows[row], column]
        terms += [sunk, sunk * along[1], sunk * across[1]]
    return np.stack(terms)


def _legendre(x: np.ndarray, degree: int) -> list[np.ndarray]:
    """Legendre polynomials of orders 0 to `degree` (at least 1), by their recurrence."""
    values = [np.ones_like(x), x]
    for n in range(1, degree):
        values.append(((2 * n + 1) * x * values[n] - n * values[n - 1]) / np.float32(n + 1))
    return values


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
    if len(length) < _LEAST_PAIRS:
        return None
    usual = [p.select(p.length > _LONG * np.percentile(length, 75)) for p in pairs]
    two = _two_gaps(usual)
    if len(two) < _LEAST_PAIRS:
        return None
    missed = _robust_square(two) - _laser_variance(usual, shared_rows)
    gap = float(np.median(np.concatenate([p.length for p in usual])))
    return missed / (2 * gap * side)


class _Paths:
    """Mean slopes along rows and columns, over the cells that can be trusted.

    Sipes and slots that the first surface does not know are bridged: the tread stands equally
    high on both sides.
    """

    def __init__(self, field: ViewField, steps: np.ndarray, grid: CylinderGrid):
        slope = field.slope
        self.spacing = (grid.step_theta * grid.nominal_radius_mm, grid.step_z)
        self._steps = [np.cumsum(steps, axis=k, dtype=np.int32) for k in range(2)]
        with np.errstate(invalid="ignore"):
            good = (np.abs(slope) < _WALL_SLOPE).all(axis=0)
            usual = np.nanmedian(field.variance, axis=(1, 2)) if good.any() else np.ones(2)
            good &= (field.variance < _UNSURE * usual[:, None, None]).all(axis=0)
        good = ndimage.binary_erosion(good, iterations=_MARGIN_CELLS)
        self._good = [np.cumsum(good, axis=k, dtype=np.int32) for k in range(2)]
        self._sums = [
            np.cumsum(np.where(good, slope[k].astype(np.float64), 0.0), axis=k) for k in range(2)
        ]

    def excess(
        self, a: np.ndarray, b: np.ndarray, row: np.ndarray, laser: LaserCells, axis: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Laser's height difference of pairs less the slopes' along z, then theta; lengths, mm.

        NaN where the path crosses a step or finds too few slopes.
        """
        corner = row[a], laser.column[b]
        total = self._between(0, corner, (row[b], laser.column[b]))
        total += self._between(1, (row[a], laser.column[a]), corner)
        cells = (row[b] - row[a]) if axis == 0 else (laser.column[b] - laser.column[a])
        return laser.value[b] - laser.value[a] - total, cells * self.spacing[axis]

    def _between(self, k: int, start: tuple, end: tuple) -> np.ndarray:
        cells = end[k] - start[k]
        count = self._good[k][end] - self._good[k][start]
        total = self._sums[k][end] - self._sums[k][start]
        with np.errstate(divide="ignore", invalid="ignore"):
            rise = np.where(cells == 0, 0.0, total / count * cells * self.spacing[k])
        enough = (np.abs(count) >= _LEAST_GOOD * np.abs(cells)) & (
            self._steps[k][start] == self._steps[k][end]
        )
        return np.where(enough, rise, np.nan)


def _theta_pairs(
    row: np.ndarray, laser: LaserCells, spacing: float
) -> tuple[np.ndarray, np.ndarray]:
    """Points of neighbouring sections in one column."""
    order = np.lexsort((row, laser.column))
    a, b = order[:-1], order[1:]
    gap = row[b] - row[a]
    near = (laser.column[a] == laser.column[b]) & (gap > 0.25 * spacing) & (gap < 3 * spacing)
    return a[near], b[near]


def _z_pairs(row: np.ndarray, laser: LaserCells, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Points of one section a half and a sixth (for grooves) of the sections' distance apart."""
    order = np.lexsort((laser.column, laser.section))
    starts, ends = [order[:0]], [order[:0]]
    for lag in sorted({max(2, round(share * spacing)) for share in _Z_LAGS}):
        a, b = order[:-lag], order[lag:]
        gap = laser.column[b] - laser.column[a]
        near = (laser.section[a] == laser.section[b]) & (gap > 0.5 * lag) & (gap < 2 * lag)
        starts.append(a[near])
        ends.append(b[near])
    return np.concatenate(starts), np.concatenate(ends)


def _robust_fit(
    basis: np.ndarray, values: np.ndarray, lengths: np.ndarray
) -> tuple[np.ndarray, float]:
    """Tukey's biweight from a start of least absolute values; noise goes with 1 / length.

    Each coefficient has a prior about zero as wide as the values themselves: where outliers leave
    a corner of the view without a point, the polynomial stays at what its neighbours say.

    Returns the coefficients and the residuals' robust standard deviation.
    """
    scale = lengths / np.median(lengths)
    design, target = basis.astype(np.float64) * scale[:, None], values * scale
    usual = 1.4826 * float(np.median(np.abs(target))) + 1e-12
    weight, spread = np.ones(len(target)), usual
    for k in range(_ROUNDS):
        lhs = (design * weight[:, None]).T @ design
        lhs += (spread / usual) ** 2 * np.eye(len(lhs))
        coefficients = np.linalg.solve(lhs, (design * weight[:, None]).T @ target)
        miss = np.abs(target - design @ coefficients)
        spread = 1.4826 * float(np.median(miss)) + 1e-12
        if k < _ROUNDS // 2:
            weight = spread / np.maximum(miss, 0.1 * spread)
        else:
            weight = np.maximum(1 - (miss / (_TUKEY * spread)) ** 2, 0) ** 2
    return coefficients, spread


def lean_of_ribs(
    field: ViewField,
    laser: LaserCells,
    r: np.ndarray,
    rib_of_column: np.ndarray,
    shared_rows: float,
    grid: CylinderGrid,
) -> np.ndarray:
    """Slope along z, (m,), by which each rib of a view still leans against its sections.

    Errors of slopes are skewed, so that their mean over paths is not what a robust solve makes of
    them. What is left is taken from the heights themselves: the line along z through the laser's
    differences to them on each rib, shrunk by its own uncertainty (James and Stein 1961).

    Parameters
    ----------
    field : ViewField
    laser : LaserCells
    r : (n, m) float
        Solved heights, mm.
    rib_of_column : (m,) int
        0 in grooves.
    shared_rows : float
        How many neighbouring points share their errors.
    grid : CylinderGrid
    """
    n = grid.shape[0]
    local = (laser.row - field.rows[0]) % n if grid.periodic else laser.row - field.rows[0]
    miss = laser.value - r[laser.row, laser.column]
    own = (local >= 0) & (local < len(field.rows)) & np.isfinite(miss)
    lean = np.zeros(grid.shape[1])
    for rib in range(1, rib_of_column.max(initial=0) + 1):
        here = own & (rib_of_column[laser.column] == rib)
        if np.count_nonzero(here) >= _LEAST_PAIRS:
            slope, variance = _robust_line(grid.z[laser.column[here]], miss[here], laser.std[here])
            shrunk = max(0.0, 1 - shared_rows * variance / slope**2)
            lean[rib_of_column == rib] = shrunk * slope
    return lean


def _robust_line(x: np.ndarray, y: np.ndarray, std: np.ndarray) -> tuple[float, float]:
    """Slope of a robust line through y(x), (k,), and its variance."""
    weight = 1 / std**2
    weight /= weight.mean()
    x = x - np.average(x, weights=weight)
    basis = np.column_stack([np.ones_like(x), x])
    (_, slope), scale = solve_robust(basis, y, np.full(2, np.inf), weight)
    return float(slope), float(scale**2 / (weight * x**2).sum())
