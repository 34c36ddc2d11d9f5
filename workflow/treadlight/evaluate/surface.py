"""The true surface: looked up at any grid, split into classes, with its normals."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from treadlight.evaluate.truth import Profile
from treadlight.geometry import CylinderGrid

# The definitions of evaluation.md; all lengths in mm.
_ENVELOPE_PERCENTILE = 98
_CLOSING_MM = 10.0
_WALL_SLOPE = 0.35
_WALL_BLUR_MM = 0.5
_WALL_MARGIN_MM = 1.0
_TOP_DEPTH_MM = 1.2
_DEEP_DEPTH_MM = 5.0
_GROOVE_DEPTH_MM = 4.0
_GROOVE_SHARE = 0.6
CLASSES = ("top", "floor", "slot", "deep", "wall")


@dataclass(frozen=True)
class Surface:
    """The truth, looked up at the cells of a result.

    Attributes
    ----------
    r : (n, m) float64
        True radius, mm, interpolated linearly; NaN outside the truth.
    envelope : (m,) float64
        Radius of the outline that bridges the grooves, mm, at the z of the cells.
    classes : dict of str to (n, m) bool
        The class of the nearest true cell, only where `r` is finite.
    extent : dict of str to float or None
        Share of each class of the truth that lies on the cells at all: coverage counts the
        result's own cells, this tells what they leave out.
    """

    r: np.ndarray
    envelope: np.ndarray
    classes: dict[str, np.ndarray]
    extent: dict[str, float | None]


def truth_grid(truth: Profile) -> CylinderGrid:
    """The grid of a true profile; its nominal radius is the median of the surface's."""
    return CylinderGrid(truth.theta, truth.z, float(np.nanmedian(truth.r)))


def look_up(truth: Profile, theta: np.ndarray, z: np.ndarray) -> Surface:
    """The true surface and its classes at the cell centres of a result.

    Parameters
    ----------
    truth : Profile
    theta : (n,) float
        Rad, compared modulo 2 pi.
    z : (m,) float
        mm.
    """
    envelope = outer_envelope(truth)
    found = classify(truth, envelope)
    r = interpolate(truth, truth.r, theta, z)
    rows, columns = truth_grid(truth).index(theta, z)
    rows = _nearest(rows, len(truth.theta), truth_grid(truth).periodic)
    columns = _nearest(columns, len(truth.z), False)
    known = np.isfinite(r)
    classes = {name: mask[np.ix_(rows, columns)] & known for name, mask in found.items()}
    extent = _extent(truth, found, CylinderGrid(theta, z, 1.0))
    return Surface(r, np.interp(z, truth.z, envelope), classes, extent)


def _extent(
    truth: Profile, classes: dict[str, np.ndarray], grid: CylinderGrid
) -> dict[str, float | None]:
    rows, columns = grid.index(truth.theta, truth.z)
    reached = np.ix_(
        grid.periodic | ((rows >= -0.5) & (rows <= grid.shape[0] - 0.5)),
        (columns >= -0.5) & (columns <= grid.shape[1] - 0.5),
    )
    return {
        name: float(mask[reached].sum() / mask.sum()) if mask.any() else None
        for name, mask in classes.items()
    }


def _nearest(index: np.ndarray, count: int, periodic: bool) -> np.ndarray:
    nearest = np.rint(index).astype(int)
    return nearest % count if periodic else np.clip(nearest, 0, count - 1)


def outer_envelope(truth: Profile) -> np.ndarray:
    """The outline that bridges the grooves and follows the crown, (m,) mm, per z column."""
    known = np.isfinite(truth.r).any(axis=0)
    outline = np.full(len(truth.z), -np.inf)
    outline[known] = np.nanpercentile(truth.r[:, known], _ENVELOPE_PERCENTILE, axis=0)
    width = 2 * round(_CLOSING_MM / truth_grid(truth).step_z) + 1
    # Outside the image of the tread there is nothing: neither filter may take a value from there.
    raised = ndimage.maximum_filter1d(outline, width, mode="constant", cval=-np.inf)
    closed = ndimage.minimum_filter1d(raised, width, mode="constant", cval=np.inf)
    return np.where(known, closed, np.nan)


def classify(truth: Profile, envelope: np.ndarray) -> dict[str, np.ndarray]:
    """Top, floor, slot, deep and wall of every true cell, (n, m) bool each."""
    grid = truth_grid(truth)
    depth = envelope - truth.r
    wall = _walls(truth, grid)
    clear = _distance_mm(wall, grid) > _WALL_MARGIN_MM
    with np.errstate(invalid="ignore"):
        groove = depth > _GROOVE_DEPTH_MM
        top = (depth < _TOP_DEPTH_MM) & clear
        deep = (depth > _DEEP_DEPTH_MM) & clear
    known = np.isfinite(depth).sum(axis=0)
    circumferential = groove.sum(axis=0) >= _GROOVE_SHARE * np.maximum(known, 1)
    floor = deep & circumferential
    return {"top": top, "floor": floor, "slot": deep & ~floor, "deep": deep, "wall": wall}


def _walls(truth: Profile, grid: CylinderGrid) -> np.ndarray:
    smooth = blur(truth, truth.r, _WALL_BLUR_MM)
    slope_theta, slope_z = _slopes(smooth, grid)
    with np.errstate(invalid="ignore"):
        return np.hypot(slope_theta, slope_z) > _WALL_SLOPE


