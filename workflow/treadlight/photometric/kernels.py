"""Algorithms 2 to 4 of the dissertation, pixel by pixel, compiled.

One pixel's LEDs lie side by side in short rows of a scratch array, padded to whole vectors, so
that the inner loops run over a fixed number of lanes and the compiler vectorises them. With
weights that do not depend on alpha the normal matrix of eq. 5.22 is the same for every trial
value: it is factorised once, and a trial costs one power and two projections per LED. Powers
are exp2(log2(I) / alpha) with polynomials instead of library calls.

The search over alpha is a coarse logarithmic grid over the dissertation's range, then a
safeguarded Newton iteration on s = 1/alpha inside the best grid point's bracket: with the
linear unknowns projected out (Golub and Pereyra's variable projection) the cost of eq. 5.23 is
|P y|2, with y_m = w_m exp2(s x_m), and its derivatives by s are as cheap as itself.
"""

import math

import numpy as np
from numba import njit, prange

LANES = 16
ALPHA_MAX = 1024.0
# Ten octaves of alpha: steps of 2^(2/3) are finer than the cost's width around its minimum.
_GRID = 16
_NEWTON_STEPS = 12
# Of s: a hundredth of what is asked of alpha. A Newton step squares the error, so what is left
# after one that was short already is shorter than that.
_TOLERANCE, _SHORT_STEP = np.float32(1e-4), np.float32(3e-3)
# How far a refinement may move alpha before the whole range is looked at again.
_STRIDE, _INSIDE = np.float32(2.0), np.float32(1.01)
# Eq. 5.27 divides by n.l: below cos 84 degrees the quotient is noise.
_MIN_NL = 0.1
# Below this power of two of the brightest LED an intensity has no weight in single precision.
_DARKEST = np.float32(-40.0)
# Change of k_d, of the brightest intensity.
_STILL = 1e-4
_LN2 = math.log(2.0)
_BLOCK = 128
# No reassociation: sums would differ between a kernel just compiled and the same from the cache,
# which inline differently.
_FAST = {"nsz"}
# Rows of a pixel's scratch.
LIGHT, W, X, Y, NL, NH, Q0, Q1, Q2, HX, HY, HZ, LX, LY, LZ, USE, NOISE, MODEL, _ROWS = range(19)
# Columns of the result.
NX, NY, NZ, KD, KS, ALPHA, RESIDUAL, LEDS, MISFIT, CXX, RESULTS = *range(10), 15

_E1, _E2, _E3, _E4, _E5, _E6 = (np.float32(_LN2**k / math.factorial(k)) for k in range(1, 7))


@njit(cache=True, inline="always")
def _exp2(x):
    """2^x for -40 <= x <= 0 to 2e-6, as (2^(x/32))^32: no exponent bits to assemble."""
    f = x * np.float32(1 / 32)
    p = np.float32(1.0) + f * (_E1 + f * (_E2 + f * (_E3 + f * (_E4 + f * (_E5 + f * _E6)))))
    p *= p
    p *= p
    p *= p
    p *= p
    return p * p


@njit(cache=True, fastmath=_FAST)
def _weigh(a, scale, by_intensity):
    """Logarithms of I_s / scale in row X; in W that itself (eq. 5.21) or, of what is lit, 1."""
    for m in range(a.shape[1]):
        w = a[W, m] * scale
        a[X, m] = max(np.float32(math.log2(max(w, np.float32(1e-12)))), _DARKEST)
        a[W, m] = w if by_intensity else np.float32(w > 0)


@njit(cache=True, fastmath=_FAST)
def _factorise(a, chol):
    """Cholesky factor of H'H (eq. 5.22) and the orthonormal rows Q = L^-1 (w h)'."""
    xx = xy = xz = yy = yz = zz = 0.0
    for m in range(a.shape[1]):
        w2 = np.float64(a[W, m]) * a[W, m]
        x, y, z = np.float64(a[HX, m]), np.float64(a[HY, m]), np.float64(a[HZ, m])
        xx += w2 * x * x
        xy += w2 * x * y
        xz += w2 * x * z
        yy += w2 * y * y
        yz += w2 * y * z
        zz += w2 * z * z
    tiny = 1e-10 * (xx + yy + zz)
    l00 = math.sqrt(max(xx, tiny))
    l10, l20 = xy / l00, xz / l00
    p11 = yy - l10 * l10
    l11 = math.sqrt(max(p11, tiny))
    l21 = (yz - l20 * l10) / l11
    p22 = zz - l20 * l20 - l21 * l21
    l22 = math.sqrt(max(p22, tiny))
    chol[0], chol[1], chol[2], chol[3], chol[4], chol[5] = l00, l10, l11, l20, l21, l22
    if not (xx > tiny and p11 > tiny and p22 > tiny):
        return False
    i00, i11, i22 = np.float32(1 / l00), np.float32(1 / l11), np.float32(1 / l22)
    f10, f20, f21 = np.float32(l10), np.float32(l20), np.float32(l21)
    for m in range(a.shape[1]):
        w = a[W, m]
        q0 = w * a[HX, m] * i00
        q1 = (w * a[HY, m] - f10 * q0) * i11
        a[Q0, m] = q0
        a[Q1, m] = q1
        a[Q2, m] = (w * a[HZ, m] - f20 * q0 - f21 * q1) * i22
    return True


