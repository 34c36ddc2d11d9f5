"""Standard uncertainty of the heights, and its proof on sections that were held out."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.special import digamma

from treadlight.geometry import CylinderGrid
from treadlight.integrate.laser import LaserCells
from treadlight.integrate.multigrid import Solver
from treadlight.integrate.solve import Problem, Solution, perturbation, weighted_system

_SAMPLES = 8
# A wall two cells away does not lend its uncertainty to a groove's floor.
_SMOOTHING_CELLS = 1.0
_TOLERANCE_MM = 1e-3
# Samples are known to a quarter by their number; what these leave undone is below 3 % of `r_std`
# in 98 of 100 cells (of the sample archive, beside 30 iterations).
_MAX_ITERATIONS = 3
_SEED = 20170617
# A nanometre: no cell is better known.
_LEAST_VARIANCE = 1e-12
# Held-out points further off than this many of their spreads are outliers.
_OUTLIER = 5.0
_MOST_FACTOR = 10.0
# What one in forty samples shows by chance proves nothing.
_SURE_SIGMA = 2.0
_LEAST_POINTS = 30
_ONE_SIGMA = 0.6827


def sampled_std(
    problem: Problem, solution: Solution, shared: float, grid: CylinderGrid
) -> np.ndarray:
    """Standard deviation of the heights under the noise of all constraints, (n, m) mm.

    The diagonal of the inverse matrix, from heights that answer to random right-hand sides with
    the constraints' covariance (a fixed seed), averaged over a few cells to steady it.

    Parameters
    ----------
    problem : Problem
    solution : Solution
    shared : float
        How many neighbouring edges share their noise; see `path_errors.shared_columns`.
    grid : CylinderGrid
    """
    rng = np.random.default_rng(_SEED)
    system, _ = weighted_system(problem, solution.share, solution.laser_share)
    solver = Solver(system)
    total = np.zeros(grid.shape)
    for _ in range(_SAMPLES):
        noise = perturbation(system, shared, rng)
        total += solver.solve(noise, _TOLERANCE_MM, _MAX_ITERATIONS)[0] ** 2
    mode = grid.filter_mode
    # Logarithms are averaged, so that a wall's uncertainty does not spread over what it flanks;
    # their mean is off by the digamma function of a chi-squared's half degrees of freedom.
    bias = digamma(_SAMPLES / 2) - np.log(_SAMPLES / 2)
    logarithm = np.log(np.maximum(total / _SAMPLES, _LEAST_VARIANCE))
    return np.exp(0.5 * (ndimage.gaussian_filter(logarithm, _SMOOTHING_CELLS, mode=mode) - bias))


@dataclass(frozen=True)
class HeldOut:
    """Held-out laser points against the heights (quality.json, `held_out_laser_mm`), mm."""

    n: int
    bias: float
    rms: float
    laser_std: float
    shape_rms: float


def compare_held_out(r: np.ndarray, held: LaserCells) -> HeldOut:
    """Laser minus heights at the held-out points, outliers left out; NaN where there are none."""
    miss = held.value - r[held.row, held.column]
    std, kept = held.std, _usual(miss, held.std)
    if not kept.any():
        return HeldOut(0, np.nan, np.nan, np.nan, np.nan)
    rms = float(np.sqrt(np.mean(miss[kept] ** 2)))
    laser = float(np.sqrt(np.mean(std[kept] ** 2)))
    shape = float(np.sqrt(max(rms**2 - laser**2, 0.0)))
    return HeldOut(int(kept.sum()), float(np.mean(miss[kept])), rms, laser, shape)


def _usual(miss: np.ndarray, std: np.ndarray) -> np.ndarray:
    """Points whose difference is none of a step, a slot or an outlier, (k,) bool."""
    known = np.isfinite(miss)
    if not known.any():
        return known
    spread = max(1.4826 * float(np.median(np.abs(miss[known]))), float(np.median(std[known])))
    return known & (np.abs(miss) < _OUTLIER * spread)


def coverage_factor(
    r: np.ndarray, std: Callable[[], np.ndarray], held: LaserCells, shared_rows: float
) -> float:
    """Factor on `r_std` that the held-out points prove, at least 1.

    Under it 68 % of them lie within one sigma of the difference, heights and laser together, or
    as few as chance alone may leave there: a point's own noise is several times that of the
    heights, and a few points too many outside would ask for half as much again. Where a section
    is held out, its neighbours are twice as far apart. 1 where too few points are held out.

    Parameters
    ----------
    r : (n, m) float
        mm.
    std : function without arguments
        `r_std`, (n, m) mm; not asked for where the points' own noise explains it all.
    held : LaserCells
    shared_rows : float
        How many neighbouring points share their errors.
    """
    held = held.select(_usual(held.value - r[held.row, held.column], held.std))
    count = len(held.value)
    if count < _LEAST_POINTS:
        return 1.0
    miss = np.abs(held.value - r[held.row, held.column])
    chance = np.sqrt(_ONE_SIGMA * (1 - _ONE_SIGMA) * shared_rows / count)
    proven = _ONE_SIGMA - _SURE_SIGMA * chance
    if np.mean(miss < held.std) >= proven:
        return 1.0
    r_std = std()[held.row, held.column]
    low, high = 1.0, _MOST_FACTOR
    for _ in range(40):
        middle = np.sqrt(low * high)
        inside = np.mean(miss < np.hypot(middle * r_std, held.std))
        low, high = (middle, high) if inside < proven else (low, middle)
    return float(np.sqrt(low * high))
