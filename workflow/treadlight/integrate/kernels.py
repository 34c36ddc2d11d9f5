"""Numba kernels of the multigrid solver: row by row, so that a row stays in the cache.

Every parallel loop runs over blocks of rows whose results do not depend on each other: the same
bits on any number of cores. Inner loops run along z with unit stride and few arrays each, which
the compiler turns into vector instructions.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from treadlight.threads import by_ranges, ranges, share

# Cells that are worth a thread.
_LEAST_CELLS = 1 << 17


class Stencil(NamedTuple):
    """A symmetric matrix on a grid (n, m) by its couplings: minus its elements off the diagonal.

    Rows are a ring: below the last one comes the first, with coupling 0 where the grid is open.
    What a cell is coupled to outside of the columns is 0.

    Attributes
    ----------
    right, below : (n, m) float
        Couplings of a cell to the next column and the next row.
    below_right, below_left : (n, m) float
        The same to the corners; (0, 0) where there are none.
    data : (n, m) float
        What the diagonal has beyond the sum of the couplings. Kept apart from it: single
        precision would lose the one in the other.
    """

    right: np.ndarray
    below: np.ndarray
    below_right: np.ndarray
    below_left: np.ndarray
    data: np.ndarray


def least_rows(cells: np.ndarray) -> int:
    """How many rows of a grid (n, m) are worth a thread."""
    return max(1, _LEAST_CELLS // cells.shape[1])


@njit(cache=True)
def neighbours(i, n):
    """The rows before and after row i of a ring of n."""
    return (i - 1 if i > 0 else n - 1), (i + 1 if i < n - 1 else 0)


@njit(cache=True)
def copy(out, a):
    """out = a; an assignment of slices compiles what raises an error first, for seconds."""
    for j in range(len(out)):
        out[j] = a[j]


@njit(cache=True)
def add_product(out, a, b):
    """out += a b."""
    for j in range(len(out)):
        out[j] += a[j] * b[j]


@njit(cache=True)
def _add(out, a):
    for j in range(len(out)):
        out[j] += a[j]


@njit(cache=True)
def _subtract_flow(out, coupling, here, there):
    for j in range(len(out)):
        out[j] -= coupling[j] * (here[j] - there[j])


@njit(cache=True)
def _vertical(stencil, x, i, value, total):
    """Add to a row's `value` its couplings to the rows around times x; `total`: its diagonal."""
    n, m = x.shape
    up, down = neighbours(i, n)
    right, below, above = stencil.right[i], stencil.below[i], stencil.below[up]
    add_product(value, below, x[down])
    add_product(value, above, x[up])
    copy(total, stencil.data[i])
    _add(total, below)
    _add(total, above)
    _add(total, right)
    _add(total[1:], right[: m - 1])
    if stencil.below_right.size:
        down_right, down_left = stencil.below_right[i], stencil.below_left[i]
        up_left, up_right = stencil.below_right[up], stencil.below_left[up]
        add_product(value[: m - 1], down_right[: m - 1], x[down, 1:])
        add_product(value[1:], down_left[1:], x[down, : m - 1])
        add_product(value[1:], up_left[: m - 1], x[up, : m - 1])
        add_product(value[: m - 1], up_right[1:], x[up, 1:])
        _add(total, down_right)
        _add(total, down_left)
        _add(total[1:], up_left[: m - 1])
        _add(total[: m - 1], up_right[1:])


@njit(cache=True)
def _relax(right, x, value, inverse, first):
    """Gauss-Seidel on every other cell of a row, from column `first` on."""
    m = len(x)
    for j in range(first, m, 2):
        around = value[j]
        if j + 1 < m:
            around += right[j] * x[j + 1]
        if j > 0:
            around += right[j - 1] * x[j - 1]
        x[j] = around * inverse[j]


@njit(cache=True)
def _smooth_row(stencil, x, rhs, i, backward, value, inverse):
    copy(value, rhs[i])
    _vertical(stencil, x, i, value, inverse)
    one = x.dtype.type(1)
    for j in range(len(inverse)):
        total = inverse[j]
        inverse[j] = one / total if total > 0 else one - one
    _relax(stencil.right[i], x[i], value, inverse, 1 if backward else 0)
    _relax(stencil.right[i], x[i], value, inverse, 0 if backward else 1)


@njit(cache=True, nogil=True)
def _smooth_alone(stencil, x, rhs, i, backward):
    m = x.shape[1]
    _smooth_row(stencil, x, rhs, i, backward, np.empty(m, x.dtype), np.empty(m, x.dtype))


@njit(cache=True, nogil=True)
def _smooth_pairs(first, last, stencil, x, rhs, backward):
    """Rows 2 first to 2 last - 1, less the one that waits for a row of the next pairs."""
    value, inverse = np.empty(x.shape[1], x.dtype), np.empty(x.shape[1], x.dtype)
    for k in range(2 * first, 2 * last):
        pair, behind = k // 2, k % 2
        if behind and pair == first:
            continue
        row = 2 * pair - behind
        if backward:
            row = 2 * pair + 1 - behind
        _smooth_row(stencil, x, rhs, row, backward, value, inverse)


