"""Maximum a posteriori fit of the full reflection model, many pixels side by side, compiled.

A block of pixels (`map_lanes`) needs some 20 KiB, and an evaluation of the model with its normal
equations about 130 operations per pixel and LED; a pixel takes some 40 evaluations.
"""

import math

import numpy as np
from numba import njit, prange

from treadlight.photometric.kernels import invert
from treadlight.photometric.lanes import exp2
from treadlight.photometric.map_lanes import (
    DARKEST,
    HX,
    HY,
    HZ,
    LANES,
    LEAST_NH,
    LED,
    LIGHT,
    LN2,
    LX,
    LY,
    LZ,
    ONE,
    SHARP,
    exp,
    log2,
    rows,
)
from treadlight.photometric.map_starts import DIRECTIONS, STARTS, choose_starts

# Columns of the result. The last five: posterior of (ln alpha, ln k_d/k_s).
NX, NY, NZ, KD, KS, ALPHA, RESIDUAL, LEDS, COST, CXX = *range(9), 9
LOG_ALPHA, LOG_RATIO, CAA, CAR, CRR, RESULTS = *range(15, 20), 20

# Pixels that one thread takes at a time.
_RUN = 32 * LANES
# Steps from each start, and at each level of misfit from the best of them on.
_FIRST_STEPS, _STEPS = 5, 12
# Misfit that the starts are given: the robust cost is flat where residuals are far beyond it. Then
# it falls by this factor down to what it is (graduated non-convexity).
_FIRST_MISFIT2, _FALL2 = np.float32(0.1**2), np.float32(1 / 4.0**2)
_DAMPING, _EASE, _BRAKE = np.float32(1e-2), np.float32(0.2), np.float32(6.0)
_MOST_TILT, _MOST_LOG = np.float32(0.3), np.float32(1.0)
_LOG_ALPHA_MAX = np.float32(math.log(1024.0))
_LOG_RATIO_MAX = np.float32(math.log(1e4))
# Geman and McClure's function of the residual: at this many standard deviations a quarter's weight.
_ROBUST = np.float32(1 / 6.0**2)

# State: the normal, k_s, k_d / k_s, alpha, the logarithms of the last two.
_X, _Y, _Z, _KS, _RATIO, _AL, _LA, _LR = rows(8)
_STATE = 8 * LANES
# Two unit vectors across the normal.
_UX, _UY, _UZ, _VX, _VY, _VZ = rows(6)
_TANGENTS = 6 * LANES
# Normal equations of (two tilts, ln k_s, ln alpha, ln k_d / k_s), and the cost.
(
    _A00, _A01, _A02, _A03, _A04, _A11, _A12, _A13, _A14, _A22, _A23, _A24, _A33, _A34, _A44,
    _B0, _B1, _B2, _B3, _B4, _COST,
) = rows(21)  # fmt: skip
_EQUATIONS = 21 * LANES
# One LED's terms in between.
_GLOSS, _DIFFUSE, _POWER, _SLOPE, _LIT, _MISS, _WEIGHT, _J0, _J1, _KD = rows(10)
_WORK = 10 * LANES
# A step of the five parameters, its damping, whether it was taken.
_S0, _S1, _S2, _S3, _S4, _DAMP, _BETTER = rows(7)
_STEP = 7 * LANES


@njit(cache=True, error_model="numpy")
def _tangents(state, t):
    """Two unit vectors across n (Duff et al. 2017, for either sign of n_z)."""
    for k in range(LANES):
        x, y, z = state[_X + k], state[_Y + k], state[_Z + k]
        sign = ONE if z >= 0 else -ONE
        a = -ONE / (sign + z)
        b = x * y * a
        t[_UX + k] = ONE + sign * x * x * a
        t[_UY + k] = sign * b
        t[_UZ + k] = -sign * x
        t[_VX + k] = b
        t[_VY + k] = sign + y * y * a
        t[_VZ + k] = -y


