"""Operator-dependent transfer between grids (Dendy, "Black box multigrid", 1982).

Coarse cell (a, b) is fine cell (2 a, 2 b). The values between are interpolated by the fine matrix
itself, so that a correction bends where the matrix does: nothing is interpolated across a step.
The weights take less time to compute than to read: they are nowhere kept, but made for a row of
coarse cells when it is their turn.
"""

import numpy as np
from numba import njit

from treadlight.integrate.kernels import (
    Stencil,
    add_product,
    copy,
    defect_row,
    least_rows,
    neighbours,
)
from treadlight.threads import by_ranges

# Rows of the weights of a row of coarse cells: from left and right in the even row (and what
# these lack to 1), the same in the next even row, from above and below in the odd row, and from
# the four corners in the odd row's odd columns.
_LEFT, _RIGHT, _LACK = 0, 1, 2
_NEXT = 3
_ABOVE, _BELOW, _LACK_COLUMN = 6, 7, 8
_CORNERS = 9
_LACK_CORNERS = 13
_WEIGHTS = 14
_SCRATCH = 5


@njit(cache=True)
def _pick(out, row, first):
    """Every other value of a row."""
    for b in range(len(out)):
        out[b] = row[2 * b + first]


@njit(cache=True)
def _add_every_other(out, row, first):
    for b in range(len(out)):
        out[b] += row[2 * b + first]


@njit(cache=True)
def _add_products(out, a, b, c, d):
    for k in range(len(out)):
        out[k] += a[k] * b[k] + c[k] * d[k]


@njit(cache=True)
def _keep_positive(row):
    """Coarse couplings may be negative, and cancel others: they do not count in the weights."""
    zero = row.dtype.type(0)
    for b in range(len(row)):
        row[b] = max(row[b], zero)


@njit(cache=True)
def _add_positive(total, row):
    _keep_positive(row)
    for b in range(len(total)):
        total[b] += row[b]


@njit(cache=True)
def _normalise(one_side, other_side, lack):
    """From couplings and data to their shares of the sum; 0 where there are none."""
    _keep_positive(one_side)
    _keep_positive(other_side)
    _keep_positive(lack)
    zero, one = lack.dtype.type(0), lack.dtype.type(1)
    for b in range(len(lack)):
        total = one_side[b] + other_side[b] + lack[b]
        share = one / total if total > zero else zero
        one_side[b] *= share
        other_side[b] *= share
        lack[b] *= share


@njit(cache=True)
def _along_row(stencil, i, left, right, lack):
    """Weights of an even row's odd cells; what couples to the rows around goes along the row."""
    n, m = stencil.data.shape
    up, half, inner = neighbours(i, n)[0], m // 2, (m - 1) // 2
    left[half:], right[half:], lack[half:] = 0, 0, 0
    left, right, lack = left[:half], right[:half], lack[:half]
    _pick(left, stencil.right[i], 0)
    _pick(right, stencil.right[i], 1)
    _pick(lack, stencil.data[i], 1)
    if stencil.below_right.size:
        _add_every_other(left, stencil.below_right[up], 0)
        _add_every_other(left, stencil.below_left[i], 1)
        _add_every_other(right, stencil.below_right[i], 1)
        _add_every_other(right[:inner], stencil.below_left[up], 2)
    _normalise(left, right, lack)


@njit(cache=True)
def _along_column(stencil, i, above, below, lack):
    """Weights of an odd row's even cells; what couples to the columns around goes along theirs."""
    m = stencil.data.shape[1]
    half = m // 2
    _pick(above, stencil.below[i - 1], 0)
    _pick(below, stencil.below[i], 0)
    _pick(lack, stencil.data[i], 0)
    if stencil.below_right.size:
        _add_every_other(below, stencil.below_left[i], 0)
        _add_every_other(below, stencil.below_right[i], 0)
        _add_every_other(above[1:], stencil.below_right[i - 1], 1)
        _add_every_other(above[:half], stencil.below_left[i - 1], 1)
    _normalise(above, below, lack)