def smooth(stencil: Stencil, x: np.ndarray, rhs: np.ndarray, backward: bool) -> None:
    """One sweep of Gauss-Seidel in four colours, in place; `backward` is its adjoint.

    Even rows before odd ones, and in a row even columns before odd ones; backward the other way
    round. An odd row follows as soon as the even ones around it are done, so that the sweep goes
    through the memory once; only where one core's rows end, it waits for the next one's. Where an
    odd number of rows closes to a ring, the last row would touch row 0 of its own colour: it is
    swept by itself, after the others (backward: before).
    """
    n = len(x)
    if n % 2 and backward:
        _smooth_alone(stencil, x, rhs, n - 1, backward)
    pairs = ranges(n // 2, least_rows(x))
    share(lambda part: _smooth_pairs(*part, stencil, x, rhs, backward), pairs)
    for first, last in pairs:
        _smooth_alone(stencil, x, rhs, 2 * first if backward else 2 * last - 1, backward)
    if n % 2 and not backward:
        _smooth_alone(stencil, x, rhs, n - 1, backward)


@njit(cache=True)
def defect_row(stencil, x, i, out):
    """Subtract from a row's `out` (m,) its row of A x, as the flow along every coupling."""
    n, m = x.shape
    up, down = neighbours(i, n)
    here, above, below = x[i], x[up], x[down]
    for j in range(m):
        out[j] -= stencil.data[i, j] * here[j]
    right = stencil.right[i, : m - 1]
    _subtract_flow(out[: m - 1], right, here[: m - 1], here[1:])
    _subtract_flow(out[1:], right, here[1:], here[: m - 1])
    _subtract_flow(out, stencil.below[i], here, below)
    _subtract_flow(out, stencil.below[up], here, above)
    if stencil.below_right.size:
        _subtract_flow(out[: m - 1], stencil.below_right[i, : m - 1], here[: m - 1], below[1:])
        _subtract_flow(out[1:], stencil.below_left[i, 1:], here[1:], below[: m - 1])
        _subtract_flow(out[1:], stencil.below_right[up, : m - 1], here[1:], above[: m - 1])
        _subtract_flow(out[: m - 1], stencil.below_left[up, 1:], here[: m - 1], above[1:])


@njit(cache=True)
def _product_row(stencil, x, i, out):
    out[:] = 0
    defect_row(stencil, x, i, out)
    total = 0.0
    for j in range(len(out)):
        out[j] = -out[j]
        total += np.float64(x[i, j]) * np.float64(out[j])
    return total


@njit(cache=True, nogil=True)
def _multiply(first, last, stencil, x, out, dots):
    for i in range(first, last):
        dots[i] = _product_row(stencil, x, i, out[i])


def multiply(stencil: Stencil, x: np.ndarray, out: np.ndarray) -> float:
    """out = A x; returns x^T A x, summed by rows in double precision."""
    dots = np.empty(len(x))
    by_ranges(_multiply, len(x), least_rows(x), stencil, x, out, dots)
    return float(dots.sum())


@njit(cache=True, nogil=True)
def _measure(first, last, a, b, dots, largest):
    m = a.shape[1]
    for i in range(first, last):
        total, most = 0.0, 0.0
        for j in range(m):
            total += np.float64(a[i, j]) * np.float64(b[i, j])
            most = max(most, abs(np.float64(a[i, j])))
        dots[i], largest[i] = total, most


def measure(a: np.ndarray, b: np.ndarray) -> tuple[float, float]:
    """Inner product of two arrays in double precision, and the largest magnitude in the first."""
    dots, largest = np.empty((2, len(a)))
    by_ranges(_measure, len(a), least_rows(a), a, b, dots, largest)
    return float(dots.sum()), float(largest.max())


@njit(cache=True, nogil=True)
def _turn(first, last, z, beta, direction):
    for i in range(first, last):
        for j in range(z.shape[1]):
            direction[i, j] = z[i, j] + beta * direction[i, j]


def turn(z: np.ndarray, beta: float, direction: np.ndarray) -> None:
    """direction = z + beta direction."""
    by_ranges(_turn, len(z), least_rows(z), z, z.dtype.type(beta), direction)


@njit(cache=True, nogil=True)
def _advance(first, last, x, residual, direction, product, step):
    for i in range(first, last):
        for j in range(x.shape[1]):
            x[i, j] += step * direction[i, j]
        for j in range(x.shape[1]):
            residual[i, j] -= step * product[i, j]


def advance(
    x: np.ndarray, residual: np.ndarray, direction: np.ndarray, product: np.ndarray, step: float
) -> None:
    """x += step direction; residual -= step product."""
    arrays = x, residual, direction, product
    by_ranges(_advance, len(x), least_rows(x), *arrays, x.dtype.type(step))
