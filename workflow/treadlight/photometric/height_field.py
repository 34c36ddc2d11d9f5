"""What the kernels of rays and of shadows share: a height field at one place, and rays over it."""

import math

import numpy as np

from treadlight.compiling import kernel


@kernel(inline="always")
def sample(field, row, column):
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


@kernel(inline="always")
def top(tops, size, row, column):
    """Of the block of `size` cells that a place lies in; beside the grid, that of its border."""
    i = min(max(int(row), 0) // size, tops.shape[0] - 1)
    j = min(max(int(column), 0) // size, tops.shape[1] - 1)
    return tops[i, j]


@kernel(inline="always")
def atan(q):
    """Arc tangent to 1e-5 for |q| < 0.4: rays turn little about the axis near the surface.

    It rises everywhere, so that an angle between two others stays there.
    """
    p = q * q
    return q * (1.0 - p * (1 / 3 - p * (1 / 5 - p * (1 / 7 - p / 9))))


@kernel(inline="always")
def angle(x, y, radius):
    """Arc tangent of y / x to 1e-15 for x > 0, where `radius` is the root of x2 + y2.

    By halves, an eighth of it at last, without a branch or a call: it is vectorised.
    """
    q = y / (radius + x)
    q = q / (1.0 + math.sqrt(1.0 + q * q))
    q = q / (1.0 + math.sqrt(1.0 + q * q))
    p = q * q
    tail = 1 / 13 - p * (1 / 15 - p * (1 / 17 - p * (1 / 19)))
    tail = 1 / 7 - p * (1 / 9 - p * (1 / 11 - p * tail))
    return 8.0 * q * (1.0 - p * (1 / 3 - p * (1 / 5 - p * tail)))


@kernel(inline="always")
def cos_sin(phi):
    """Cosine and sine to 1e-13 for |phi| < 1: what one view sees of a tire turns by less."""
    q = phi * phi
    return _nested(q, 2, 12, 30, 56, 90, 132, 182), phi * _nested(q, 6, 20, 42, 72, 110, 156, 210)


@kernel(inline="always")
def _nested(q, a, b, c, d, e, f, g):
    """1 - q/a (1 - q/b (1 - ...)), as the series of cosine and sine nest."""
    rest = 1.0 - q * (1.0 / f) * (1.0 - q * (1.0 / g))
    rest = 1.0 - q * (1.0 / d) * (1.0 - q * (1.0 / e) * rest)
    return 1.0 - q * (1.0 / a) * (1.0 - q * (1.0 / b) * (1.0 - q * (1.0 / c) * rest))


@kernel
def crossings(x, y, dx, dy, radius):
    """Both ray parameters at which |(x, y) + t (dx, dy)| = radius; NaN if never."""
    a = dx * dx + dy * dy
    b = x * dx + y * dy
    disc = b * b - a * (x * x + y * y - radius * radius)
    if not (a > 0.0 and disc >= 0.0):
        return np.nan, np.nan
    root, inverse = math.sqrt(disc), 1.0 / a
    return (-b - root) * inverse, (root - b) * inverse