@njit(cache=True)
def _between_corners(stencil, i, weights, around):
    """Weights of an odd row's odd cells, through the cells around them; `around` is scratch."""
    m = stencil.data.shape[1]
    half, inner = m // 2, (m - 1) // 2
    weights[_CORNERS:] = 0
    north, south, west, east, total = (
        around[0, :half], around[1, :half], around[2, :half], around[3, :half], around[4, :half],
    )  # fmt: skip
    upper_left, upper_right = weights[_CORNERS, :half], weights[_CORNERS + 1, :half]
    lower_left, lower_right = weights[_CORNERS + 2, :half], weights[_CORNERS + 3, :half]
    lack = weights[_LACK_CORNERS, :half]
    _pick(north, stencil.below[i - 1], 1)
    _pick(south, stencil.below[i], 1)
    _pick(west, stencil.right[i], 0)
    _pick(east, stencil.right[i], 1)
    _pick(lack, stencil.data[i], 1)
    if stencil.below_right.size:
        _pick(upper_left, stencil.below_right[i - 1], 0)
        _pick(upper_right[:inner], stencil.below_left[i - 1], 2)
        _pick(lower_left, stencil.below_left[i], 1)
        _pick(lower_right, stencil.below_right[i], 1)
    total[:] = 0
    for k in range(4):
        _add_positive(total, around[k, :half])
    for k in range(5):
        _add_positive(total, weights[_CORNERS + k, :half])
    _add_products(upper_left, north, weights[_LEFT], west, weights[_ABOVE])
    _add_products(lower_left, south, weights[_NEXT], west, weights[_BELOW])
    add_product(upper_right, north, weights[_RIGHT])
    add_product(upper_right[:inner], east, weights[_ABOVE, 1:])
    add_product(lower_right, south, weights[_NEXT + 1])
    add_product(lower_right[:inner], east, weights[_BELOW, 1:])
    _add_products(lack, north, weights[_LACK], south, weights[_NEXT + 2])
    add_product(lack, west, weights[_LACK_COLUMN])
    add_product(lack[:inner], east, weights[_LACK_COLUMN, 1:])
    zero, one = total.dtype.type(0), total.dtype.type(1)
    for b in range(half):
        total[b] = one / total[b] if total[b] > zero else zero
    for k in range(5):
        corner = weights[_CORNERS + k]
        for b in range(half):
            corner[b] *= total[b]


@njit(cache=True)
def _row_weights(stencil, a, weights):
    """The weights (14, M) of coarse row a, and scratch (5, M) behind them."""
    n = stencil.data.shape[0]
    i, rows = 2 * a, (n + 1) // 2
    _along_row(stencil, i, weights[_LEFT], weights[_RIGHT], weights[_LACK])
    below = i + 2 if a + 1 < rows else 0
    _along_row(stencil, below, weights[_NEXT], weights[_NEXT + 1], weights[_NEXT + 2])
    if i + 1 == n:
        weights[_ABOVE:] = 0
        return
    _along_column(stencil, i + 1, weights[_ABOVE], weights[_BELOW], weights[_LACK_COLUMN])
    _between_corners(stencil, i + 1, weights[:_WEIGHTS], weights[_WEIGHTS:])


