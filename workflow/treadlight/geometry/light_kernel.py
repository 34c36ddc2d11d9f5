"""The inner loop of `Illumination.irradiance`; imported when first used: numba loads slowly."""

import numpy as np

from treadlight.compiling import kernel


@kernel
def irradiance(
    first, last, points, position, normal, height, intrinsics, distortion, table, step, lens, out
):
    """Irradiance at points first to last - 1 of (n, 3), into out (n,).

    `height` is the LED's signed distance from the reference plane, `intrinsics` fx, skew, cx,
    fy, cy, `table` one LED's map, `lens` the vignetting; see `Illumination.irradiance`, whose
    plain numpy twin stands in the tests.
    """
    fx, skew, cx, fy, cy = intrinsics
    k1, k2, p1, p2, k3 = distortion
    rows, columns = table.shape
    for i in range(first, last):
        dx = points[i, 0] - position[0]
        dy = points[i, 1] - position[1]
        dz = points[i, 2] - position[2]
        squared = dx * dx + dy * dy + dz * dz
        if np.isnan(squared):
            out[i] = np.nan
            continue
        reach = -height / (dx * normal[0] + dy * normal[1] + dz * normal[2])
        depth = position[2] + reach * dz
        if not (reach > 0 and np.isfinite(reach)) or depth <= 0:
            out[i] = 0.0
            continue
        x = (position[0] + reach * dx) / depth
        y = (position[1] + reach * dy) / depth
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        u = min(max((fx * xd + skew * yd + cx) / step, 0.0), columns - 1.0)
        v = min(max((fy * yd + cy) / step, 0.0), rows - 1.0)
        left, top = min(int(u), columns - 2), min(int(v), rows - 2)
        a, b = u - left, v - top
        upper = (1 - a) * table[top, left] + a * table[top, left + 1]
        lower = (1 - a) * table[top + 1, left] + a * table[top + 1, left + 1]
        seen = (points[i, 0] ** 2 + points[i, 1] ** 2) / points[i, 2] ** 2
        seen = min(seen, lens[2])
        passed = 1 + seen * (lens[0] + seen * lens[1])
        out[i] = passed * ((1 - b) * upper + b * lower) / squared
