"""Other ways to integrate slopes, on the same lattice and with the same linear solver."""

from dataclasses import replace

import numpy as np

from treadlight.integrate.edges import Edges
from treadlight.integrate.laser import LaserCells
from treadlight.integrate.solve import Problem, linear_solve

# The dissertation's: slopes that err by 0.05, laser points by 0.2 mm, everywhere alike.
SLOPE_STD = 0.05
LASER_STD_MM = 0.2
# Of bilateral integration, as published (Cao et al., ECCV 2022).
_SHARPNESS = 2.0
_ROUNDS = 15
_ITERATIONS = 60
# Slope to a neighbour that is none.
_APART = 1e3
# Holds a lattice without any point in place, and moves nothing that slopes or points hold.
_LEAST_WEIGHT = 1e-9


def edges_of(slope: np.ndarray, sides_mm: tuple[float, float], slope_std: float) -> Edges:
    """Edges with uniform weights, from slopes (2, n, m); none where a side has no slope."""
    step, weight = np.zeros(slope.shape, np.float32), np.zeros(slope.shape, np.float32)
    for axis, side in enumerate(sides_mm):
        one, other = (_cut(slope[axis], axis, part) for part in (0, 1))
        mean = 0.5 * side * (one + other)
        known = np.isfinite(mean)
        _cut(step[axis], axis, 0)[known] = mean[known]
        _cut(weight[axis], axis, 0)[known] = 1 / (slope_std * side) ** 2
    return Edges(step, weight, weight > 0, np.zeros_like(weight))


def poisson(edges: Edges, laser: LaserCells) -> np.ndarray:
    """Eq. 3.25: slopes alone; the constant that they leave free is the laser's median."""
    nothing = laser.select(np.zeros(len(laser.value), bool))
    r = _solved(edges, nothing, np.zeros(edges.step.shape[1:]))
    miss = laser.value - r[laser.row, laser.column]
    return r + np.nanmedian(miss[np.isfinite(miss)])


def constrained(edges: Edges, laser: LaserCells) -> np.ndarray:
    """Eqs. 4.5 to 4.10 on the cylinder: uniform weights, and the laser's points."""
    laser = replace(laser, std=np.full(len(laser.value), LASER_STD_MM))
    return _solved(edges, laser, np.full(edges.step.shape[1:], np.median(laser.value)))


def bilateral(edges: Edges, laser: LaserCells, slope: np.ndarray, sides_mm: tuple) -> np.ndarray:
    """One-sided differences, weighted by which side continues the surface (Cao et al. 2022).

    Every cell counts its slope towards either neighbour; the weights follow from the last
    heights, from those of `constrained` on.
    """
    laser = replace(laser, std=np.full(len(laser.value), LASER_STD_MM))
    r = constrained(edges, laser)
    for _ in range(_ROUNDS):
        step, weight = edges.step.copy(), edges.weight.copy()
        for axis, side in enumerate(sides_mm):
            ahead = np.diff(r, axis=axis) - side * _cut(slope[axis], axis, 0)
            behind = np.diff(r, axis=axis) - side * _cut(slope[axis], axis, 1)
            share = _shares(ahead, behind, axis, side)
            forward, backward = _cut(share, axis, 0), 1 - _cut(share, axis, 1)
            total = np.maximum(forward + backward, 1e-6)
            mean = forward * _cut(slope[axis], axis, 0) + backward * _cut(slope[axis], axis, 1)
            known = _cut(edges.weight[axis], axis, 0) > 0
            _cut(step[axis], axis, 0)[known] = (side * mean / total)[known]
            _cut(weight[axis], axis, 0)[known] *= total[known]
        r = _solved(Edges(step, weight, edges.photometric, edges.mixed), laser, r)
    return r


def _shares(ahead: np.ndarray, behind: np.ndarray, axis: int, side: float) -> np.ndarray:
    """How far each cell goes with its next neighbour (1) rather than with the one before (0)."""
    pad = [(0, 0), (0, 0)]
    pad[axis] = (0, 1)
    to_next = np.pad(np.nan_to_num(ahead / side, nan=_APART), pad, constant_values=_APART)
    pad[axis] = (1, 0)
    to_last = np.pad(np.nan_to_num(behind / side, nan=_APART), pad, constant_values=_APART)
    last, following = to_last**2, to_next**2
    return 1 / (1 + np.exp(-np.clip(_SHARPNESS * (last - following), -50, 50)))


def _cut(values: np.ndarray, axis: int, part: int) -> np.ndarray:
    """All but the last (0) or the first (1) along an axis; a view."""
    length = values.shape[axis]
    index = [slice(None)] * values.ndim
    index[axis] = slice(part, length - 1 + part)
    return values[tuple(index)]


def _solved(edges: Edges, laser: LaserCells, start: np.ndarray) -> np.ndarray:
    problem = Problem(edges, laser, start, np.full(start.shape, _LEAST_WEIGHT))
    whole = np.ones(edges.step.shape, np.float32)
    return linear_solve(problem, start, whole, np.ones(len(laser.value)), _ITERATIONS)