@njit(cache=True)
def _gather_odd(weights, fine, below, out):
    """Add to coarse row `out` what an odd row of the fine grid hands to the coarse row above it.

    Or, with `below`, to the one below.
    """
    column = weights[_BELOW if below else _ABOVE]
    left = weights[_CORNERS + (2 if below else 0)]
    right = weights[_CORNERS + (3 if below else 1)]
    columns, m = len(out), len(fine)
    for b in range(columns):
        out[b] += column[b] * fine[2 * b]
    for b in range(m // 2):
        out[b] += left[b] * fine[2 * b + 1]
    for b in range(columns - 1):
        out[b + 1] += right[b] * fine[2 * b + 1]


@njit(cache=True)
def _gather_even(weights, fine, out):
    columns, m = len(out), len(fine)
    for b in range(columns):
        out[b] += fine[2 * b]
    for b in range(m // 2):
        out[b] += weights[_LEFT, b] * fine[2 * b + 1]
    for b in range(columns - 1):
        out[b + 1] += weights[_RIGHT, b] * fine[2 * b + 1]


@njit(cache=True)
def _defect(stencil, x, rhs, i, out):
    copy(out, rhs[i])
    defect_row(stencil, x, i, out)


@njit(cache=True, nogil=True)
def _restrict(first, last, stencil, x, rhs, out):
    n, m = x.shape
    rows, columns = out.shape
    weights = np.empty((_WEIGHTS + _SCRATCH, columns), x.dtype)
    fine = np.empty(m, x.dtype)
    out[first] = 0
    before = first - 1 if first > 0 else rows - 1
    if 2 * before + 1 < n:
        _row_weights(stencil, before, weights)
        _defect(stencil, x, rhs, 2 * before + 1, fine)
        _gather_odd(weights, fine, True, out[first])
    for i in range(2 * first, min(2 * last, n)):
        a = i // 2
        _defect(stencil, x, rhs, i, fine)
        if i % 2 == 0:
            _row_weights(stencil, a, weights)
            _gather_even(weights, fine, out[a])
        else:
            _gather_odd(weights, fine, False, out[a])
        if i % 2 == 1 and a + 1 < last:
            out[a + 1] = 0
            _gather_odd(weights, fine, True, out[a + 1])


def restrict_defect(stencil: Stencil, x: np.ndarray, rhs: np.ndarray, out: np.ndarray) -> None:
    """out (N, M) = P^T (rhs - A x)."""
    by_ranges(_restrict, len(out), least_rows(out), stencil, x, rhs, out)


@njit(cache=True)
def _spread_even(weights, coarse, x):
    for b in range(len(coarse)):
        x[2 * b] += coarse[b]
    for b in range(len(x) // 2):
        x[2 * b + 1] += weights[_LEFT, b] * coarse[b]
    for b in range(len(coarse) - 1):
        x[2 * b + 1] += weights[_RIGHT, b] * coarse[b + 1]


@njit(cache=True)
def _spread_odd(weights, above, below, x):
    for b in range(len(above)):
        x[2 * b] += weights[_ABOVE, b] * above[b] + weights[_BELOW, b] * below[b]
    upper, lower = weights[_CORNERS], weights[_CORNERS + 2]
    for b in range(len(x) // 2):
        x[2 * b + 1] += upper[b] * above[b] + lower[b] * below[b]
    upper, lower = weights[_CORNERS + 1], weights[_CORNERS + 3]
    for b in range(len(above) - 1):
        x[2 * b + 1] += upper[b] * above[b + 1] + lower[b] * below[b + 1]


@njit(cache=True, nogil=True)
def _prolong(first, last, stencil, coarse, x):
    rows, columns = coarse.shape
    weights = np.empty((_WEIGHTS + _SCRATCH, columns), x.dtype)
    for a in range(first, last):
        _row_weights(stencil, a, weights)
        _spread_even(weights, coarse[a], x[2 * a])
        if 2 * a + 1 < len(x):
            below = a + 1 if a + 1 < rows else 0
            _spread_odd(weights, coarse[a], coarse[below], x[2 * a + 1])


def prolong(stencil: Stencil, coarse: np.ndarray, x: np.ndarray) -> None:
    """x += P coarse (N, M)."""
    by_ranges(_prolong, len(coarse), least_rows(coarse), stencil, coarse, x)


@njit(cache=True)
def _edge(total, coupling, p, q):
    """Add an edge between two cells to the matrix of their four coarse cells.

    p, q : what the cells take of the four, and what that lacks to 1.
    total : couplings 01, 02, 03, 12, 13, 23 and data of the four.
    """
    d0, d1, d2, d3 = p[0] - q[0], p[1] - q[1], p[2] - q[2], p[3] - q[3]
    flow = coupling * (q[4] - p[4])
    return (
        total[0] - coupling * d0 * d1,
        total[1] - coupling * d0 * d2,
        total[2] - coupling * d0 * d3,
        total[3] - coupling * d1 * d2,
        total[4] - coupling * d1 * d3,
        total[5] - coupling * d2 * d3,
        total[6] + flow * d0,
        total[7] + flow * d1,
        total[8] + flow * d2,
        total[9] + flow * d3,
    )


@njit(cache=True)
def _mass(total, data, p):
    """Add a cell's data term to the matrix of its four coarse cells, as `_edge`."""
    whole = data * (1 - p[4])
    return (
        total[0] - data * p[0] * p[1],
        total[1] - data * p[0] * p[2],
        total[2] - data * p[0] * p[3],
        total[3] - data * p[1] * p[2],
        total[4] - data * p[1] * p[3],
        total[5] - data * p[2] * p[3],
        total[6] + whole * p[0],
        total[7] + whole * p[1],
        total[8] + whole * p[2],
        total[9] + whole * p[3],
    )


@njit(cache=True)
def _element(stencil, weights, a, b):
    """Matrix of coarse cells (a, b), (a, b + 1), (a + 1, b), (a + 1, b + 1), as in `_edge`.

    From the fine cells and edges between them, the upper and the left sides included.
    """
    n, m = stencil.data.shape
    columns = weights.shape[1]
    i, j = 2 * a, 2 * b
    zero, one = weights.dtype.type(0), weights.dtype.type(1)
    wide, tall = j + 1 < m, i + 1 < n
    left = (one, zero, zero, zero, zero)
    right = (zero, one, zero, zero, zero)
    low_left = (zero, zero, one, zero, zero)
    low_right = (zero, zero, zero, one, zero)
    top = (weights[_LEFT, b], weights[_RIGHT, b], zero, zero, weights[_LACK, b])
    bottom = (zero, zero, weights[_NEXT, b], weights[_NEXT + 1, b], weights[_NEXT + 2, b])
    west = (weights[_ABOVE, b], zero, weights[_BELOW, b], zero, weights[_LACK_COLUMN, b])
    middle = (
        weights[_CORNERS, b], weights[_CORNERS + 1, b],
        weights[_CORNERS + 2, b], weights[_CORNERS + 3, b], weights[_LACK_CORNERS, b],
    )  # fmt: skip
    east = left
    if b + 1 < columns:
        east = (
            zero, weights[_ABOVE, b + 1], zero, weights[_BELOW, b + 1],
            weights[_LACK_COLUMN, b + 1],
        )  # fmt: skip
    total = (zero, zero, zero, zero, zero, zero, zero, zero, zero, zero)
    total = _mass(total, stencil.data[i, j], left)
    total = _edge(total, stencil.right[i, j], left, top)
    if wide:
        total = _mass(total, stencil.data[i, j + 1], top)
        total = _edge(total, stencil.right[i, j + 1], top, right)
    total = _edge(total, stencil.below[i, j], left, west if tall else low_left)
    if wide:
        total = _edge(total, stencil.below[i, j + 1], top, middle if tall else bottom)
    if tall:
        total = _mass(total, stencil.data[i + 1, j], west)
        total = _edge(total, stencil.below[i + 1, j], west, low_left)
        total = _edge(total, stencil.right[i + 1, j], west, middle)
        if wide:
            total = _mass(total, stencil.data[i + 1, j + 1], middle)
            total = _edge(total, stencil.right[i + 1, j + 1], middle, east)
            total = _edge(total, stencil.below[i + 1, j + 1], middle, bottom)
    if stencil.below_right.size:
        south, south_west, south_east = middle, west, east
        if not tall:
            south, south_west, south_east = bottom, low_left, low_right
        total = _edge(total, stencil.below_right[i, j], left, south)
        if wide:
            total = _edge(total, stencil.below_left[i, j + 1], top, south_west)
            total = _edge(total, stencil.below_right[i, j + 1], top, south_east)
        if j + 2 < m:
            total = _edge(total, stencil.below_left[i, j + 2], right, south)
        if tall:
            total = _edge(total, stencil.below_right[i + 1, j], west, bottom)
            if wide:
                total = _edge(total, stencil.below_left[i + 1, j + 1], middle, low_left)
                total = _edge(total, stencil.below_right[i + 1, j + 1], middle, low_right)
            if j + 2 < m:
                total = _edge(total, stencil.below_left[i + 1, j + 2], east, bottom)
    return total


@njit(cache=True)
def _assemble_row(stencil, a, weights, coarse, right_below, data_below):
    """Couplings of coarse row a; of the row below what belongs to its `right` and `data`."""
    for b in range(weights.shape[1]):
        total = _element(stencil, weights, a, b)
        coarse.right[a, b] = total[0]
        right_below[b] = total[5]
        coarse.below[a, b] += total[1]
        coarse.below_right[a, b] = total[2]
        coarse.data[a, b] += total[6]
        data_below[b] += total[8]
        if b + 1 < weights.shape[1]:
            coarse.below_left[a, b + 1] = total[3]
            coarse.below[a, b + 1] += total[4]
            coarse.data[a, b + 1] += total[7]
            data_below[b + 1] += total[9]


@njit(cache=True, nogil=True)
def _assemble(first, last, stencil, coarse, right_below, data_below):
    rows, columns = coarse.data.shape
    weights = np.empty((_WEIGHTS + _SCRATCH, columns), coarse.data.dtype)
    for a in range(first, last):
        down = a + 1 if a + 1 < rows else 0
        _row_weights(stencil, a, weights)
        _assemble_row(stencil, a, weights, coarse, right_below[down], data_below[down])


def galerkin(stencil: Stencil) -> Stencil:
    """The coarse matrix P^T A P of a stencil (n, m), on (N, M); needs N >= 3.

    Assembled from elements between four coarse cells, some 240 operations each.
    """
    shape = tuple((size + 1) // 2 for size in stencil.data.shape)
    coarse = Stencil(*(np.zeros(shape, stencil.data.dtype) for _ in range(5)))
    right_below, data_below = (np.zeros(shape, stencil.data.dtype) for _ in range(2))
    rows = least_rows(coarse.data)
    by_ranges(_assemble, shape[0], rows, stencil, coarse, right_below, data_below)
    coarse.right[:] += right_below
    coarse.data[:] += data_below
    return coarse
