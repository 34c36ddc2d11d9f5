"""Operator-dependent transfer between grids, after black box multigrid (Dendy, 1982).

Coarse cell (a, b) is fine cell (2 a, 2 b). Between two of them along theta, and in the odd columns
between the even ones, the values are interpolated by the fine matrix itself, so that a correction
bends where the matrix does: nothing is interpolated across a step. An odd column follows its
neighbours as a whole, as it does where it is relaxed; Dendy's weights, each from its own row,
tear a strip of cells that is cut off on both sides.
"""

import numpy as np

from treadlight.compiling import kernel
from treadlight.integrate.kernels import (
    Ring,
    Stencil,
    copy,
    least_columns,
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


@kernel
def _add_product(out, a, b):
    for j in range(len(out)):
        out[j] += a[j] * b[j]


@kernel
def _pick(out, row, first):
    """Every other value of a row."""
    for b in range(len(out)):
        out[b] = row[2 * b + first]


@kernel
def _add_every_other(out, row, first):
    for b in range(len(out)):
        out[b] += row[2 * b + first]


@kernel
def _keep_positive(row):
    """Coarse couplings may be negative, and cancel others: along theta they do not count."""
    zero = row.dtype.type(0)
    for b in range(len(row)):
        row[b] = max(row[b], zero)


@kernel
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


@kernel
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


@kernel
def _defect_even(stencil, x, rhs, i, out):
    """A row of rhs - A x in the even columns, as the flow along every coupling."""
    n, m = x.shape
    up, down = neighbours(i, n)
    here, above, below = x[i], x[up], x[down]
    right = stencil.right[i]
    for b in range(len(out)):
        j = 2 * b
        flow = stencil.data[i, j] * here[j]
        flow += stencil.below[i, j] * (here[j] - below[j])
        flow += stencil.below[up, j] * (here[j] - above[j])
        out[b] = rhs[i, j] - flow
    for b in range(m // 2):
        j = 2 * b
        out[b] -= right[j] * (here[j] - here[j + 1])
    for b in range(1, len(out)):
        j = 2 * b
        out[b] -= right[j - 1] * (here[j] - here[j - 1])
    if stencil.below_right.size:
        lower, upper = stencil.below_right[i], stencil.below_left[up]
        for b in range(m // 2):
            j = 2 * b
            out[b] -= lower[j] * (here[j] - below[j + 1])
            out[b] -= upper[j + 1] * (here[j] - above[j + 1])
        lower, upper = stencil.below_left[i], stencil.below_right[up]
        for b in range(1, len(out)):
            j = 2 * b
            out[b] -= lower[j] * (here[j] - below[j - 1])
            out[b] -= upper[j - 1] * (here[j] - above[j - 1])


@kernel(allocates=True)
def _restrict(first, last, stencil, x, rhs, out):
    n, rows, columns = len(x), len(out), out.shape[1]
    above, below, lack = np.zeros((3, columns), x.dtype)
    fine = np.zeros(columns, x.dtype)
    before = 2 * first - 1 if first > 0 else 2 * rows - 1
    if before < n:
        _along_column(stencil, before, above, below, lack)
        _defect_even(stencil, x, rhs, before, fine)
    for a in range(first, last):
        _defect_even(stencil, x, rhs, 2 * a, out[a])
        _add_product(out[a], below, fine)
        if 2 * a + 1 < n:
            _along_column(stencil, 2 * a + 1, above, below, lack)
            _defect_even(stencil, x, rhs, 2 * a + 1, fine)
            _add_product(out[a], above, fine)


def restrict_defect(stencil: Stencil, x: np.ndarray, rhs: np.ndarray, out: np.ndarray) -> None:
    """out (N, M) = P^T (rhs - A x), where odd columns are solved: they have no defect."""
    by_ranges(_restrict, len(out), least_rows(out), stencil, x, rhs, out)


@kernel(allocates=True)
def _prolong(first, last, stencil, coarse, x):
    rows, columns = coarse.shape
    above, below, lack = np.empty((3, columns), x.dtype)
    for a in range(first, last):
        for b in range(columns):
            x[2 * a, 2 * b] += coarse[a, b]
        if 2 * a + 1 < len(x):
            _along_column(stencil, 2 * a + 1, above, below, lack)
            low = coarse[a + 1 if a + 1 < rows else 0]
            for b in range(columns):
                x[2 * a + 1, 2 * b] += above[b] * coarse[a, b] + below[b] * low[b]


def prolong(stencil: Stencil, coarse: np.ndarray, x: np.ndarray) -> None:
    """x += P coarse (N, M) in the even columns; the odd ones follow when they are solved."""
    by_ranges(_prolong, len(coarse), least_rows(coarse), stencil, coarse, x)


@kernel
def _sides(stencil, i, first, last, left, right, lack):
    """What the odd cells of a row are coupled to in the columns beside them, and their data."""
    n, m = stencil.data.shape
    up, end = neighbours(i, n)[0], min(last, (m - 1) // 2)
    for k in range(first, last):
        j = 2 * k + 1
        left[k], right[k] = stencil.right[i, j - 1], stencil.right[i, j]
        lack[k] = stencil.data[i, j]
    if stencil.below_right.size:
        for k in range(first, last):
            j = 2 * k + 1
            left[k] += stencil.below_left[i, j] + stencil.below_right[up, j - 1]
            right[k] += stencil.below_right[i, j]
        for k in range(first, end):
            right[k] += stencil.below_left[up, 2 * k + 2]


@kernel(allocates=True)
def _respond(first, last, stencil, left, right, lack, follow):
    """Columns 2 first + 1 to 2 last - 1 of `respond`, as `kernels.relax_lines` solves them."""
    n, columns = left.shape
    zero, one = left.dtype.type(0), left.dtype.type(1)
    excess = np.zeros(columns, left.dtype)
    for i in range(n):
        _sides(stencil, i, first, last, left[i], right[i], lack[i])
        for k in range(first, last):
            total = left[i, k] + right[i, k] + lack[i, k]
            if i > 0:
                coupling = stencil.below[i - 1, 2 * k + 1]
                total += coupling * excess[k]
                left[i, k] += coupling * left[i - 1, k]
                right[i, k] += coupling * right[i - 1, k]
                lack[i, k] += coupling * lack[i - 1, k]
            coupling = stencil.below[i, 2 * k + 1] if i + 1 < n else zero
            pivot = total + coupling
            share = one / pivot if pivot > zero else zero
            left[i, k] *= share
            right[i, k] *= share
            lack[i, k] *= share
            follow[i, k] = coupling * share
            excess[k] = total * share
    for i in range(n - 2, -1, -1):
        for k in range(first, last):
            left[i, k] += follow[i, k] * left[i + 1, k]
            right[i, k] += follow[i, k] * right[i + 1, k]
            lack[i, k] += follow[i, k] * lack[i + 1, k]


def respond(stencil: Stencil, ring: Ring | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """How odd columns follow where the columns to their left, or right, rise by one.

    `ring` is that of the stencil.

    Returns
    -------
    left, right, lack : (n, m // 2) float
        By how much; and what these lack to one, which the data hold.
    """
    n, m = stencil.data.shape
    left, right, lack, follow = np.empty((4, n, m // 2), stencil.data.dtype)
    by_ranges(_respond, m // 2, least_columns(left), stencil, left, right, lack, follow)
    if ring is not None:
        for weights in (left, right, lack):
            ring.close(weights)
    return left, right, lack


@kernel
def _corners(weights, left, right, lack):
    """Weights of an odd row's odd cells: as they follow the even ones beside them."""
    half, inner = len(left), min(len(left), weights.shape[1] - 1)
    above, below, lacking = weights[_ABOVE], weights[_BELOW], weights[_LACK_COLUMN]
    for b in range(half):
        weights[_CORNERS, b] = left[b] * above[b]
        weights[_CORNERS + 2, b] = left[b] * below[b]
        weights[_LACK_CORNERS, b] = lack[b] + left[b] * lacking[b]
    for b in range(inner):
        weights[_CORNERS + 1, b] = right[b] * above[b + 1]
        weights[_CORNERS + 3, b] = right[b] * below[b + 1]
        weights[_LACK_CORNERS, b] += right[b] * lacking[b + 1]


@kernel
def _row_weights(stencil, left, right, lack, a, weights):
    """The weights (14, M) of coarse row a, from how odd columns follow."""
    n, half = left.shape
    i, rows = 2 * a, (n + 1) // 2
    below = i + 2 if a + 1 < rows else 0
    weights[:] = 0
    for k, row in enumerate((i, below)):
        copy(weights[_NEXT * k, :half], left[row])
        copy(weights[_NEXT * k + 1, :half], right[row])
        copy(weights[_NEXT * k + 2, :half], lack[row])
    if i + 1 < n:
        _along_column(stencil, i + 1, weights[_ABOVE], weights[_BELOW], weights[_LACK_COLUMN])
        _corners(weights, left[i + 1], right[i + 1], lack[i + 1])


@kernel
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


@kernel
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


@kernel
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


@kernel
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


@kernel(allocates=True)
def _assemble(first, last, stencil, left, right, lack, coarse, right_below, data_below):
    rows, columns = coarse.data.shape
    weights = np.empty((_WEIGHTS, columns), coarse.data.dtype)
    for a in range(first, last):
        down = a + 1 if a + 1 < rows else 0
        _row_weights(stencil, left, right, lack, a, weights)
        _assemble_row(stencil, a, weights, coarse, right_below[down], data_below[down])


def galerkin(stencil: Stencil, ring: Ring | None) -> Stencil:
    """The coarse matrix P^T A P of a stencil (n, m) and its ring, on (N, M); needs N >= 3.

    Assembled from elements between four coarse cells, some 240 operations each.
    """
    shape = tuple((size + 1) // 2 for size in stencil.data.shape)
    coarse = Stencil(*(np.zeros(shape, stencil.data.dtype) for _ in range(5)))
    right_below, data_below = (np.zeros(shape, stencil.data.dtype) for _ in range(2))
    rows = least_rows(coarse.data)
    by_ranges(
        _assemble, shape[0], rows, stencil, *respond(stencil, ring), coarse, right_below, data_below
    )
    coarse.right[:] += right_below
    coarse.data[:] += data_below
    return coarse
