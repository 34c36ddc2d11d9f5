"""What a fit of many pixels side by side has found: results, residuals and covariances."""

import numpy as np

from treadlight.compiling import kernel
from treadlight.photometric.map_descent import DAMPING, S0, S1, S3, S4, solve
from treadlight.photometric.map_lanes import BRIGHT, LANES, LED, LIGHT, ONE, SHARP, ZERO
from treadlight.photometric.map_model import (
    ALPHA,
    B0,
    B1,
    B3,
    B4,
    COST,
    DIFFUSE,
    GLOSS,
    K_D,
    K_S,
    LN_ALPHA,
    LN_RATIO,
    RATIO,
    UX,
    VX,
    X,
    Y,
    Z,
    shade,
)
from treadlight.photometric.observations import MIN_LEDS

# Columns of the result. The last five: posterior of (ln alpha, ln k_d/k_s).
NORMAL_X, NORMAL_Y, NORMAL_Z, FOUND_K_D, FOUND_K_S, FOUND_ALPHA = range(6)
RESIDUAL, LEDS, FOUND_COST, CXX = range(6, 10)
FOUND_LN_ALPHA, FOUND_LN_RATIO, CAA, CAR, CRR, RESULTS = range(15, 21)
# Rows of a block's results: those above, and whether there is a normal (1, else NaN).
_KNOWN = RESULTS * LANES
FOUND = _KNOWN + LANES


@kernel(allocates=True)
def rerender(leds, state, work, squarings, found):
    """Mean relative error (eq. 5.30) over LEDs above three sigma, and how many LEDs there are."""
    relative, used = found[RESIDUAL * LANES :], found[LEDS * LANES :]
    bright = np.zeros(LANES, np.float32)
    for k in range(LANES):
        relative[k] = used[k] = ZERO
        work[K_D + k] = state[K_S + k] * state[RATIO + k]
    for m in range(len(leds) // LED):
        led = leds[m * LED : (m + 1) * LED]
        shade(led, state, work, squarings)
        for k in range(LANES):
            miss = led[LIGHT + k] - work[GLOSS + k] - work[DIFFUSE + k]
            relative[k] += abs(miss) * led[BRIGHT + k]
            bright[k] += ONE if led[BRIGHT + k] > 0 else ZERO
            used[k] += ONE if led[SHARP + k] > 0 else ZERO
    for k in range(LANES):
        relative[k] /= bright[k]


@kernel(allocates=True)
def covariances(eq, t, step, found):
    """Of the normal's components, and of the material's logarithms, from the inverse equations."""
    step[DAMPING : DAMPING + LANES] = ZERO
    _unit_solution(eq, B1, step)
    yy = step[S1 : S1 + LANES].copy()
    _unit_solution(eq, B0, step)
    at = CXX * LANES
    for i in range(3):
        for j in range(i, 3):
            ui, vi = t[UX + i * LANES :], t[VX + i * LANES :]
            uj, vj = t[UX + j * LANES :], t[VX + j * LANES :]
            for k in range(LANES):
                cross = step[S1 + k] * (ui[k] * vj[k] + vi[k] * uj[k])
                found[at + k] = step[S0 + k] * ui[k] * uj[k] + yy[k] * vi[k] * vj[k] + cross
            at += LANES
    _unit_solution(eq, B4, step)
    for k in range(LANES):
        found[CRR * LANES + k] = step[S4 + k]
    _unit_solution(eq, B3, step)
    for k in range(LANES):
        found[CAA * LANES + k], found[CAR * LANES + k] = step[S3 + k], step[S4 + k]


@kernel
def _unit_solution(eq, row, step):
    """A row of the normal equations' inverse."""
    eq[B0 : B4 + LANES] = ZERO
    eq[row : row + LANES] = ONE
    solve(eq, step)


@kernel
def report(found, state, eq, views, pixels, out):
    """Write a block's results; NaN, but for the count of LEDs, where there is no normal."""
    for k in range(LANES):
        found[NORMAL_X * LANES + k], found[NORMAL_Y * LANES + k] = state[X + k], state[Y + k]
        found[NORMAL_Z * LANES + k] = state[Z + k]
        found[FOUND_K_D * LANES + k] = state[K_S + k] * state[RATIO + k]
        found[FOUND_K_S * LANES + k] = state[K_S + k]
        found[FOUND_ALPHA * LANES + k] = state[ALPHA + k]
        found[FOUND_COST * LANES + k] = eq[COST + k]
        found[FOUND_LN_ALPHA * LANES + k] = state[LN_ALPHA + k]
        found[FOUND_LN_RATIO * LANES + k] = state[LN_RATIO + k]
    _tell_known(found, views, pixels)
    for c in range(RESULTS):
        row = found[c * LANES : (c + 1) * LANES]
        if c != LEDS:
            for k in range(LANES):
                row[k] *= found[_KNOWN + k]
        _write(row, pixels, out[c])


@kernel
def _tell_known(found, views, pixels):
    """Which lanes have a normal: it faces the camera, and enough LEDs show light."""
    for k in range(len(pixels)):
        facing = ZERO
        for c in range(3):
            facing += views[pixels[k], c] * found[c * LANES + k]
        found[_KNOWN + k] = facing
    for k in range(LANES):
        known = (found[_KNOWN + k] > 0) & (found[RESIDUAL * LANES + k] >= 0)
        known = known & (found[LEDS * LANES + k] >= MIN_LEDS)
        found[_KNOWN + k] = ONE if known else np.float32(np.nan)


@kernel
def _write(row, pixels, out):
    count, first = len(pixels), pixels[0]
    if pixels[count - 1] - first == count - 1:
        for k in range(count):
            out[first + k] = row[k]
    else:
        for k in range(count):
            out[pixels[k]] = row[k]
