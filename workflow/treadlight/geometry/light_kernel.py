"""The inner loops of `Illumination.irradiance`; imported when first used: numba loads slowly.

A point takes some 60 operations in double precision and four looks into the map. They are done for
a run of points at a time, without a branch, so that the compiler vectorises them.
"""

import numpy as np

from treadlight.compiling import kernel

_RUN = 256


@kernel(allocates=True)
def irradiance(
    first, last, points, position, normal, height, intrinsics, distortion, table, step, lens, out
):
    """Irradiance at points first to last - 1 of (n, 3), into out (n,).

    `height` is the LED's signed distance from the reference plane, `intrinsics` fx, skew, cx,
    fy, cy, `table` one LED's map, `lens` the vignetting; see `Illumination.irradiance`, whose
    plain numpy twin stands in the tests.
    """
    rows, columns = table.shape
    u, v, scale = np.empty(_RUN), np.empty(_RUN), np.empty(_RUN)
    place, flat = np.empty(_RUN, np.int32), table.reshape(table.size)
    for begin in range(first, last, _RUN):
        end = min(begin + _RUN, last)
        _take(points[begin:end], u, v, scale)
        _project(position, normal, height, lens, u, v, scale)
        _distort(intrinsics, distortion, u, v)
        _find(rows, columns, step, u, v, place)
        _look_up(flat, columns, place, u, v, scale, out[begin:end])


@kernel
def _take(points, x, y, z):
    """Components by themselves: what follows is vectorised, in two thirds of the time."""
    for i in range(len(points)):
        x[i], y[i], z[i] = points[i, 0], points[i, 1], points[i, 2]


@kernel
def _project(position, normal, height, lens, x, y, scale):
    """Where the camera sees the line from the LED through each point meet the plane, undistorted.

    The points' components come in x, y and scale. In scale goes what distance and lens leave at
    the point: nothing where the LED has it behind.
    """
    p_x, p_y, p_z = position[0], position[1], position[2]
    n_x, n_y, n_z = normal[0], normal[1], normal[2]
    linear, quadratic, most = lens
    for i in range(_RUN):
        there_x, there_y, there_z = x[i], y[i], scale[i]
        dx, dy, dz = there_x - p_x, there_y - p_y, there_z - p_z
        squared = dx * dx + dy * dy + dz * dz
        # The plane's point times this one's distance from the LED along the normal.
        towards = dx * n_x + dy * n_y + dz * n_z
        depth = towards * p_z - height * dz
        # One division for three.
        square_z = there_z * there_z
        inverse = 1.0 / (depth * squared * square_z)
        per_depth = inverse * squared * square_z
        x[i] = (towards * p_x - height * dx) * per_depth
        y[i] = (towards * p_y - height * dy) * per_depth
        seen = (there_x * there_x + there_y * there_y) * (inverse * depth * squared)
        seen = seen if seen < most else most
        left = (1 + seen * (linear + seen * quadratic)) * (inverse * depth * square_z)
        ahead = (towards * height < 0) & (depth * towards > 0)
        left = left if ahead else 0.0
        scale[i] = left if squared == squared else np.nan


@kernel
def _distort(intrinsics, distortion, u, v):
    """From undistorted places, in place, to pixels."""
    fx, skew, cx, fy, cy = intrinsics
    k1, k2, p1, p2, k3 = distortion
    for i in range(_RUN):
        x, y = u[i], v[i]
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        u[i] = fx * xd + skew * yd + cx
        v[i] = fy * yd + cy


@kernel
def _find(rows, columns, step, u, v, place):
    """The map's cell at each pixel (beside it, the nearest), and where in the cell, in place."""
    scale, most_u, most_v = 1.0 / step, columns - 1.0, rows - 1.0
    for i in range(_RUN):
        x, y = u[i] * scale, v[i] * scale
        x, y = x if x > 0.0 else 0.0, y if y > 0.0 else 0.0
        x, y = x if x < most_u else most_u, y if y < most_v else most_v
        left, top = np.int32(x), np.int32(y)
        left = left if left < columns - 2 else np.int32(columns - 2)
        top = top if top < rows - 2 else np.int32(rows - 2)
        u[i], v[i] = x - left, y - top
        place[i] = top * np.int32(columns) + left


@kernel
def _look_up(table, columns, place, u, v, scale, out):
    """Bilinear in the flat map."""
    for i in range(len(out)):
        at, a, b = place[i], u[i], v[i]
        upper = table[at] + a * (table[at + 1] - table[at])
        at += columns
        lower = table[at] + a * (table[at + 1] - table[at])
        out[i] = scale[i] * (upper + b * (lower - upper))
