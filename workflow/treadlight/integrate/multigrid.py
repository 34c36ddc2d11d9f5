"""Matrix-free multigrid-preconditioned conjugate gradients for the surface's normal equations.

The same heights on any number of cores: see `kernels`.
"""

from dataclasses import dataclass

import numpy as np

from treadlight.integrate.coarsening import galerkin, interpolation, prolong, restrict
from treadlight.integrate.kernels import advance, assemble, defect, dot, multiply, smooth, turn

# The ring of rows needs three coarse rows; below this many cells a dense solve costs nothing.
_LEAST_ROWS = 6
_COARSEST_CELLS = 128


@dataclass(frozen=True)
class System:
    """Normal equations of ``sum w (r_next - r - g)^2 + sum d (r - y)^2`` on a grid.

    Attributes
    ----------
    w_theta : (n, m) float
        Weight of the edge from row i to row i + 1 (of the last row: to the first, 0 unless the
        grid is periodic), mm^-2.
    w_z : (n, m) float
        Weight of the edge from column j to column j + 1 (0 in the last column), mm^-2.
    data : (n, m) float
        Diagonal data term d, mm^-2. A cell without data or edges keeps its start.
    """

    w_theta: np.ndarray
    w_z: np.ndarray
    data: np.ndarray


@dataclass(frozen=True)
class _Level:
    stencil: np.ndarray
    weights: np.ndarray  # to the next level; empty on the last
    x: np.ndarray
    rhs: np.ndarray
    defect: np.ndarray


class Solver:
    """A system made ready: solves for any number of right-hand sides.

    The preconditioner is one V-cycle of black box multigrid (Dendy, 1982) with a sweep of
    Gauss-Seidel before and its adjoint after, so that it is symmetric.
    """

    def __init__(self, system: System):
        self._levels: list[_Level] = []
        stencil = assemble(system.w_theta, system.w_z, system.data)
        while True:
            n, m, _ = stencil.shape
            last = n < _LEAST_ROWS or n * m <= _COARSEST_CELLS
            weights = np.empty((0, 0, 8), stencil.dtype) if last else interpolation(stencil)
            vectors = np.zeros((3, n, m), stencil.dtype)
            self._levels.append(_Level(stencil, weights, *vectors))
            if last:
                break
            stencil = galerkin(stencil, weights)
        self._coarsest = _dense_inverse(stencil)

    def solve(
        self, residual: np.ndarray, tolerance_mm: float, max_iterations: int = 200
    ) -> tuple[np.ndarray, int]:
        """The correction x of A x = residual.

        Stops when the preconditioned residual, which estimates the error in the heights, is
        below the tolerance in every cell.

        Parameters
        ----------
        residual : (n, m) float
            b - A r at the present heights r, mm^-1.
        tolerance_mm : float
        max_iterations : int

        Returns
        -------
        x : (n, m) float
            mm.
        iterations : int
        """
        stencil = self._levels[0].stencil
        residual = residual.astype(stencil.dtype)
        x = np.zeros_like(residual)
        direction = np.zeros_like(residual)
        product = self._levels[0].defect
        rho_before = np.inf
        for iteration in range(max_iterations):
            z = self._cycle(residual)
            if np.max(np.abs(z)) < tolerance_mm:
                return x, iteration
            rho = dot(z, residual)
            turn(z, rho / rho_before, direction)
            rho_before = rho
            multiply(stencil, direction, product)
            advance(x, residual, direction, product, rho / dot(direction, product))
        return x, max_iterations

    def _cycle(self, residual: np.ndarray) -> np.ndarray:
        """One V-cycle from zero; the result is the finest level's `x`."""
        rhs = residual
        for level, below in zip(self._levels[:-1], self._levels[1:], strict=True):
            level.x[:] = 0
            smooth(level.stencil, level.x, rhs, backward=False)
            defect(level.stencil, level.x, rhs, level.defect)
            restrict(level.weights, level.defect, below.rhs)
            rhs = below.rhs
        last = self._levels[-1]
        last.x[:] = (self._coarsest @ rhs.ravel()).reshape(last.x.shape)
        for k in range(len(self._levels) - 2, -1, -1):
            level = self._levels[k]
            prolong(level.weights, self._levels[k + 1].x, level.x)
            smooth(level.stencil, level.x, residual if k == 0 else level.rhs, backward=True)
        return self._levels[0].x


def _dense_inverse(stencil: np.ndarray) -> np.ndarray:
    """Inverse of the coarsest matrix; pseudo-inverse over cells without an equation."""
    n, m, _ = stencil.shape
    matrix = np.empty((n * m, n * m))
    unit, out = np.zeros((n, m), stencil.dtype), np.empty((n, m), stencil.dtype)
    for k in range(n * m):
        unit.ravel()[k] = 1
        multiply(stencil, unit, out)
        matrix[k] = out.ravel()
        unit.ravel()[k] = 0
    return np.linalg.pinv(0.5 * (matrix + matrix.T), rcond=1e-14, hermitian=True).astype(
        stencil.dtype
    )
