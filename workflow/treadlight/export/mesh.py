"""A profile as points and triangles."""

import numpy as np

from treadlight.geometry import CylinderGrid


def coarser(values: np.ndarray, sides: tuple[int, int]) -> np.ndarray:
    """Means over blocks of cells.

    Parameters
    ----------
    values : (n, m) float
        NaN = missing.
    sides : (int, int)
        Cells per block along theta and z, see `block_sides`.

    Returns
    -------
    (n // sides[0], m // sides[1]) float64
        NaN where fewer than half the cells of a block are known. What is left over at the ends is
        dropped.
    """
    tall, wide = sides
    rows, columns = values.shape[0] // tall, values.shape[1] // wide
    blocks = values[: rows * tall, : columns * wide].reshape(rows, tall, columns, wide)
    known = np.isfinite(blocks)
    count = known.sum(axis=(1, 3))
    total = np.where(known, blocks, 0.0).sum(axis=(1, 3))
    return np.where(2 * count >= tall * wide, total / np.maximum(count, 1), np.nan)


def block_sides(grid: CylinderGrid, step_mm: float) -> tuple[int, int]:
    """Cells per block along theta and z, so that each side is at least `step_mm` long."""
    sides = (grid.step_theta * grid.nominal_radius_mm, grid.step_z)
    tall, wide = (max(1, int(np.ceil(step_mm / side - 1e-6))) for side in sides)
    return min(tall, grid.shape[0]), min(wide, grid.shape[1])


def coarser_grid(grid: CylinderGrid, sides: tuple[int, int]) -> CylinderGrid:
    """The grid of `coarser`."""
    tall, wide = sides
    rows, columns = grid.shape[0] // tall, grid.shape[1] // wide
    return CylinderGrid(
        grid.theta[: rows * tall].reshape(rows, tall).mean(axis=1),
        grid.z[: columns * wide].reshape(columns, wide).mean(axis=1),
        grid.nominal_radius_mm,
    )


def to_cartesian(r: np.ndarray, theta: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Points (n, m, 3) in mm of radii (n, m) at theta (n,) rad and z (m,) mm.

    x is theta = 0, y is theta = pi/2, z the axis: {T} as a right-handed Cartesian frame.
    """
    x, y = r * np.cos(theta)[:, None], r * np.sin(theta)[:, None]
    return np.stack([x, y, np.broadcast_to(z, r.shape)], axis=2)


def triangles(known: np.ndarray, whole_turn: bool) -> tuple[np.ndarray, np.ndarray]:
    """Two triangles per square of four known cells, outward faces counter-clockwise.

    Parameters
    ----------
    known : (n, m) bool
    whole_turn : bool
        Whether the last row is a neighbour of the first.

    Returns
    -------
    vertices : (k,) int64
        Flat indices of the cells that are vertices: the known ones.
    corners : (t, 3) int32
        Into `vertices`.
    """
    vertices = np.flatnonzero(known)
    flat = np.full(known.size, -1, np.int32)
    flat[vertices] = np.arange(len(vertices), dtype=np.int32)
    number = flat.reshape(known.shape)
    if whole_turn:
        number = np.concatenate([number, number[:1]])
    a, b = number[:-1, :-1], number[1:, :-1]
    c, d = number[1:, 1:], number[:-1, 1:]
    whole = np.minimum(np.minimum(a, b), np.minimum(c, d)) >= 0
    a, b, c, d = a[whole], b[whole], c[whole], d[whole]
    return vertices, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
