"""What algorithms 2 to 4 report of a block of pixels: residuals, misfits and covariances.

Everything is in units of the pixel's brightest gloss, so that single precision holds any light.
About 120 operations per pixel and LED.
"""

import math

import numpy as np

from treadlight.compiling import kernel
from treadlight.photometric import lanes
from treadlight.photometric.lanes import ALPHA_MAX, PIXELS, exp2, log2
from treadlight.photometric.map_lanes import DARKEST, LEAST_NH, ONE, ZERO

# Columns of the result.
NX, NY, NZ, KD, KS, ALPHA, RESIDUAL, LEDS, MISFIT, CXX, RESULTS = *range(10), 15


def _rows(count: int) -> range:
    return range(0, count * PIXELS, PIXELS)


# One LED, gathered from `lanes`' rows: in this order those of _TAKEN, then its error's variance
# and what its light does to the two tilts of the normal.
_TAKEN = (
    lanes.LIGHT, lanes.NOISE, lanes.USE, lanes.NL, lanes.NH, lanes.HX, lanes.HY, lanes.HZ,
    lanes.W, lanes.X, lanes.Y, lanes.PART,
)  # fmt: skip
_LIGHT, _NOISE, _USE, _NL, _NH, _HX, _HY, _HZ, _W, _X, _Y, _PART, _GAIN_U, _GAIN_V = _rows(14)
_LED = 14 * PIXELS

# The pixels' normals and lobes (k_d in units of the brightest gloss), and which LED gave k_d.
(
    _N0, _N1, _N2, _K_D, _ALPHA, _LOG_LENGTH, _LENGTH, _UNIT, _SEARCHED, _DARKEST, _DARK_NL,
    _RHO2,
) = _rows(12)  # fmt: skip
_PIXEL = 12 * PIXELS
# Two unit vectors across the normal.
_UX, _UY, _UZ, _VX, _VY, _VZ = _rows(6)
_TANGENTS = 6 * PIXELS
# Sums over the LEDs of the residuals.
_RELATIVE, _BRIGHT, _USED, _SQUARES, _POWER, _DARK = _rows(6)
_SUMS = 6 * PIXELS
# Normal equations of (N, s) in double precision, and the two solutions that the tilts take.
_A00, _A01, _A02, _A03, _A11, _A12, _A13, _A22, _A23, _A33 = _rows(10)
_U0, _U1, _U2, _U3, _V0, _V1, _V2, _V3, _THROUGH_U, _THROUGH_V, _UU, _UV, _VV = (
    10 * PIXELS + row for row in _rows(13)
)
_SOLUTION = 23 * PIXELS
_LN2 = np.float32(lanes.LN2)
_LEAST_PIVOT = 1e-12


@kernel(allocates=True)
def report_desk(n_leds):
    """Memory for one block: LEDs, pixels, tangents, sums, equations, results."""
    return (
        np.empty(n_leds * _LED, np.float32),
        np.empty(_PIXEL, np.float32),
        np.empty(_TANGENTS, np.float32),
        np.empty(_SUMS, np.float32),
        np.empty(_SOLUTION),
        np.empty((RESULTS, PIXELS)),
    )


@kernel
def report(r, v, normals, lobes, misfit2, prior_weight, desk):
    """Results of a block's pixels, (RESULTS, PIXELS) double, in the desk's last array.

    Parameters
    ----------
    r, v : rows and lanes
        As the last pass had them; NL and NH of the normals found, DARKEST and DARK_NL those of
        the LED of eq. 5.27.
    normals : (3, PIXELS) float64
    lobes : (4, PIXELS) float64
        k_d, 1 / alpha, the length of N and the brightest gloss.
    misfit2, prior_weight : float
        The region's squared relative misfit, and how many observations it is worth.
    """
    leds, pixel, t, sums, eq, found = desk
    _gather(r, leds)
    _describe(v, normals, lobes, pixel, found)
    _rerender(leds, pixel, sums)
    _judge(sums, misfit2, prior_weight, pixel, found)
    _tangents(pixel, t)
    _propagate(leds, pixel, t, eq)
    _spread(t, eq, found)


@kernel
def _gather(r, leds):
    for m in range(r.shape[1]):
        led = leds[m * _LED : (m + 1) * _LED]
        for k in range(len(_TAKEN)):
            row, at = r[_TAKEN[k], m], k * PIXELS
            for p in range(PIXELS):
                led[at + p] = row[p]


@kernel
def _describe(v, normals, lobes, pixel, found):
    """The pixels' lobes; k_s by eq. 5.25.

    A highlight that no LED shows leaves the peak's height to extrapolation: it ends at 2^100.
    """
    for p in range(PIXELS):
        alpha, length, top = 1.0 / lobes[1, p], lobes[2, p], lobes[3, p]
        log_length = math.log2(max(length, 1e-30))
        for i in range(3):
            pixel[_N0 + i * PIXELS + p] = found[NX + i, p] = normals[i, p]
        found[KD, p], found[ALPHA, p] = lobes[0, p], alpha
        found[KS, p] = top * math.exp2(min(alpha * log_length, 100.0))
        pixel[_ALPHA + p], pixel[_LOG_LENGTH + p], pixel[_LENGTH + p] = alpha, log_length, length
        pixel[_UNIT + p], pixel[_K_D + p] = 1.0 / top, lobes[0, p] / top
        searched = alpha > 1.001 and alpha < 0.999 * ALPHA_MAX
        pixel[_SEARCHED + p] = ONE if searched else ZERO
        pixel[_DARKEST + p] = v[lanes.DARKEST, p] if lobes[0, p] > 0 else -ONE
        pixel[_DARK_NL + p] = v[lanes.DARK_NL, p]


