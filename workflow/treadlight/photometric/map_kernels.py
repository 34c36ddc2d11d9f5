"""Maximum a posteriori fit of the full reflection model, many pixels side by side, compiled.

A block of pixels (`map_lanes`) needs some 130 KiB. Most pixels are explained from their best start:
they take some 9 evaluations of the model (`map_model`), and as long as five of them to find it
(`map_starts`). The others of a span, side by side again, take some 28, from several starts.
"""

import math

import numpy as np

from treadlight.compiling import kernel
from treadlight.photometric.map_descent import BETTER, STEP, choose, descend
from treadlight.photometric.map_lanes import (
    BRIGHT,
    DARK,
    HX,
    HY,
    HZ,
    LANES,
    LED,
    LIGHT,
    LX,
    LY,
    LZ,
    ONE,
    SHARP,
    ZERO,
)
from treadlight.photometric.map_model import (
    ALPHA,
    COST,
    EQUATIONS,
    K_S,
    LN_ALPHA,
    LN_RATIO,
    RATIO,
    STATE,
    TANGENTS,
    WORK,
    X,
    Y,
    Z,
    tangents,
)
from treadlight.photometric.map_report import RESULTS, covariances, report, rerender
from treadlight.photometric.map_starts import (
    START,
    START_KS,
    START_X,
    START_Y,
    START_Z,
    STARTS,
    choose_starts,
    starts_desk,
)

# Steps from each start, and from the best of them at each level of misfit.
_FIRST_STEPS, _STEPS = 3, 8
# Pixels whose doubtful ones are put side by side.
SPAN = 16 * LANES
# Parameters fitted at a pixel.
_FITTED = np.float32(5.0)
# Least misfit that the starts are given: the robust cost is flat where residuals are far beyond it.
_FIRST_MISFIT2 = np.float32(0.02**2)


@kernel
def _gather(seen, pixels, leds, look):
    """The LEDs of some pixels; lanes beyond see nothing. `look` is room for their views."""
    intensity, lights, views, usable, noise = seen
    leds[:] = look[:] = ZERO
    for k in range(len(pixels)):
        for c in range(3):
            look[c * LANES + k] = views[pixels[k], c]
    for m in range(intensity.shape[0]):
        led = leds[m * LED : (m + 1) * LED]
        led[DARK : DARK + LANES] = np.float32(np.inf)
        for k in range(len(pixels)):
            at = pixels[k]
            i, lx = intensity[m, at], lights[m, at, 0]
            if usable[m, at] and i == i and lx == lx:
                led[LX + k], led[LY + k], led[LZ + k] = lx, lights[m, at, 1], lights[m, at, 2]
                led[LIGHT + k] = i
                led[DARK + k] = noise[m, at] ** 2
        _add_halfway(led, look)


@kernel
def _add_halfway(led, look):
    """The halfway vectors of an LED, and 1 / intensity where that is worth something."""
    for k in range(LANES):
        lx, ly, lz = led[LX + k], led[LY + k], led[LZ + k]
        hx, hy, hz = lx + look[k], ly + look[LANES + k], lz + look[2 * LANES + k]
        scale = ONE / math.sqrt(max(hx * hx + hy * hy + hz * hz, np.float32(1e-12)))
        # Of an LED that is not used, any unit vector.
        used = lx * lx + ly * ly + lz * lz > 0
        led[HX + k], led[HY + k] = hx * scale if used else ZERO, hy * scale if used else ZERO
        led[HZ + k] = hz * scale if used else ONE
        i = led[LIGHT + k]
        bright = i * i > np.float32(9.0) * led[DARK + k]
        led[BRIGHT + k] = ONE / i if bright and i > 0 else ZERO


