"""Algorithms 2 to 4 of the dissertation, block of pixels by block, compiled.

`lanes` holds algorithm 3's parts; here is what surrounds them, the diffuse part and its
refinement; `sps_report` says what has been found.
"""

import math

import numpy as np

from treadlight.compiling import kernel
from treadlight.photometric import lanes
from treadlight.photometric.lanes import (
    COUNT,
    DARK_LIGHT,
    DARK_NH,
    DARK_NL,
    DARKEST,
    HX,
    HY,
    HZ,
    LENGTH,
    LIGHT,
    LX,
    LY,
    LZ,
    MOVING,
    N0,
    N1,
    N2,
    NH,
    NL,
    NOISE,
    PART,
    PIXELS,
    SOUND,
    TOP,
    USE,
    S,
    W,
    Y,
)
from treadlight.photometric.sps_report import LEDS, report, report_desk

# Eq. 5.27 divides by n.l: below cos 84 degrees the quotient is noise.
_MIN_NL = 0.1
# Change of k_d, of the brightest intensity.
_STILL = 1e-4
# State: what stands between passes, one value per pixel in double precision. OLD are the normal
# and k_d that the last good pass subtracted, GOOD what it found.
_OLD_X, _OLD_Y, _OLD_Z, _OLD_KD, _GOOD_X, _GOOD_Y, _GOOD_Z, _GOOD_S, _GOOD_LENGTH = range(9)
_GOOD_TOP, _PUT, _ACTIVE, _SOLVED, _STATE = range(9, 14)


@kernel
def _gather(r, v, first, intensity, lights, views, usable, noise):
    """A block's LEDs side by side; the usable ones of each pixel in COUNT."""
    r[:] = 0
    v[:] = 0
    last = min(first + PIXELS, intensity.shape[1])
    for m in range(intensity.shape[0]):
        for k in range(first, last):
            if not (usable[m, k] and intensity[m, k] == intensity[m, k]):
                continue
            lx, ly, lz = lights[m, 0, k], lights[m, 1, k], lights[m, 2, k]
            hx, hy, hz = lx + views[k, 0], ly + views[k, 1], lz + views[k, 2]
            length = math.sqrt(hx * hx + hy * hy + hz * hz)
            if not length > 0:
                continue
            p = k - first
            r[LX][m, p], r[LY][m, p], r[LZ][m, p] = lx, ly, lz
            r[HX][m, p], r[HY][m, p], r[HZ][m, p] = hx / length, hy / length, hz / length
            r[LIGHT][m, p], r[NOISE][m, p], r[USE][m, p] = intensity[m, k], noise[m, k], 1.0
            v[COUNT][p] += 1


@kernel
def _cosines(r, n0, n1, n2):
    """n.l and n.h of all LEDs, in rows NL and NH."""
    lanes.dot(r[LX], r[LY], r[LZ], n0, n1, n2, r[NL])
    lanes.dot(r[HX], r[HY], r[HZ], n0, n1, n2, r[NH])


@kernel
def _subtract(r, v, k_d):
    """I_s of eq. 5.28 in row W; its largest value in TOP and how many LEDs count in COUNT."""
    v[TOP][:] = 0
    v[COUNT][:] = 0
    for m in range(r[W].shape[0]):
        for p in range(PIXELS):
            facing = r[USE][m, p] > 0 and r[NL][m, p] > 0
            left = r[LIGHT][m, p] - np.float32(k_d[p]) * r[NL][m, p]
            left = max(left, np.float32(0.0)) if facing else np.float32(0.0)
            r[W][m, p] = left
            v[TOP][p] = max(v[TOP][p], left)
            v[COUNT][p] += np.float32(1.0) if facing else np.float32(0.0)


