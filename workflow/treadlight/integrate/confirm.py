"""What of the slopes' slow relief the laser confirms.

Errors of neighbouring normals go together over millimetres: texture below the pixel, light from
the walls around. Integrated, they look like relief, and no pixel's covariance knows of them. The
sections do: the regression of the laser's slopes on the photometric ones, between the same points,
tells which share of the deviation from the tread's outline is real.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy import ndimage

from treadlight.geometry import CylinderGrid
from treadlight.integrate.gather import ViewField
from treadlight.integrate.laser import LaserCells
from treadlight.integrate.pairs import laser_pairs

# Slow is what a Gaussian of so many sections' distances leaves: finer relief, texture and the
# edges of blocks, the sections are too far apart to judge.
_SLOW = 1 / 9
# A Gaussian mean over columns has the noise of a plain mean over this many sigmas.
_FOOTPRINT = 2 * np.sqrt(np.pi)
# Deviations beyond so many of their spreads are no error: they keep their part the more.
_USUAL = 2.0
_TRIM = 4.0
_LEAST_GROUPS = 30


def confirm(
    fields: Sequence[ViewField],
    laser: LaserCells,
    outline: np.ndarray,
    steps: np.ndarray,
    spacing: float,
    grid: CylinderGrid,
) -> list[ViewField]:
    """Views whose slow deviations from the outline are drawn in to the share that is confirmed.

    Parameters
    ----------
    fields : sequence of ViewField
        Without their bias.
    laser : LaserCells
    outline : (n, m) float
        Surface of revolution that the tread follows, mm.
    steps : (n, m) bool
        Where the first surface has a step.
    spacing : float
        Distance of sections, cells along theta.
    grid : CylinderGrid
    """
    sigma = max(1.0, _SLOW * spacing)
    shares = confirmed_shares(fields, laser, outline, steps, spacing, sigma, grid)
    usual = _outline_slopes(outline, grid)
    calm = ~ndimage.maximum_filter(steps, 3)
    drawn = []
    for field in fields:
        slope = field.slope.copy()
        for axis, share in enumerate(shares):
            away = np.where(calm[field.rows], slope[axis] - usual[axis][field.rows], np.nan)
            slope[axis] -= (1 - share) * _slow_part(away, sigma)
        drawn.append(replace(field, slope=slope))
    return drawn


def confirmed_shares(
    fields: Sequence[ViewField],
    laser: LaserCells,
    outline: np.ndarray,
    steps: np.ndarray,
    spacing: float,
    sigma: float,
    grid: CylinderGrid,
) -> tuple[float, float]:
    """Regression of the laser's slopes on the photometric ones, along theta and z, in [0, 1].

    Both as deviations from the outline, averaged over as many columns as a Gaussian of `sigma`
    cells spans. 1 where too few points tell.
    """
    width = max(1, round(_FOOTPRINT * sigma))
    ours: list[list[np.ndarray]] = [[], []]
    theirs: list[list[np.ndarray]] = [[], []]
    for field in fields:
        for pairs in laser_pairs(field, laser, steps, spacing, grid):
            a, b = pairs.start, pairs.end
            usual = outline[laser.row[b], laser.column[b]] - outline[laser.row[a], laser.column[a]]
            group = laser.section[a] * grid.shape[1] + pairs.middle[1] // width
            _, place = np.unique(group, return_inverse=True)
            count = np.bincount(place)
            full = count >= width / 2
            for values, into in (
                (pairs.rise - pairs.excess - usual, ours),
                (pairs.rise - usual, theirs),
            ):
                mean = np.bincount(place, values / pairs.length) / count
                into[pairs.axis].append(mean[full])
    if not fields:
        return 1.0, 1.0
    along, across = (
        _share(np.concatenate(x), np.concatenate(y)) for x, y in zip(ours, theirs, strict=True)
    )
    return along, across


def _share(ours: np.ndarray, theirs: np.ndarray) -> float:
    """Slope of a regression through the origin over what is usual in both, in [0, 1]."""
    if len(ours) < _LEAST_GROUPS:
        return 1.0
    usual = np.ones(len(ours), bool)
    for values in (ours, theirs):
        usual &= np.abs(values) < _TRIM * 1.4826 * np.median(np.abs(values)) + 1e-12
    x, y = ours[usual], theirs[usual]
    power = float(x @ x)
    if len(x) < _LEAST_GROUPS or power == 0:
        return 1.0
    share = float(x @ y) / power
    # On the side of the light: one standard error more than the best estimate.
    error = float(np.sqrt(np.sum((y - share * x) ** 2) / len(x) / power))
    return float(np.clip(share + error, 0.0, 1.0))


def _outline_slopes(outline: np.ndarray, grid: CylinderGrid) -> tuple[np.ndarray, np.ndarray]:
    """dr / (r dtheta) and dr / dz of a surface, (n, m) each."""
    if grid.periodic:
        ahead, behind = np.roll(outline, -1, axis=0), np.roll(outline, 1, axis=0)
        along = (ahead - behind) / (2 * grid.step_theta)
    else:
        along = np.gradient(outline, grid.step_theta, axis=0)
    return along / outline, np.gradient(outline, grid.step_z, axis=1)


def _slow_part(away: np.ndarray, sigma: float) -> np.ndarray:
    """Gaussian mean of deviations (k, m; NaN = none), less of it the more it stands out."""
    known = np.isfinite(away)
    weight = ndimage.gaussian_filter(known.astype(np.float32), sigma)
    total = ndimage.gaussian_filter(np.where(known, away, 0).astype(np.float32), sigma)
    slow = np.where(known, total / np.maximum(weight, 1e-6), 0)
    spread = 1.4826 * float(np.median(np.abs(slow[known]))) if known.any() else 0.0
    if spread == 0:
        return np.zeros_like(slow)
    return slow / (1 + (slow / (_USUAL * spread)) ** 2)
