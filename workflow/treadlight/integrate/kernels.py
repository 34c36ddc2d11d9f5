"""Numba kernels of the multigrid solver: row by row, so that a row stays in the cache.

Every kernel is called for ranges of rows, or of columns, whose results do not depend on each
other: the same bits on any number of cores. Inner loops run along z with few arrays each, which
the compiler turns into vector instructions.
"""

from typing import NamedTuple

import numpy as np

from treadlight.compiling import kernel
from treadlight.threads import by_ranges, cores, ranges, share

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


def least_columns(cells: np.ndarray) -> int:
    """The same of columns: one range a core, since short pieces of rows are read slowly."""
    n, m = cells.shape
    return max(1, _LEAST_CELLS // n, -(-m // cores()))


@kernel
def neighbours(i, n):
    """The rows before and after row i of a ring of n."""
    return (i - 1 if i > 0 else n - 1), (i + 1 if i < n - 1 else 0)


@kernel
def copy(out, a):
    """out = a; an assignment of slices compiles what raises an error first, for seconds."""
    for j in range(len(out)):
        out[j] = a[j]


@kernel
def _subtract_flow(out, coupling, here, there):
    for j in range(len(out)):
        out[j] -= coupling[j] * (here[j] - there[j])


@kernel
def _add_sides(stencil, x, i, odd, first, last, value, total):
    """What a row's even, or odd, cells are coupled to in the columns beside them.

    Added to `value`: couplings times x; to `total`: couplings; of cells first to last - 1.
    """
    n, m = x.shape
    up, down = neighbours(i, n)
    # From here on cells have a column to their left, up to there one to their right.
    begin, end = max(first, 1 - odd), min(last, (m - odd) // 2)
    right = stencil.right[i]
    for k in range(begin, last):
        j = 2 * k + odd - 1
        value[k] += right[j] * x[i, j]
        total[k] += right[j]
    for k in range(first, end):
        j = 2 * k + odd
        value[k] += right[j] * x[i, j + 1]
        total[k] += right[j]
    if stencil.below_right.size:
        lower_left, upper_left = stencil.below_left[i], stencil.below_right[up]
        for k in range(begin, last):
            j = 2 * k + odd
            value[k] += lower_left[j] * x[down, j - 1] + upper_left[j - 1] * x[up, j - 1]
            total[k] += lower_left[j] + upper_left[j - 1]
        lower_right, upper_right = stencil.below_right[i], stencil.below_left[up]
        for k in range(first, end):
            j = 2 * k + odd
            value[k] += lower_right[j] * x[down, j + 1] + upper_right[j + 1] * x[up, j + 1]
            total[k] += lower_right[j] + upper_right[j + 1]


@kernel
def _relax_row(stencil, x, rhs, i, value, total):
    """Gauss-Seidel on the even cells of a row, which are not coupled to each other."""
    up, down = neighbours(i, len(x))
    below, above = stencil.below[i], stencil.below[up]
    zero, one = x.dtype.type(0), x.dtype.type(1)
    for k in range(len(value)):
        j = 2 * k
        value[k] = rhs[i, j] + below[j] * x[down, j] + above[j] * x[up, j]
        total[k] = stencil.data[i, j] + below[j] + above[j]
    _add_sides(stencil, x, i, 0, 0, len(value), value, total)
    for k in range(len(value)):
        x[i, 2 * k] = value[k] * (one / total[k] if total[k] > zero else zero)


@kernel(allocates=True)
def _relax_alone(stencil, x, rhs, i):
    value, total = np.empty((2, (x.shape[1] + 1) // 2), x.dtype)
    _relax_row(stencil, x, rhs, i, value, total)


@kernel(allocates=True)
def _relax_pairs(first, last, stencil, x, rhs, backward):
    """Rows 2 first to 2 last - 1, less the one that waits for a row of the next pairs."""
    value, total = np.empty((2, (x.shape[1] + 1) // 2), x.dtype)
    for k in range(2 * first, 2 * last):
        pair, behind = k // 2, k % 2
        if behind and pair == first:
            continue
        row = 2 * pair - behind
        if backward:
            row = 2 * pair + 1 - behind
        _relax_row(stencil, x, rhs, row, value, total)


def relax_points(stencil: Stencil, x: np.ndarray, rhs: np.ndarray, backward: bool) -> None:
    """Gauss-Seidel on the cells of even columns, in place; `backward` is its adjoint.

    Even rows before odd ones; backward the other way round. An odd row follows as soon as the
    even ones around it are done, so that the sweep goes through the memory once; only where one
    core's rows end, it waits for the next one's. Where an odd number of rows closes to a ring,
    the last row would touch row 0 of its own colour: it is swept by itself, after the others
    (backward: before).
    """
    n = len(x)
    if n % 2 and backward:
        _relax_alone(stencil, x, rhs, n - 1)
    pairs = ranges(n // 2, -(-least_rows(x) // 2))
    share(lambda part: _relax_pairs(*part, stencil, x, rhs, backward), pairs)
    for first, last in pairs:
        _relax_alone(stencil, x, rhs, 2 * first if backward else 2 * last - 1)
    if n % 2 and not backward:
        _relax_alone(stencil, x, rhs, n - 1)


@kernel
def _odd(row, first, last, out):
    for k in range(first, last):
        out[k] = row[2 * k + 1]


@kernel
def _eliminate(stencil, x, i, first, last, value, excess, follow):
    """Forward elimination of a row, its diagonal kept as couplings and the `excess` over them.

    So that nothing is lost where the data are small beside the couplings.
    """
    n = len(x)
    zero, one = x.dtype.type(0), x.dtype.type(1)
    for k in range(first, last):
        j = 2 * k + 1
        coupling = stencil.below[i, j] if i + 1 < n else zero
        pivot = excess[k] + coupling
        inverse = one / pivot if pivot > zero else zero
        x[i, j] = value[k] * inverse
        follow[i, k] = coupling * inverse
        excess[k] *= inverse


@kernel(allocates=True)
def _relax_lines(first, last, stencil, x, rhs, follow):
    """Odd columns 2 first + 1 to 2 last - 1: from the first row to the last, and back."""
    n = len(x)
    value, total, excess = np.zeros((3, x.shape[1] // 2), x.dtype)
    for i in range(n):
        _odd(rhs[i], first, last, value)
        _odd(stencil.data[i], first, last, total)
        _add_sides(stencil, x, i, 1, first, last, value, total)
        if i > 0:
            above = stencil.below[i - 1]
            for k in range(first, last):
                j = 2 * k + 1
                value[k] += above[j] * x[i - 1, j]
                total[k] += above[j] * excess[k]
        copy(excess[first:last], total[first:last])
        _eliminate(stencil, x, i, first, last, value, excess, follow)
    for i in range(n - 2, -1, -1):
        for k in range(first, last):
            j = 2 * k + 1
            x[i, j] += follow[i, k] * x[i + 1, j]


@kernel
def _subtract_scaled(first, last, rows, response, scale):
    for i in range(first, last):
        for k in range(len(scale)):
            rows[i, k] -= response[i, k] * scale[k]


class Ring(NamedTuple):
    """How a ring's odd columns take the coupling of their last cell to the first.

    Attributes
    ----------
    response : (n, m // 2) float
        Of the columns, open, to a pull of one on the first cell and back on the last one.
    share : (m // 2,) float
        Of the open columns' gap between first and last cell, as a pull.
    """

    response: np.ndarray
    share: np.ndarray

    def close(self, columns: np.ndarray) -> None:
        """From solved open columns (n, m // 2) to closed ones, in place (Sherman, Morrison)."""
        pull = self.share * (columns[0] - columns[-1])
        by_ranges(_subtract_scaled, len(columns), least_rows(columns), columns, self.response, pull)


def ring_of(stencil: Stencil) -> Ring | None:
    """None where the grid is open."""
    closing = stencil.below[-1, 1::2]
    if not closing.any():
        return None
    x, pull = np.zeros((2, *stencil.data.shape), stencil.data.dtype)
    pull[0, 1::2], pull[-1, 1::2] = 1, -1
    relax_lines(stencil, None, x, pull, np.empty(x[:, 1::2].shape, x.dtype))
    response = x[:, 1::2].copy()
    gap = response[0] - response[-1]
    return Ring(response, closing / (1 + closing * gap))


def relax_lines(
    stencil: Stencil, ring: Ring | None, x: np.ndarray, rhs: np.ndarray, follow: np.ndarray
) -> None:
    """Every odd column solved for all of its cells at once, given the even columns, in place.

    Strips of cells along a wall, cut off on both sides, are rigid: no sweep from cell to cell
    moves them.

    Parameters
    ----------
    stencil : Stencil
    ring : Ring or None
        See `ring_of`; None leaves a ring open.
    x, rhs : (n, m) float
    follow : (n, m // 2) float
        Overwritten.
    """
    by_ranges(_relax_lines, follow.shape[1], least_columns(follow), stencil, x, rhs, follow)
    if ring is not None:
        ring.close(x[:, 1::2])


@kernel
def _defect_row(stencil, x, i, out):
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


@kernel
def _product_row(stencil, x, i, out):
    out[:] = 0
    _defect_row(stencil, x, i, out)
    total = 0.0
    for j in range(len(out)):
        out[j] = -out[j]
        total += np.float64(x[i, j]) * np.float64(out[j])
    return total


@kernel
def _multiply(first, last, stencil, x, out, dots):
    for i in range(first, last):
        dots[i] = _product_row(stencil, x, i, out[i])


def multiply(stencil: Stencil, x: np.ndarray, out: np.ndarray) -> float:
    """out = A x; returns x^T A x, summed by rows in double precision."""
    dots = np.empty(len(x))
    by_ranges(_multiply, len(x), least_rows(x), stencil, x, out, dots)
    return float(dots.sum())


@kernel
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


@kernel
def _turn(first, last, z, beta, direction):
    for i in range(first, last):
        for j in range(z.shape[1]):
            direction[i, j] = z[i, j] + beta * direction[i, j]


def turn(z: np.ndarray, beta: float, direction: np.ndarray) -> None:
    """direction = z + beta direction."""
    by_ranges(_turn, len(z), least_rows(z), z, z.dtype.type(beta), direction)


@kernel
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
