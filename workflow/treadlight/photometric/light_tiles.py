"""How much light LEDs send to what an image's pixels see, asked at a few places of each tile.

Light from hundreds of millimetres away hardly changes over a tile of pixels. So an LED is asked at
27 places of the box that holds a tile's points, and 1 / irradiance, which goes with the square of
the distance, is a polynomial between them, quadratic in angle, place along the axis and radius.
That is within 1e-6 of what the LED sends where tiles are a few millimetres wide, 1e-5 where
16; where a tile lies across the border of an LED's map, within 1e-4 on a full rig.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np

from treadlight.compiling import kernel
from treadlight.threads import by_ranges

# Pixels of a tile.
_ROWS, _COLUMNS = 16, 32
_LEAST_TILES = 1 << 6
# Half of a box's extent at least, rad and mm: a tile may be a single pixel.
_LEAST_HALF = 1e-6
# Places in a box, from -1 to 1 along phi, z and r; and the powers of each term.
_PLACES = np.array(list(product((-1.0, 0.0, 1.0), repeat=3)))
_ACROSS = ((0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (2, 0))
_POWERS = np.array([(a, b, c) for c in (0, 1, 2) for a, b in _ACROSS])
_TERMS = np.linalg.pinv(np.prod(_PLACES[:, None] ** _POWERS, axis=2))


@dataclass(frozen=True)
class Tiles:
    """Tiles of pixels, row by row, and boxes that hold the points that these see.

    Attributes
    ----------
    shape : (int, int)
        Rows and columns of pixels in a tile.
    middle, half : (n_tiles, 3) float64
        Of the boxes, phi, z and r in {V}, rad and mm; NaN where no point is known.
    """

    shape: tuple[int, int]
    middle: np.ndarray
    half: np.ndarray

    @property
    def places(self) -> np.ndarray:
        """Where light is asked for, (27 n_tiles, 3): phi, z, r in {V}."""
        return (self.middle[:, None] + self.half[:, None] * _PLACES).reshape(-1, 3)

    def terms(self, irradiance: np.ndarray) -> np.ndarray:
        """Terms (n_tiles, 18) float32 of 1 / irradiance, as `add_terms` adds them up.

        From the irradiance (27 n_tiles,) at `places`; NaN in a whole tile where at any of its
        places none is known or there is no light, as behind an LED.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            return ((1.0 / irradiance).reshape(-1, len(_PLACES)) @ _TERMS.T).astype(np.float32)


def tiles_of(points: np.ndarray, width: int | None) -> Tiles:
    """The tiles of points (n, 3), phi, z, r in {V}, of an image's pixels with `width` in a row.

    Without a width, every point is a tile.
    """
    shape, width = ((1, 1), max(len(points), 1)) if width is None else ((_ROWS, _COLUMNS), width)
    rows = -(-len(points) // width)
    across = -(-width // shape[1])
    boxes = np.empty((-(-rows // shape[0]) * across, 2, 3))
    by_ranges(_bound, len(boxes), _LEAST_TILES, points, width, shape, across, boxes)
    low, high = boxes[:, 0], boxes[:, 1]
    return Tiles(shape, 0.5 * (low + high), np.maximum(0.5 * (high - low), _LEAST_HALF))


@kernel
def _bound(first, last, points, width, shape, across, boxes):
    """Least and most of the known points of tiles first to last - 1; NaN where there are none."""
    for tile in range(first, last):
        low, high = boxes[tile, 0], boxes[tile, 1]
        low[:], high[:] = np.inf, -np.inf
        row, column = tile // across * shape[0], tile % across * shape[1]
        for v in range(row, row + shape[0]):
            begin = v * width + column
            for k in range(begin, min(len(points), begin + shape[1], (v + 1) * width)):
                # No comparison with NaN holds.
                for c in range(3):
                    value = points[k, c]
                    low[c] = value if value < low[c] else low[c]
                    high[c] = value if value > high[c] else high[c]
        if not high[2] >= low[2]:
            low[:], high[:] = np.nan, np.nan


@kernel
def add_terms(terms, columns, places, out):
    """1 / irradiance of a row of pixels: of the tiles that it crosses, `columns` wide.

    Parameters
    ----------
    terms : (tiles, 18) float32
        Of an LED, see `Tiles.terms`.
    places : (3, n) float32
        Where each pixel's point lies in its tile's box, from -1 to 1.
    out : (n,) float32
    """
    for tile in range(len(terms)):
        begin = tile * columns
        a0, a1, a2, a3, a4, a5 = terms[tile, 0:6]
        b0, b1, b2, b3, b4, b5 = terms[tile, 6:12]
        c0, c1, c2, c3, c4, c5 = terms[tile, 12:18]
        for k in range(begin, min(begin + columns, len(out))):
            p, q, r = places[0, k], places[1, k], places[2, k]
            level = a0 + q * (a1 + q * a2) + p * (a3 + q * a4 + p * a5)
            slope = b0 + q * (b1 + q * b2) + p * (b3 + q * b4 + p * b5)
            curve = c0 + q * (c1 + q * c2) + p * (c3 + q * c4 + p * c5)
            out[k] = level + r * (slope + r * curve)
