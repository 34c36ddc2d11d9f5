"""The full reflection model of many pixels side by side: its cost and normal equations.

The gloss is Blinn and Phong's, or the generalised distribution of Trowbridge and Reitz (Burley
2012) in their terms: what a pixel shows of texture below it, and microfacets, have longer tails.

About 130 operations per pixel and LED.
"""

import numpy as np

from treadlight.compiling import kernel
from treadlight.photometric.lanes import exp2, fma, log2
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
    ZERO,
    rows,
)

# Geman and McClure's function of the residual: at this many standard deviations a quarter's weight.
_ROBUST = np.float32(1 / 6.0**2)

# State: the normal, k_s, k_d / k_s, alpha, the logarithms of the last two.
X, Y, Z, K_S, RATIO, ALPHA, LN_ALPHA, LN_RATIO = rows(8)
STATE = 8 * LANES
# Two unit vectors across the normal.
UX, UY, UZ, VX, VY, VZ = rows(6)
TANGENTS = 6 * LANES
# Normal equations of (two tilts, ln k_s, ln alpha, ln k_d / k_s), and the cost.
(
    A00, A01, A02, A03, A04, A11, A12, A13, A14, A22, A23, A24, A33, A34, A44,
    B0, B1, B2, B3, B4, COST,
) = rows(21)  # fmt: skip
EQUATIONS = 21 * LANES
# One LED's terms in between.
GLOSS, DIFFUSE, _POWER, _SLOPE, _LIT, _MISS, _WEIGHT, _J0, _J1, K_D = rows(10)
WORK = 10 * LANES


@kernel
def tangents(state, t):
    """Two unit vectors across n (Duff et al. 2017, for either sign of n_z)."""
    for k in range(LANES):
        x, y, z = state[X + k], state[Y + k], state[Z + k]
        sign = ONE if z >= 0 else -ONE
        a = -ONE / (sign + z)
        b = x * y * a
        t[UX + k] = ONE + sign * x * x * a
        t[UY + k] = sign * b
        t[UZ + k] = -sign * x
        t[VX + k] = b
        t[VY + k] = sign + y * y * a
        t[VZ + k] = -y


@kernel(inline="always")
def _look(led, state, k):
    """n.l, whether it is lit, n.h and log2 (n.h) of one LED and lane."""
    x, y, z = state[X + k], state[Y + k], state[Z + k]
    nl = fma(led[LX + k], x, fma(led[LY + k], y, led[LZ + k] * z))
    nh = fma(led[HX + k], x, fma(led[HY + k], y, led[HZ + k] * z))
    nh = min(max(nh, LEAST_NH), ONE)
    return nl, ONE if nl > 0 else ZERO, nh, log2(nh)


@kernel
def shade(led, state, work, squarings):
    """Gloss and diffuse light of one LED, and the gloss's relative slopes by ln alpha and n.h.

    `squarings` as `Material.squarings` has it.
    """
    if squarings < 0:
        _shade_blinn_phong(led, state, work)
    else:
        _shade_trowbridge_reitz(led, state, work, squarings)


@kernel
def _shade_blinn_phong(led, state, work):
    """k_s (n.h)^alpha (eq. 5.1)."""
    for k in range(LANES):
        nl, lit, nh, power = _look(led, state, k)
        alpha = state[ALPHA + k]
        gloss = state[K_S + k] * exp2(max(alpha * power, DARKEST)) * lit
        work[GLOSS + k] = gloss
        work[DIFFUSE + k] = work[K_D + k] * nl * lit
        work[_POWER + k] = power
        work[_SLOPE + k] = alpha * gloss * (ONE / nh)
        work[_LIT + k] = work[K_D + k] * lit


@kernel
def _shade_trowbridge_reitz(led, state, work, squarings):
    """k_s (1 - alpha ln(n.h) / gamma)^-gamma, gamma = 2^squarings: as sharp, with longer tails."""
    share = LN2 / np.float32(2.0**squarings)
    for k in range(LANES):
        nl, lit, nh, power = _look(led, state, k)
        alpha = state[ALPHA + k]
        # One division for two.
        tail = fma(-share * alpha, power, ONE)
        inverse = ONE / (nh * tail)
        part = inverse * nh
        work[GLOSS + k] = part * lit
        work[DIFFUSE + k] = work[K_D + k] * nl * lit
        work[_POWER + k] = power * part
        work[_SLOPE + k] = alpha * inverse
        work[_LIT + k] = work[K_D + k] * lit
    for _ in range(squarings):
        for k in range(LANES):
            work[GLOSS + k] *= work[GLOSS + k]
    for k in range(LANES):
        gloss = state[K_S + k] * work[GLOSS + k]
        work[GLOSS + k] = gloss
        work[_SLOPE + k] *= gloss


