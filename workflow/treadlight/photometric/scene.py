"""Where a view's pixels meet the tire's surface, and which LEDs a rib hides from them.

The surface is a height field r(theta, z), so rays are marched through it directly: that needs
no mesh and no tree, keeps its memory to the grid itself, and gives the same bits on any number
of cores.

Everything here happens in {V}, the tire frame {T} held still at one encoder angle: x from the
axis to the camera centre, z along the axis, and phi = theta + encoder.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit, prange

from treadlight.geometry import CylinderGrid

# A ray that leaves the surface flatter than this (72 degrees off its normal) is not looked for
# beyond the seen sector: the patch reaches this many height ranges past it.
_REACH = 3.0
_MAX_STEPS = 4096
_BISECTIONS = 24
_BLOCK = 512


@dataclass(frozen=True)
class SurfacePatch:
    """The part of a surface that one view can see or be shadowed by, in {V}.

    Attributes
    ----------
    phi_0, step_phi : float
        First row's angle and the rows' distance, rad.
    z_0, step_z : float
        First column and the columns' distance, mm.
    r : (rows, columns) float32
        mm; NaN where there is no surface.
    r_std : (rows, columns) float32
        Standard uncertainty of `r`, mm; never NaN.
    """

    phi_0: float
    step_phi: float
    z_0: float
    step_z: float
    r: np.ndarray
    r_std: np.ndarray

    @property
    def r_max(self) -> float:
        """mm; NaN if the patch holds no surface."""
        return float(np.nanmax(self.r, initial=-np.inf))

    @property
    def r_min(self) -> float:
        return float(np.nanmin(self.r, initial=np.inf))

    @property
    def step_mm(self) -> float:
        """The finer of the two grid steps, mm."""
        return min(self.step_phi * self.r_max, self.step_z)


def cut_patch(
    grid: CylinderGrid,
    r: np.ndarray,
    r_std: np.ndarray,
    encoder: float,
    phi_range: tuple[float, float],
) -> SurfacePatch:
    """The rows of a surface that matter to a view.

    Parameters
    ----------
    grid : CylinderGrid
    r, r_std : (n_theta, n_z) float
        mm; where `r` is known and `r_std` is not, its median stands in (0 if none is known).
    encoder : float
        Rad.
    phi_range : (float, float)
        Seen angles phi = theta + encoder, rad; widened here by what may cast shadows.

    Returns
    -------
    SurfacePatch
        Without rows if the surface has none there.
    """
    height = np.nanmax(r, initial=-np.inf) - np.nanmin(r, initial=np.inf)
    margin = _REACH * max(float(height), 0.0) / grid.nominal_radius_mm
    start, _ = grid.index(np.asarray(-encoder), np.asarray(0.0))
    low = math.floor(float(start) + (phi_range[0] - margin) / grid.step_theta)
    high = math.ceil(float(start) + (phi_range[1] + margin) / grid.step_theta) + 1
    count = len(grid.theta)
    if grid.periodic:
        rows = np.arange(low, min(high, low + count))
    else:
        rows = np.arange(max(low, 0), min(high, count))
    first = float(rows[0]) if len(rows) else 0.0
    known = r_std[np.isfinite(r_std)]
    typical = float(np.median(known)) if known.size else 0.0
    std = r_std[rows % count]
    return SurfacePatch(
        phi_0=(first - float(start)) * grid.step_theta,
        step_phi=grid.step_theta,
        z_0=float(grid.z[0]),
        step_z=grid.step_z,
        r=np.ascontiguousarray(r[rows % count], np.float32),
        r_std=np.where(np.isfinite(std), std, typical).astype(np.float32),
    )


def coarsen(patch: SurfacePatch, cell_mm: float) -> SurfacePatch:
    """The patch on a grid whose cells are means of whole cells and at most `cell_mm` wide."""
    stride = max(1, int(cell_mm / patch.step_mm)) if patch.r.size else 1
    if stride == 1:
        return patch
    rows, columns = (size // stride for size in patch.r.shape)
    shape = (rows, stride, columns, stride)
    blocks = patch.r[: rows * stride, : columns * stride].reshape(shape)
    std = patch.r_std[: rows * stride, : columns * stride].reshape(shape)
    return SurfacePatch(
        phi_0=patch.phi_0 + 0.5 * (stride - 1) * patch.step_phi,
        step_phi=patch.step_phi * stride,
        z_0=patch.z_0 + 0.5 * (stride - 1) * patch.step_z,
        step_z=patch.step_z * stride,
        r=np.ascontiguousarray(blocks.mean(axis=(1, 3)), np.float32),
        r_std=np.ascontiguousarray(std.mean(axis=(1, 3)), np.float32),
    )


def cast(patch: SurfacePatch, origin: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """First points where rays from outside meet the surface.

    Parameters
    ----------
    patch : SurfacePatch
    origin : (3,) float64
        The camera centre in {V}, mm.
    directions : (n, 3) float64
        In {V}, any length.

    Returns
    -------
    (n, 3) float64
        phi (rad), z (mm), r (mm) of the points; NaN where a ray meets no known surface, or
        is below it when it leaves a hole, so that it met something unknown before.
    """
    found = np.full((len(directions), 3), np.nan)
    if np.isfinite(patch.r).any():
        _cast(
            patch.r, patch.phi_0, patch.step_phi, patch.z_0, patch.step_z,
            patch.r_min, patch.r_max, patch.step_mm,
            np.ascontiguousarray(origin, np.float64),
            np.ascontiguousarray(directions, np.float64), found,
        )  # fmt: skip
    return found


def lit(patch: SurfacePatch, points: np.ndarray, leds: np.ndarray) -> np.ndarray:
    """Whether LEDs reach points, or a part of the surface stands between.

    A ray is blocked where it runs below the surface by more than `lift`: two standard
    deviations of the height difference between the point and the obstacle, and half a grid
    step, for what the grid cannot resolve. Noise of the surface so casts no shadow on itself.

    Parameters
    ----------
    patch : SurfacePatch
    points : (n, 3) float64
        phi (rad), z (mm), r (mm); NaN rows come out unlit.
    leds : (n_leds, 3) float64
        Positions in {V}, mm.

    Returns
    -------
    (n_leds, n) bool
    """
    out = np.zeros((len(leds), len(points)), np.bool_)
    if np.isfinite(patch.r).any():
        crest = np.fmax.reduce(patch.r, axis=0, initial=-np.inf)
        # Highest surface at a column or beyond it, towards -z (row 0) and +z (row 1).
        crests = np.stack([np.maximum.accumulate(crest), np.maximum.accumulate(crest[::-1])[::-1]])
        _lit(
            patch.r, patch.r_std, crests, patch.phi_0, patch.step_phi, patch.z_0, patch.step_z,
            patch.r_max, patch.step_mm,
            np.ascontiguousarray(points, np.float64), np.ascontiguousarray(leds, np.float64), out,
        )  # fmt: skip
    return out


@njit(cache=True, inline="always")
def _sample(field, row, column):
    """Bilinear; NaN outside and beside NaN."""
    if not (row >= 0.0 and column >= 0.0):
        return np.nan
    i, j = int(row), int(column)
    if i > field.shape[0] - 2 or j > field.shape[1] - 2:
        return np.nan
    a, b = row - i, column - j
    top = field[i, j] + b * (field[i, j + 1] - field[i, j])
    bottom = field[i + 1, j] + b * (field[i + 1, j + 1] - field[i + 1, j])
    return top + a * (bottom - top)


@njit(cache=True, inline="always")
def _atan(q):
    """Arc tangent to 1e-5 for |q| < 0.4: rays turn little about the axis near the surface."""
    p = q * q
    return q * (1.0 - p * (1 / 3 - p * (1 / 5 - p * (1 / 7 - p / 9))))


@njit(cache=True)
def _crossings(x, y, dx, dy, radius):
    """Both ray parameters at which |(x, y) + t (dx, dy)| = radius; NaN if never."""
    a = dx * dx + dy * dy
    b = x * dx + y * dy
    disc = b * b - a * (x * x + y * y - radius * radius)
    if not (a > 0.0 and disc >= 0.0):
        return np.nan, np.nan
    root = math.sqrt(disc)
    return (-b - root) / a, (-b + root) / a


@njit(cache=True, parallel=True)
def _cast(r, phi_0, step_phi, z_0, step_z, r_min, r_max, cell, origin, directions, found):
    x0, y0, zc = origin
    n = len(directions)
    for block in prange((n + _BLOCK - 1) // _BLOCK):
        for k in range(block * _BLOCK, min(n, (block + 1) * _BLOCK)):
            dx, dy, dz = directions[k]
            enter, leave = _crossings(x0, y0, dx, dy, r_max)
            if not enter > 0.0:
                continue
            bottom, _ = _crossings(x0, y0, dx, dy, r_min)
            end = 0.5 * (enter + leave) if math.isnan(bottom) else bottom
            # The local frame at the entry keeps angles small.
            ex, ey, z = x0 + enter * dx, y0 + enter * dy, zc + enter * dz
            phi = math.atan2(ey, ex)
            c, s = ex / r_max, ey / r_max
            radial, tangential = c * dx + s * dy, c * dy - s * dx
            span = end - enter
            lateral = span * math.sqrt(tangential * tangential + dz * dz)
            steps = min(_MAX_STEPS, 4 + int(2.0 * lateral / cell))
            low, before = 0.0, 0.0
            for i in range(steps + 1):
                t = span * i / steps
                gap = _gap(
                    r, phi_0, step_phi, z_0, step_z, r_max, phi, z, radial, tangential, dz, t
                )
                if gap <= 0.0:
                    if i == 0:
                        low, high = 0.0, 0.0
                    elif not math.isnan(before):
                        high = t
                    else:
                        break
                    for _ in range(_BISECTIONS):
                        middle = 0.5 * (low + high)
                        gap = _gap(
                            r, phi_0, step_phi, z_0, step_z, r_max, phi, z,
                            radial, tangential, dz, middle,
                        )  # fmt: skip
                        if gap > 0.0:
                            low = middle
                        else:
                            high = middle
                    t = 0.5 * (low + high)
                    x, y = r_max + t * radial, t * tangential
                    found[k, 0] = phi + math.atan2(y, x)
                    found[k, 1] = z + t * dz
                    found[k, 2] = math.hypot(x, y)
                    break
                low, before = t, gap


@njit(cache=True, inline="always")
def _gap(r, phi_0, step_phi, z_0, step_z, start, phi, z, radial, tangential, dz, t):
    """Height of a ray's point over the surface below it, mm."""
    x, y = start + t * radial, t * tangential
    row = (phi + _atan(y / x) - phi_0) / step_phi
    column = (z + t * dz - z_0) / step_z
    return math.sqrt(x * x + y * y) - _sample(r, row, column)


