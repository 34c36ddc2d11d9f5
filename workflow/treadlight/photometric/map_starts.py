"""Where to start the fit of `map_kernels`: the best few of many directions.

A dictionary holds the intensities that the region's usual material would show at `DIRECTIONS`
normals; a pixel's are held against them with a free amplitude. Neighbouring pixels share one
dictionary as long as their LEDs stand alike.
"""

import math

import numpy as np
from numba import njit

from treadlight.photometric.lanes import exp2
from treadlight.photometric.map_lanes import DARKEST, LANES, LEAST_NH, LED, LIGHT, ONE, SHARP, log2

DIRECTIONS = 128
STARTS = 3
# Widest angle between a normal and the view: 75 degrees.
WIDEST = math.radians(75.0)
# Starts nearer than 25 degrees to a better one lead to the same minimum.
APART = math.cos(math.radians(25.0))
# A dictionary serves pixels whose LEDs stand within 3 degrees; every so many pixels are looked at.
_ALIKE = 0.05
_LOOK = 8


@njit(cache=True, error_model="numpy")
def _differs(leds, lane, place):
    """Whether a lane's usable LEDs stand elsewhere than those the dictionary was made for.

    1 if so, 0 if not, -1 if none is usable.
    """
    found = -1
    for m in range(place.shape[0]):
        at = m * LED + lane
        if leds[at + SHARP] > 0:
            found = 0
            for c in range(6):
                if not abs(leds[at + c * LANES] - place[m, c]) <= _ALIKE:
                    return 1
    return found


@njit(cache=True, error_model="numpy")
def _show(led, normals, alpha, ratio, shown, power):
    """What one LED shows of unit gloss at all directions, and its square."""
    lx, ly, lz, hx, hy, hz = led[0], led[1], led[2], led[3], led[4], led[5]
    for j in range(DIRECTIONS):
        nx, ny, nz = normals[j, 0], normals[j, 1], normals[j, 2]
        nl = lx * nx + ly * ny + lz * nz
        nh = min(max(hx * nx + hy * ny + hz * nz, LEAST_NH), ONE)
        lit = ONE if nl > 0 else np.float32(0.0)
        shown[j] = lit * (exp2(max(alpha * log2(nh), DARKEST)) + ratio * nl)
    for j in range(DIRECTIONS):
        power[j] = shown[j] * shown[j]


@njit(cache=True, error_model="numpy")
def _make_dictionary(lights, view, base, prior, place, normals, book, square):
    """Directions about the view, and what the usual material shows at each, (LEDs, directions)."""
    x, y, z = view[0], view[1], view[2]
    sign = ONE if z >= 0 else -ONE
    a = -ONE / (sign + z)
    b = x * y * a
    alpha, ratio = np.float32(math.exp(prior[0])), np.float32(math.exp(prior[1]))
    for m in range(lights.shape[0]):
        hx, hy, hz = lights[m, 0] + x, lights[m, 1] + y, lights[m, 2] + z
        scale = ONE / math.sqrt(max(hx * hx + hy * hy + hz * hz, np.float32(1e-12)))
        place[m, 0], place[m, 1], place[m, 2] = lights[m, 0], lights[m, 1], lights[m, 2]
        place[m, 3], place[m, 4], place[m, 5] = hx * scale, hy * scale, hz * scale
    for j in range(DIRECTIONS):
        u, v, w = base[j, 0], base[j, 1], base[j, 2]
        normals[j, 0] = u * (ONE + sign * x * x * a) + v * b + w * x
        normals[j, 1] = u * sign * b + v * (sign + y * y * a) + w * y
        normals[j, 2] = -u * sign * x - v * y + w * z
    for m in range(lights.shape[0]):
        _show(place[m], normals, alpha, ratio, book[m], square[m])


@njit(cache=True, error_model="numpy")
def _match(leds, lane, book, square, up, down):
    """How much of a lane's light each direction explains, and with which amplitude, in `down`."""
    up[:] = np.float32(0.0)
    down[:] = np.float32(1e-20)
    for m in range(book.shape[0]):
        sharp = leds[m * LED + SHARP + lane]
        w = sharp * sharp
        wi = w * leds[m * LED + LIGHT + lane]
        shown, power = book[m], square[m]
        for j in range(DIRECTIONS):
            up[j] += wi * shown[j]
        for j in range(DIRECTIONS):
            down[j] += w * power[j]
    for j in range(DIRECTIONS):
        down[j] = up[j] / down[j]
    for j in range(DIRECTIONS):
        up[j] *= down[j]


@njit(cache=True, error_model="numpy")
def _best(score):
    best = 0
    for j in range(1, DIRECTIONS):
        if score[j] > score[best]:
            best = j
    return best


@njit(cache=True, error_model="numpy")
def choose_starts(
    leds, lights, views, first, count, base, far, prior, begin, place, normals, book, square
):
    """Normals and strengths to start each lane from, (starts, lanes, 4)."""
    up, down = np.empty(DIRECTIONS, np.float32), np.empty(DIRECTIONS, np.float32)
    begin[:] = np.float32(0.0)
    begin[:, :, 2] = ONE
    looked = False
    for k in range(count):
        looked &= k % _LOOK > 0
        if not looked:
            differs = _differs(leds, k, place)
            looked = differs >= 0
            if differs > 0:
                _make_dictionary(
                    lights[:, first + k], views[first + k], base, prior, place, normals, book,
                    square,
                )  # fmt: skip
        _match(leds, k, book, square, up, down)
        for s in range(STARTS):
            best = _best(up)
            begin[s, k, :3] = normals[best]
            begin[s, k, 3] = down[best]
            for j in range(DIRECTIONS):
                up[j] *= far[best, j]
