"""The pixels of a capture too large for the memory, some rows of the turn after the other."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from treadlight.geometry import CylinderGrid
from treadlight.integrate.profile import Profile
from treadlight.integrate.uncertainty import HeldOut

# What slopes carry from beyond a band's end is forgotten over so many cells.
_MARGIN_CELLS = 4
_MASKS = ("laser", "photometric", "step", "shadowed", "saturated")


@dataclass(frozen=True)
class Band:
    """Some rows of a grid.

    Attributes
    ----------
    rows : (k,) int
        Rows of the whole grid, consecutive modulo its length.
    grid : CylinderGrid
        Of these rows.
    core : slice
        Of the k rows, those that no other band has in its core.
    """

    rows: np.ndarray
    grid: CylinderGrid
    core: slice


def bands_of(grid: CylinderGrid, width: int, most_pixels: int) -> Iterator[Band]:
    """Bands of about `most_pixels`, and no fewer than their margins have.

    One, if cells are pixels or the grid has no more.

    Parameters
    ----------
    grid : CylinderGrid
        Of the pixels.
    width : int
        Pixels along the side of a cell that was solved.
    most_pixels : int
    """
    n, m = grid.shape
    margin = _MARGIN_CELLS * width
    core = max(most_pixels // m - 2 * margin, 2 * margin)
    count = -(-n // core)
    bounds = np.linspace(0, n, count + 1).round().astype(int)
    if width == 1 or count == 1 or np.diff(bounds).max() + 2 * margin >= n:
        yield Band(np.arange(n), grid, slice(0, n))
        return
    for first, last in pairwise(bounds):
        rows = np.arange(first - margin, last + margin)
        if not grid.periodic:
            rows = rows[(rows >= 0) & (rows < n)]
        core_rows = slice(int(first - rows[0]), int(last - rows[0]))
        yield Band(rows % n, grid.part(rows % n), core_rows)


class Joined:
    """The profile of a whole grid (n, m), laid from those of its bands.

    Parameters
    ----------
    shape : (n, m)
    empty : function of a shape and a dtype
        Makes the arrays, in memory or in files.
    """

    def __init__(
        self, shape: tuple[int, int], empty: Callable[[tuple[int, ...], type], np.ndarray]
    ) -> None:
        self._figures: list[tuple[int, int, tuple[float, float]]] = []
        self._arrays = {
            "r": empty(shape, np.float64),
            "r_std": empty(shape, np.float32),
            "normal": empty((*shape, 3), np.float32),
            "material": empty((3, *shape), np.float32),
            **{name: empty(shape, np.bool_) for name in _MASKS},
        }

    def add(self, part: Profile, band: Band) -> None:
        """Lay a band's core."""
        rows = band.rows[band.core]
        for name, into in self._arrays.items():
            own = getattr(part, name)
            if name == "material":
                into[:, rows] = own[:, band.core]
            else:
                into[rows] = own[band.core]
        lit = int(part.photometric[band.core].sum())
        self._figures.append((part.laser_points, lit, part.normal_residual))

    def profile(self, held_out: HeldOut) -> Profile:
        """What was laid, with the figures of all bands; normals' quantiles by their mean."""
        points, lit, residual = zip(*self._figures, strict=True)
        median, high = (_mean(values, np.array(lit)) for values in np.array(residual).T)
        return Profile(
            **self._arrays,
            held_out=held_out,
            laser_points=sum(points),
            normal_residual=(median, high),
        )


def _mean(values: np.ndarray, weight: np.ndarray) -> float:
    """Weighted mean of what is known; NaN where nothing is."""
    known = np.isfinite(values) & (weight > 0)
    return float(np.average(values[known], weights=weight[known])) if known.any() else np.nan
