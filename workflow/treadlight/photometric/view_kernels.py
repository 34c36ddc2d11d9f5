"""What a view's pixels saw, compiled: light and vectors of all LEDs in one pass over the pixels.

A pixel and LED takes some 30 operations in double precision, and reads 13 and writes 21 bytes.
"""

import math

import numpy as np

from treadlight.compiling import kernel
from treadlight.photometric.observations import OUTSIDE, SATURATED, SHADOWED

_RUN = 512


@kernel(allocates=True)
def observe(
    begin, end, points, counts, irradiance, dark, lit, leds, camera,
    intensity, noise, lights, views, usable, quality,
):  # fmt: skip
    """Observations of pixels begin to end - 1, in the local bases (r, theta, z) of their points.

    Parameters
    ----------
    points : (n, 3) float64
        phi, z, r in {V}; NaN outside the surface.
    counts : (n_leds, n) float32
        `View.intensity` there.
    irradiance : (n_leds, n) float64
    dark : (n_leds,) float64
        `View.noise`.
    lit : (n_leds, n) bool
    leds, camera : (n_leds, 3), (3,) float64
        In {V}, mm.
    intensity, noise, lights, views, usable
        As in `Observations`; written here.
    quality : (n,) uint8
        outside, shadowed, saturated; written here.
    """
    for first in range(begin, end, _RUN):
        last = min(end, first + _RUN)
        cosine, sine = np.empty(last - first), np.empty(last - first)
        for k in range(first, last):
            phi = points[k, 0]
            c, s = math.cos(phi), math.sin(phi)
            cosine[k - first], sine[k - first] = c, s
            x, y, z = _unit_vector(c, s, points[k, 2], points[k, 1], camera)
            views[k, 0], views[k, 1], views[k, 2] = x, y, z
            quality[k] = OUTSIDE if math.isnan(points[k, 2]) else 0
        for m in range(len(leds)):
            for k in range(first, last):
                c, s = cosine[k - first], sine[k - first]
                x, y, z = _unit_vector(c, s, points[k, 2], points[k, 1], leds[m])
                lights[m, k, 0], lights[m, k, 1], lights[m, k, 2] = x, y, z
                # Behind an LED there is no light to divide by.
                per_light = 1.0 / irradiance[m, k]
                count = counts[m, k]
                light = count * per_light
                intensity[m, k], noise[m, k] = light, dark[m] * per_light
                usable[m, k] = lit[m, k] and math.isfinite(light)
                if quality[k] != OUTSIDE:
                    quality[k] |= np.uint8(0) if lit[m, k] else SHADOWED
                    quality[k] |= SATURATED if math.isnan(count) else np.uint8(0)


@kernel(inline="always")
def _unit_vector(c, s, r, z, target):
    """From a point (cosine and sine of phi, r, z) to a place, both in {V}, in its own basis."""
    x, y, z = c * target[0] + s * target[1] - r, c * target[1] - s * target[0], target[2] - z
    scale = 1.0 / math.sqrt(x * x + y * y + z * z)
    return x * scale, y * scale, z * scale
