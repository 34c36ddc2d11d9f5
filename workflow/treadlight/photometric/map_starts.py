"""Where to start the fit of `map_kernels`: the best few of many directions.

A dictionary holds the intensities that the region's usual material would show at `DIRECTIONS`
normals; the pixels of a block are held against them side by side, each with a free amplitude:
some 4 operations per pixel, LED and direction. Pixels share one dictionary as long as their LEDs
stand alike, as those of neighbours do.
"""

import math

import numpy as np

from treadlight.compiling import kernel
from treadlight.photometric.lanes import exp2, fma, log2
from treadlight.photometric.map_lanes import (
    DARKEST,
    LANES,
    LEAST_NH,
    LED,
    LIGHT,
    LN2,
    LX,
    ONE,
    SHARP,
    ZERO,
    either,
    rows,
)

DIRECTIONS = 128
STARTS = 3
# Widest angle between a normal and the view: 75 degrees.
WIDEST = math.radians(75.0)
# A start: normal and strength.
START_X, START_Y, START_Z, START_KS = rows(4)
START = 4 * LANES
# Starts nearer than 25 degrees to a better one lead to the same minimum.
_APART = np.float32(math.cos(math.radians(25.0)))
# A dictionary serves pixels whose LEDs stand within 3 degrees.
_ALIKE = np.float32(0.05)
# One LED's light over its variance and 1 over it; what a direction explains, and its strength.
_WEIGHED = _SCORE = 2 * LANES
# LEDs that a loop takes at a time; a dictionary has rows for a multiple of as many.
_TOGETHER = 4


@kernel(allocates=True)
def starts_desk(n_leds):
    """Room for `choose_starts` to work in, used anew for every block.

    The dictionary (places of the LEDs, normals, what they show), with LEDs a multiple of those
    taken together; LEDs weighed; scores; the start found last; best scores and their directions;
    lanes that wait and are served.
    """
    padded = (n_leds + _TOGETHER - 1) // _TOGETHER * _TOGETHER
    return (
        np.empty((n_leds, 6), np.float32),
        np.empty((3, DIRECTIONS), np.float32),
        np.zeros((padded, DIRECTIONS), np.float32),
        np.zeros(padded * _WEIGHED, np.float32),
        np.empty(DIRECTIONS * _SCORE, np.float32),
        np.zeros(START, np.float32),
        np.empty(2 * LANES, np.float32),
        np.empty(LANES, np.float32),
        np.empty(LANES, np.float32),
    )


@kernel
def _show(led, normals, alpha, ratio, squarings, shown):
    """What one LED shows of unit gloss at all directions."""
    lx, ly, lz, hx, hy, hz = led[0], led[1], led[2], led[3], led[4], led[5]
    x, y, z = normals[0], normals[1], normals[2]
    share = LN2 / np.float32(2.0**squarings)
    for j in range(DIRECTIONS):
        nh = min(max(hx * x[j] + hy * y[j] + hz * z[j], LEAST_NH), ONE)
        power = log2(nh)
        blinn_phong = exp2(max(alpha * power, DARKEST))
        shown[j] = blinn_phong if squarings < 0 else ONE / (ONE - share * alpha * power)
    for _ in range(squarings):
        for j in range(DIRECTIONS):
            shown[j] *= shown[j]
    for j in range(DIRECTIONS):
        nl = lx * x[j] + ly * y[j] + lz * z[j]
        shown[j] = (shown[j] + ratio * nl) * (ONE if nl > 0 else ZERO)


@kernel
def _make_dictionary(lights, view, base, material, place, normals, book):
    """Directions about the view, and what the usual material shows at each, (LEDs, directions)."""
    x, y, z = view[0], view[1], view[2]
    sign = ONE if z >= 0 else -ONE
    a = -ONE / (sign + z)
    b = x * y * a
    alpha, ratio = np.float32(math.exp(material[0])), np.float32(math.exp(material[1]))
    for m in range(lights.shape[0]):
        hx, hy, hz = lights[m, 0] + x, lights[m, 1] + y, lights[m, 2] + z
        scale = ONE / math.sqrt(max(hx * hx + hy * hy + hz * hz, np.float32(1e-12)))
        place[m, 0], place[m, 1], place[m, 2] = lights[m, 0], lights[m, 1], lights[m, 2]
        place[m, 3], place[m, 4], place[m, 5] = hx * scale, hy * scale, hz * scale
        # What is unknown shows nothing.
        for c in range(6):
            place[m, c] = place[m, c] if place[m, c] == place[m, c] else ZERO
    for j in range(DIRECTIONS):
        u, v, w = base[j, 0], base[j, 1], base[j, 2]
        normals[0, j] = u * (ONE + sign * x * x * a) + v * b + w * x
        normals[1, j] = u * sign * b + v * (sign + y * y * a) + w * y
        normals[2, j] = -u * sign * x - v * y + w * z
    for m in range(lights.shape[0]):
        _show(place[m], normals, alpha, ratio, int(material[5]), book[m])