@njit(cache=True, parallel=True)
def _lit(r, r_std, crests, phi_0, step_phi, z_0, step_z, r_max, cell, points, leds, out):
    n = len(points)
    for block in prange((n + _BLOCK - 1) // _BLOCK):
        for k in range(block * _BLOCK, min(n, (block + 1) * _BLOCK)):
            phi, z, height = points[k]
            if not height > 0.0:
                continue
            c, s = math.cos(phi), math.sin(phi)
            std = _sample(r_std, (phi - phi_0) / step_phi, (z - z_0) / step_z)
            var = 0.0 if math.isnan(std) else std * std
            for m in range(len(leds)):
                radial = c * leds[m, 0] + s * leds[m, 1] - height
                tangential = c * leds[m, 1] - s * leds[m, 0]
                dz = leds[m, 2] - z
                out[m, k] = not _blocked(
                    r, r_std, crests, phi_0, step_phi, z_0, step_z, r_max, cell,
                    phi, z, height, radial, tangential, dz, var,
                )  # fmt: skip


@njit(cache=True)
def _blocked(
    r, r_std, crests, phi_0, step_phi, z_0, step_z, r_max, cell,
    phi, z, height, radial, tangential, dz, var,
):  # fmt: skip
    """Whether the surface hides the light at (radial, tangential, dz) from a point."""
    _, leave = _crossings(height, 0.0, radial, tangential, max(r_max, height))
    if math.isnan(leave):
        return False
    span = min(leave, 1.0)
    lateral = span * math.sqrt(tangential * tangential + dz * dz)
    steps = min(_MAX_STEPS, 1 + int(lateral / cell))
    ahead = crests[1] if dz > 0 else crests[0]
    for i in range(1, steps + 1):
        t = span * i / steps
        x, y = height + t * radial, t * tangential
        column = (z + t * dz - z_0) / step_z
        level = math.sqrt(x * x + y * y)
        # A rising ray that is above all that lies ahead meets nothing any more.
        nearest = min(max(int(column) + (dz <= 0), 0), len(ahead) - 1)
        if radial > 0.0 and level > ahead[nearest]:
            return False
        row = (phi + _atan(y / x) - phi_0) / step_phi
        depth = _sample(r, row, column) - level
        # The square root of the variances only where half a step alone is exceeded.
        if depth > 0.5 * cell:
            std = r_std[int(row), int(column)]
            if depth > 0.5 * cell + 2.0 * math.sqrt(var + std * std):
                return True
    return False