@njit(cache=True, fastmath=_FAST)
def _powers(a, s):
    """y = w exp2(s x) of all LEDs, in row Y.

    A loop of its own: the compiler cannot know that the rows it reads elsewhere are others.
    """
    for m in range(a.shape[1]):
        a[Y, m] = a[W, m] * _exp2(a[X, m] * s)


@njit(cache=True, fastmath=_FAST)
def _cost(a, s):
    """Eq. 5.23 at alpha = 1/s, with the best N for it."""
    _powers(a, s)
    c0 = c1 = c2 = np.float32(0.0)
    for m in range(a.shape[1]):
        y = a[Y, m]
        c0 += a[Q0, m] * y
        c1 += a[Q1, m] * y
        c2 += a[Q2, m] * y
    cost = np.float32(0.0)
    for m in range(a.shape[1]):
        r = a[Y, m] - c0 * a[Q0, m] - c1 * a[Q1, m] - c2 * a[Q2, m]
        cost += r * r
    return cost


@njit(cache=True, fastmath=_FAST)
def _slope(a, s):
    """First and second derivative of half the cost by s (in units of ln 2)."""
    _powers(a, s)
    c0 = c1 = c2 = e0 = e1 = e2 = np.float32(0.0)
    for m in range(a.shape[1]):
        y = a[Y, m]
        d = y * a[X, m]
        c0 += a[Q0, m] * y
        c1 += a[Q1, m] * y
        c2 += a[Q2, m] * y
        e0 += a[Q0, m] * d
        e1 += a[Q1, m] * d
        e2 += a[Q2, m] * d
    first = second = np.float32(0.0)
    for m in range(a.shape[1]):
        d = a[Y, m] * a[X, m]
        r = a[Y, m] - c0 * a[Q0, m] - c1 * a[Q1, m] - c2 * a[Q2, m]
        p = d - e0 * a[Q0, m] - e1 * a[Q1, m] - e2 * a[Q2, m]
        first += r * p
        second += p * p + r * d * a[X, m]
    return first, second


@njit(cache=True)
def _best_exponent(a, grid):
    """s = 1/alpha of least cost: the best point of the grid, then `_descend` beside it."""
    best, least = 0, np.float32(np.inf)
    for k in range(len(grid)):
        cost = _cost(a, grid[k])
        if cost < least:
            best, least = k, cost
    # The grid falls from s = 1 (alpha = 1) on.
    return _descend(a, grid[best], grid[min(best + 1, len(grid) - 1)], grid[max(best - 1, 0)])


@njit(cache=True)
def _descend(a, s, low, high):
    """The minimum of the cost between low and high: Newton steps, bisecting when they leave."""
    for _ in range(_NEWTON_STEPS):
        first, second = _slope(a, s)
        if first > 0:
            high = s
        else:
            low = s
        step = first / (second * np.float32(_LN2)) if second > 0 else np.float32(np.inf)
        before = s
        s = s - step
        inside = low <= s <= high
        if not inside:
            s = np.float32(0.5) * (low + high)
        if abs(s - before) < (_SHORT_STEP if inside else _TOLERANCE) * s:
            break
    return s


@njit(cache=True)
def _follow(a, s, grid):
    """s after a refinement: the minimum near the last one, or the grid's where that is gone."""
    low, high = max(s / _STRIDE, grid[-1]), min(s * _STRIDE, grid[0])
    found = _descend(a, s, low, high)
    if low * _INSIDE < found < high / _INSIDE:
        return found
    return _best_exponent(a, grid)


