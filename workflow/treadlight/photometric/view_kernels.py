"""What a view's pixels saw, compiled: light and vectors of all LEDs in one pass over the pixels.

A pixel and LED takes some 30 operations in double precision, vectorised in runs of pixels, and
reads 13 and writes 21 bytes.
"""

import math

import numpy as np

from treadlight.compiling import kernel
from treadlight.photometric.observations import OUTSIDE, SATURATED, SHADOWED

_RUN = 256


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
    places, rows = np.empty((4, _RUN)), np.empty((3, _RUN), np.float32)
    for first in range(begin, end, _RUN):
        run = slice(first, min(end, first + _RUN))
        _place(points[run], places)
        _unit_vectors(places, camera, rows, views[run])
        quality[run] = 0
        for m in range(len(leds)):
            _unit_vectors(places, leds[m], rows, lights[m, run])
            _divide(counts[m, run], irradiance[m, run], dark[m], intensity[m, run], noise[m, run])
            _use(intensity[m, run], lit[m, run], usable[m, run])
            _tell(counts[m, run], lit[m, run], quality[run])
        _tell_outside(places, quality[run])


@kernel
def _place(points, places):
    """Cosine and sine of phi, r and z of points (phi, z, r), a row each."""
    for k in range(len(points)):
        places[0, k], places[1, k] = math.cos(points[k, 0]), math.sin(points[k, 0])
        places[2, k], places[3, k] = points[k, 2], points[k, 1]


@kernel
def _unit_vectors(places, target, rows, found):
    """From points to a place in {V}, each in its own basis (r, theta, z)."""
    to_x, to_y, to_z = target[0], target[1], target[2]
    for k in range(len(found)):
        c, s = places[0, k], places[1, k]
        x, y, z = c * to_x + s * to_y - places[2, k], c * to_y - s * to_x, to_z - places[3, k]
        scale = 1.0 / math.sqrt(x * x + y * y + z * z)
        rows[0, k], rows[1, k], rows[2, k] = x * scale, y * scale, z * scale
    # By itself, so that the loop before is vectorised.
    for k in range(len(found)):
        found[k, 0], found[k, 1], found[k, 2] = rows[0, k], rows[1, k], rows[2, k]


@kernel
def _divide(counts, irradiance, dark, intensity, noise):
    for k in range(len(counts)):
        # Behind an LED there is no light to divide by.
        per_light = 1.0 / irradiance[k]
        intensity[k], noise[k] = counts[k] * per_light, dark * per_light


@kernel
def _use(intensity, lit, usable):
    for k in range(len(lit)):
        usable[k] = lit[k] & (abs(intensity[k]) < np.inf)


@kernel
def _tell(counts, lit, quality):
    for k in range(len(lit)):
        told = np.uint8(0) if lit[k] else SHADOWED
        quality[k] |= told | (np.uint8(0) if counts[k] == counts[k] else SATURATED)


@kernel
def _tell_outside(places, quality):
    """Of what is not seen nothing else is told."""
    for k in range(len(quality)):
        quality[k] = quality[k] if places[2, k] == places[2, k] else OUTSIDE
