"""From the normals of a view to slopes of the surface on the cells of the profile's grid."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields, replace
from typing import Protocol

import numpy as np

from treadlight.compiling import kernel
from treadlight.geometry import CylinderGrid
from treadlight.geometry.angle_kernel import wrapped
from treadlight.threads import by_ranges, cores

# Two slopes times their weights, these, material, and how many pixels are usable; the share of
# each flag, and how many pixels there are.
_CHANNELS = 12
FLAGS = ("shadowed", "saturated", "poor_fit")
POOR_FIT = FLAGS.index("poor_fit")
# A cell has a slope where at least this much of a pixel fell on it (bilinear shares add up to
# about one where the view has a pixel per cell).
_LEAST_SHARE = 0.15
# Pixels taken at a time: what is worked out for them stays in the cache.
_BLOCK_PX = 1 << 17
_LEAST_PX = 1 << 12


class View(Protocol):
    """A view that may be larger than the memory."""

    def blocks(self, grid: CylinderGrid) -> Iterator["ViewNormals"]:
        """Parts of the image, all that see something of a grid among them."""
        ...


@dataclass(frozen=True)
class ViewNormals:
    """What the photometric stage found in one view, or in some rows of its image.

    Attributes
    ----------
    normal : (v, u, 3) float
        Unit normals, local basis (r, theta, z) of {T}; NaN where there is none.
    covariance : (v, u, 3) float
        Variances and covariance of the components n_theta and n_z (tt, tz, zz), rad^2.
    r, theta, z : (v, u) float
        Scene point of the pixel in {T}, mm, rad, mm.
    material : (v, u, 3) float
        k_d, k_s, alpha.
    shadowed, saturated, poor_fit : (v, u) bool, or float
        Whether, or the share of what a pixel was made of.
    camera : (3,) float or None
        Centre of the camera in {T}: r mm, theta rad, z mm. None if it is not known.
    """

    normal: np.ndarray
    covariance: np.ndarray
    r: np.ndarray
    theta: np.ndarray
    z: np.ndarray
    material: np.ndarray
    shadowed: np.ndarray
    saturated: np.ndarray
    poor_fit: np.ndarray
    camera: np.ndarray | None = None

    def blocks(self, grid: CylinderGrid) -> Iterator["ViewNormals"]:
        """Some rows of the image after the other."""
        del grid
        height, *width = self.theta.shape
        step = max(1, _BLOCK_PX // int(np.prod(width, dtype=int)))
        arrays = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "camera"}
        for row in range(0, height, step):
            some = {name: values[row : row + step] for name, values in arrays.items()}
            yield replace(self, **some)


@dataclass(frozen=True)
class ViewField:
    """One view on the rows of the grid that it covers; k rows, m columns.

    Attributes
    ----------
    rows : (k,) int
        Rows of the grid, consecutive (modulo its length on a whole turn).
    slope : (2, k, m) float32
        dr / (r dtheta) and dr / dz, mm per mm; NaN where there is none.
    variance : (2, k, m) float32
        Of the slopes.
    material : (3, k, m) float32
    flags : (3, k, m) float32
        Share of the cell's pixels that have each of `FLAGS`.
    blend : (k,) float32
        1 in the middle of the view, falling linearly to its ends.
    """

    rows: np.ndarray
    slope: np.ndarray
    variance: np.ndarray
    material: np.ndarray
    flags: np.ndarray
    blend: np.ndarray


def view_field(blocks: Iterable[ViewNormals], grid: CylinderGrid) -> ViewField | None:
    """Slopes of a view, given in `blocks`, on the grid; None where it has no pixel on it.

    The slopes are p = -n_theta / n_r and q = -n_z / n_r, with the variances that the normal's
    covariance gives to first order. Each pixel is shared bilinearly among the four cells around
    its scene point, weighted by its information (1 / variance).
    """
    total = np.zeros((*grid.shape, _CHANNELS), np.float32)
    taken = np.zeros(grid.shape[0], bool)
    ends = np.array([np.inf, -np.inf])
    for view in blocks:
        row, column = _indices(view, grid)
        begin, count = _mark_taken(row, grid.periodic, taken, ends)
        if count > 0:
            given = row, column, _channels(view, row), grid.periodic
            # Every range looks at all pixels.
            by_ranges(_splat, count, -(-count // cores()), begin, *given, total)
    if not taken.any():
        return None
    rows = _rows_covered(taken, grid)
    first, last = int(rows[0]), int(rows[0]) + len(rows)
    if grid.periodic:
        total = total[rows]
    else:
        total = total[first:last]
        # The view may go on beyond an open grid.
        first, last = int(np.floor(ends[0])), int(np.floor(ends[1])) + 2
    return _field(total, rows, _blend(rows[0] - first, len(rows), last - first))


def _indices(view: ViewNormals, grid: CylinderGrid) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns (k,) of the pixels' scene points; NaN of those aside of the columns.

    As `CylinderGrid.index`.
    """
    row, column = np.empty((2, view.theta.size))
    middle = 0.5 * (grid.theta[0] + grid.theta[-1])
    place = middle, middle - grid.theta[0], grid.step_theta, grid.z[0], grid.step_z
    points = view.theta.ravel(), view.z.ravel()
    by_ranges(_index, len(row), _LEAST_PX, *points, *place, grid.periodic, *grid.shape, row, column)
    return row, column


