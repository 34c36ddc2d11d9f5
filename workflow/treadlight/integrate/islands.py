"""Islands: a few cells that strong edges hold together, and only weak ones to all others.

Coarse cells do not know the level of an island that is hardly wider than they are, since they
belong to what is around it as well; one by one islands keep conjugate gradients from converging.
Their levels are a small system of their own, which is solved directly: deflation by subdomains
(Nicolaides, 1987), its steps in the order A-DEF2 (Tang, Nabben, Vuik and Erlangga, 2009). That is
as good as symmetric while the residual's sums over islands are 0, which the first correction
makes them.
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import SuperLU, splu

from treadlight.compiling import kernel
from treadlight.integrate.kernels import Stencil, neighbours
from treadlight.threads import by_ranges

# What of the strongest edge of either cell makes an edge strong (Ruge and Stueben, 1987).
_STRONG = 0.25
# The levels of larger ones coarse grids know.
_MOST_CELLS = 1000
# Where weights scatter everywhere the smallest islands stay out: so many cells for each, at least.
_CELLS_PER_ISLAND = 64
# What holds islands by less than this share of what couples them to each other is lost in the
# rounding of their pivots: nothing does.
_HELD = 1e-10
_LEAST_ISLANDS = 1 << 10


@dataclass(frozen=True)
class Islands:
    """The islands of a grid.

    Attributes
    ----------
    cells : (k,) int64
        Flat indices of their cells, one island after the other.
    first : (count + 1,) int64
        Where the cells of each begin.
    levels : SuperLU or None
        The matrix of their levels, factorised; None where there are no islands.
    """

    cells: np.ndarray
    first: np.ndarray
    levels: SuperLU | None

    def correct(self, stencil: Stencil, x: np.ndarray, rhs: np.ndarray) -> None:
        """Change the islands' levels in x so that rhs - A x sums up to 0 on each."""
        if self.levels is None:
            return
        defect = np.empty(len(self.first) - 1)
        lie = self.cells, self.first
        by_ranges(_sum_defects, len(defect), _LEAST_ISLANDS, *lie, stencil, x, rhs, defect)
        levels = self.levels.solve(defect).astype(x.dtype)
        by_ranges(_raise, len(levels), _LEAST_ISLANDS, *lie, levels, x)


def islands_of(stencil: Stencil) -> Islands:
    """The islands of a matrix without couplings to corners, (n, m).

    12 bytes a cell meanwhile, and some 70 for each cell of an island, 8 of which stay.
    """
    island = np.empty(stencil.data.size, np.int32)
    count = np.zeros(len(island), np.int32)
    _join(stencil, island)
    least = _least_cells(island, count)
    # Of this only what is written takes memory.
    sizes = np.empty(len(island), np.int64)
    sizes = sizes[: _number(island, count, least, sizes)]
    first = np.concatenate([np.zeros(1, np.int64), np.cumsum(sizes)])
    cells = np.empty(first[-1], np.int64)
    _list_cells(island, first[:-1].copy(), cells)
    return Islands(cells, first, _factorised(stencil, island, cells, len(sizes)))


def _least_cells(island: np.ndarray, count: np.ndarray) -> int:
    """Of how many cells an island has to be, so that there are not too many.

    From parents to roots, and from zeros to how many cells each root has.
    """
    histogram = np.zeros(_MOST_CELLS + 1, np.int64)
    _count(island, count, histogram)
    so_large = np.cumsum(histogram[::-1])[::-1]
    few = so_large <= len(island) // _CELLS_PER_ISLAND
    few[:2] = False
    return int(np.argmax(few)) if few.any() else _MOST_CELLS + 1


def _factorised(
    stencil: Stencil, island: np.ndarray, cells: np.ndarray, count: int
) -> SuperLU | None:
    if not count:
        return None
    held, between = np.zeros((2, count))
    pairs, weights = np.empty((2, 4 * len(cells)), np.int32), np.empty(4 * len(cells))
    found = _couple(cells, island, stencil, held, between, pairs, weights)
    shape = (count, count)
    matrix = sparse.coo_array((-weights[:found], tuple(pairs[:, :found])), shape=shape).tocsc()
    # Islands that only islands hold which nothing holds: one of them stays where it is.
    label = connected_components(matrix, directed=False)[1]
    firm = np.bincount(label, held) > _HELD * np.bincount(label, between)
    loose = np.unique(label, return_index=True)[1][~firm]
    held[loose] += np.maximum(between[loose], 1)
    symmetric = {"SymmetricMode": True}
    return splu(
        (matrix + sparse.diags_array(held + between)).tocsc(),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options=symmetric,
    )


@kernel
def _root(parent, cell):
    while parent[cell] != cell:
        parent[cell] = parent[parent[cell]]
        cell = parent[cell]
    return cell


@kernel
def _unite(parent, a, b):
    a, b = _root(parent, a), _root(parent, b)
    parent[max(a, b)] = min(a, b)


