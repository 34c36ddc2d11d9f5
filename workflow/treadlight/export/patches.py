"""Patches of rib tops, on which areal parameters are taken."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from treadlight.geometry import CylinderGrid
from treadlight.tread import TOP, Regions

_PATCHES_PER_RIB = 12
# A patch of which less is top says more of slots than of the rubber.
_LEAST_SHARE = 0.3
# The edges of slots and sipes are rounded, in rubber and in measurement.
_EDGE_MM = 1.0


@dataclass(frozen=True)
class Patch:
    """A square piece of a rib.

    Attributes
    ----------
    rib : int
    theta_rad, z_mm : float
        Its middle.
    height : (n, m) float
        mm; NaN off the tops and where nothing is known.
    share : float
        Of its cells that are known tops.
    """

    rib: int
    theta_rad: float
    z_mm: float
    height: np.ndarray
    share: float


def rib_patches(
    r: np.ndarray, height: np.ndarray, grid: CylinderGrid, regions: Regions
) -> Iterator[Patch]:
    """Squares as wide as each rib, evenly spaced, at most 12 per rib; slots and sipes are NaN.

    Parameters
    ----------
    r, height : (n, m) float
        mm; NaN = missing.
    grid : CylinderGrid
    regions : Regions
        On the grid's columns.
    """
    for rib, (low, high) in enumerate(regions.ribs, 1):
        columns = np.flatnonzero(regions.rib_of_column == rib)
        rows = round((high - low) / (grid.step_theta * grid.nominal_radius_mm))
        count = min(_PATCHES_PER_RIB, len(r) // max(1, rows))
        for start in np.linspace(0, len(r) - rows, count).astype(int) if count else ():
            span = slice(start, start + rows)
            classes = regions.classify(r[span], grid.theta[span])[:, columns]
            top = ndimage.minimum_filter(classes == TOP, _edge_cells(grid), mode="nearest")
            cells = np.where(top, height[span][:, columns], np.nan)
            share = float(np.isfinite(cells).mean())
            if share >= _LEAST_SHARE:
                middle = float(grid.theta[span].mean())
                yield Patch(rib, middle, 0.5 * (low + high), cells, share)


def _edge_cells(grid: CylinderGrid) -> tuple[int, int]:
    """Size of a filter that reaches over an edge, cells along theta and z."""
    sides = (grid.step_theta * grid.nominal_radius_mm, grid.step_z)
    along, across = (2 * int(np.ceil(_EDGE_MM / side)) + 1 for side in sides)
    return along, across