def _slopes(r: np.ndarray, grid: CylinderGrid) -> tuple[np.ndarray, np.ndarray]:
    """dr / (r dtheta) and dr / dz, by central differences, mm per mm."""
    if grid.periodic:
        along = np.gradient(np.concatenate([r[-1:], r, r[:1]]), grid.step_theta, axis=0)[1:-1]
    else:
        along = np.gradient(r, grid.step_theta, axis=0)
    return along / r, np.gradient(r, grid.step_z, axis=1)


def _distance_mm(mask: np.ndarray, grid: CylinderGrid) -> np.ndarray:
    """Distance of each cell centre to the nearest cell of a mask, mm."""
    if not mask.any():
        return np.full(mask.shape, np.inf)
    step = grid.step_theta * grid.nominal_radius_mm
    margin = int(np.ceil(_WALL_MARGIN_MM / step)) + 1
    if grid.periodic:
        mask = np.concatenate([mask[-margin:], mask, mask[:margin]])
    distance = ndimage.distance_transform_edt(~mask, sampling=(step, grid.step_z))
    return distance[margin:-margin] if grid.periodic else distance


def blur(truth: Profile, values: np.ndarray, sigma_mm: float) -> np.ndarray:
    """Gaussian mean of values on the truth's grid over the finite cells, (n, m)."""
    grid = truth_grid(truth)
    sigma = (sigma_mm / (grid.step_theta * grid.nominal_radius_mm), sigma_mm / grid.step_z)
    return masked_mean(values, np.isfinite(values), sigma, grid.periodic)


def masked_mean(
    values: np.ndarray, mask: np.ndarray, sigma: tuple[float, float], periodic: bool
) -> np.ndarray:
    """Gaussian mean over the cells of a mask, NaN elsewhere.

    Parameters
    ----------
    values : (n, m) float
    mask : (n, m) bool
    sigma : (float, float)
        Cells, along both axes.
    periodic : bool
        Whether the first axis is a whole turn.
    """
    mode = ("wrap" if periodic else "nearest", "nearest")
    centre = float(values[mask].mean()) if mask.any() else 0.0
    total = ndimage.gaussian_filter(np.where(mask, values - centre, 0.0), sigma, mode=mode)
    weight = ndimage.gaussian_filter(mask.astype(np.float64), sigma, mode=mode)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(mask, total / weight + centre, np.nan)


def interpolate(truth: Profile, values: np.ndarray, theta: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Values of the truth's grid at (theta x z) cells, bilinear, NaN outside, (n, m)."""
    grid = truth_grid(truth)
    rows, columns = grid.index(theta, z)
    low, high, share = _neighbours(rows, len(truth.theta), grid.periodic)
    along = values[low] * (1 - share)[:, None] + values[high] * share[:, None]
    low, high, share = _neighbours(columns, len(truth.z), False)
    return along[:, low] * (1 - share) + along[:, high] * share


def interpolate_at(
    truth: Profile, values: np.ndarray, theta: np.ndarray, z: np.ndarray
) -> np.ndarray:
    """As `interpolate`, at scattered points of any shape."""
    grid = truth_grid(truth)
    rows, columns = grid.index(theta, z)
    top, bottom, down = _neighbours(rows, len(truth.theta), grid.periodic)
    left, right, across = _neighbours(columns, len(truth.z), False)
    upper = values[top, left] * (1 - across) + values[top, right] * across
    lower = values[bottom, left] * (1 - across) + values[bottom, right] * across
    return upper * (1 - down) + lower * down


def _neighbours(
    index: np.ndarray, count: int, periodic: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Indices of the two neighbours and the share of the second; NaN outside."""
    # A millionth of a cell: two ways to compute one grid differ by rounding.
    nearest = np.rint(index)
    index = np.where(np.abs(index - nearest) < 1e-6, nearest, index)
    inside = np.isfinite(index)
    if not periodic:
        inside &= (index >= 0) & (index <= count - 1)
    index = np.where(inside, index, 0.0)
    low = np.floor(index).astype(int)
    share = index - low
    # A neighbour that has no share must not bring its NaN in.
    high = np.where(share > 0, low + 1, low)
    return low % count, high % count, np.where(inside, share, np.nan)


def true_normals(truth: Profile, sigma_mm: float) -> np.ndarray:
    """Unit normals of the truth after a Gaussian blur, (n, m, 3) in the local (r, theta, z)."""
    slope_theta, slope_z = _slopes(blur(truth, truth.r, sigma_mm), truth_grid(truth))
    normal = np.stack([np.ones_like(slope_z), -slope_theta, -slope_z], axis=-1)
    return normal / np.linalg.norm(normal, axis=-1, keepdims=True)


def normals_at(truth: Profile, theta: np.ndarray, z: np.ndarray, sigma_mm: float) -> np.ndarray:
    """As `true_normals`, at scattered points of any shape, (..., 3); NaN outside the truth."""
    normals = true_normals(truth, sigma_mm)
    found = np.stack([interpolate_at(truth, normals[..., k], theta, z) for k in range(3)], axis=-1)
    return found / np.linalg.norm(found, axis=-1, keepdims=True)
