"""The void ratio: how much of the tread is grooves, slots and sipes."""

import numpy as np

from treadlight.tread.regions import OUTSIDE, TOP, Regions

# Standard deviation of an edge that lies anywhere in its cell.
_EDGE_CELLS = 12**-0.5


def void_ratio(r: np.ndarray, theta: np.ndarray, regions: Regions) -> tuple[float, float]:
    """Area of the voids over the area of the whole tread between its shoulders.

    Parameters
    ----------
    r : (n, m) float
        mm, on the regions' columns; NaN = missing, and left out of both areas.
    theta : (n,) float
        rad.
    regions : Regions

    Returns
    -------
    share, std : float
        The standard uncertainty is an upper bound: as if all edges were off to the same side.
        NaN where nothing is known.
    """
    classes = regions.classify(r, theta)
    known = np.isfinite(r) & (classes != OUTSIDE)
    land, void = known & (classes == TOP), known & (classes != TOP)
    total = known.sum()
    if not total:
        return np.nan, np.nan
    edges = sum(
        (a[before] & b[after]).sum()
        for a, b in ((land, void), (void, land))
        for before, after in (
            ((slice(None, -1), slice(None)), (slice(1, None), slice(None))),
            ((slice(None), slice(None, -1)), (slice(None), slice(1, None))),
        )
    )
    return float(void.sum() / total), float(_EDGE_CELLS * edges / total)
