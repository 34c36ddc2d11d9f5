"""Viewing rays of many pixels, compiled; imported when first used: numba loads slowly.

A pixel takes some 40 operations a turn of the iteration, vectorised, and five to ten turns.
"""

import math

import numpy as np

from treadlight.compiling import kernel

_RUN = 256
# Of x / z: some 1e-8 pixels. Lenses that take more turns than this cannot be undone.
_TOLERANCE, _MOST_TURNS = 1e-12, 100


@kernel(allocates=True)
def directions(first, last, pixels, width, intrinsics, distortion, basis, out):
    """Rays of pixels first to last - 1, lens distortion undone, into out (n, 3).

    Parameters
    ----------
    pixels : (n,) int64
        Row times `width` plus column.
    width : int
    intrinsics, distortion : tuple of float
        fx, skew, cx, fy, cy; k1, k2, p1, p2, k3.
    basis : (3, 3) float64
        Rows are the axes that the result is given in.
    out : (n, 3) float64
        Of length 1 along the optical axis.
    """
    x_0, y_0, x, y = np.empty(_RUN), np.empty(_RUN), np.empty(_RUN), np.empty(_RUN)
    for begin in range(first, last, _RUN):
        end = min(begin + _RUN, last)
        count = end - begin
        _normalise(pixels[begin:end], width, intrinsics, x_0, y_0)
        x[:count], y[:count] = x_0[:count], y_0[:count]
        for _ in range(_MOST_TURNS):
            if _undistort(x_0[:count], y_0[:count], distortion, x, y) == 0:
                break
        _turn(x, y, basis, out[begin:end])


@kernel
def _normalise(pixels, width, intrinsics, x, y):
    fx, skew, cx, fy, cy = intrinsics
    for k in range(len(pixels)):
        # In floating point, which is vectorised: exact for any image.
        row = math.floor((pixels[k] + 0.5) / width)
        y[k] = (row - cy) / fy
        x[k] = (pixels[k] - row * width - cx - skew * y[k]) / fx


@kernel
def _undistort(x_0, y_0, distortion, x, y):
    """One turn of the fixed-point iteration; how many pixels still move."""
    k1, k2, p1, p2, k3 = distortion
    moving = 0
    for k in range(len(x_0)):
        u, v = x[k], y[k]
        r2 = u * u + v * v
        inverse = 1.0 / (1 + r2 * (k1 + r2 * (k2 + r2 * k3)))
        new_u = (x_0[k] - 2 * p1 * u * v - p2 * (r2 + 2 * u * u)) * inverse
        new_v = (y_0[k] - p1 * (r2 + 2 * v * v) - 2 * p2 * u * v) * inverse
        moving += abs(new_u - u) + abs(new_v - v) > _TOLERANCE
        x[k], y[k] = new_u, new_v
    return moving


@kernel
def _turn(x, y, basis, out):
    xx, xy, xz = basis[0, 0], basis[0, 1], basis[0, 2]
    yx, yy, yz = basis[1, 0], basis[1, 1], basis[1, 2]
    zx, zy, zz = basis[2, 0], basis[2, 1], basis[2, 2]
    for k in range(len(out)):
        u, v = x[k], y[k]
        out[k, 0] = u * xx + v * xy + xz
        out[k, 1] = u * yx + v * yy + yz
        out[k, 2] = u * zx + v * zy + zz