@kernel
def _pass(r, v, bits, sums, k_d, views, by_intensity, again):
    """Algorithm 2 or 3 on what k_d leaves; lanes with no normal to find are not SOUND then."""
    _subtract(r, v, k_d)
    for p in range(PIXELS):
        if v[COUNT][p] < 4 or not v[TOP][p] > 0:
            v[SOUND][p] = 0
    lanes.weigh(r, v, bits, by_intensity)
    lanes.factorise(r, v, sums)
    if again:
        lanes.follow(r, v)
    else:
        for p in range(PIXELS):
            v[MOVING][p] = v[SOUND][p]
        lanes.search(r, v)
    lanes.solve(r, v)
    for p in range(len(views)):
        n0, n1, n2 = v[N0][p], v[N1][p], v[N2][p]
        if not n0 * views[p, 0] + n1 * views[p, 1] + n2 * views[p, 2] > 0:
            v[SOUND][p] = 0


@kernel
def _power(base, exponent):
    """base^exponent, 0 of what is not positive.

    A highlight that no LED shows leaves the peak's height to extrapolation: it ends at 2^100.
    """
    return math.exp2(min(exponent * math.log2(base), 100.0)) if base > 0.0 else 0.0


@kernel
def _find_darkest(r, v):
    """The usable LED whose gloss is least (eq. 5.26): its number, n.h, n.l and light; -1 if none.

    Lanes DARKEST, DARK_NH, DARK_NL and DARK_LIGHT.
    """
    darkest, least, facing, seen = v[DARKEST], v[DARK_NH], v[DARK_NL], v[DARK_LIGHT]
    darkest[:] = -1
    least[:] = 2
    for m in range(r[NL].shape[0]):
        for p in range(PIXELS):
            nl, nh = r[NL][m, p], r[NH][m, p]
            lower = r[USE][m, p] > 0 and nl > _MIN_NL and nh < least[p]
            darkest[p] = np.float32(m) if lower else darkest[p]
            facing[p] = nl if lower else facing[p]
            seen[p] = r[LIGHT][m, p] if lower else seen[p]
            least[p] = nh if lower else least[p]


@kernel
def _diffuse(v, state, p):
    """k_d from the darkest LED (eq. 5.27), never negative."""
    if v[DARKEST][p] < 0:
        return 0.0
    # k_s (n.h)^alpha = (|N| n.h)^alpha (eqs. 5.9 and 5.11): one power instead of two.
    reach = state[_GOOD_LENGTH, p] * v[DARK_NH][p]
    gloss = state[_GOOD_TOP, p] * _power(reach, 1.0 / state[_GOOD_S, p])
    return max(0.0, (v[DARK_LIGHT][p] - gloss) / v[DARK_NL][p])


@kernel
def _accept(v, state):
    """Keep what a pass found, and what it stood on, where it is SOUND and still wanted."""
    for p in range(PIXELS):
        if not (state[_ACTIVE, p] > 0 and v[SOUND][p] > 0):
            state[_ACTIVE, p] = 0
            continue
        for i in range(3):
            state[_OLD_X + i, p] = state[_GOOD_X + i, p]
        state[_OLD_KD, p] = state[_PUT, p]
        state[_GOOD_X, p], state[_GOOD_Y, p] = v[N0][p], v[N1][p]
        state[_GOOD_Z, p], state[_GOOD_S, p] = v[N2][p], v[S][p]
        state[_GOOD_LENGTH, p], state[_GOOD_TOP, p] = v[LENGTH][p], v[TOP][p]
        state[_SOLVED, p] = 1


@kernel
def _refine(r, v, bits, sums, state, by_intensity, refinements, converged2, views):
    """Algorithm 4's steps 2 to 6; a refinement that leaves nothing to fit is undone.

    Without refinements it is algorithm 2 or 3.
    """
    for refinement in range(refinements + 1):
        for p in range(PIXELS):
            v[SOUND][p] = state[_ACTIVE, p]
        _pass(r, v, bits, sums, state[_PUT], views, by_intensity, refinement > 0)
        _accept(v, state)
        if not state[_ACTIVE].any():
            break
        _cosines(r, v[N0], v[N1], v[N2])
        _find_darkest(r, v)
        for p in range(PIXELS):
            if not state[_ACTIVE, p] > 0:
                continue
            found = _diffuse(v, state, p)
            still = _STILL * state[_GOOD_TOP, p]
            moved2 = 0.0
            for i in range(3):
                moved2 += (state[_GOOD_X + i, p] - state[_OLD_X + i, p]) ** 2
            # A pixel among symmetric LEDs knows its normal long before it knows k_d.
            if moved2 < converged2 and abs(found - state[_PUT, p]) < still:
                state[_ACTIVE, p] = 0
            state[_PUT, p] = found


