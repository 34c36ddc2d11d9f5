"""Maximum a posteriori fit of the full reflection model, many pixels side by side, compiled.

A block of pixels (`map_lanes`) needs some 130 KiB, and 40 ns a pixel for an evaluation of the model
(`map_model`) by one core. Where pixels are an image's, most are explained from where the pixel
above ended, after some four evaluations. The others of a span of pixels, side by side again, are
fitted to the end, and those that this leaves in doubt are asked whether they are explained better
from one of their starts (`map_starts`). Pixels without one above begin at their best start.
"""

import math

import numpy as np

from treadlight.compiling import kernel
from treadlight.photometric.map_descent import (
    BETTER,
    NOTHING,
    PROMISE,
    STEP,
    choose,
    descend,
)
from treadlight.photometric.map_gather import count_usable, gather, sharpen
from treadlight.photometric.map_lanes import LANES, LED, ONE, SHARP, ZERO
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
    evaluate,
    tangents,
)
from treadlight.photometric.map_report import (
    FOUND,
    FOUND_K_S,
    FOUND_LN_ALPHA,
    FOUND_LN_RATIO,
    LEDS,
    NORMAL_X,
    NORMAL_Y,
    NORMAL_Z,
    covariances,
    report,
    rerender,
)
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
from treadlight.photometric.observations import MIN_LEDS

# Steps from where the pixel above ended, from each start, and from there to the end.
_NEAR_STEPS, _FIRST_STEPS, _STEPS = 3, 3, 8
# Pixels whose unfinished ones are put side by side.
SPAN = 16 * LANES
# A start is better if it leaves a cost lower by more than this: a standard deviation's.
_LEAD = np.float32(1.0)
# Parameters fitted at a pixel.
_FITTED = np.float32(5.0)
# Least misfit that the starts are given: the robust cost is flat where residuals are far beyond it.
_FIRST_MISFIT2 = np.float32(0.02**2)


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
def _start_above(state, pixels, width, out):
    """Start where the pixels above ended; lanes that are no pixels keep what they hold."""
    for k in range(len(pixels)):
        at = pixels[k] - width
        state[X + k], state[Y + k], state[Z + k] = (
            out[NORMAL_X, at],
            out[NORMAL_Y, at],
            out[NORMAL_Z, at],
        )
        state[K_S + k] = max(out[FOUND_K_S, at], np.float32(1e-12))
        state[LN_ALPHA + k], state[LN_RATIO + k] = out[FOUND_LN_ALPHA, at], out[FOUND_LN_RATIO, at]
    for k in range(LANES):
        state[ALPHA + k] = np.float32(math.exp(state[LN_ALPHA + k]))
        state[RATIO + k] = np.float32(math.exp(state[LN_RATIO + k]))


