"""Checkerboard corners in an image: found by OpenCV, placed by a model of the image around each."""

from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np

from treadlight.calibrate.saddle import fit_saddles

# Above this many pixels a board is first looked for in a smaller image: the detectors' time
# grows with the area, and a board that fills a useful part of the field is as plain there.
_SEARCH_PIXELS = 2_000_000
# Below this many pixels a side no board of useful size can be told.
_MIN_SEARCH_SIDE = 200
# Share of the distance to the nearest corner that the window of a fit may cover; at one half
# it would take in the next corners' edges.
_WINDOW_SHARE = 0.4
# Half-width of the largest window: what a fit costs grows with its square.
_MOST_HALF_PX = 20
# Edges softer than this have nothing to show in finer pixels.
_SOFT_PX = 2.0


def find_corners(intensity: np.ndarray, inner_corners: tuple[int, int]) -> np.ndarray | None:
    """Inner corners of a checkerboard, columns running fastest, or None where none is found.

    Parameters
    ----------
    intensity : (h, w) float
        Linear.
    inner_corners : (int, int)
        Columns and rows.

    Returns
    -------
    (n, 2) float64 or None
        Pixels, to some hundredths.
    """
    image = to_8bit(intensity)
    for small, factor in _search_images(image):
        raw = _search(small, inner_corners)
        if raw is not None:
            return _refine(intensity, _ordered(_to_full(raw, factor), inner_corners), inner_corners)
    return None


def to_8bit(intensity: np.ndarray) -> np.ndarray:
    """Linear intensity (h, w) as 8-bit counts for a detector: stretched, square root.

    The square root keeps the dark squares apart from black.
    """
    low, high = np.percentile(intensity, [1, 99.5])
    scale = max(float(high - low), 1e-9)
    return (255 * np.sqrt(np.clip((intensity - low) / scale, 0, 1)) + 0.5).astype(np.uint8)


def object_points(inner_corners: tuple[int, int], square_mm: float) -> np.ndarray:
    """Corners (n, 3) float64 in the board's frame, mm; columns run fastest, z = 0."""
    columns, rows = inner_corners
    y, x = np.mgrid[:rows, :columns]
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]) * square_mm


def _search(image: np.ndarray, inner_corners: tuple[int, int]) -> np.ndarray | None:
    """Corners to a pixel or so. The second detector costs a hundred times the first."""
    found, corners = cv2.findChessboardCorners(image, inner_corners)
    if not found:
        flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
        found, corners = cv2.findChessboardCornersSB(image, inner_corners, flags=flags)
    return np.asarray(corners) if found else None


def _refine(
    intensity: np.ndarray, corners: np.ndarray, inner_corners: tuple[int, int]
) -> np.ndarray:
    """Fits in the smallest image whose window suffices, then in finer ones while it is sharp."""
    half = _WINDOW_SHARE * _spacing(corners, inner_corners)
    factor = max(1.0, half / _MOST_HALF_PX)
    while True:
        small, scale = _shrunk(intensity, factor)
        size = max(2, min(int(half / factor), _MOST_HALF_PX))
        start = ((corners + 0.5) / scale - 0.5).reshape(inner_corners[1], inner_corners[0], 2)
        saddles = fit_saddles(small, start, size)
        corners = _to_full(saddles.position, scale)
        if factor == 1.0 or np.median(saddles.softness_px) > _SOFT_PX:
            return corners
        factor = max(1.0, 0.5 * factor)


def _search_images(image: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """The image and how much smaller it is (across, down): as large as is worth it, then smaller.

    A board out of focus has no corners at full size, but has some when it is shrunk.
    """
    factor = max(1.0, float(np.sqrt(image.size / _SEARCH_PIXELS)))
    yield _shrunk(image, factor)
    while min(image.shape) / (2 * factor) >= _MIN_SEARCH_SIDE:
        factor *= 2
        yield _shrunk(image, factor)


def _shrunk(image: np.ndarray, factor: float) -> tuple[np.ndarray, np.ndarray]:
    if factor == 1.0:
        return image, np.ones(2)
    full = np.array(image.shape[::-1])
    size = np.round(full / factor).astype(int)
    # Sizes are whole numbers, so the factors are not quite the one that was wanted.
    small = cv2.resize(image, size.tolist(), interpolation=cv2.INTER_AREA)
    return np.asarray(small), full / size


def _to_full(corners: Any, factor: np.ndarray) -> np.ndarray:
    # Pixel centres are whole numbers, so the scaling is about the corner (-0.5, -0.5).
    return (corners.reshape(-1, 2).astype(np.float64) + 0.5) * factor - 0.5


def _spacing(corners: np.ndarray, inner_corners: tuple[int, int]) -> float:
    grid = corners.reshape(inner_corners[1], inner_corners[0], 2)
    along = np.linalg.norm(np.diff(grid, axis=1), axis=2).min()
    return float(min(along, np.linalg.norm(np.diff(grid, axis=0), axis=2).min()))


def _ordered(corners: np.ndarray, inner_corners: tuple[int, int]) -> np.ndarray:
    """The corners in an order that is not mirrored: the board's z points away from the camera."""
    grid = corners.reshape(inner_corners[1], inner_corners[0], 2)
    across, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    if across[0] * down[1] - across[1] * down[0] < 0:
        grid = grid[:, ::-1]
    return np.ascontiguousarray(grid.reshape(-1, 2))


def symmetric_orders(inner_corners: tuple[int, int]) -> list[np.ndarray]:
    """Index arrays (n,) that reorder corners as if the board were turned in its plane.

    A detector may start at any corner of the board: two orders fit an oblong board, four a
    square one.
    """
    columns, rows = inner_corners
    index = np.arange(columns * rows).reshape(rows, columns)
    turns = range(4) if columns == rows else (0, 2)
    return [np.rot90(index, turn).ravel() for turn in turns]