@kernel
def _index(
    first, last, theta, z, middle, offset, step_theta, first_z, step_z, periodic, rows, columns,
    row, column,
):  # fmt: skip
    for k in range(first, last):
        column[k] = (z[k] - first_z) / step_z
        row[k] = (offset + wrapped(theta[k] - middle)) / step_theta
        if periodic:
            row[k] -= np.floor(row[k] / rows) * rows
            # The rest of a number just below zero is rounded to the divisor.
            row[k] = row[k] if row[k] < rows else 0.0
        if not -0.5 < column[k] < columns - 0.5:
            row[k] = np.nan


@kernel
def _mark_taken(row, periodic, taken, ends):
    """Mark what rows of the grid (n,) points lie behind; NaN for those off an open one.

    Widens `ends` to the first and the last row of all; returns which rows these points are shared
    among: the first, and how many from there on.
    """
    n, low, high = len(taken), len(taken), -1
    for k in range(len(row)):
        if np.isfinite(row[k]):
            ends[0], ends[1] = min(ends[0], row[k]), max(ends[1], row[k])
            if periodic or -0.5 < row[k] < n - 0.5:
                behind = max(int(np.floor(row[k])), 0)
                taken[behind] = True
                low, high = min(low, behind), max(high, behind + 1)
            else:
                row[k] = np.nan
    if high == n and periodic:
        return 0, n
    return low, min(high + 1, n) - low


def _channels(view: ViewNormals, row: np.ndarray) -> np.ndarray:
    """What pixels hand to cells, (k, 12) float32; undefined where their `row` is NaN."""
    channels = np.empty((view.theta.size, _CHANNELS), np.float32)
    known = view.normal, view.covariance, view.material
    flags = (view.shadowed.ravel(), view.saturated.ravel(), view.poor_fit.ravel())
    values = (x.reshape(-1, 3) for x in known)
    by_ranges(_hand_over, len(channels), _LEAST_PX, row, *values, *flags, channels)
    return channels


@kernel
def _hand_over(
    first, last, row, normal, covariance, material, shadowed, saturated, poor_fit, channels
):
    for k in range(first, last):
        if not np.isfinite(row[k]):
            continue
        p, q, w_p, w_q = slopes_of(
            np.float64(normal[k, 0]), normal[k, 1], normal[k, 2], covariance[k, 0], covariance[k, 2]
        )
        channels[k] = 0
        if np.isfinite(p + q + w_p + w_q):
            channels[k, 0], channels[k, 1] = w_p * p, w_q * q
            channels[k, 2], channels[k, 3] = w_p, w_q
            for c in range(3):
                channels[k, 4 + c] = material[k, c]
            channels[k, 7] = 1
        channels[k, 8], channels[k, 9] = shadowed[k], saturated[k]
        channels[k, 10], channels[k, 11] = poor_fit[k], 1