@njit(cache=True, fastmath=_FAST)
def _solve(a, chol, s, n):
    """The direction of eq. 5.22's N at 1/s; returns its length."""
    _powers(a, s)
    z0 = z1 = z2 = np.float32(0.0)
    for m in range(a.shape[1]):
        z0 += a[Q0, m] * a[Y, m]
        z1 += a[Q1, m] * a[Y, m]
        z2 += a[Q2, m] * a[Y, m]
    l00, l10, l11, l20, l21, l22 = chol
    n[2] = z2 / l22
    n[1] = (z1 - l21 * n[2]) / l11
    n[0] = (z0 - l10 * n[1] - l20 * n[2]) / l00
    length = math.sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2])
    for i in range(3):
        n[i] /= length
    return length


@njit(cache=True, fastmath=_FAST)
def _cosines(a, n):
    """n.l and n.h of all LEDs, in rows NL and NH."""
    x, y, z = np.float32(n[0]), np.float32(n[1]), np.float32(n[2])
    for m in range(a.shape[1]):
        a[NL, m] = a[LX, m] * x + a[LY, m] * y + a[LZ, m] * z
        a[NH, m] = a[HX, m] * x + a[HY, m] * y + a[HZ, m] * z


@njit(cache=True)
def _gloss(k_s, alpha, nh):
    return k_s * math.exp2(alpha * math.log2(nh)) if nh > 0.0 else 0.0


@njit(cache=True)
def _diffuse(a, k_s, alpha):
    """k_d from the usable LED whose gloss is least (eqs. 5.26 and 5.27), never negative."""
    darkest = -1
    for m in range(a.shape[1]):
        usable = a[USE, m] > 0 and a[NL, m] > _MIN_NL
        if usable and (darkest < 0 or a[NH, m] < a[NH, darkest]):
            darkest = m
    if darkest < 0:
        return 0.0
    gloss = _gloss(k_s, alpha, a[NH, darkest])
    return max(0.0, (a[LIGHT, darkest] - gloss) / a[NL, darkest])


@njit(cache=True)
def _subtract(a, k_d):
    """I_s of eq. 5.28 in row W; returns its largest value and how many LEDs count."""
    largest, count = np.float32(0.0), 0
    for m in range(a.shape[1]):
        facing = a[USE, m] > 0 and a[NL, m] > 0
        left = a[LIGHT, m] - np.float32(k_d) * a[NL, m] if facing else np.float32(0.0)
        a[W, m] = max(left, np.float32(0.0))
        largest = max(largest, a[W, m])
        count += facing
    return largest, count


@njit(cache=True)
def _pass(a, chol, n, grid, s, k_d, view, by_intensity):
    """Algorithm 2 or 3 on what k_d leaves; returns s, or 0 where there is no normal to find."""
    largest, count = _subtract(a, k_d)
    if count < 4 or not largest > 0:
        return np.float32(0.0)
    _weigh(a, np.float32(1.0) / largest, by_intensity)
    if not _factorise(a, chol):
        return np.float32(0.0)
    s = _follow(a, s, grid) if s > 0 else _best_exponent(a, grid)
    length = _solve(a, chol, s, n)
    if not n[0] * view[0] + n[1] * view[1] + n[2] * view[2] > 0.0:
        return np.float32(0.0)
    n[3], n[4] = length, largest
    return s


@njit(cache=True)
def _fit_gloss(a, chol, n, grid, by_intensity, view, out):
    """Algorithm 2 or 3 at one pixel: all light is gloss; False where it finds no normal."""
    # Every usable LED counts until there is a normal for it to be behind of.
    for m in range(a.shape[1]):
        a[NL, m] = 1.0
    s = _pass(a, chol, n, grid, np.float32(0.0), 0.0, view, by_intensity)
    if not s > 0:
        return False
    _publish(a, n, s, out)
    out[KD] = 0.0
    return True


@njit(cache=True)
def _publish(a, n, s, out):
    out[NX], out[NY], out[NZ] = n[0], n[1], n[2]
    out[ALPHA], out[KS] = _lobe(n, s)
    _cosines(a, n)


@njit(cache=True)
def _lobe(n, s):
    """alpha and k_s of a pass (eq. 5.25)."""
    alpha = 1.0 / np.float64(s)
    # A highlight that no LED shows leaves the peak's height to extrapolation.
    return alpha, n[4] * math.exp2(min(alpha * math.log2(n[3]), 100.0))


