"""Numba kernels of the multigrid solver, on stencils of symmetric couplings.

A stencil is an array (n, m, c): [..., 0] is the matrix's diagonal, [..., 1] the coupling to the
right, [..., 2] to the cell below; on coarse levels (c = 5) also [..., 3] below right and [..., 4]
below left. A coupling is minus the matrix element. Rows are a ring: below the last row comes the
first, with coupling 0 where the grid is open. Every parallel loop runs over rows whose results do
not depend on each other.
"""

import numpy as np
from numba import njit, prange


def dot(a: np.ndarray, b: np.ndarray) -> float:
    """Inner product of two (n, m) arrays, the same on any number of cores, float64."""
    return float(np.sum(_row_dots(a, b)))


@njit(cache=True, parallel=True)
def _row_dots(a, b):
    sums = np.empty(a.shape[0], np.float64)
    for i in prange(a.shape[0]):
        total = 0.0
        for j in range(a.shape[1]):
            total += np.float64(a[i, j]) * np.float64(b[i, j])
        sums[i] = total
    return sums


@njit(cache=True, parallel=True)
def assemble(w_theta, w_z, data):
    """The stencil (n, m, 3) of edge weights and a diagonal data term."""
    n, m = data.shape
    stencil = np.empty((n, m, 3), data.dtype)
    for row in prange(n):
        i = np.int64(row)
        up = i - 1 if i > 0 else n - 1
        for j in range(m):
            total = data[i, j] + w_theta[i, j] + w_theta[up, j] + w_z[i, j]
            if j > 0:
                total += w_z[i, j - 1]
            stencil[i, j, 0] = total
            stencil[i, j, 1] = w_z[i, j]
            stencil[i, j, 2] = w_theta[i, j]
    return stencil


@njit(cache=True, inline="always")
def _coupled(stencil, x, i, j, up, down):
    """Sum of the couplings of a cell times the neighbours' values."""
    m = x.shape[1]
    value = stencil[i, j, 2] * x[down, j] + stencil[up, j, 2] * x[up, j]
    if j + 1 < m:
        value += stencil[i, j, 1] * x[i, j + 1]
    if j > 0:
        value += stencil[i, j - 1, 1] * x[i, j - 1]
    if stencil.shape[2] == 5:
        if j + 1 < m:
            value += stencil[i, j, 3] * x[down, j + 1] + stencil[up, j + 1, 4] * x[up, j + 1]
        if j > 0:
            value += stencil[i, j, 4] * x[down, j - 1] + stencil[up, j - 1, 3] * x[up, j - 1]
    return value


@njit(cache=True)
def _smooth_row(stencil, x, rhs, i, backward):
    n, m = x.shape
    up = i - 1 if i > 0 else n - 1
    down = i + 1 if i < n - 1 else 0
    for k in range(m):
        j = m - 1 - k if backward else k
        total = stencil[i, j, 0]
        if total > 0:
            x[i, j] = (rhs[i, j] + _coupled(stencil, x, i, j, up, down)) / total


@njit(cache=True, parallel=True)
def _smooth_rows(stencil, x, rhs, first, count, backward):
    for k in prange(count):
        _smooth_row(stencil, x, rhs, first + 2 * np.int64(k), backward)


def smooth(stencil: np.ndarray, x: np.ndarray, rhs: np.ndarray, backward: bool) -> None:
    """One Gauss-Seidel sweep in place: even rows, then odd rows; `backward` is its adjoint.

    Where an odd number of rows closes to a ring, the last row would touch row 0 of its own
    parity: it is swept by itself, after (backward: before) the others.
    """
    n = x.shape[0]
    odd = n % 2 == 1 and n > 1
    even_rows = n // 2 if odd else (n + 1) // 2
    if not backward:
        _smooth_rows(stencil, x, rhs, 0, even_rows, False)
        _smooth_rows(stencil, x, rhs, 1, n // 2, False)
    if odd:
        _smooth_row(stencil, x, rhs, n - 1, backward)
    if backward:
        _smooth_rows(stencil, x, rhs, 1, n // 2, True)
        _smooth_rows(stencil, x, rhs, 0, even_rows, True)


@njit(cache=True, parallel=True)
def multiply(stencil, x, out):
    """out = A x."""
    n = x.shape[0]
    for row in prange(n):
        i = np.int64(row)
        up = i - 1 if i > 0 else n - 1
        down = i + 1 if i < n - 1 else 0
        for j in range(x.shape[1]):
            out[i, j] = stencil[i, j, 0] * x[i, j] - _coupled(stencil, x, i, j, up, down)


@njit(cache=True, parallel=True)
def defect(stencil, x, rhs, out):
    """out = rhs - A x."""
    n = x.shape[0]
    for row in prange(n):
        i = np.int64(row)
        up = i - 1 if i > 0 else n - 1
        down = i + 1 if i < n - 1 else 0
        for j in range(x.shape[1]):
            out[i, j] = (
                rhs[i, j] - stencil[i, j, 0] * x[i, j] + _coupled(stencil, x, i, j, up, down)
            )


@njit(cache=True, parallel=True)
def turn(z, beta, direction):
    """direction = z + beta direction."""
    for i in prange(z.shape[0]):
        for j in range(z.shape[1]):
            direction[i, j] = z[i, j] + beta * direction[i, j]


@njit(cache=True, parallel=True)
def advance(x, residual, direction, product, step):
    """x += step direction; residual -= step product."""
    for i in prange(x.shape[0]):
        for j in range(x.shape[1]):
            x[i, j] += step * direction[i, j]
            residual[i, j] -= step * product[i, j]
