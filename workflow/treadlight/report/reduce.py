"""Maps brought down to the size of a page."""

from collections.abc import Callable

import numpy as np

# About this many cells are read at once.
_CELLS = 4_000_000


def reduce_map(
    read: Callable[[slice], np.ndarray], shape: tuple[int, int], limit: tuple[int, int]
) -> np.ndarray:
    """Means over blocks of cells, so that at most `limit` blocks remain.

    A block is NaN where fewer than half its cells are finite: a border or a hole neither
    spreads nor shrinks.

    Parameters
    ----------
    read : callable
        Rows of the map, (rows, m) float, for a slice.
    shape : (int, int)
        Of the map.
    limit : (int, int)
        Most blocks along both axes.

    Returns
    -------
    (a, b) float32
        The last block along an axis may hold fewer cells than the others.
    """
    tall, wide = block_size(shape, limit)
    rows = max(1, _CELLS // (shape[1] * tall)) * tall
    slabs = [
        _block_means(read(slice(start, min(start + rows, shape[0]))), (tall, wide))
        for start in range(0, shape[0], rows)
    ]
    return np.concatenate(slabs)


def block_size(shape: tuple[int, int], limit: tuple[int, int]) -> tuple[int, int]:
    """Cells per block along both axes."""
    return max(1, -(-shape[0] // limit[0])), max(1, -(-shape[1] // limit[1]))


def _block_means(values: np.ndarray, block: tuple[int, int]) -> np.ndarray:
    known = np.isfinite(values)
    total = _sums(np.where(known, values, 0).astype(np.float64), block)
    count = _sums(known.astype(np.float64), block)
    cells = _sums(np.ones(values.shape), block)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(2 * count >= cells, total / count, np.nan).astype(np.float32)


def _sums(values: np.ndarray, block: tuple[int, int]) -> np.ndarray:
    rows = np.arange(0, values.shape[0], block[0])
    columns = np.arange(0, values.shape[1], block[1])
    return np.add.reduceat(np.add.reduceat(values, rows, axis=0), columns, axis=1)
