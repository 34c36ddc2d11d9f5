"""Operator-dependent transfer between grids (Dendy, "Black box multigrid", 1982).

Coarse cell (I, J) is fine cell (2 I, 2 J). The values between are interpolated by the fine
matrix itself, so that a correction bends where the matrix does: nothing is interpolated across a
step. The weights are an array (N, M, 8) over the coarse cells: of fine cell (2I, 2J+1) from its
left and right neighbour; of (2I+1, 2J) from above and below; of (2I+1, 2J+1) from above left,
above right, below left, below right; 0 where a cell does not exist.
"""

import numpy as np
from numba import njit, prange


@njit(cache=True, inline="always")
def _cell(stencil, i, j, up, corners, around):
    """Couplings of cell (i, j): around[0..2, 0..2] by row above, same, below; the diagonal."""
    m = stencil.shape[1]
    around[:] = 0
    around[0, 1] = stencil[up, j, 2]
    around[2, 1] = stencil[i, j, 2]
    if j + 1 < m:
        around[1, 2] = stencil[i, j, 1]
    if j > 0:
        around[1, 0] = stencil[i, j - 1, 1]
    if corners:
        if j + 1 < m:
            around[2, 2] = stencil[i, j, 3]
            around[0, 2] = stencil[up, j + 1, 4]
        if j > 0:
            around[2, 0] = stencil[i, j, 4]
            around[0, 0] = stencil[up, j - 1, 3]
    return stencil[i, j, 0]


@njit(cache=True, inline="always")
def _ratio(part, whole):
    return part / whole if whole > 0 else 0.0


@njit(cache=True, parallel=True)
def interpolation(stencil):
    """The interpolation weights (N, M, 8) of a stencil (n, m, 3 or 5)."""
    n, m, c = stencil.shape
    rows, columns = (n + 1) // 2, (m + 1) // 2
    weights = np.zeros((rows, columns, 8), stencil.dtype)
    for a in prange(rows):
        around = np.empty((3, 3), stencil.dtype)
        i = 2 * np.int64(a)
        up = i - 1 if i > 0 else n - 1
        for b in range(columns):
            if 2 * b + 1 < m:
                total = _cell(stencil, i, 2 * b + 1, up, c == 5, around)
                total -= around[0, 1] + around[2, 1]
                weights[a, b, 0] = _ratio(around[0, 0] + around[1, 0] + around[2, 0], total)
                weights[a, b, 1] = _ratio(around[0, 2] + around[1, 2] + around[2, 2], total)
            if i + 1 < n:
                total = _cell(stencil, i + 1, 2 * b, i, c == 5, around)
                total -= around[1, 0] + around[1, 2]
                weights[a, b, 2] = _ratio(around[0, 0] + around[0, 1] + around[0, 2], total)
                weights[a, b, 3] = _ratio(around[2, 0] + around[2, 1] + around[2, 2], total)
    for a in prange(rows):
        around = np.empty((3, 3), stencil.dtype)
        i = 2 * np.int64(a) + 1
        below = np.int64(a) + 1 if a + 1 < rows else 0
        for b in range(columns):
            if i < n and 2 * b + 1 < m:
                total = _cell(stencil, i, 2 * b + 1, i - 1, c == 5, around)
                left, right = around[1, 0], around[1, 2]
                above, under = around[0, 1], around[2, 1]
                beside_up = weights[a, b + 1, 2] if b + 1 < columns else 0.0
                beside_down = weights[a, b + 1, 3] if b + 1 < columns else 0.0
                weights[a, b, 4] = _ratio(
                    around[0, 0] + above * weights[a, b, 0] + left * weights[a, b, 2], total
                )
                weights[a, b, 5] = _ratio(
                    around[0, 2] + above * weights[a, b, 1] + right * beside_up, total
                )
                weights[a, b, 6] = _ratio(
                    around[2, 0] + under * weights[below, b, 0] + left * weights[a, b, 3], total
                )
                weights[a, b, 7] = _ratio(
                    around[2, 2] + under * weights[below, b, 1] + right * beside_down, total
                )
    return weights


@njit(cache=True, parallel=True)
def restrict(weights, fine, out):
    """out = P^T fine."""
    n, m = fine.shape
    rows, columns = out.shape
    for a in prange(rows):
        i = 2 * np.int64(a)
        over = np.int64(a) - 1 if a > 0 else rows - 1
        above = 2 * over + 1
        for b in range(columns):
            j = 2 * b
            value = fine[i, j]
            if j + 1 < m:
                value += weights[a, b, 0] * fine[i, j + 1]
            if b > 0:
                value += weights[a, b - 1, 1] * fine[i, j - 1]
            if i + 1 < n:
                value += weights[a, b, 2] * fine[i + 1, j]
                if j + 1 < m:
                    value += weights[a, b, 4] * fine[i + 1, j + 1]
                if b > 0:
                    value += weights[a, b - 1, 5] * fine[i + 1, j - 1]
            if above < n:
                value += weights[over, b, 3] * fine[above, j]
                if j + 1 < m:
                    value += weights[over, b, 6] * fine[above, j + 1]
                if b > 0:
                    value += weights[over, b - 1, 7] * fine[above, j - 1]
            out[a, b] = value