def slope_variance(slope: np.ndarray, tilt: np.ndarray) -> np.ndarray:
    """Variances of both slopes (2, ...) from those of the normal's components n_theta and n_z.

    n_r follows from |n| = 1: dp = (1 + p^2) sqrt(1 + p^2 + q^2) dn_theta, and so for q. A wall's
    height is much less certain than a tread's.
    """
    p, q = slope
    return np.stack([steepened.py_func(p, q), steepened.py_func(q, p)]) * tilt


@kernel(inline="always")
def slopes_of(n_r, n_theta, n_z, theta_variance, z_variance):
    """Both slopes of a normal and their information; not finite where it tells none."""
    if not n_r > 0:
        n_r = np.nan
    p, q = -n_theta / n_r, -n_z / n_r
    return p, q, 1 / (steepened(p, q) * theta_variance), 1 / (steepened(q, p) * z_variance)


@kernel(inline="always")
def steepened(along, aside):
    """Variance of the slope along an axis over that of the normal's component."""
    squared = along * along
    return (1 + squared) ** 2 * (1 + squared + aside * aside)


def _field(total: np.ndarray, rows: np.ndarray, blend: np.ndarray) -> ViewField:
    """Means of the cells from the sums (k, m, 12) of what pixels handed to them."""
    values = np.empty((10, *total.shape[:2]), np.float32)
    by_ranges(_means, len(total), 1, total, values)
    return ViewField(rows, values[0:2], values[2:4], values[4:7], values[7:10], blend)


@kernel
def _means(first, last, total, values):
    for i in range(first, last):
        for j in range(total.shape[1]):
            cell = total[i, j]
            known = cell[7] > _LEAST_SHARE and cell[2] > 0 and cell[3] > 0
            for k in range(2):
                values[k, i, j] = cell[k] / cell[2 + k] if known else np.nan
                values[2 + k, i, j] = 1 / cell[2 + k] if known else np.nan
            for k in range(3):
                values[4 + k, i, j] = cell[4 + k] / cell[7] if known else np.nan
                values[7 + k, i, j] = cell[8 + k] / cell[11] if cell[11] > 0 else 0


def _rows_covered(taken: np.ndarray, grid: CylinderGrid) -> np.ndarray:
    """Consecutive rows that hold all points, from the rows (n,) that points lie behind.

    On a whole turn they may pass its end.
    """
    n = grid.shape[0]
    if not grid.periodic:
        found = np.flatnonzero(taken)
        return np.arange(found[0], min(found[-1] + 2, n))
    if taken.all():
        return np.arange(n)
    # The view starts where the longest run of empty rows ends.
    ends = np.flatnonzero(~np.roll(taken, 1) & taken | np.roll(~taken, 1) & taken)
    starts = [int(e) for e in ends]
    gaps = [_gap_before(taken, s) for s in starts]
    first = starts[int(np.argmax(gaps))]
    return (first + np.arange(n - max(gaps) + 1)) % n if max(gaps) < n else np.arange(n)


def _gap_before(taken: np.ndarray, row: int) -> int:
    before = np.roll(taken, -row)[::-1]
    return int(np.argmax(before)) if before.any() else len(taken)


def _blend(first: int, count: int, whole: int) -> np.ndarray:
    """Of `count` rows from the `first` on of the `whole` view's."""
    place = (first + np.arange(count) + 0.5) / whole
    return (2 * np.minimum(place, 1 - place)).astype(np.float32)


@kernel
def _splat(first, last, begin, row, column, channels, periodic, total):
    """Share every point's channels bilinearly among the four cells around it, in some rows."""
    rows, columns = total.shape[:2]
    first, last = first + begin, last + begin
    for k in range(len(row)):
        if not np.isfinite(row[k]):
            continue
        i = int(np.floor(row[k]))
        j = int(np.floor(column[k]))
        down = row[k] - i
        right = column[k] - j
        for a in range(2):
            place = (i + a) % rows if periodic else i + a
            if not first <= place < last:
                continue
            for b in range(2):
                if not 0 <= j + b < columns:
                    continue
                share = (down if a else 1 - down) * (right if b else 1 - right)
                for c in range(_CHANNELS):
                    total[place, j + b, c] += share * channels[k, c]
