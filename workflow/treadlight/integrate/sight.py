"""Where a view's pixels lie on the tread, if the surface they were placed on was not the tread."""

from dataclasses import replace

import numpy as np
from scipy import ndimage

from treadlight.geometry import CylinderGrid
from treadlight.integrate.gather import ViewNormals

# Sections that tell together where the tread is: a cut that is narrower than one and a half of
# their distances is bridged.
_SECTIONS = 3
_PER_SPACING = 4
# A surface this many standard deviations off the tread is a cut, or a ghost.
_OFF_SIGMA = 4.0
_ROUNDS = 3


def bridged_surface(
    start: np.ndarray, std: float, spacing: float, grid: CylinderGrid
) -> np.ndarray:
    """A complete surface (n, m), with the median around wherever it is far off it.

    Parameters
    ----------
    start : (n, m) float
        First surface, mm.
    std : float
        Its usual standard deviation, mm.
    spacing : float
        Distance of sections, cells along theta.
    grid : CylinderGrid
    """
    stride = max(1, round(spacing / _PER_SPACING))
    rows = np.arange(0, grid.shape[0], stride)
    size = 2 * round(_SECTIONS * spacing / stride / 2) + 1
    mode = "wrap" if grid.periodic else "nearest"
    median = ndimage.median_filter(start[rows], (size, 1), mode=mode)
    nearest = np.minimum(np.rint(np.arange(grid.shape[0]) / stride).astype(int), len(rows) - 1)
    # Beside a wall either side of it is where the tread may be.
    low, high = (
        pick(median, (3, 1), mode=mode)[nearest]
        for pick in (ndimage.minimum_filter, ndimage.maximum_filter)
    )
    off = (start < low - _OFF_SIGMA * std) | (start > high + _OFF_SIGMA * std)
    return np.where(off, median[nearest], start)


def seen_on(view: ViewNormals, surface: np.ndarray, grid: CylinderGrid) -> ViewNormals:
    """The view with its scene points moved along their rays onto a surface (n, m), mm.

    The first surface has a cut wherever a section crosses one, as a block half the sections'
    distance wide. Of the pixels that were placed on its floor most show the tread, which the
    camera, looking in obliquely, sees elsewhere.
    """
    if view.camera is None:
        return view
    centre, encoder = view.camera[0], -view.camera[1]
    away = view.theta.astype(np.float64) + encoder
    ray = np.stack(
        [view.r * np.cos(away) - centre, view.r * np.sin(away), view.z - view.camera[2]], axis=-1
    )
    along = ray[..., 0] ** 2 + ray[..., 1] ** 2
    theta, z, r = (x.astype(np.float64) for x in (view.theta, view.z, view.r))
    for _ in range(_ROUNDS):
        r = _looked_up(surface, theta, z, grid)
        # Where |centre + share * ray| = r, on the near side of the axis.
        half = centre * ray[..., 0]
        with np.errstate(invalid="ignore"):
            root = np.sqrt(half**2 - along * (centre**2 - r**2))
            share = -(half + root) / along
        x, y = centre + share * ray[..., 0], share * ray[..., 1]
        theta, z = np.arctan2(y, x) - encoder, share * ray[..., 2] + view.camera[2]
    return replace(view, normal=_turned(view.normal, theta - view.theta), r=r, theta=theta, z=z)


def _turned(normal: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Normals in the local basis of places further along theta by an angle, rad."""
    c, s = np.cos(angle), np.sin(angle)
    n_r, n_theta, n_z = np.moveaxis(normal, -1, 0)
    return np.stack([c * n_r + s * n_theta, c * n_theta - s * n_r, n_z], axis=-1)


def _looked_up(
    surface: np.ndarray, theta: np.ndarray, z: np.ndarray, grid: CylinderGrid
) -> np.ndarray:
    """Values of the nearest cells; at the rim those of the last ones. NaN where a place is NaN."""
    row, column = grid.index(theta, z)
    known = np.isfinite(row) & np.isfinite(column)
    i = np.rint(np.where(known, row, 0)).astype(int)
    j = np.clip(np.rint(np.where(known, column, 0)).astype(int), 0, grid.shape[1] - 1)
    i = i % grid.shape[0] if grid.periodic else np.clip(i, 0, grid.shape[0] - 1)
    return np.where(known, surface[i, j], np.nan)
