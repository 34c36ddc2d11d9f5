"""What a view's pixels saw, compiled: their rays, and light and vectors of all LEDs in one pass.

A pixel and LED takes some 30 operations in double precision, vectorised in runs of pixels, and
reads 13 and writes 21 bytes. Rays are undistorted as OpenCV does it, to the same 1e-8 pixels, in a
fifth of its time.
"""

import math

import numpy as np

from treadlight.compiling import kernel
from treadlight.photometric.height_field import cos_sin
from treadlight.photometric.observations import OUTSIDE, SATURATED, SHADOWED

_RUN = 256
# Of the undistortion's fixed point, as `Camera` asks it of OpenCV: a share of the focal length.
_MOST_ROUNDS, _STILL = 40, 1e-12


@kernel(allocates=True)
def directions(begin, end, pixels, width, intrinsics, distortion, basis, out):
    """Viewing rays of pixels begin to end - 1 of (n,), counted row by row, into out (n, 3).

    `intrinsics` are `Camera.intrinsics`, `distortion` k1, k2, p1, p2, k3, `basis` (3, 3) the axes
    that the rays are given along, in {C}.
    """
    fx, skew, cx, fy, cy = intrinsics
    x0, y0, x, y = np.empty(_RUN), np.empty(_RUN), np.empty(_RUN), np.empty(_RUN)
    moved = np.empty(_RUN)
    for first in range(begin, end, _RUN):
        count = min(_RUN, end - first)
        for k in range(count):
            row = pixels[first + k] // width
            y0[k] = (row - cy) / fy
            x0[k] = (pixels[first + k] - row * width - cx - skew * y0[k]) / fx
        _undistort(distortion, x0[:count], y0[:count], x, y, moved)
        for k in range(count):
            for c in range(3):
                out[first + k, c] = basis[c, 0] * x[k] + basis[c, 1] * y[k] + basis[c, 2]


@kernel
def _undistort(distortion, x0, y0, x, y, moved):
    """Places x, y that a lens shows at x0, y0: the same until it stands still."""
    k1, k2, p1, p2, k3 = distortion
    for k in range(len(x0)):
        x[k], y[k] = x0[k], y0[k]
    for _ in range(_MOST_ROUNDS):
        for k in range(len(x0)):
            xk, yk = x[k], y[k]
            r2 = xk * xk + yk * yk
            inverse = 1.0 / (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)))
            x[k] = (x0[k] - 2.0 * p1 * xk * yk - p2 * (r2 + 2.0 * xk * xk)) * inverse
            y[k] = (y0[k] - p1 * (r2 + 2.0 * yk * yk) - 2.0 * p2 * xk * yk) * inverse
            moved[k] = abs(x[k] - xk) + abs(y[k] - yk)
        # By itself, so that the loop before is vectorised.
        most = 0.0
        for k in range(len(x0)):
            most = max(most, moved[k])
        if most <= _STILL:
            break


@kernel
def to_camera(begin, end, points, basis, foot, out):
    """Points begin to end - 1 of (n, 3), phi, z, r in {V}, to {C}: out (n, 3).

    `basis` (3, 3) are the axes of {V} in {C}, `foot` (3,) its origin.
    """
    for k in range(begin, end):
        c, s = cos_sin(points[k, 0])
        x, y, z = points[k, 2] * c, points[k, 2] * s, points[k, 1]
        for i in range(3):
            out[k, i] = x * basis[0, i] + y * basis[1, i] + z * basis[2, i] + foot[i]


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
        As `Observations.arrays` gives them; written here.
    quality : (n,) uint8
        outside, shadowed, saturated; written here.
    """
    places, rows = np.empty((4, _RUN)), np.empty((3, _RUN), np.float32)
    for first in range(begin, end, _RUN):
        run = slice(first, min(end, first + _RUN))
        _place(points[run], places)
        _unit_vectors(places, camera, rows[0], rows[1], rows[2])
        _side_by_side(rows, views[run])
        quality[run] = 0
        for m in range(len(leds)):
            _unit_vectors(places, leds[m], lights[m, 0, run], lights[m, 1, run], lights[m, 2, run])
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
def _unit_vectors(places, target, found_r, found_theta, found_z):
    """From points to a place in {V}, each in its own basis (r, theta, z)."""
    to_x, to_y, to_z = target[0], target[1], target[2]
    for k in range(len(found_r)):
        c, s = places[0, k], places[1, k]
        x, y, z = c * to_x + s * to_y - places[2, k], c * to_y - s * to_x, to_z - places[3, k]
        scale = 1.0 / math.sqrt(x * x + y * y + z * z)
        found_r[k], found_theta[k], found_z[k] = x * scale, y * scale, z * scale


@kernel
def _side_by_side(rows, found):
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