@kernel
def _sharpen(leds, misfit2, brightest):
    """How exact the LEDs are if the model misfits by so much, as `Material` defines it."""
    brightest[:] = ZERO
    for m in range(len(leds) // LED):
        light = leds[m * LED + LIGHT :]
        for k in range(LANES):
            brightest[k] = max(brightest[k], light[k])
    for m in range(len(leds) // LED):
        led = leds[m * LED : (m + 1) * LED]
        for k in range(LANES):
            power = led[LIGHT + k] * led[LIGHT + k] + brightest[k] * brightest[k]
            variance = led[DARK + k] + misfit2 * np.float32(0.5) * power
            led[SHARP + k] = ONE / math.sqrt(max(variance, np.float32(1e-30)))


@kernel
def _start(state, start, material):
    alpha, ratio = np.float32(math.exp(material[0])), np.float32(math.exp(material[1]))
    for k in range(LANES):
        state[X + k], state[Y + k] = start[START_X + k], start[START_Y + k]
        state[Z + k] = start[START_Z + k]
        state[K_S + k] = max(start[START_KS + k], np.float32(1e-12))
        state[LN_ALPHA + k], state[LN_RATIO + k] = material[0], material[1]
        state[ALPHA + k], state[RATIO + k] = alpha, ratio


@kernel
def _doubt(leds, eq, enough, doubtful):
    """Which lanes are not explained as well as their LEDs' number lets expect; these see no more.

    A cost of `enough` times the degrees of freedom is: another start could lower it by no more.
    """
    doubtful[:] = -_FITTED
    for m in range(len(leds) // LED):
        led = leds[m * LED : (m + 1) * LED]
        for k in range(LANES):
            doubtful[k] += ONE if led[SHARP + k] > 0 else ZERO
    for k in range(LANES):
        doubtful[k] = ZERO if eq[COST + k] <= enough * doubtful[k] else ONE
    for m in range(len(leds) // LED):
        led = leds[m * LED : (m + 1) * LED]
        for k in range(LANES):
            led[DARK + k] = np.float32(np.inf) if doubtful[k] > 0 else led[DARK + k]


@kernel(allocates=True)
def _make_room(n_leds, out):
    """Arrays to fit a block of lanes in, used anew for every one; and where its results go."""
    return (
        np.empty(n_leds * LED, np.float32),
        np.zeros(STATE, np.float32),
        np.zeros(STATE, np.float32),
        np.zeros(TANGENTS, np.float32),
        np.zeros(WORK, np.float32),
        np.zeros(EQUATIONS, np.float32),
        np.zeros(EQUATIONS, np.float32),
        np.zeros(STEP, np.float32),
        np.empty(LANES, np.float32),
        np.empty(LANES, np.float32),
        np.empty(3 * LANES, np.float32),
        np.empty((STARTS, START), np.float32),
        np.zeros(STATE, np.float32),
        starts_desk(n_leds),
        (np.zeros(RESULTS * LANES, np.float32), out),
    )


@kernel
def _put_off(pixels, doubtful, state, eq, starts, count, waiting, put_off):
    """Keep the lanes in doubt, after `count` others: pixel, state, its cost, starts not yet tried.

    `waiting` (SPAN,) are the pixels, `put_off` the rest in blocks of rows; how many wait then.
    """
    for k in range(len(pixels)):
        if not doubtful[k] > 0:
            continue
        waiting[count] = pixels[k]
        block, lane = put_off[count // LANES], count % LANES
        for row in range(0, STATE, LANES):
            block[row + lane] = state[row + k]
        cost = eq[COST + k]
        block[STATE + lane] = cost if cost == cost else np.float32(np.inf)
        for s in range(1, STARTS):
            for row in range(0, START, LANES):
                block[STATE + LANES + (s - 1) * START + row + lane] = starts[s, row + k]
        count += 1
    return count


@kernel(allocates=True)
def _fit_best_start(seen, pixels, base, material, misfit2, enough, room, count, waiting, put_off):
    """Fit a block from its best starts alone, put off what is in doubt; how many wait then."""
    leds, state, trial, t, work, eq, eq_trial, step, flags, brightest, look, starts, _, desk, _ = (
        room
    )
    _gather(seen, pixels, leds, look)
    _sharpen(leds, max(misfit2, _FIRST_MISFIT2), brightest)
    choose_starts(leds, seen, pixels, base, material, starts, desk)
    _start(state, starts[0], material)
    descend(leds, state, t, work, material, step, trial, eq, eq_trial, _FIRST_STEPS)
    _doubt(leds, eq, enough, flags)
    waited = count
    count = _put_off(pixels, flags, state, eq, starts, count, waiting, put_off)
    if count - waited < len(pixels):
        _sharpen(leds, misfit2, brightest)
        descend(leds, state, t, work, material, step, trial, eq, eq_trial, _STEPS)
        _report(seen, pixels, state, material, room)
    return count


@kernel(allocates=True)
def _fit_other_starts(seen, pixels, material, misfit2, room, put_off):
    """Fit a block that was put off from its other starts too."""
    leds, state, trial, t, work, eq, eq_trial, step, least, brightest, look, _, best, _, _ = room
    level2 = max(misfit2, _FIRST_MISFIT2)
    _gather(seen, pixels, leds, look)
    _sharpen(leds, level2, brightest)
    best[:], least[:] = put_off[:STATE], put_off[STATE : STATE + LANES]
    for s in range(STARTS - 1):
        start = put_off[STATE + LANES + s * START :]
        _start(state, start, material)
        descend(leds, state, t, work, material, step, trial, eq, eq_trial, _FIRST_STEPS)
        better = step[BETTER : BETTER + LANES]
        for k in range(LANES):
            better[k] = ONE if eq[COST + k] < least[k] else ZERO
        choose(better, state, best)
        choose(better, eq[COST : COST + LANES], least)
    descend(leds, best, t, work, material, step, trial, eq, eq_trial, _STEPS)
    if level2 > misfit2:
        _sharpen(leds, misfit2, brightest)
        descend(leds, best, t, work, material, step, trial, eq, eq_trial, _STEPS)
    _report(seen, pixels, best, material, room)


@kernel(allocates=True)
def _report(seen, pixels, state, material, room):
    leds, _, _, t, work, eq, _, step, _, _, _, _, _, _, (found, out) = room
    tangents(state, t)
    rerender(leds, state, work, int(material[5]), found)
    covariances(eq, t, step, found)
    report(found, state, eq, seen[2], pixels, out)


@kernel(allocates=True)
def fit_pixels(
    begin, end, intensity, lights, views, usable, noise, base, material, misfit2, enough, out
):
    """The most probable normal and material of pixels begin to end - 1.

    `begin` is a multiple of LANES: pixels of one block start from the same dictionary.

    Parameters
    ----------
    intensity, lights, views, usable, noise : as in `Observations`
    base : (DIRECTIONS, 3) float32
        Unit vectors about (0, 0, 1).
    material : (6,) float32
        `Material.packed`.
    misfit2 : float32
        Squared misfit of the model relative to the light, as `Material` defines it.
    enough : float32
        A pixel's best start is enough if its cost is at most this, per degree of freedom.
    out : (n, RESULTS) float64
        Written here, in the columns of `map_report`; NaN where there is no normal, but for LEDS.
    """
    seen = (intensity, lights, views, usable, noise)
    room = _make_room(intensity.shape[0], out)
    waiting = np.empty(SPAN, np.int64)
    # Lanes of the last block that nothing is put off in are no pixels, but calculated with.
    put_off = np.ones((SPAN // LANES, STATE + LANES + (STARTS - 1) * START), np.float32)
    for span in range(begin, end, SPAN):
        count = 0
        for first in range(span, min(span + SPAN, end), LANES):
            pixels = np.arange(first, min(first + LANES, end))
            count = _fit_best_start(
                seen, pixels, base, material, misfit2, enough, room, count, waiting, put_off
            )
        for first in range(0, count, LANES):
            pixels = waiting[first : min(first + LANES, count)]
            _fit_other_starts(seen, pixels, material, misfit2, room, put_off[first // LANES])