@njit(cache=True, error_model="numpy")
def _shade(led, state, work):
    """k_s (n.h)^alpha, k_d n.l, log2 (n.h) and alpha gloss / n.h of one LED."""
    for k in range(LANES):
        x, y, z = state[_X + k], state[_Y + k], state[_Z + k]
        nl = led[LX + k] * x + led[LY + k] * y + led[LZ + k] * z
        nh = max(led[HX + k] * x + led[HY + k] * y + led[HZ + k] * z, LEAST_NH)
        lit = ONE if nl > 0 else np.float32(0.0)
        power = log2(min(nh, ONE))
        alpha = state[_AL + k]
        gloss = state[_KS + k] * exp2(max(alpha * power, DARKEST)) * lit
        work[_GLOSS + k] = gloss
        work[_DIFFUSE + k] = work[_KD + k] * nl * lit
        work[_POWER + k] = power
        work[_SLOPE + k] = alpha * gloss / nh
        work[_LIT + k] = work[_KD + k] * lit


@njit(cache=True, error_model="numpy")
def _weigh(led, work, eq):
    """Standardised residual, its robust weight, and the cost of one LED."""
    for k in range(LANES):
        r = (led[LIGHT + k] - work[_GLOSS + k] - work[_DIFFUSE + k]) * led[SHARP + k]
        g = ONE / (ONE + r * r * _ROBUST)
        work[_MISS + k] = r
        work[_WEIGHT + k] = g * g
        eq[_COST + k] += r * r * g


@njit(cache=True, error_model="numpy")
def _tilt(led, t, work):
    """Derivatives of one LED's standardised model by the two tilts."""
    for k in range(LANES):
        lx, ly, lz = led[LX + k], led[LY + k], led[LZ + k]
        hx, hy, hz = led[HX + k], led[HY + k], led[HZ + k]
        lit, slope, sharp = work[_LIT + k], work[_SLOPE + k], led[SHARP + k]
        gx, gy, gz = lit * lx + slope * hx, lit * ly + slope * hy, lit * lz + slope * hz
        work[_J0 + k] = (gx * t[_UX + k] + gy * t[_UY + k] + gz * t[_UZ + k]) * sharp
        work[_J1 + k] = (gx * t[_VX + k] + gy * t[_VY + k] + gz * t[_VZ + k]) * sharp


@njit(cache=True, error_model="numpy")
def _accumulate(led, state, work, eq):
    """Add one LED to the normal equations."""
    for k in range(LANES):
        w, r, sharp = work[_WEIGHT + k], work[_MISS + k], led[SHARP + k]
        gloss, diffuse = work[_GLOSS + k] * sharp, work[_DIFFUSE + k] * sharp
        x0, x1, x2, x4 = work[_J0 + k], work[_J1 + k], gloss + diffuse, diffuse
        x3 = gloss * state[_AL + k] * work[_POWER + k] * LN2
        w0, w1, w2, w3, w4 = w * x0, w * x1, w * x2, w * x3, w * x4
        eq[_A00 + k] += w0 * x0
        eq[_A01 + k] += w0 * x1
        eq[_A02 + k] += w0 * x2
        eq[_A03 + k] += w0 * x3
        eq[_A04 + k] += w0 * x4
        eq[_A11 + k] += w1 * x1
        eq[_A12 + k] += w1 * x2
        eq[_A13 + k] += w1 * x3
        eq[_A14 + k] += w1 * x4
        eq[_A22 + k] += w2 * x2
        eq[_A23 + k] += w2 * x3
        eq[_A24 + k] += w2 * x4
        eq[_A33 + k] += w3 * x3
        eq[_A34 + k] += w3 * x4
        eq[_A44 + k] += w4 * x4
        eq[_B0 + k] += w0 * r
        eq[_B1 + k] += w1 * r
        eq[_B2 + k] += w2 * r
        eq[_B3 + k] += w3 * r
        eq[_B4 + k] += w4 * r