@kernel
def _weigh(led, work, eq):
    """Standardised residual, its robust weight, and the cost of one LED."""
    for k in range(LANES):
        r = (led[LIGHT + k] - work[GLOSS + k] - work[DIFFUSE + k]) * led[SHARP + k]
        g = ONE / fma(r * r, _ROBUST, ONE)
        work[_MISS + k] = r
        work[_WEIGHT + k] = g * g
        eq[COST + k] = fma(r * r, g, eq[COST + k])


@kernel
def _tilt(led, t, work):
    """Derivatives of one LED's standardised model by the two tilts."""
    for k in range(LANES):
        lx, ly, lz = led[LX + k], led[LY + k], led[LZ + k]
        hx, hy, hz = led[HX + k], led[HY + k], led[HZ + k]
        lit, slope, sharp = work[_LIT + k], work[_SLOPE + k], led[SHARP + k]
        lit, slope = lit * sharp, slope * sharp
        gx, gy, gz = fma(lit, lx, slope * hx), fma(lit, ly, slope * hy), fma(lit, lz, slope * hz)
        work[_J0 + k] = fma(gx, t[UX + k], fma(gy, t[UY + k], gz * t[UZ + k]))
        work[_J1 + k] = fma(gx, t[VX + k], fma(gy, t[VY + k], gz * t[VZ + k]))


@kernel
def _accumulate(led, state, work, eq):
    """Add one LED to the normal equations."""
    for k in range(LANES):
        w, r, sharp = work[_WEIGHT + k], work[_MISS + k], led[SHARP + k]
        gloss, diffuse = work[GLOSS + k] * sharp, work[DIFFUSE + k] * sharp
        x0, x1, x2, x4 = work[_J0 + k], work[_J1 + k], gloss + diffuse, diffuse
        x3 = gloss * state[ALPHA + k] * work[_POWER + k] * LN2
        w0, w1, w2, w3, w4 = w * x0, w * x1, w * x2, w * x3, w * x4
        eq[A00 + k] = fma(w0, x0, eq[A00 + k])
        eq[A01 + k] = fma(w0, x1, eq[A01 + k])
        eq[A02 + k] = fma(w0, x2, eq[A02 + k])
        eq[A03 + k] = fma(w0, x3, eq[A03 + k])
        eq[A04 + k] = fma(w0, x4, eq[A04 + k])
        eq[A11 + k] = fma(w1, x1, eq[A11 + k])
        eq[A12 + k] = fma(w1, x2, eq[A12 + k])
        eq[A13 + k] = fma(w1, x3, eq[A13 + k])
        eq[A14 + k] = fma(w1, x4, eq[A14 + k])
        eq[A22 + k] = fma(w2, x2, eq[A22 + k])
        eq[A23 + k] = fma(w2, x3, eq[A23 + k])
        eq[A24 + k] = fma(w2, x4, eq[A24 + k])
        eq[A33 + k] = fma(w3, x3, eq[A33 + k])
        eq[A34 + k] = fma(w3, x4, eq[A34 + k])
        eq[A44 + k] = fma(w4, x4, eq[A44 + k])
        eq[B0 + k] = fma(w0, r, eq[B0 + k])
        eq[B1 + k] = fma(w1, r, eq[B1 + k])
        eq[B2 + k] = fma(w2, r, eq[B2 + k])
        eq[B3 + k] = fma(w3, r, eq[B3 + k])
        eq[B4 + k] = fma(w4, r, eq[B4 + k])


@kernel
def _add_prior(state, material, eq):
    mean_a, mean_r, aa, ar, rr = material[0], material[1], material[2], material[3], material[4]
    for k in range(LANES):
        x, y = state[LN_ALPHA + k] - mean_a, state[LN_RATIO + k] - mean_r
        gx, gy = aa * x + ar * y, ar * x + rr * y
        eq[A33 + k] += aa
        eq[A34 + k] += ar
        eq[A44 + k] += rr
        eq[B3 + k] -= gx
        eq[B4 + k] -= gy
        eq[COST + k] += x * gx + y * gy


@kernel
def evaluate(leds, state, t, work, material, eq):
    """Normal equations and cost of a block's state; `material` as `Material.packed` has it."""
    eq[:] = ZERO
    squarings = int(material[5])
    tangents(state, t)
    for k in range(LANES):
        work[K_D + k] = state[K_S + k] * state[RATIO + k]
    for m in range(len(leds) // LED):
        led = leds[m * LED : (m + 1) * LED]
        shade(led, state, work, squarings)
        _weigh(led, work, eq)
        _tilt(led, t, work)
        _accumulate(led, state, work, eq)
    _add_prior(state, material, eq)
