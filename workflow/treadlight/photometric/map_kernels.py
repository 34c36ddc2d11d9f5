"""Maximum a posteriori fit of the full reflection model, many pixels side by side, compiled.

A block of pixels (`map_lanes`) needs some 130 KiB. A pixel takes some 20 evaluations of the model
(`map_model`), and as long as eight of them to find its starts (`map_starts`).
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
# Least misfit that the starts are given: the robust cost is flat where residuals are far beyond it.
_FIRST_MISFIT2 = np.float32(0.02**2)


@kernel
def _gather(intensity, noise, usable, lights, views, first, count, leds):
    """The LEDs of `count` pixels from `first` on; lanes beyond see nothing."""
    leds[:] = ZERO
    for m in range(intensity.shape[0]):
        led = leds[m * LED : (m + 1) * LED]
        led[HZ : HZ + LANES] = ONE
        led[DARK : DARK + LANES] = np.float32(np.inf)
        for k in range(count):
            i = intensity[m, first + k]
            lx, ly, lz = lights[m, first + k, 0], lights[m, first + k, 1], lights[m, first + k, 2]
            if not (usable[m, first + k] and i == i and lx == lx):
                continue
            hx, hy, hz = (
                lx + views[first + k, 0],
                ly + views[first + k, 1],
                lz + views[first + k, 2],
            )
            scale = ONE / math.sqrt(max(hx * hx + hy * hy + hz * hz, np.float32(1e-12)))
            led[LX + k], led[LY + k], led[LZ + k] = lx, ly, lz
            led[HX + k], led[HY + k], led[HZ + k] = hx * scale, hy * scale, hz * scale
            led[LIGHT + k] = i
            led[DARK + k] = noise[m, first + k] ** 2
            led[BRIGHT + k] = ONE / i if i > 3 * noise[m, first + k] else ZERO


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


@kernel(allocates=True)
def fit_pixels(begin, end, intensity, lights, views, usable, noise, base, material, misfit2, out):
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
    out : (n, RESULTS) float64
        Written here, in the columns of `map_report`; NaN where there is no normal, but for LEDS.
    """
    n_leds = intensity.shape[0]
    leds = np.empty(n_leds * LED, np.float32)
    state, best = np.zeros(STATE, np.float32), np.zeros(STATE, np.float32)
    trial = np.zeros(STATE, np.float32)
    t, work = np.zeros(TANGENTS, np.float32), np.zeros(WORK, np.float32)
    eq, eq_trial = np.zeros(EQUATIONS, np.float32), np.zeros(EQUATIONS, np.float32)
    step = np.zeros(STEP, np.float32)
    least, brightest = np.empty(LANES, np.float32), np.empty(LANES, np.float32)
    starts = np.empty((STARTS, START), np.float32)
    desk = starts_desk(n_leds)
    found = np.zeros(RESULTS * LANES, np.float32)
    for first in range(begin, end, LANES):
        count = min(LANES, end - first)
        level2 = max(misfit2, _FIRST_MISFIT2)
        _gather(intensity, noise, usable, lights, views, first, count, leds)
        _sharpen(leds, level2, brightest)
        choose_starts(leds, lights, views, first, count, base, material, starts, desk)
        least[:] = np.float32(np.inf)
        # A pixel that no start explains has no normal.
        best[:] = ZERO
        for s in range(STARTS):
            _start(state, starts[s], material)
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
        tangents(best, t)
        rerender(leds, best, work, int(material[5]), found)
        covariances(eq, t, step, found)
        report(found, best, eq, views, first, count, out)
