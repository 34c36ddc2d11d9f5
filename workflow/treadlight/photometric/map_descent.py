"""Levenberg and Marquardt's descent of many pixels side by side."""

import math

import numpy as np

from treadlight.compiling import kernel
from treadlight.photometric.map_lanes import LANES, ONE, ZERO, either, exp, rows
from treadlight.photometric.map_model import (
    A00,
    A01,
    A02,
    A03,
    A04,
    A11,
    A12,
    A13,
    A14,
    A22,
    A23,
    A24,
    A33,
    A34,
    A44,
    ALPHA,
    B0,
    B1,
    B2,
    B3,
    B4,
    COST,
    K_S,
    LN_ALPHA,
    LN_RATIO,
    RATIO,
    UX,
    UY,
    UZ,
    VX,
    VY,
    VZ,
    X,
    Y,
    Z,
    evaluate,
    tangents,
)

# A fall of the cost that moves no parameter by more than a tenth of its standard deviation: steps
# shrink so fast then that what they leave is some hundredths.
NOTHING = np.float32(1e-2)
_DAMPING, _EASE, _BRAKE = np.float32(1e-2), np.float32(0.2), np.float32(6.0)
_LEAST_DAMPING, _MOST_DAMPING = np.float32(1e-6), np.float32(1e6)
_MOST_TILT, _MOST_LOG = np.float32(0.3), np.float32(1.0)
_LN_ALPHA_MAX = np.float32(math.log(1024.0))
_LN_RATIO_MAX = np.float32(math.log(1e4))

# A step of the five parameters, its damping, whether it was taken, what it promises.
S0, S1, S2, S3, S4, DAMPING, BETTER, PROMISE = rows(8)
STEP = 8 * LANES


@kernel
def solve(eq, step):
    """Steps (A + damping diag A)^-1 b, by L D L'."""
    for k in range(LANES):
        f = ONE + step[DAMPING + k]
        a01, a02, a03, a04 = eq[A01 + k], eq[A02 + k], eq[A03 + k], eq[A04 + k]
        tiny = np.float32(1e-20) + np.float32(1e-7) * eq[A22 + k]
        d0 = eq[A00 + k] * f + tiny
        l10, l20, l30, l40 = a01 / d0, a02 / d0, a03 / d0, a04 / d0
        d1 = max(eq[A11 + k] * f + tiny - l10 * a01, tiny)
        c21 = eq[A12 + k] - l20 * a01
        c31 = eq[A13 + k] - l30 * a01
        c41 = eq[A14 + k] - l40 * a01
        l21, l31, l41 = c21 / d1, c31 / d1, c41 / d1
        d2 = max(eq[A22 + k] * f + tiny - l20 * a02 - l21 * c21, tiny)
        c32 = eq[A23 + k] - l30 * a02 - l31 * c21
        c42 = eq[A24 + k] - l40 * a02 - l41 * c21
        l32, l42 = c32 / d2, c42 / d2
        d3 = max(eq[A33 + k] * f + tiny - l30 * a03 - l31 * c31 - l32 * c32, tiny)
        c43 = eq[A34 + k] - l40 * a03 - l41 * c31 - l42 * c32
        l43 = c43 / d3
        d4 = eq[A44 + k] * f + tiny - l40 * a04 - l41 * c41 - l42 * c42 - l43 * c43
        y0 = eq[B0 + k]
        y1 = eq[B1 + k] - l10 * y0
        y2 = eq[B2 + k] - l20 * y0 - l21 * y1
        y3 = eq[B3 + k] - l30 * y0 - l31 * y1 - l32 * y2
        y4 = eq[B4 + k] - l40 * y0 - l41 * y1 - l42 * y2 - l43 * y3
        x4 = y4 / max(d4, tiny)
        x3 = y3 / d3 - l43 * x4
        x2 = y2 / d2 - l32 * x3 - l42 * x4
        x1 = y1 / d1 - l21 * x2 - l31 * x3 - l41 * x4
        x0 = y0 / d0 - l10 * x1 - l20 * x2 - l30 * x3 - l40 * x4
        step[S0 + k], step[S1 + k], step[S2 + k] = x0, x1, x2
        step[S3 + k], step[S4 + k] = x3, x4