@njit(cache=True, parallel=True)
def prolong(weights, coarse, x):
    """x += P coarse."""
    n, m = x.shape
    rows, columns = coarse.shape
    for a in prange(rows):
        i = 2 * np.int64(a)
        below = np.int64(a) + 1 if a + 1 < rows else 0
        for b in range(columns):
            j = 2 * b
            w = weights[a, b]
            right = b + 1 if b + 1 < columns else b
            x[i, j] += coarse[a, b]
            if j + 1 < m:
                x[i, j + 1] += w[0] * coarse[a, b] + w[1] * coarse[a, right]
            if i + 1 < n:
                x[i + 1, j] += w[2] * coarse[a, b] + w[3] * coarse[below, b]
                if j + 1 < m:
                    x[i + 1, j + 1] += (
                        w[4] * coarse[a, b]
                        + w[5] * coarse[a, right]
                        + w[6] * coarse[below, b]
                        + w[7] * coarse[below, right]
                    )


@njit(cache=True)
def _parents(weights, i, j, parent_row, parent_column, share):
    """Coarse cells that a fine cell is interpolated from; returns how many."""
    rows, columns = weights.shape[:2]
    a, b = i // 2, j // 2
    below = a + 1 if a + 1 < rows else 0
    right = b + 1 if b + 1 < columns else b
    if i % 2 == 0 and j % 2 == 0:
        parent_row[0], parent_column[0], share[0] = a, b, 1.0
        return 1
    if i % 2 == 0:
        parent_row[0], parent_column[0], share[0] = a, b, weights[a, b, 0]
        parent_row[1], parent_column[1], share[1] = a, right, weights[a, b, 1]
        return 2
    if j % 2 == 0:
        parent_row[0], parent_column[0], share[0] = a, b, weights[a, b, 2]
        parent_row[1], parent_column[1], share[1] = below, b, weights[a, b, 3]
        return 2
    for k in range(4):
        parent_row[k] = a if k < 2 else below
        parent_column[k] = b if k % 2 == 0 else right
        share[k] = weights[a, b, 4 + k]
    return 4


@njit(cache=True, parallel=True)
def galerkin(stencil, weights):
    """The coarse matrix P^T A P as a stencil (N, M, 5); needs N >= 3 (offsets on the ring)."""
    n, m, c = stencil.shape
    rows, columns = weights.shape[:2]
    coarse = np.zeros((rows, columns, 5), stencil.dtype)
    for ring in prange(rows):
        a = np.int64(ring)
        around = np.empty((3, 3), stencil.dtype)
        parent_row, parent_column = np.empty(4, np.int64), np.empty(4, np.int64)
        share = np.empty(4, stencil.dtype)
        own_row, own_column = np.empty(4, np.int64), np.empty(4, np.int64)
        own = np.empty(4, stencil.dtype)
        for di in range(-1, 2):
            i = (2 * a + di) % n if a + di < 0 else 2 * a + di
            if i >= n or (di != 0 and i % 2 == 0):
                continue
            up = i - 1 if i > 0 else n - 1
            for b in range(columns):
                for dj in range(-1, 2):
                    j = 2 * b + dj
                    if j < 0 or j >= m:
                        continue
                    factor = 0.0
                    for k in range(_parents(weights, i, j, own_row, own_column, own)):
                        if own_row[k] == a and own_column[k] == b:
                            factor += own[k]
                    if factor == 0:
                        continue
                    total = _cell(stencil, i, j, up, c == 5, around)
                    around[1, 1] = -total
                    for gi in range(3):
                        for gj in range(3):
                            value = around[gi, gj]
                            if value == 0:
                                continue
                            i2 = i + gi - 1
                            if i2 < 0:
                                i2 = n - 1
                            if i2 == n:
                                i2 = 0
                            count = _parents(
                                weights, i2, j + gj - 1, parent_row, parent_column, share
                            )
                            for k in range(count):
                                _add(coarse, a, b, parent_row[k], parent_column[k],
                                     factor * value * share[k], rows)  # fmt: skip
    return coarse


@njit(cache=True, inline="always")
def _add(coarse, a, b, row, column, value, rows):
    """Add a coupling to (row, column) where the stencil of (a, b) keeps it."""
    down = row - a
    if down > 1:
        down -= rows
    elif down < -1:
        down += rows
    right = column - b
    if down == 0 and right == 0:
        coarse[a, b, 0] -= value
    elif down == 0 and right == 1:
        coarse[a, b, 1] += value
    elif down == 1:
        if right == 0:
            coarse[a, b, 2] += value
        elif right == 1:
            coarse[a, b, 3] += value
        else:
            coarse[a, b, 4] += value