@kernel
def _serve(leds, place, waiting, served):
    """Which of the waiting lanes have their usable LEDs where the dictionary has them."""
    for k in range(LANES):
        served[k] = waiting[k]
    for m in range(place.shape[0]):
        led = leds[m * LED : (m + 1) * LED]
        for c in range(6):
            at = place[m, c]
            row = led[LX + c * LANES : LX + (c + 1) * LANES]
            for k in range(LANES):
                alike = abs(row[k] - at) <= _ALIKE
                served[k] = served[k] if alike or not led[SHARP + k] > 0 else ZERO


@kernel
def _weigh(leds, weighed):
    """Squared sharpness of the LEDs, with and without their light, as `_match` wants them."""
    for m in range(len(leds) // LED):
        led = leds[m * LED : (m + 1) * LED]
        row = weighed[m * _WEIGHED : (m + 1) * _WEIGHED]
        for k in range(LANES):
            sharp2 = led[SHARP + k] * led[SHARP + k]
            row[k] = sharp2 * led[LIGHT + k]
            row[LANES + k] = sharp2


@kernel
def _match(weighed, book, score):
    """How much of each lane's light a direction explains, and with which strength."""
    for j in range(DIRECTIONS):
        at = score[j * _SCORE : (j + 1) * _SCORE]
        at[:] = ZERO
        for m in range(0, book.shape[0], _TOGETHER):
            led = weighed[m * _WEIGHED : (m + _TOGETHER) * _WEIGHED]
            a, b, c, d = book[m, j], book[m + 1, j], book[m + 2, j], book[m + 3, j]
            aa, bb, cc, dd = a * a, b * b, c * c, d * d
            for k in range(LANES):
                e, f = fma(led[k], a, at[k]), fma(led[LANES + k], aa, at[LANES + k])
                e, f = fma(led[2 * LANES + k], b, e), fma(led[3 * LANES + k], bb, f)
                e, f = fma(led[4 * LANES + k], c, e), fma(led[5 * LANES + k], cc, f)
                at[k] = fma(led[6 * LANES + k], d, e)
                at[LANES + k] = fma(led[7 * LANES + k], dd, f)
        for k in range(LANES):
            strength = at[k] / (at[LANES + k] + np.float32(1e-20))
            at[k] *= strength
            at[LANES + k] = strength


@kernel
def _pick(score, best):
    """The best direction of each lane."""
    best[:LANES] = -ONE
    best[LANES:] = ZERO
    for j in range(DIRECTIONS):
        at, number = score[j * _SCORE : (j + 1) * _SCORE], np.float32(j)
        for k in range(LANES):
            better = at[k] > best[k]
            best[k] = either(better, at[k], best[k])
            best[LANES + k] = either(better, number, best[LANES + k])


@kernel
def _pick_next(score, normals, former, best):
    """The best direction of each lane that is apart from the one chosen before.

    What is not counts for nothing from now on.
    """
    best[:LANES] = -ONE
    best[LANES:] = ZERO
    for j in range(DIRECTIONS):
        x, y, z = normals[0, j], normals[1, j], normals[2, j]
        at, number = score[j * _SCORE : (j + 1) * _SCORE], np.float32(j)
        for k in range(LANES):
            along = former[START_X + k] * x + former[START_Y + k] * y + former[START_Z + k] * z
            worth = at[k] if along < _APART else -ONE
            at[k] = worth
            better = worth > best[k]
            best[k] = either(better, worth, best[k])
            best[LANES + k] = either(better, number, best[LANES + k])


@kernel
def _take(score, normals, best, served, found, start):
    """The start that was picked, into found; and into the starts of those lanes that are served."""
    for k in range(LANES):
        j = int(best[LANES + k])
        found[START_X + k], found[START_Y + k] = normals[0, j], normals[1, j]
        found[START_Z + k] = normals[2, j]
        found[START_KS + k] = score[j * _SCORE + LANES + k]
    for row in range(0, START, LANES):
        for k in range(LANES):
            start[row + k] = either(served[k] > 0, found[row + k], start[row + k])


@kernel
def _middle(waiting):
    """The middle one of the lanes that wait, -1 if none does."""
    half = waiting.sum() / 2
    passed = ZERO
    for k in range(LANES):
        passed += waiting[k]
        if waiting[k] > 0 and passed >= half:
            return k
    return -1


@kernel
def choose_starts(leds, seen, pixels, base, material, starts, desk):
    """Normals and strengths to start each lane from: (STARTS, START), a flat block of rows each.

    The best one first. `seen` are the fields of `Observations`, `desk` is one of `starts_desk`.
    """
    place, normals, book, weighed, score, found, best, waiting, served = desk
    waiting[:] = ZERO
    waiting[: len(pixels)] = ONE
    starts[:] = ZERO
    starts[:, START_Z : START_Z + LANES] = ONE
    _weigh(leds, weighed)
    lane = _middle(waiting)
    while lane >= 0:
        at = pixels[lane]
        _make_dictionary(seen[1][:, :, at], seen[2][at], base, material, place, normals, book)
        _serve(leds, place, waiting, served)
        served[lane] = ONE
        _match(weighed, book, score)
        _pick(score, best)
        _take(score, normals, best, served, found, starts[0])
        for s in range(1, STARTS):
            _pick_next(score, normals, found, best)
            _take(score, normals, best, served, found, starts[s])
        for k in range(LANES):
            waiting[k] -= served[k]
        lane = _middle(waiting)