@kernel
def _doubt(leds, eq, enough, doubtful):
    """Which lanes are not explained as well as their LEDs' number lets expect.

    A cost of `enough` times the degrees of freedom is.
    """
    doubtful[:] = -_FITTED
    for m in range(len(leds) // LED):
        led = leds[m * LED : (m + 1) * LED]
        for k in range(LANES):
            doubtful[k] += ONE if led[SHARP + k] > 0 else ZERO
    for k in range(LANES):
        doubtful[k] = ZERO if eq[COST + k] <= enough * doubtful[k] else ONE


@kernel
def _doubt_unfinished(step, doubtful):
    """Lanes that another step would still do something for are in doubt too."""
    for k in range(LANES):
        doubtful[k] = doubtful[k] if step[PROMISE + k] <= NOTHING else ONE


@kernel(allocates=True)
def _make_room(n_leds, out):
    """Arrays to fit a block of lanes in, used anew for every one; and where its results go."""
    return (
        np.empty(n_leds * LED, np.float32),
        np.ones(STATE, np.float32),
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
        (np.zeros(FOUND, np.float32), out),
    )


@kernel(allocates=True)
def _make_queue():
    """Pixels of a span that wait, and their states in blocks of rows.

    Lanes of the last block that are no pixels are calculated with all the same.
    """
    return np.empty(SPAN, np.int64), np.ones((SPAN // LANES, STATE), np.float32)


@kernel
def _put_off(pixels, chosen, state, queue, count):
    """Add the chosen lanes to a queue of `count`; how many it has then."""
    waiting, states = queue
    for k in range(len(pixels)):
        if not chosen[k] > 0:
            continue
        waiting[count] = pixels[k]
        block, lane = states[count // LANES], count % LANES
        for row in range(0, STATE, LANES):
            block[row + lane] = state[row + k]
        count += 1
    return count


@kernel(allocates=True)
def _fit_from_above(seen, pixels, width, material, misfit2, enough, room, queue, count):
    """Fit a block from where the pixels above ended; what is in doubt then waits."""
    leds, state, trial, t, work, eq, eq_trial, step, doubtful, brightest, look = room[:11]
    gather(seen, pixels, leds, look)
    sharpen(leds, misfit2, brightest)
    _start_above(state, pixels, width, room[14][1])
    descend(leds, state, t, work, material, step, trial, eq, eq_trial, _NEAR_STEPS)
    _doubt(leds, eq, enough, doubtful)
    _doubt_unfinished(step, doubtful)
    waited = count
    count = _put_off(pixels, doubtful, state, queue, count)
    if count - waited < len(pixels):
        _report(seen, pixels, state, material, room)
    return count


@kernel(allocates=True)
def _begin(seen, pixels, base, material, first2, room, queue, count):
    """Take a block some steps from its best starts; all of it waits then."""
    leds, state, trial, t, work, eq, eq_trial, step, chosen, brightest, look = room[:11]
    starts, desk = room[11], room[13]
    gather(seen, pixels, leds, look)
    sharpen(leds, first2, brightest)
    choose_starts(leds, seen, pixels, base, material, starts, desk)
    _start(state, starts[0], material)
    descend(leds, state, t, work, material, step, trial, eq, eq_trial, _FIRST_STEPS)
    chosen[:] = ONE
    return _put_off(pixels, chosen, state, queue, count)


@kernel(allocates=True)
def _finish(seen, pixels, states, material, misfits, soften, enough, room, queue, count):
    """Fit a block from where it stands to the end; what is in doubt then waits.

    `soften`: with the first misfit before. By that one it is in doubt: what is explained as well
    as the first misfit lets expect would hardly be better explained from elsewhere.
    """
    leds, state, trial, t, work, eq, eq_trial, step, doubtful, brightest, look = room[:11]
    first2, misfit2 = misfits
    gather(seen, pixels, leds, look)
    state[:] = states
    if soften and first2 > misfit2:
        sharpen(leds, first2, brightest)
        descend(leds, state, t, work, material, step, trial, eq, eq_trial, _STEPS)
    sharpen(leds, misfit2, brightest)
    descend(leds, state, t, work, material, step, trial, eq, eq_trial, _STEPS)
    _report(seen, pixels, state, material, room)
    sharpen(leds, first2, brightest)
    evaluate(leds, state, t, work, material, eq)
    _doubt(leds, eq, enough, doubtful)
    return _put_off(pixels, doubtful, state, queue, count)


@kernel(allocates=True)
def _finish_all(seen, queue, count, material, misfits, soften, enough, room, doubtful, left):
    """Finish a queue of `count`; how many wait in the other one then, which had `left`."""
    for k in range(0, count, LANES):
        pixels, states = queue[0][k : min(k + LANES, count)], queue[1][k // LANES]
        left = _finish(
            seen, pixels, states, material, misfits, soften, enough, room, doubtful, left
        )
    return left


@kernel(allocates=True)
def _try_starts(seen, pixels, states, base, material, first2, room, queue, count):
    """Which pixels of a block are explained better from one of their starts; these wait there."""
    leds, state, trial, t, work, eq, eq_trial, step, least, changed, look = room[:11]
    starts, best, desk = room[11], room[12], room[13]
    gather(seen, pixels, leds, look)
    sharpen(leds, first2, changed)
    choose_starts(leds, seen, pixels, base, material, starts, desk)
    best[:] = states
    evaluate(leds, best, t, work, material, eq)
    better = step[BETTER : BETTER + LANES]
    for k in range(LANES):
        cost = eq[COST + k]
        least[k], changed[k] = cost if cost == cost else np.float32(np.inf), ZERO
    for s in range(STARTS):
        _start(state, starts[s], material)
        descend(leds, state, t, work, material, step, trial, eq, eq_trial, _FIRST_STEPS)
        for k in range(LANES):
            better[k] = ONE if eq[COST + k] < least[k] - _LEAD else ZERO
            changed[k] = max(changed[k], better[k])
        choose(better, state, best)
        choose(better, eq[COST : COST + LANES], least)
    return _put_off(pixels, changed, best, queue, count)


@kernel(allocates=True)
def _report(seen, pixels, state, material, room):
    leds, _, _, t, work, eq, _, step = room[:8]
    found, out = room[14]
    tangents(state, t)
    rerender(leds, state, work, int(material[5]), found)
    covariances(eq, t, step, found)
    report(found, state, eq, seen[2], pixels, out)


@kernel
def _sort(seen, span, width, first_row, used, above, new, out):
    """How many pixels of a span begin at the one above, and how many do not; these in `new`.

    Those that see too few LEDs are in neither.
    """
    first, last = span
    n_above = n_new = 0
    count_usable(seen[3], first, used[: last - first])
    for k in range(first, last):
        over = k - width
        if used[k - first] < MIN_LEDS:
            out[:, k] = np.nan
            out[LEDS, k] = used[k - first]
        elif width > 0 and first_row <= over < first and out[NORMAL_X, over] == out[NORMAL_X, over]:
            above[n_above] = k
            n_above += 1
        else:
            new[n_new] = k
            n_new += 1
    return n_above, n_new


@kernel(allocates=True)
def _fit_span(seen, span, width, first_row, base, material, misfit2, enough, room, desk):
    """Fit the pixels of a span; all above it, from that of `first_row` on, are."""
    used, above, new, queue, doubtful = desk
    n_above, n_new = _sort(seen, span, width, first_row, used, above, new, room[14][1])
    first2, nobody = max(misfit2, _FIRST_MISFIT2), np.float32(np.inf)
    misfits = (first2, misfit2)
    count = left = 0
    for k in range(0, n_new, LANES):
        pixels = new[k : min(k + LANES, n_new)]
        count = _begin(seen, pixels, base, material, first2, room, queue, count)
    left = _finish_all(seen, queue, count, material, misfits, True, enough, room, doubtful, left)
    count = 0
    for k in range(0, n_above, LANES):
        pixels = above[k : min(k + LANES, n_above)]
        count = _fit_from_above(seen, pixels, width, material, misfit2, enough, room, queue, count)
    left = _finish_all(seen, queue, count, material, misfits, False, enough, room, doubtful, left)
    count = 0
    for k in range(0, left, LANES):
        pixels, states = doubtful[0][k : min(k + LANES, left)], doubtful[1][k // LANES]
        count = _try_starts(seen, pixels, states, base, material, first2, room, queue, count)
    _finish_all(seen, queue, count, material, misfits, True, nobody, room, doubtful, 0)


@kernel(allocates=True)
def fit_pixels(
    begin, end, intensity, lights, views, usable, noise, base, material, misfit2, enough,
    width, band, out,
):  # fmt: skip
    """The most probable normal and material of the pixels of bands begin to end - 1.

    Parameters
    ----------
    intensity, lights, views, usable, noise : as `Observations.arrays` gives them
    base : (DIRECTIONS, 3) float32
        Unit vectors about (0, 0, 1).
    material : (6,) float32
        `Material.packed`.
    misfit2 : float32
        Squared misfit of the model relative to the light, as `Material` defines it.
    enough : float32
        A fit needs no other start if its cost is at most this, per degree of freedom.
    width : int
        Pixels in a row of the image that these are, row by row; 0 if they are no image's.
    band : int
        Pixels of a band: whole rows. Its first row knows of none above.
    out : (RESULTS, n) float32
        Written here, in the rows of `map_report`; NaN where there is no normal, but for LEDS.
    """
    seen = (intensity, lights, views, usable, noise)
    room = _make_room(intensity.shape[0], out)
    desk = (
        np.empty(SPAN, np.uint8), np.empty(SPAN, np.int64), np.empty(SPAN, np.int64),
        _make_queue(), _make_queue(),
    )  # fmt: skip
    # Of a span longer than a row, some pixels would lie above others.
    length = min(SPAN, max(width // LANES, 1) * LANES) if width > 0 else SPAN
    for number in range(begin, end):
        first_row, last = number * band, min((number + 1) * band, out.shape[1])
        for first in range(first_row, last, length):
            span = (first, min(first + length, last))
            _fit_span(seen, span, width, first_row, base, material, misfit2, enough, room, desk)