@kernel
def _strongest(stencil, i, out):
    """The strongest edge of each cell in a row."""
    n, m = stencil.data.shape
    up = neighbours(i, n)[0]
    for j in range(m):
        out[j] = max(stencil.below[i, j], stencil.below[up, j])
    for j in range(m - 1):
        right = stencil.right[i, j]
        out[j] = max(out[j], right)
        out[j + 1] = max(out[j + 1], right)


@kernel
def _strong(edges, one_side, other_side, out):
    part = edges.dtype.type(_STRONG)
    for j in range(len(out)):
        out[j] = edges[j] > 0 and edges[j] >= part * max(one_side[j], other_side[j])


@kernel(allocates=True)
def _join(stencil, parent):
    """Of every cell itself, or one before it that strong edges lead to, as its parent (n m,).

    Trees of cells, joined row by row (Rosenfeld and Pfaltz, 1966).
    """
    n, m = stencil.data.shape
    above, here = np.zeros((2, m), stencil.data.dtype)
    across_above, across, down = np.zeros((3, m), np.bool_)
    for i in range(n):
        _strongest(stencil, i, here)
        _strong(stencil.right[i], here[: m - 1], here[1:], across[1:])
        if i > 0:
            _strong(stencil.below[i - 1], above, here, down)
        for j in range(m):
            cell = i * m + j
            parent[cell] = parent[cell - 1] if across[j] else cell
            if down[j] and not (across[j] and across_above[j] and down[j - 1]):
                _unite(parent, cell - m, cell)
        above, here = here, above
        across_above, across = across, across_above
    _strongest(stencil, 0, here)
    _strong(stencil.below[n - 1], above, here, down)
    for j in range(m):
        if down[j]:
            _unite(parent, j, (n - 1) * m + j)


@kernel
def _count(island, count, histogram):
    """From parents to roots; cells of each root, and how many roots have so many cells."""
    for cell in range(len(island)):
        # A parent comes first and is a root by now.
        island[cell] = island[island[cell]]
        count[island[cell]] += 1
    for cell in range(len(island)):
        if 0 < count[cell] < len(histogram):
            histogram[count[cell]] += 1


@kernel
def _number(island, count, least, sizes):
    """From roots to the number of each cell's island, or -1; how many, and their `sizes`."""
    found = 0
    for cell in range(len(island)):
        if island[cell] == cell:
            if least <= count[cell] <= _MOST_CELLS:
                sizes[found] = count[cell]
                count[cell] = found
                found += 1
            else:
                count[cell] = -1
    for cell in range(len(island) - 1, -1, -1):
        island[cell] = count[island[cell]]
    return found


@kernel
def _list_cells(island, place, cells):
    for cell in range(len(island)):
        number = island[cell]
        if number >= 0:
            cells[place[number]] = cell
            place[number] += 1


@kernel
def _couple(cells, island, stencil, held, between, pairs, weights):
    """Couplings of `pairs` of islands; how many.

    To `held` goes what holds each island, data and edges to what is none, to `between` the sum of
    its edges to other islands.
    """
    n, m = stencil.data.shape
    found = 0
    for cell in cells:
        i, j = cell // m, cell % m
        up, down = neighbours(i, n)
        own = island[cell]
        held[own] += stencil.data[i, j]
        for side in range(4):
            if side == 0:
                weight, other = stencil.below[up, j], up * m + j
            elif side == 1:
                weight, other = stencil.below[i, j], down * m + j
            elif side == 2 and j > 0:
                weight, other = stencil.right[i, j - 1], cell - 1
            elif side == 3 and j < m - 1:
                weight, other = stencil.right[i, j], cell + 1
            else:
                continue
            if island[other] == own or not weight > 0:
                continue
            if island[other] < 0:
                held[own] += weight
            else:
                between[own] += weight
                pairs[0, found], pairs[1, found], weights[found] = own, island[other], weight
                found += 1
    return found


@kernel
def _sum_defects(first, last, cells, begin, stencil, x, rhs, out):
    """Sums of rhs - A x over islands."""
    n, m = x.shape
    for k in range(first, last):
        total = 0.0
        for place in range(begin[k], begin[k + 1]):
            i, j = cells[place] // m, cells[place] % m
            up, down = neighbours(i, n)
            here = np.float64(x[i, j])
            total += rhs[i, j] - stencil.data[i, j] * here
            total -= stencil.below[i, j] * (here - x[down, j])
            total -= stencil.below[up, j] * (here - x[up, j])
            if j > 0:
                total -= stencil.right[i, j - 1] * (here - x[i, j - 1])
            if j < m - 1:
                total -= stencil.right[i, j] * (here - x[i, j + 1])
        out[k] = total


@kernel
def _raise(first, last, cells, begin, levels, x):
    m = x.shape[1]
    for k in range(first, last):
        for place in range(begin[k], begin[k + 1]):
            x[cells[place] // m, cells[place] % m] += levels[k]
