"""The smooth bias of photometric slopes, estimated against the laser sections.

Errors of the light model, of the material and interreflection tilt all normals of a region
alike: over the gap between two sections a degree adds up to a fifth of a millimetre, where noise
averages out. The sections say how large it is.
"""

from dataclasses import replace

import numpy as np

from treadlight.geometry import CylinderGrid
from treadlight.integrate.gather import ViewField
from treadlight.integrate.laser import LaserCells
from treadlight.integrate.pairs import LEAST_PAIRS, laser_pairs
from treadlight.tread.robust import TUKEY, solve_robust

# Bias over a view: polynomials of the place in it up to this degree, as many as the points tell.
_MAX_DEGREE = 5
# Neighbouring points of a section share speckle and smoothing: about this many make one.
_CORRELATED_POINTS = 3
_ROUNDS = 12


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
        if len(pairs.excess) < LEAST_PAIRS:
            continue
        fit = _best_fit(
            pairs.middle, field, depth, pairs.excess / pairs.length, pairs.length, pairs.axis
        )
        slope[pairs.axis] += _evaluate(fit[0], rows, columns, *fit[1:], field, depth)
    return replace(field, slope=slope)


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
        if np.count_nonzero(here) >= LEAST_PAIRS:
            slope, variance = _robust_line(grid.z[laser.column[here]], miss[here], laser.std[here])
            # By as much as the slope is more than its noise.
            told = max(0.0, slope**2 - shared_rows * variance)
            lean[rib_of_column == rib] = told / slope if told else 0.0
    return lean


def _robust_line(x: np.ndarray, y: np.ndarray, std: np.ndarray) -> tuple[float, float]:
    """Slope of a robust line through y(x), (k,), and its variance."""
    weight = 1 / std**2
    weight /= weight.mean()
    x = x - np.average(x, weights=weight)
    basis = np.column_stack([np.ones_like(x), x])
    (_, slope), scale = solve_robust(basis, y, np.full(2, np.inf), weight)
    return float(slope), float(scale**2 / (weight * x**2).sum())


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
            weight = np.maximum(1 - (miss / (TUKEY * spread)) ** 2, 0) ** 2
    return coefficients, spread
