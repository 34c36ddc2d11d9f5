"""Where a view's pixels lie on the tread, if the surface they were placed on was not the tread."""

from dataclasses import replace

import numpy as np
from scipy import ndimage

from treadlight.compiling import kernel
from treadlight.geometry import CylinderGrid
from treadlight.geometry.angle_kernel import wrapped
from treadlight.geometry.axis import wrap_angle
from treadlight.integrate.gather import ViewNormals
from treadlight.threads import by_ranges

# Sections that tell together where the tread is: a cut that is narrower than one and a half of
# their distances is bridged.
_SECTIONS = 3
_PER_SPACING = 4
# A surface this many standard deviations off the tread is a cut, or a ghost.
_OFF_SIGMA = 4.0
_ROUNDS = 3
# A pixel lies aside of where its view was placed, as far as it looks into a groove obliquely.
ASIDE_MM = 3.0
_LEAST_PX = 1 << 10


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


def angles_of_chunks(theta: np.ndarray, chunk: int) -> tuple[float, np.ndarray, np.ndarray]:
    """Between which angles squares of a view's image see the tire.

    Parameters
    ----------
    theta : (v, u) float32
        Of the pixels' scene points, rad.
    chunk : int
        Side of a square, pixels.

    Returns
    -------
    middle : float
        An angle of the view, rad.
    low, high : (rows, columns) float64
        Of each square, off that one, rad; NaN where it sees nothing.
    """
    known = np.isfinite(theta)
    middle = float(theta.ravel()[np.argmax(known)]) if known.any() else 0.0
    low, high = np.full((2, *(-(-size // chunk) for size in theta.shape)), np.nan)
    by_ranges(_angles, len(low), 1, theta, middle, chunk, low, high)
    return middle, low, high


def sees(middle: float, low: np.ndarray, high: np.ndarray, grid: CylinderGrid) -> np.ndarray:
    """Which squares see a grid or something beside it, by the angles of `angles_of_chunks`.

    As far aside as a pixel may lie off where its view was placed.
    """
    own = (grid.theta[0] + grid.theta[-1]) / 2
    half = (grid.theta[-1] - grid.theta[0]) / 2 + ASIDE_MM / grid.nominal_radius_mm
    away = wrap_angle(middle - own)
    known = np.isfinite(low)
    return known & (grid.periodic | ((away + high >= -half) & (away + low <= half)))


@kernel
def _angles(first, last, theta, middle, chunk, low, high):
    height, width = theta.shape
    for v in range(first * chunk, min(last * chunk, height)):
        for u in range(width):
            away = wrapped(np.float64(theta[v, u]) - middle)
            if np.isfinite(away):
                row, column = v // chunk, u // chunk
                # Neither is less, or more, than what is not known.
                if not low[row, column] <= away:
                    low[row, column] = away
                if not high[row, column] >= away:
                    high[row, column] = away


def seen_on(view: ViewNormals, surface: np.ndarray, grid: CylinderGrid) -> ViewNormals:
    """The view with its scene points moved along their rays onto a surface (n, m), mm.

    The first surface has a cut wherever a section crosses one, as a block half the sections'
    distance wide. Of the pixels that were placed on its floor most show the tread, which the
    camera, looking in obliquely, sees elsewhere.
    """
    if view.camera is None:
        return view
    shape = view.theta.shape
    r, theta, z = (np.empty(shape) for _ in range(3))
    normal = np.empty((*shape, 3), np.float32)
    known = (view.r.ravel(), view.theta.ravel(), view.z.ravel(), view.normal.reshape(-1, 3))
    moved = (r.ravel(), theta.ravel(), z.ravel(), normal.reshape(-1, 3))
    middle = 0.5 * (grid.theta[0] + grid.theta[-1])
    place = (grid.periodic, middle, middle - grid.theta[0], grid.step_theta, grid.z[0], grid.step_z)
    centre, turned, beside = (float(x) for x in view.camera)
    camera = centre, -turned, beside
    aside = ASIDE_MM / (grid.step_theta * grid.nominal_radius_mm)
    by_ranges(_see, theta.size, _LEAST_PX, *known, *camera, aside, surface, *place, *moved)
    return replace(view, normal=normal, r=r, theta=theta, z=z)


@kernel
def _see(
    first, last, r, theta, z, normal, centre, encoder, beside, aside, surface, periodic, middle,
    offset, step_theta, first_z, step_z, new_r, new_theta, new_z, new_normal,
):  # fmt: skip
    """Move pixels along their rays onto the surface (n, m), and turn their normals with them."""
    n, m = surface.shape
    rows, columns = 1 / step_theta, 1 / step_z
    for k in range(first, last):
        start = (offset + wrapped(theta[k] - middle)) * rows
        if not periodic and (start < -aside or start > n - 1 + aside):
            new_r[k], new_theta[k], new_z[k] = r[k], theta[k], z[k]
            for c in range(3):
                new_normal[k, c] = normal[k, c]
            continue
        cosine, sine = _turn(wrapped(theta[k] + encoder))
        ray_x, ray_y = r[k] * cosine - centre, r[k] * sine
        ray_z = z[k] - beside
        along, half = ray_x * ray_x + ray_y * ray_y, centre * ray_x
        shorter = 1 / along
        tangent, turned, at_z, at_r = 0.0, 0.0, np.float64(z[k]), np.nan
        i, j = -1, -1
        for _ in range(_ROUNDS):
            # The nearest cell; at the rim the last one.
            row, column = start + turned * rows, (at_z - first_z) * columns
            if not (np.isfinite(row) and np.isfinite(column)):
                at_r = np.nan
                break
            before = i, j
            i, j = int(np.rint(row)), min(max(int(np.rint(column)), 0), m - 1)
            i = i % n if periodic else min(max(i, 0), n - 1)
            if before == (i, j):
                break
            at_r = surface[i, j]
            # Where |centre + share * ray| = r, on the near side of the axis.
            inside = half * half - along * (centre * centre - at_r * at_r)
            share = -(half + np.sqrt(inside)) * shorter if inside >= 0 else np.nan
            x, y = centre + share * ray_x, share * ray_y
            tangent = (y * cosine - x * sine) / (x * cosine + y * sine)
            turned = _arctan(tangent)
            at_z = share * ray_z + beside
        new_r[k], new_theta[k], new_z[k] = at_r, theta[k] + turned, at_z
        # The local basis of a place further along theta.
        c = 1 / np.sqrt(1 + tangent * tangent)
        s = tangent * c
        new_normal[k, 0] = c * normal[k, 0] + s * normal[k, 1]
        new_normal[k, 1] = c * normal[k, 1] - s * normal[k, 0]
        new_normal[k, 2] = normal[k, 2]


@kernel(inline="always")
def _arctan(x):
    """To 1e-12; most angles here are those of some millimetres."""
    if abs(x) > 0.03:
        return np.arctan(x)
    y = x * x
    return x * (1 - y * (1 / 3 - y * (1 / 5 - y * (1 / 7))))


@kernel(inline="always")
def _turn(angle):
    """Cosine and sine, to 1e-13 within a view by their series."""
    if abs(angle) > 0.3:
        return np.cos(angle), np.sin(angle)
    x = angle * angle
    cosine = 1 - x * (1 / 2 - x * (1 / 24 - x * (1 / 720 - x * (1 / 40320 - x * (1 / 3628800)))))
    sine = 1 - x * (1 / 6 - x * (1 / 120 - x * (1 / 5040 - x * (1 / 362880 - x * (1 / 39916800)))))
    return cosine, angle * sine