@njit(cache=True)
def _fit(a, chol, n, grid, refinements, cos_converged, view, out):
    """Algorithm 4 at one pixel; False where it finds no normal.

    A refinement that leaves nothing to fit is undone.
    """
    # Every usable LED counts until there is a normal for it to be behind of.
    for m in range(a.shape[1]):
        a[NL, m] = 1.0
    s = np.float32(0.0)
    put = put_before = 0.0
    px = py = pz = 0.0
    for refinement in range(refinements + 1):
        last_s, last_put = s, put_before
        s = _pass(a, chol, n, grid, s, put, view, True)
        if not s > 0:
            if not refinement > 0:
                return False
            # The normal of the last pass stands in px, py, pz: its LEDs, its weights again.
            n[0], n[1], n[2] = px, py, pz
            _cosines(a, n)
            s = _pass(a, chol, n, grid, last_s, last_put, view, True)
            if not s > 0:
                return False
            break
        alpha, k_s = _lobe(n, s)
        _cosines(a, n)
        found = _diffuse(a, k_s, alpha)
        # A pixel among symmetric LEDs knows its normal long before it knows k_d.
        still = px * n[0] + py * n[1] + pz * n[2] > cos_converged
        if still and abs(found - put) < _STILL * n[4]:
            break
        px, py, pz = n[0], n[1], n[2]
        put_before, put = put, found
    _publish(a, n, s, out)
    out[KD] = _diffuse(a, out[KS], out[ALPHA])
    return True


@njit(cache=True)
def _rerender(a, out):
    """Eq. 5.1 in row MODEL; the residual of eq. 5.30, LEDs used, and squared relative misfit."""
    relative, bright, used = 0.0, 0, 0
    squares = power = noise = 0.0
    for m in range(a.shape[1]):
        if not (a[USE, m] > 0 and a[NL, m] > 0):
            continue
        used += 1
        a[MODEL, m] = out[KD] * a[NL, m] + _gloss(out[KS], out[ALPHA], a[NH, m])
        error = np.float64(a[LIGHT, m]) - a[MODEL, m]
        squares += error * error
        power += np.float64(a[LIGHT, m]) * a[LIGHT, m]
        noise += np.float64(a[NOISE, m]) * a[NOISE, m]
        if a[LIGHT, m] > 3 * a[NOISE, m]:
            relative += abs(error) / a[LIGHT, m]
            bright += 1
    out[LEDS] = used
    out[RESIDUAL] = relative / bright if bright else np.nan
    # Three of the normal and its strength, alpha and k_d are fitted.
    freedom = used - 5
    if freedom > 0 and power > 0:
        out[MISFIT] = max(0.0, squares * used / freedom - noise) / power
    else:
        out[MISFIT] = np.nan


@njit(cache=True)
def _covariance(a, n, misfit2, prior_weight, mat, gain, out):
    """First-order propagation of each LED's error through eqs. 5.22 to 5.28.

    The error of an LED is its noise and a misfit proportional to its intensity, whose square
    is this pixel's own, joined with `misfit2` as if that had been seen `prior_weight` times.
    The LED of eq. 5.27 acts through k_d on all others too.
    """
    freedom = out[LEDS] - 5
    rho2 = misfit2
    if freedom > 0:
        rho2 = (prior_weight * misfit2 + freedom * out[MISFIT]) / (prior_weight + freedom)
    s, length, largest = 1.0 / out[ALPHA], n[3], n[4]
    searched = out[ALPHA] > 1.001 and out[ALPHA] < 0.999 * ALPHA_MAX
    mat[:] = 0.0
    darkest = -1
    for m in range(a.shape[1]):
        if a[USE, m] > 0 and a[NL, m] > _MIN_NL and (darkest < 0 or a[NH, m] < a[NH, darkest]):
            darkest = m
        if a[W, m] > 0:
            _jacobian(a, m, s, searched, gain[m])
            for i in range(4):
                for j in range(4):
                    mat[i, j] += gain[m, i] * gain[m, j]
    if not searched:
        mat[3, 3] = 1.0
    invert(mat)
    through = np.zeros(3)
    for m in range(a.shape[1]):
        if not a[W, m] > 0:
            gain[m, :] = 0.0
            continue
        y = s * a[W, m] * math.exp2(np.float64(a[X, m]) * (s - 1.0)) / (largest * length)
        g0, g1, g2, g3 = gain[m, 0], gain[m, 1], gain[m, 2], gain[m, 3]
        for i in range(3):
            gain[m, i] = y * (mat[i, 0] * g0 + mat[i, 1] * g1 + mat[i, 2] * g2 + mat[i, 3] * g3)
        along = gain[m, 0] * n[0] + gain[m, 1] * n[1] + gain[m, 2] * n[2]
        for i in range(3):
            gain[m, i] -= along * n[i]
            through[i] += gain[m, i] * a[NL, m]
    if darkest >= 0 and out[KD] > 0:
        for i in range(3):
            gain[darkest, i] -= through[i] / a[NL, darkest]
    out[CXX : CXX + 6] = 0.0
    for m in range(a.shape[1]):
        variance = np.float64(a[NOISE, m]) ** 2 + rho2 * np.float64(a[LIGHT, m]) ** 2
        k = CXX
        for i in range(3):
            for j in range(i, 3):
                out[k] += gain[m, i] * gain[m, j] * variance
                k += 1