@kernel
def _stand_again(r, v, bits, state, by_intensity):
    """Rows and lanes as the last good pass of each pixel had them, but its own normal's cosines."""
    for p in range(PIXELS):
        v[N0][p], v[N1][p], v[N2][p] = state[_OLD_X, p], state[_OLD_Y, p], state[_OLD_Z, p]
        v[S][p] = state[_GOOD_S, p] if state[_SOLVED, p] > 0 else 1.0
    _cosines(r, v[N0], v[N1], v[N2])
    _count_all(r, state)
    _subtract(r, v, state[_OLD_KD])
    lanes.weigh(r, v, bits, by_intensity)
    lanes.powers(r, v)
    for p in range(PIXELS):
        v[N0][p], v[N1][p], v[N2][p] = state[_GOOD_X, p], state[_GOOD_Y, p], state[_GOOD_Z, p]
    _cosines(r, v[N0], v[N1], v[N2])
    _find_darkest(r, v)


@kernel
def _count_all(r, state):
    """Every usable LED counts until there is a normal for it to be behind of."""
    for m in range(r[NL].shape[0]):
        for p in range(PIXELS):
            if state[_OLD_X, p] == 0 and state[_OLD_Y, p] == 0 and state[_OLD_Z, p] == 0:
                r[NL][m, p] = 1.0


@kernel(allocates=True)
def _lobes(v, state, refined):
    """k_d (of algorithm 4; else 0), 1 / alpha, the length of N and the brightest gloss."""
    lobes = np.zeros((4, PIXELS))
    for p in range(PIXELS):
        for i in range(3):
            lobes[1 + i, p] = state[_GOOD_S + i, p]
        if refined and state[_SOLVED, p] > 0:
            lobes[0, p] = _diffuse(v, state, p)
    return lobes


@kernel(allocates=True)
def fit_pixels(
    begin, end, intensity, lights, views, usable, noise,
    algorithm, refinements, converged_rad, misfit2, prior_weight, out,
):  # fmt: skip
    """Algorithm 2, 3 or 4 at pixels begin to end - 1; begin is a multiple of PIXELS.

    Parameters
    ----------
    intensity, lights, views, usable, noise : as `Observations.arrays` gives them
    algorithm : int
    refinements : int
        Of algorithm 4: passes through steps 2 to 5 after the first, at most.
    converged_rad : float
        Angle between two passes' normals below which no other is made.
    misfit2, prior_weight : float
        The region's squared relative misfit, and how many observations it is worth.
    out : (n, RESULTS) float64
        Written here: see the column names above; NaN where there is no normal, with LEDS.
    """
    n_leds = len(intensity)
    for first in range(begin, end, PIXELS):
        last = min(first + PIXELS, end)
        r = np.empty((lanes.ROWS, n_leds, PIXELS), np.float32)
        v = np.empty((lanes.LANES, PIXELS), np.float32)
        bits = (r[PART].view(np.int32), r[Y].view(np.int32))
        sums = np.empty((6, PIXELS))
        state = np.zeros((_STATE, PIXELS))
        desk = report_desk(n_leds)
        _gather(r, v, first, intensity, lights, views, usable, noise)
        out[first:last] = np.nan
        for p in range(PIXELS):
            state[_ACTIVE, p] = v[COUNT][p] >= 4
            v[S][p] = 1.0
            if first + p < last:
                out[first + p, LEDS] = v[COUNT][p]
        _count_all(r, state)
        _refine(
            r, v, bits, sums, state, algorithm > 2,
            refinements if algorithm == 4 else 0, converged_rad**2, views[first:last],
        )  # fmt: skip
        _stand_again(r, v, bits, state, algorithm > 2)
        lobes = _lobes(v, state, algorithm == 4)
        report(r, v, state[_GOOD_X : _GOOD_Z + 1], lobes, misfit2, prior_weight, desk)
        for p in range(last - first):
            if state[_SOLVED, p] > 0:
                for i in range(out.shape[1]):
                    out[first + p, i] = desk[-1][i, p]