@kernel
def _rerender(leds, pixel, sums):
    """Over the LEDs in front of the surface: sums for eqs. 5.30 and 5.1, and how many they are."""
    sums[:] = ZERO
    for m in range(len(leds) // _LED):
        led = leds[m * _LED : (m + 1) * _LED]
        for p in range(PIXELS):
            unit, nl, nh = pixel[_UNIT + p], led[_NL + p], led[_NH + p]
            light, dark = led[_LIGHT + p] * unit, led[_NOISE + p] * unit
            log_nh = log2(min(max(nh, LEAST_NH), ONE))
            # k_s (n.h)^alpha = (|N| n.h)^alpha (eqs. 5.9 and 5.11).
            exponent = pixel[_ALPHA + p] * (log_nh + pixel[_LOG_LENGTH + p])
            part = exp2(max(-abs(exponent), DARKEST))
            gloss = (part if exponent < 0 else ONE / part) * (ONE if nh > 0 else ZERO)
            facing = (ONE if nl > 0 else ZERO) * (ONE if led[_USE + p] > 0 else ZERO)
            error = facing * (light - pixel[_K_D + p] * nl - gloss)
            bright = facing * (ONE if light > np.float32(3.0) * dark else ZERO)
            sums[_RELATIVE + p] += bright * abs(error) / max(light, np.float32(1e-30))
            sums[_BRIGHT + p] += bright
            sums[_USED + p] += facing
            sums[_SQUARES + p] += error * error
            sums[_POWER + p] += facing * light * light
            sums[_DARK + p] += facing * dark * dark


@kernel
def _judge(sums, misfit2, prior_weight, pixel, found):
    """The residual, LEDs used, the misfit, and what is believed of it, in lane RHO2."""
    for p in range(PIXELS):
        used = np.float64(sums[_USED + p])
        # Three of the normal and its strength, alpha and k_d are fitted.
        freedom = max(used - 5.0, 0.0)
        squares = sums[_SQUARES + p] * used / freedom - sums[_DARK + p]
        misfit = max(squares, 0.0) / sums[_POWER + p] if freedom > 0 else np.nan
        found[LEDS, p], found[MISFIT, p] = used, misfit
        found[RESIDUAL, p] = sums[_RELATIVE + p] / sums[_BRIGHT + p]
        own = freedom * misfit if freedom > 0 else 0.0
        pixel[_RHO2 + p] = (prior_weight * misfit2 + own) / (prior_weight + freedom)


@kernel
def _tangents(pixel, t):
    """Two unit vectors across n (Duff et al. 2017, for either sign of n_z)."""
    for p in range(PIXELS):
        x, y, z = pixel[_N0 + p], pixel[_N1 + p], pixel[_N2 + p]
        sign = ONE if z >= 0 else -ONE
        a = -ONE / (sign + z)
        b = x * y * a
        t[_UX + p] = ONE + sign * x * x * a
        t[_UY + p] = sign * b
        t[_UZ + p] = -sign * x
        t[_VX + p] = b
        t[_VY + p] = sign + y * y * a
        t[_VZ + p] = -y


@kernel
def _propagate(leds, pixel, t, eq):
    """First-order propagation of each LED's error through eqs. 5.22 to 5.28 to the two tilts.

    The error of an LED is its noise and a misfit proportional to its intensity, whose square
    is this pixel's own, joined with the region's. The LED of eq. 5.27 acts through k_d on all
    others too.
    """
    eq[:] = 0.0
    for m in range(len(leds) // _LED):
        _add_equations(leds[m * _LED : (m + 1) * _LED], pixel, eq)
    _solve(t, pixel, eq)
    for m in range(len(leds) // _LED):
        _find_gains(leds[m * _LED : (m + 1) * _LED], pixel, eq)
    for m in range(len(leds) // _LED):
        _add_variances(np.float32(m), leds[m * _LED : (m + 1) * _LED], pixel, eq)


@kernel
def _add_equations(led, pixel, eq):
    """J'J of the weighted residuals by N and s; row Y holds w exp2(s x) of the last pass."""
    for p in range(PIXELS):
        w = np.float64(led[_W + p])
        x, y, z = w * led[_HX + p], w * led[_HY + p], w * led[_HZ + p]
        s = np.float64(-led[_Y + p] * led[_X + p] * _LN2 * pixel[_SEARCHED + p])
        eq[_A00 + p] += x * x
        eq[_A01 + p] += x * y
        eq[_A02 + p] += x * z
        eq[_A03 + p] += x * s
        eq[_A11 + p] += y * y
        eq[_A12 + p] += y * z
        eq[_A13 + p] += y * s
        eq[_A22 + p] += z * z
        eq[_A23 + p] += z * s
        eq[_A33 + p] += s * s


@kernel
def _solve(t, pixel, eq):
    """The inverse equations times either tilt, by L D L'; what is not determined varies hugely."""
    for p in range(PIXELS):
        d0 = max(eq[_A00 + p], _LEAST_PIVOT)
        l10, l20, l30 = eq[_A01 + p] / d0, eq[_A02 + p] / d0, eq[_A03 + p] / d0
        d1 = max(eq[_A11 + p] - l10 * eq[_A01 + p], _LEAST_PIVOT)
        c21 = eq[_A12 + p] - l20 * eq[_A01 + p]
        c31 = eq[_A13 + p] - l30 * eq[_A01 + p]
        l21, l31 = c21 / d1, c31 / d1
        d2 = max(eq[_A22 + p] - l20 * eq[_A02 + p] - l21 * c21, _LEAST_PIVOT)
        c32 = eq[_A23 + p] - l30 * eq[_A02 + p] - l31 * c21
        l32 = c32 / d2
        d3 = eq[_A33 + p] - l30 * eq[_A03 + p] - l31 * c31 - l32 * c32
        d3 = max(d3 + (1.0 - pixel[_SEARCHED + p]), _LEAST_PIVOT)
        u0, v0 = np.float64(t[_UX + p]), np.float64(t[_VX + p])
        u1, v1 = t[_UY + p] - l10 * u0, t[_VY + p] - l10 * v0
        u2, v2 = t[_UZ + p] - l20 * u0 - l21 * u1, t[_VZ + p] - l20 * v0 - l21 * v1
        u3, v3 = -l30 * u0 - l31 * u1 - l32 * u2, -l30 * v0 - l31 * v1 - l32 * v2
        u3, v3 = u3 / d3, v3 / d3
        u2, v2 = u2 / d2 - l32 * u3, v2 / d2 - l32 * v3
        u1, v1 = u1 / d1 - l21 * u2 - l31 * u3, v1 / d1 - l21 * v2 - l31 * v3
        u0 = u0 / d0 - l10 * u1 - l20 * u2 - l30 * u3
        v0 = v0 / d0 - l10 * v1 - l20 * v2 - l30 * v3
        eq[_U0 + p], eq[_U1 + p], eq[_U2 + p], eq[_U3 + p] = u0, u1, u2, u3
        eq[_V0 + p], eq[_V1 + p], eq[_V2 + p], eq[_V3 + p] = v0, v1, v2, v3


@kernel
def _find_gains(led, pixel, eq):
    """What one LED's light does to the tilts, directly; and through the light that k_d takes."""
    for p in range(PIXELS):
        w = np.float64(led[_W + p])
        x, y, z = w * led[_HX + p], w * led[_HY + p], w * led[_HZ + p]
        s = np.float64(-led[_Y + p] * led[_X + p] * _LN2 * pixel[_SEARCHED + p])
        lit = ONE if led[_W + p] > 0 else ZERO
        rise = lit * led[_Y + p] / (led[_PART + p] * pixel[_ALPHA + p] * pixel[_LENGTH + p])
        u = rise * (eq[_U0 + p] * x + eq[_U1 + p] * y + eq[_U2 + p] * z + eq[_U3 + p] * s)
        v = rise * (eq[_V0 + p] * x + eq[_V1 + p] * y + eq[_V2 + p] * z + eq[_V3 + p] * s)
        led[_GAIN_U + p], led[_GAIN_V + p] = u, v
        eq[_THROUGH_U + p] += u * led[_NL + p]
        eq[_THROUGH_V + p] += v * led[_NL + p]


@kernel
def _add_variances(number, led, pixel, eq):
    for p in range(PIXELS):
        unit, darkest = pixel[_UNIT + p], pixel[_DARKEST + p] == number
        light, dark = led[_LIGHT + p] * unit, led[_NOISE + p] * unit
        variance = np.float64(dark * dark + pixel[_RHO2 + p] * light * light)
        inverse = ONE / pixel[_DARK_NL + p]
        share = inverse if darkest else ZERO
        u = led[_GAIN_U + p] - share * eq[_THROUGH_U + p]
        v = led[_GAIN_V + p] - share * eq[_THROUGH_V + p]
        eq[_UU + p] += u * u * variance
        eq[_UV + p] += u * v * variance
        eq[_VV + p] += v * v * variance


@kernel
def _spread(t, eq, found):
    """The normal's covariance from that of the tilts."""
    k = CXX
    for i in range(3):
        for j in range(i, 3):
            ui, vi = t[_UX + i * PIXELS :], t[_VX + i * PIXELS :]
            uj, vj = t[_UX + j * PIXELS :], t[_VX + j * PIXELS :]
            row = found[k]
            for p in range(PIXELS):
                cross = eq[_UV + p] * (ui[p] * vj[p] + vi[p] * uj[p])
                row[p] = eq[_UU + p] * ui[p] * uj[p] + cross + eq[_VV + p] * vi[p] * vj[p]
            k += 1