@njit(cache=True)
def _jacobian(a, m, s, searched, row):
    """Derivatives of LED m's weighted residual by N and s."""
    w = np.float64(a[W, m])
    row[0], row[1], row[2] = w * a[HX, m], w * a[HY, m], w * a[HZ, m]
    x = np.float64(a[X, m])
    row[3] = -w * math.exp2(x * s) * x * _LN2 if searched else 0.0


@njit(cache=True)
def invert(mat):
    """Invert a symmetric positive matrix in place; what is not determined gets a huge variance."""
    size = mat.shape[0]
    for k in range(size):
        pivot = max(mat[k, k], 1e-12)
        mat[k, k] = 1.0
        for j in range(size):
            mat[k, j] /= pivot
        for i in range(size):
            if i != k:
                factor = mat[i, k]
                mat[i, k] = 0.0
                for j in range(size):
                    mat[i, j] -= factor * mat[k, j]


@njit(cache=True)
def gather(a, k, intensity, lights, views, usable, noise):
    """One pixel's LEDs side by side; returns how many are usable."""
    count = 0
    a[:] = 0.0
    for m in range(intensity.shape[0]):
        if not (usable[m, k] and intensity[m, k] == intensity[m, k]):
            continue
        lx, ly, lz = lights[m, k, 0], lights[m, k, 1], lights[m, k, 2]
        hx, hy, hz = lx + views[k, 0], ly + views[k, 1], lz + views[k, 2]
        length = math.sqrt(hx * hx + hy * hy + hz * hz)
        if not length > 0:
            continue
        a[LX, m], a[LY, m], a[LZ, m] = lx, ly, lz
        a[HX, m], a[HY, m], a[HZ, m] = hx / length, hy / length, hz / length
        a[LIGHT, m], a[NOISE, m], a[USE, m] = intensity[m, k], noise[m, k], 1.0
        count += 1
    return count


@njit(cache=True, parallel=True)
def fit_pixels(
    intensity, lights, views, usable, noise,
    algorithm, refinements, cos_converged, misfit2, prior_weight, out,
):  # fmt: skip
    """Algorithm 2, 3 or 4 at every pixel.

    Parameters
    ----------
    intensity, lights, views, usable, noise : as in `Observations`
    algorithm : int
    refinements : int
        Of algorithm 4: passes through steps 2 to 5 after the first, at most.
    cos_converged : float
        Of the angle between two passes' normals below which no other is made.
    misfit2, prior_weight : float
        The region's squared relative misfit, and how many observations it is worth.
    out : (n, RESULTS) float64
        Written here: see the column names above; NaN where there is no normal, with LEDS.
    """
    n_leds, n = intensity.shape
    lanes = (n_leds + LANES - 1) // LANES * LANES
    grid = np.empty(_GRID, np.float32)
    for k in range(_GRID):
        grid[k] = ALPHA_MAX ** (-k / (_GRID - 1))
    for block in prange((n + _BLOCK - 1) // _BLOCK):
        a = np.zeros((_ROWS, lanes), np.float32)
        gain = np.zeros((lanes, 4))
        mat = np.zeros((4, 4))
        chol = np.zeros(6)
        normal = np.zeros(5)
        for k in range(block * _BLOCK, min(n, (block + 1) * _BLOCK)):
            out[k, :] = np.nan
            count = gather(a, k, intensity, lights, views, usable, noise)
            out[k, LEDS] = count
            if count < 4:
                continue
            if algorithm == 4:
                found = _fit(a, chol, normal, grid, refinements, cos_converged, views[k], out[k])
            else:
                found = _fit_gloss(a, chol, normal, grid, algorithm == 3, views[k], out[k])
            if found:
                _rerender(a, out[k])
                _covariance(a, normal, misfit2, prior_weight, mat, gain, out[k])