@kernel
def _bound(step):
    """No step turns a normal, or changes a logarithm, further than the equations hold."""
    for row in (S0, S1):
        for k in range(LANES):
            step[row + k] = min(max(step[row + k], -_MOST_TILT), _MOST_TILT)
    for row in (S2, S3, S4):
        for k in range(LANES):
            step[row + k] = min(max(step[row + k], -_MOST_LOG), _MOST_LOG)


@kernel
def _advance(state, t, step, trial):
    """The state after a step; width and ratio stay within their ranges."""
    for k in range(LANES):
        s0, s1 = step[S0 + k], step[S1 + k]
        x = state[X + k] + t[UX + k] * s0 + t[VX + k] * s1
        y = state[Y + k] + t[UY + k] * s0 + t[VY + k] * s1
        z = state[Z + k] + t[UZ + k] * s0 + t[VZ + k] * s1
        inverse = ONE / math.sqrt(x * x + y * y + z * z)
        trial[X + k] = x * inverse
        trial[Y + k] = y * inverse
        trial[Z + k] = z * inverse
    for k in range(LANES):
        la, lr = state[LN_ALPHA + k], state[LN_RATIO + k]
        wide = min(max(step[S3 + k], -la), _LN_ALPHA_MAX - la)
        more = min(max(step[S4 + k], -_LN_RATIO_MAX - lr), _LN_RATIO_MAX - lr)
        trial[K_S + k] = state[K_S + k] * exp(step[S2 + k])
        trial[ALPHA + k] = state[ALPHA + k] * exp(wide)
        trial[RATIO + k] = state[RATIO + k] * exp(more)
        trial[LN_ALPHA + k] = la + wide
        trial[LN_RATIO + k] = lr + more


@kernel
def _judge(eq, eq_trial, step):
    """Whether a step lowers the cost, and the damping after it.

    A lane that has nothing to gain rests, whatever those beside it do.
    """
    for k in range(LANES):
        promised = step[PROMISE + k] - NOTHING
        gain = eq[COST + k] - eq_trial[COST + k]
        gain = gain if promised > 0 else ZERO
        factor = _EASE if gain > 0 else _BRAKE
        factor = factor if promised > 0 else ONE
        step[BETTER + k] = ONE if gain > 0 else ZERO
        step[DAMPING + k] = min(max(step[DAMPING + k] * factor, _LEAST_DAMPING), _MOST_DAMPING)


@kernel
def _promise(eq, step):
    """How much each lane's cost would still fall, to first order; the most of all."""
    most = ZERO
    for k in range(LANES):
        fall = step[S0 + k] * eq[B0 + k] + step[S1 + k] * eq[B1 + k]
        fall += step[S2 + k] * eq[B2 + k] + step[S3 + k] * eq[B3 + k]
        step[PROMISE + k] = fall + step[S4 + k] * eq[B4 + k]
    for k in range(LANES):
        most = max(most, step[PROMISE + k])
    return most


@kernel
def choose(better, new, old):
    """Take the new rows where a step (flags, one per lane) is better."""
    for row in range(len(old) // LANES):
        at = row * LANES
        for k in range(LANES):
            old[at + k] = either(better[k] > 0, new[at + k], old[at + k])


@kernel
def descend(leds, state, t, work, material, step, trial, eq, eq_trial, steps):
    """Levenberg and Marquardt's steps from `state` on, in place; `eq` is that of the last state.

    A step that promises next to nothing is the last one, and taken without asking what it brings.
    What a lane's next step would promise stands in `step` afterwards.
    """
    step[DAMPING : DAMPING + LANES] = _DAMPING
    evaluate(leds, state, t, work, material, eq)
    for left in range(steps, -1, -1):
        solve(eq, step)
        most = _promise(eq, step)
        _bound(step)
        tangents(state, t)
        _advance(state, t, step, trial)
        if most <= NOTHING or left == 0:
            break
        evaluate(leds, trial, t, work, material, eq_trial)
        _judge(eq, eq_trial, step)
        better = step[BETTER : BETTER + LANES]
        choose(better, trial, state)
        choose(better, eq_trial, eq)
    better = step[BETTER : BETTER + LANES]
    for k in range(LANES):
        better[k] = ONE if step[PROMISE + k] <= NOTHING else ZERO
    choose(better, trial, state)