@njit(cache=True, error_model="numpy")
def _add_prior(state, prior, eq):
    mean_a, mean_r, aa, ar, rr = prior[0], prior[1], prior[2], prior[3], prior[4]
    for k in range(LANES):
        x, y = state[_LA + k] - mean_a, state[_LR + k] - mean_r
        gx, gy = aa * x + ar * y, ar * x + rr * y
        eq[_A33 + k] += aa
        eq[_A34 + k] += ar
        eq[_A44 + k] += rr
        eq[_B3 + k] -= gx
        eq[_B4 + k] -= gy
        eq[_COST + k] += x * gx + y * gy


@njit(cache=True, error_model="numpy")
def _evaluate(leds, state, t, work, prior, eq):
    """Normal equations and cost of a block's state."""
    eq[:] = np.float32(0.0)
    _tangents(state, t)
    for k in range(LANES):
        work[_KD + k] = state[_KS + k] * state[_RATIO + k]
    for m in range(len(leds) // LED):
        led = leds[m * LED : (m + 1) * LED]
        _shade(led, state, work)
        _weigh(led, work, eq)
        _tilt(led, t, work)
        _accumulate(led, state, work, eq)
    _add_prior(state, prior, eq)


@njit(cache=True, error_model="numpy")
def _solve(eq, step):
    """Steps (A + damping diag A)^-1 b, clipped, by L D L'."""
    for k in range(LANES):
        f = ONE + step[_DAMP + k]
        a01, a02, a03, a04 = eq[_A01 + k], eq[_A02 + k], eq[_A03 + k], eq[_A04 + k]
        tiny = np.float32(1e-20) + np.float32(1e-7) * eq[_A22 + k]
        d0 = eq[_A00 + k] * f + tiny
        l10, l20, l30, l40 = a01 / d0, a02 / d0, a03 / d0, a04 / d0
        d1 = max(eq[_A11 + k] * f + tiny - l10 * a01, tiny)
        c21 = eq[_A12 + k] - l20 * a01
        c31 = eq[_A13 + k] - l30 * a01
        c41 = eq[_A14 + k] - l40 * a01
        l21, l31, l41 = c21 / d1, c31 / d1, c41 / d1
        d2 = max(eq[_A22 + k] * f + tiny - l20 * a02 - l21 * c21, tiny)
        c32 = eq[_A23 + k] - l30 * a02 - l31 * c21
        c42 = eq[_A24 + k] - l40 * a02 - l41 * c21
        l32, l42 = c32 / d2, c42 / d2
        d3 = max(eq[_A33 + k] * f + tiny - l30 * a03 - l31 * c31 - l32 * c32, tiny)
        c43 = eq[_A34 + k] - l40 * a03 - l41 * c31 - l42 * c32
        l43 = c43 / d3
        d4 = eq[_A44 + k] * f + tiny - l40 * a04 - l41 * c41 - l42 * c42 - l43 * c43
        y0 = eq[_B0 + k]
        y1 = eq[_B1 + k] - l10 * y0
        y2 = eq[_B2 + k] - l20 * y0 - l21 * y1
        y3 = eq[_B3 + k] - l30 * y0 - l31 * y1 - l32 * y2
        y4 = eq[_B4 + k] - l40 * y0 - l41 * y1 - l42 * y2 - l43 * y3
        x4 = y4 / max(d4, tiny)
        x3 = y3 / d3 - l43 * x4
        x2 = y2 / d2 - l32 * x3 - l42 * x4
        x1 = y1 / d1 - l21 * x2 - l31 * x3 - l41 * x4
        x0 = y0 / d0 - l10 * x1 - l20 * x2 - l30 * x3 - l40 * x4
        step[_S0 + k] = min(max(x0, -_MOST_TILT), _MOST_TILT)
        step[_S1 + k] = min(max(x1, -_MOST_TILT), _MOST_TILT)
        step[_S2 + k] = min(max(x2, -_MOST_LOG), _MOST_LOG)
        step[_S3 + k] = min(max(x3, -_MOST_LOG), _MOST_LOG)
        step[_S4 + k] = min(max(x4, -_MOST_LOG), _MOST_LOG)


@njit(cache=True, error_model="numpy")
def _advance(state, t, step, trial):
    """The state after a step; width and ratio stay within their ranges."""
    for k in range(LANES):
        s0, s1 = step[_S0 + k], step[_S1 + k]
        x = state[_X + k] + t[_UX + k] * s0 + t[_VX + k] * s1
        y = state[_Y + k] + t[_UY + k] * s0 + t[_VY + k] * s1
        z = state[_Z + k] + t[_UZ + k] * s0 + t[_VZ + k] * s1
        inverse = ONE / math.sqrt(x * x + y * y + z * z)
        trial[_X + k] = x * inverse
        trial[_Y + k] = y * inverse
        trial[_Z + k] = z * inverse
    for k in range(LANES):
        la, lr = state[_LA + k], state[_LR + k]
        wide = min(max(step[_S3 + k], -la), _LOG_ALPHA_MAX - la)
        more = min(max(step[_S4 + k], -_LOG_RATIO_MAX - lr), _LOG_RATIO_MAX - lr)
        trial[_KS + k] = state[_KS + k] * exp(step[_S2 + k])
        trial[_AL + k] = state[_AL + k] * exp(wide)
        trial[_RATIO + k] = state[_RATIO + k] * exp(more)
        trial[_LA + k] = la + wide
        trial[_LR + k] = lr + more


@njit(cache=True, error_model="numpy")
def _judge(eq, eq_trial, step):
    """Whether a step lowers the cost, and the damping after it."""
    for k in range(LANES):
        good = eq_trial[_COST + k] < eq[_COST + k]
        step[_BETTER + k] = ONE if good else np.float32(0.0)
        damp = step[_DAMP + k] * (_EASE if good else _BRAKE)
        step[_DAMP + k] = min(max(damp, np.float32(1e-6)), np.float32(1e6))


@njit(cache=True, error_model="numpy")
def _choose(better, new, old):
    """Take the new rows where a step (flags, one per lane) is better."""
    for row in range(0, len(old), LANES):
        into, source = old[row : row + LANES], new[row : row + LANES]
        for k in range(LANES):
            into[k] = source[k] if better[k] > 0 else into[k]


@njit(cache=True, error_model="numpy")
def _descend(leds, state, t, work, prior, step, trial, eq, eq_trial, steps):
    """Levenberg and Marquardt's steps from `state` on, in place; `eq` is that of the last state."""
    step[_DAMP : _DAMP + LANES] = _DAMPING
    _evaluate(leds, state, t, work, prior, eq)
    for _ in range(steps):
        _solve(eq, step)
        _tangents(state, t)
        _advance(state, t, step, trial)
        _evaluate(leds, trial, t, work, prior, eq_trial)
        _judge(eq, eq_trial, step)
        better = step[_BETTER : _BETTER + LANES]
        _choose(better, trial, state)
        _choose(better, eq_trial, eq)


@njit(cache=True, error_model="numpy")
def _gather(intensity, noise, usable, lights, views, first, count, misfit2, leds):
    """The LEDs of `count` pixels from `first` on; lanes beyond see nothing."""
    leds[:] = np.float32(0.0)
    n_leds = intensity.shape[0]
    bright = np.zeros(LANES, np.float32)
    for m in range(n_leds):
        for k in range(count):
            i = intensity[m, first + k]
            if usable[m, first + k] and i > bright[k]:
                bright[k] = i
    for m in range(n_leds):
        led = leds[m * LED : (m + 1) * LED]
        led[HZ : HZ + LANES] = ONE
        for k in range(count):
            i = intensity[m, first + k]
            if not (usable[m, first + k] and i == i):
                continue
            lx, ly, lz = lights[m, first + k, 0], lights[m, first + k, 1], lights[m, first + k, 2]
            hx, hy, hz = (
                lx + views[first + k, 0],
                ly + views[first + k, 1],
                lz + views[first + k, 2],
            )
            scale = ONE / math.sqrt(max(hx * hx + hy * hy + hz * hz, np.float32(1e-12)))
            led[LX + k], led[LY + k], led[LZ + k] = lx, ly, lz
            led[HX + k], led[HY + k], led[HZ + k] = hx * scale, hy * scale, hz * scale
            variance = noise[m, first + k] ** 2
            variance += misfit2 * np.float32(0.5) * (i * i + bright[k] * bright[k])
            led[LIGHT + k] = i
            led[SHARP + k] = ONE / math.sqrt(max(variance, np.float32(1e-30)))


@njit(cache=True, error_model="numpy")
def _start(state, lane, normal, strength, prior):
    state[_X + lane], state[_Y + lane], state[_Z + lane] = normal[0], normal[1], normal[2]
    state[_KS + lane] = max(strength, np.float32(1e-12))
    state[_LA + lane], state[_LR + lane] = prior[0], prior[1]
    state[_AL + lane] = np.float32(math.exp(prior[0]))
    state[_RATIO + lane] = np.float32(math.exp(prior[1]))


@njit(cache=True, error_model="numpy")
def _rerender(leds, lane, state, noise, out):
    """Mean relative error (eq. 5.30) over LEDs above three sigma, and how many LEDs there are."""
    used, bright, relative = 0, 0, 0.0
    for m in range(len(noise)):
        led = leds[m * LED : (m + 1) * LED]
        if not led[SHARP + lane] > 0:
            continue
        used += 1
        nl = nh = np.float32(0.0)
        for c in range(0, 3 * LANES, LANES):
            nl += led[LX + c + lane] * state[_X + c + lane]
            nh += led[HX + c + lane] * state[_X + c + lane]
        model = np.float32(0.0)
        if nl > 0:
            power = state[_AL + lane] * log2(min(max(nh, LEAST_NH), ONE))
            model = state[_KS + lane] * (exp2(max(power, DARKEST)) + state[_RATIO + lane] * nl)
        light = led[LIGHT + lane]
        if light > 3 * noise[m]:
            relative += abs(light - model) / light
            bright += 1
    out[LEDS] = used
    out[RESIDUAL] = relative / bright if bright else np.nan


@njit(cache=True, error_model="numpy")
def _report(lane, view, state, t, eq, matrix, out):
    """Parameters and covariances of one lane."""
    facing = 0.0
    for c in range(3):
        facing += view[c] * state[_X + c * LANES + lane]
    if out[LEDS] < 4 or not out[RESIDUAL] >= 0 or not facing > 0:
        out[RESIDUAL] = np.nan
        return
    out[NX], out[NY], out[NZ] = state[_X + lane], state[_Y + lane], state[_Z + lane]
    out[KS], out[ALPHA] = state[_KS + lane], state[_AL + lane]
    out[KD] = state[_KS + lane] * state[_RATIO + lane]
    out[COST] = eq[_COST + lane]
    row = lane
    for i in range(5):
        for j in range(i, 5):
            matrix[i, j] = matrix[j, i] = eq[row]
            row += LANES
        # Where nothing tells a parameter, its variance is large, not infinite.
        matrix[i, i] += 1e-6
    invert(matrix)
    at = CXX
    for i in range(3):
        for j in range(i, 3):
            total = 0.0
            for a in range(2):
                for b in range(2):
                    across = t[(3 * a + i) * LANES + lane] * t[(3 * b + j) * LANES + lane]
                    total += matrix[a, b] * across
            out[at] = total
            at += 1
    out[LOG_ALPHA], out[LOG_RATIO] = state[_LA + lane], state[_LR + lane]
    out[CAA], out[CAR], out[CRR] = matrix[3, 3], matrix[3, 4], matrix[4, 4]


@njit(cache=True, error_model="numpy", parallel=True)
def fit_pixels(intensity, lights, views, usable, noise, base, far, prior, misfit2, out):
    """The most probable normal and material of every pixel.

    Parameters
    ----------
    intensity, lights, views, usable, noise : as in `Observations`
    base : (DIRECTIONS, 3) float32
        Unit vectors about (0, 0, 1).
    far : (DIRECTIONS, DIRECTIONS) float32
        0 where two of them are too near to each other to be different starts, else 1.
    prior : (5,) float32
        Means of ln alpha and ln(k_d / k_s), and the inverse of their covariance (xx, xy, yy).
    misfit2 : float32
        Squared misfit of the model relative to the light, as `Material` defines it.
    out : (n, RESULTS) float64
        Written here: see the column names above; NaN where there is no normal, with LEDS.
    """
    n = intensity.shape[1]
    for run in prange((n + _RUN - 1) // _RUN):
        first = np.int64(run) * _RUN
        _fit_run(intensity, lights, views, usable, noise, base, far, prior, misfit2,
                 first, min(n, first + _RUN), out)  # fmt: skip


@njit(cache=True, error_model="numpy")
def _fit_run(intensity, lights, views, usable, noise, base, far, prior, misfit2, begin, end, out):
    """Blocks of pixels one after the other, which share a dictionary while their LEDs are alike."""
    n_leds = intensity.shape[0]
    leds = np.empty(n_leds * LED, np.float32)
    state, best = np.zeros(_STATE, np.float32), np.zeros(_STATE, np.float32)
    trial = np.zeros(_STATE, np.float32)
    t, work = np.zeros(_TANGENTS, np.float32), np.zeros(_WORK, np.float32)
    eq, eq_trial = np.zeros(_EQUATIONS, np.float32), np.zeros(_EQUATIONS, np.float32)
    step, least = np.zeros(_STEP, np.float32), np.empty(LANES, np.float32)
    first_steps = np.empty((STARTS, LANES, 4), np.float32)
    place, normals = np.full((n_leds, 6), np.nan, np.float32), np.zeros((DIRECTIONS, 3), np.float32)
    book = np.zeros((n_leds, DIRECTIONS), np.float32)
    square = np.zeros((n_leds, DIRECTIONS), np.float32)
    matrix = np.zeros((5, 5))
    for first in range(begin, end, LANES):
        count = min(LANES, end - first)
        level2 = max(misfit2, _FIRST_MISFIT2)
        _gather(intensity, noise, usable, lights, views, first, count, level2, leds)
        choose_starts(leds, lights, views, first, count, base, far, prior, first_steps,
                       place, normals, book, square)  # fmt: skip
        least[:] = np.float32(np.inf)
        # A pixel that no start explains has no normal.
        best[:] = np.float32(0.0)
        for s in range(STARTS):
            for k in range(LANES):
                _start(state, k, first_steps[s, k], first_steps[s, k, 3], prior)
            _descend(leds, state, t, work, prior, step, trial, eq, eq_trial, _FIRST_STEPS)
            better = step[_BETTER : _BETTER + LANES]
            for k in range(LANES):
                better[k] = ONE if eq[_COST + k] < least[k] else np.float32(0.0)
            _choose(better, state, best)
            _choose(better, eq[_COST : _COST + LANES], least)
        while True:
            level2 = max(misfit2, level2 * _FALL2)
            _gather(intensity, noise, usable, lights, views, first, count, level2, leds)
            _descend(leds, best, t, work, prior, step, trial, eq, eq_trial, _STEPS)
            if level2 <= misfit2:
                break
        _tangents(best, t)
        for k in range(count):
            out[first + k, :] = np.nan
            _rerender(leds, k, best, noise[:, first + k], out[first + k])
            _report(k, views[first + k], best, t, eq, matrix, out[first + k])
