"""Matrix-free multigrid-preconditioned conjugate gradients for the surface's normal equations.

The same heights on any number of cores: see `kernels`.
"""

from dataclasses import dataclass

import numpy as np

from treadlight.integrate.coarsening import galerkin, prolong, restrict_defect
from treadlight.integrate.islands import islands_of
from treadlight.integrate.kernels import (
    Ring,
    Stencil,
    advance,
    measure,
    multiply,
    relax_lines,
    relax_points,
    ring_of,
    turn,
)

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
    stencil: Stencil
    ring: Ring | None
    x: np.ndarray
    rhs: np.ndarray


class Solver:
    """A system made ready: solves for any number of right-hand sides.

    The preconditioner is one V-cycle: Gauss-Seidel on the even columns, then every odd column
    solved as a whole; after the coarse grid's correction the adjoint, so that it is symmetric. Of
    islands coarse grids know nothing: after each cycle they are set to their level.
    In the precision of the system: single precision takes some 40 bytes per unknown, those of the
    system, of the residual and of a few islands among them; a ring takes 3 more, and 4 while it
    is closed.
    """

    def __init__(self, system: System):
        empty = np.empty((0, 0), system.data.dtype)
        stencil = Stencil(system.w_z, system.w_theta, empty, empty, system.data)
        self._islands = islands_of(stencil)
        vectors = np.empty_like(system.data), empty
        self._levels = []
        while len(stencil.data) >= _LEAST_ROWS and stencil.data.size > _COARSEST_CELLS:
            ring = ring_of(stencil)
            self._levels.append(_Level(stencil, ring, *vectors))
            stencil = galerkin(stencil, ring)
            vectors = tuple(np.empty((2, *stencil.data.shape), stencil.data.dtype))
        self._levels.append(_Level(stencil, None, *vectors))
        self._coarsest = _dense_inverse(stencil)
        n, m = system.data.shape
        self._follow = np.empty(n * (m // 2), system.data.dtype)

    def solve(
        self, residual: np.ndarray, tolerance_mm: float, max_iterations: int = 200
    ) -> tuple[np.ndarray, int]:
        """The correction x of A x = residual.

        Stops when the preconditioned residual, which is some four times less than the error in
        the heights, is below the tolerance in every cell.

        Parameters
        ----------
        residual : (n, m) float
            b - A r at the present heights r, mm^-1. Used up.
        tolerance_mm : float
        max_iterations : int

        Returns
        -------
        x : (n, m) float
            mm.
        iterations : int
        """
        stencil = self._levels[0].stencil
        x, direction = np.zeros((2, *residual.shape), stencil.data.dtype)
        rho_before = np.inf
        # The islands' levels begin where they belong; what follows leaves them there.
        self._islands.correct(stencil, x, residual)
        multiply(stencil, x, direction)
        residual -= direction
        for iteration in range(max_iterations):
            z = self._cycle(residual)
            rho, largest = measure(z, residual)
            if largest < tolerance_mm:
                return x, iteration
            turn(z, rho / rho_before, direction)
            rho_before = rho
            product = z
            energy = multiply(stencil, direction, product)
            advance(x, residual, direction, product, rho / energy)
        return x, max_iterations

    def _cycle(self, residual: np.ndarray) -> np.ndarray:
        """One V-cycle from zero; the result is the finest level's `x`."""
        if len(self._levels) == 1:
            self._levels[0].x[:] = self._solved(residual)
        else:
            self._correct(0, residual)
        level = self._levels[0]
        self._islands.correct(level.stencil, level.x, residual)
        return level.x

    def _correct(self, k: int, rhs: np.ndarray) -> None:
        """One V-cycle from zero on level k, into its `x`."""
        level, below = self._levels[k : k + 2]
        level.x[:] = 0
        relax_points(level.stencil, level.x, rhs, False)
        self._solve_lines(level, rhs)
        restrict_defect(level.stencil, level.x, rhs, below.rhs)
        if k + 2 == len(self._levels):
            below.x[:] = self._solved(below.rhs)
        else:
            self._correct(k + 1, below.rhs)
        prolong(level.stencil, below.x, level.x)
        self._solve_lines(level, rhs)
        relax_points(level.stencil, level.x, rhs, True)

    def _solve_lines(self, level: _Level, rhs: np.ndarray) -> None:
        n, m = level.x.shape
        follow = self._follow[: n * (m // 2)].reshape(n, m // 2)
        relax_lines(level.stencil, level.ring, level.x, rhs, follow)

    def _solved(self, rhs: np.ndarray) -> np.ndarray:
        return (self._coarsest @ rhs.ravel()).reshape(rhs.shape)


def _dense_inverse(stencil: Stencil) -> np.ndarray:
    """Inverse of the coarsest matrix; pseudo-inverse over cells without an equation."""
    shape = stencil.data.shape
    matrix = np.empty((stencil.data.size, stencil.data.size))
    unit, out = np.zeros(shape, stencil.data.dtype), np.empty(shape, stencil.data.dtype)
    for k in range(stencil.data.size):
        unit.ravel()[k] = 1
        multiply(stencil, unit, out)
        matrix[k] = out.ravel()
        unit.ravel()[k] = 0
    return np.linalg.pinv(0.5 * (matrix + matrix.T), rcond=1e-14, hermitian=True).astype(
        stencil.data.dtype
    )
