"""What a view's pixels saw, compiled: their rays, and light and vectors of all LEDs in one pass.

A pixel and LED takes some 40 operations in single precision, vectorised along a row of pixels, and
reads 5 and writes 21 bytes. Rays are undistorted as OpenCV does it, to the same 1e-8 pixels, in a
fifth of its time.
"""

import math

import numpy as np

from treadlight.compiling import kernel
from treadlight.photometric.height_field import cos_sin
from treadlight.photometric.light_tiles import add_terms
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
    begin, end, width, points, counts, terms, tile, middle, half, dark, lit, leds, camera,
    intensity, noise, lights, views, usable, quality,
):  # fmt: skip
    """Observations of rows begin to end - 1 of pixels, in the local bases (r, theta, z) of points.

    Parameters
    ----------
    width : int
        Pixels of a row.
    points : (n, 3) float64
        phi, z, r in {V}; NaN outside the surface.
    counts : (n_leds, n) float32
        `View.intensity` there.
    terms : (n_leds, n_tiles, 18) float32
        Of 1 / irradiance, see `light_tiles`.
    tile, middle, half
        `shape`, `middle` and `half` of `light_tiles.Tiles`.
    dark : (n_leds,) float32
        `View.noise`.
    lit : (n_leds, n) bool
    leds, camera : (n_leds, 3), (3,) float64
        In {V}, mm.
    intensity, noise, lights, views, usable
        As `Observations.arrays` gives them; written here.
    quality : (n,) uint8
        outside, shadowed, saturated; written here.
    """
    across = (width + tile[1] - 1) // tile[1]
    # Of a row's points: cosine and sine of phi, r, z; their places within their tiles' boxes.
    bases, places = np.empty((4, width), np.float32), np.empty((3, width), np.float32)
    vectors, per_light = np.empty((3, width), np.float32), np.empty(width, np.float32)
    for row in range(begin, end):
        here = slice(row * width, min((row + 1) * width, len(points)))
        first = row // tile[0] * across
        tiles = slice(first, first + across)
        _take_bases(points[here], bases)
        _take_places(points[here], middle[tiles], half[tiles], tile[1], places)
        _unit_vectors(bases, camera, vectors[0], vectors[1], vectors[2])
        _side_by_side(vectors, views[here])
        quality[here] = 0
        for m in range(len(leds)):
            x, y, z = lights[m, 0, here], lights[m, 1, here], lights[m, 2, here]
            _unit_vectors(bases, leds[m], x, y, z)
            add_terms(terms[m, tiles], tile[1], places, per_light)
            _divide(counts[m, here], per_light, dark[m], intensity[m, here], noise[m, here])
            _use(intensity[m, here], lit[m, here], usable[m, here])
            _tell(counts[m, here], lit[m, here], quality[here])
        _tell_outside(bases, quality[here])


@kernel
def _take_bases(points, bases):
    for k in range(len(points)):
        c, s = cos_sin(points[k, 0])
        bases[0, k], bases[1, k], bases[2, k], bases[3, k] = c, s, points[k, 2], points[k, 1]


@kernel
def _take_places(points, middle, half, columns, places):
    for tile in range(len(middle)):
        for c in range(3):
            centre, scale = middle[tile, c], 1.0 / half[tile, c]
            for k in range(tile * columns, min((tile + 1) * columns, len(points))):
                places[c, k] = (points[k, c] - centre) * scale


@kernel
def _unit_vectors(bases, target, found_r, found_theta, found_z):
    """From points to a place in {V}, each in its own basis (r, theta, z)."""
    to_x, to_y, to_z = np.float32(target[0]), np.float32(target[1]), np.float32(target[2])
    for k in range(len(found_r)):
        c, s = bases[0, k], bases[1, k]
        x, y, z = c * to_x + s * to_y - bases[2, k], c * to_y - s * to_x, to_z - bases[3, k]
        scale = np.float32(1.0) / math.sqrt(x * x + y * y + z * z)
        found_r[k], found_theta[k], found_z[k] = x * scale, y * scale, z * scale


@kernel
def _side_by_side(rows, found):
    for k in range(len(found)):
        found[k, 0], found[k, 1], found[k, 2] = rows[0, k], rows[1, k], rows[2, k]


@kernel
def _divide(counts, per_light, dark, intensity, noise):
    for k in range(len(counts)):
        intensity[k], noise[k] = counts[k] * per_light[k], dark * per_light[k]


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
def _tell_outside(bases, quality):
    """Of what is not seen nothing else is told."""
    for k in range(len(quality)):
        quality[k] = quality[k] if bases[2, k] == bases[2, k] else OUTSIDE
