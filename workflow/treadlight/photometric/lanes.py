"""Algorithm 3 of the dissertation on many pixels at a time, compiled.

A block of pixels lies side by side: every quantity of an LED is a row (n_leds, PIXELS) in single
precision, every quantity of a pixel a lane (PIXELS,). Loops run over the lanes innermost and add
up LED by LED, so the compiler vectorises them without changing the order of a sum: a pixel's
result depends neither on its neighbours nor on the machine's vectors. Powers and logarithms are
polynomials instead of library calls.

With weights that do not depend on alpha the normal matrix of eq. 5.22 is the same for every
trial value: it is factorised once, and a trial costs one power and two projections per LED. The
search over alpha is a coarse logarithmic grid over the dissertation's range, then a safeguarded
Newton iteration on s = 1/alpha inside the best grid point's bracket: with the linear unknowns
projected out (Golub and Pereyra's variable projection) the cost of eq. 5.23 is |P y|2, with
y_m = w_m exp2(s x_m), and its derivatives by s are as cheap as itself.
"""

import math
from typing import Any

import numpy as np
from numba import types
from numba.extending import intrinsic

from treadlight.compiling import kernel

PIXELS = 64
ALPHA_MAX = 1024.0
# Ten octaves of alpha: steps of 2^(2/3) are finer than the cost's width around its minimum.
_GRID = 16
_NEWTON_STEPS = 12
# Of s: a hundredth of what is asked of alpha. A Newton step squares the error, so what is left
# after one that was short already is shorter than that.
_TOLERANCE, _SHORT_STEP = np.float32(1e-4), np.float32(3e-3)
# How far a refinement may move alpha before the whole range is looked at again.
_STRIDE, _INSIDE = np.float32(2.0), np.float32(1.01)
_S_MIN, _S_MAX = np.float32(1 / ALPHA_MAX), np.float32(1.0)
# Below this share of the brightest LED an intensity has no weight in single precision.
_DARKEST = np.float32(1e-12)
LN2 = math.log(2.0)
# No reassociation: sums would differ between a kernel just compiled and the same from the cache,
# which inline differently.
_FAST = {"nsz"}

# Rows: one value per LED and pixel.
LIGHT, NOISE, USE, LX, LY, LZ, HX, HY, HZ, NL, NH = range(11)
PART, W, X, Y, D, R, T, Q0, Q1, Q2, ROWS = range(11, 22)
# Lanes: one value per pixel.
S, LOW, HIGH, FIRST, SECOND, COST, LEAST, TOP, COUNT, SOUND, MOVING = range(11)
C0, C1, C2, L00, L10, L11, L20, L21, L22, N0, N1, N2, LENGTH = range(11, 24)
DARKEST, DARK_NH, DARK_NL, DARK_LIGHT, LANES = range(24, 29)

# Bits of sqrt(1/2), and how many the mantissa has, in single precision.
_HALF_ROOT, _MANTISSA = np.int32(0x3F3504F3), np.int32(23)
_A1, _A3, _A5, _A7 = (np.float32(2 / (k * LN2)) for k in (1, 3, 5, 7))
_L0, _L1, _L2, _L3, _L4, _L5, _L6, _L7, _L8 = (
    np.float32(value)
    for value in (
        3.3333331174e-1, -2.4999993993e-1, 2.0000714765e-1, -1.6668057665e-1, 1.4249322787e-1,
        -1.2420140846e-1, 1.1676998740e-1, -1.1514610310e-1, 7.0376836292e-2,
    )
)  # fmt: skip
_E1, _E2, _E3, _E4, _E5, _E6 = (np.float32(LN2**k / math.factorial(k)) for k in range(1, 7))


def _fma(context, a, b, c):
    def generate(context, builder, signature, arguments):
        return builder.fma(*arguments)

    return (a(a, a, a), generate) if a == b == c else None


# a b + c, rounded once: said instead of left to the compiler, whose choice may change.
fma: Any = intrinsic(_fma)


def _as_int(context, x):
    def generate(context, builder, signature, arguments):
        return builder.bitcast(arguments[0], context.get_value_type(types.int32))

    return (types.int32(x), generate) if x == types.float32 else None


def _as_float(context, x):
    def generate(context, builder, signature, arguments):
        return builder.bitcast(arguments[0], context.get_value_type(types.float32))

    return (types.float32(x), generate) if x == types.int32 else None


# The bits of a number in single precision as an integer, and back.
as_int: Any = intrinsic(_as_int)
as_float: Any = intrinsic(_as_float)


@kernel(inline="always")
def log2(x):
    """log2 to 3e-7 for normal x: 2^e f with f about 1, and Cephes' polynomial for log f.

    Without a root or a division, which take as long as eight products.
    """
    # Numba's integers grow to 64 bits, of which half as many make a vector.
    exponent = np.int32(np.int32(as_int(x) - _HALF_ROOT) >> _MANTISSA)
    m = as_float(np.int32(as_int(x) - np.int32(exponent << _MANTISSA))) - np.float32(1.0)
    p = fma(_L8, m, _L7)
    p = fma(p, m, _L6)
    p = fma(p, m, _L5)
    p = fma(p, m, _L4)
    p = fma(p, m, _L3)
    p = fma(p, m, _L2)
    p = fma(p, m, _L1)
    p = fma(p, m, _L0)
    square = m * m
    logarithm = fma(p, square * m, fma(np.float32(-0.5), square, m))
    return fma(logarithm, np.float32(1 / LN2), np.float32(exponent))


@kernel(inline="always")
def exp2(x):
    """2^x for -40 <= x <= 0 to 2e-6, as (2^(x/32))^32: no exponent bits to assemble."""
    f = x * np.float32(1 / 32)
    p = fma(f, _E6, _E5)
    p = fma(f, p, _E4)
    p = fma(f, p, _E3)
    p = fma(f, p, _E2)
    p = fma(f, p, _E1)
    p = fma(f, p, np.float32(1.0))
    p *= p
    p *= p
    p *= p
    p *= p
    return p * p


@kernel(fastmath=_FAST)
def _log2(bits, mantissa, mantissa_bits, x):
    """log2 to 1e-7 in x: 2^e f with f about 1, and the series of artanh for f.

    `bits` are those of the numbers; `mantissa_bits` is the memory of `mantissa`, as integers.
    """
    for m in range(x.shape[0]):
        for p in range(PIXELS):
            exponent = (bits[m, p] - _HALF_ROOT) >> _MANTISSA
            mantissa_bits[m, p] = bits[m, p] - (exponent << _MANTISSA)
    for m in range(x.shape[0]):
        for p in range(PIXELS):
            x[m, p] = np.float32((bits[m, p] - _HALF_ROOT) >> _MANTISSA)
    for m in range(x.shape[0]):
        for p in range(PIXELS):
            t = (mantissa[m, p] - np.float32(1.0)) / (mantissa[m, p] + np.float32(1.0))
            t2 = t * t
            x[m, p] += t * (_A1 + t2 * (_A3 + t2 * (_A5 + t2 * _A7)))


@kernel(fastmath=_FAST)
def _share(part, w, top):
    """w over the pixel's brightest, but not nothing, in part."""
    for m in range(w.shape[0]):
        for p in range(PIXELS):
            part[m, p] = max(w[m, p] / max(top[p], np.float32(1e-30)), _DARKEST)


@kernel
def weigh(r, v, bits, by_intensity):
    """From I_s in row W: its share of TOP in PART, the logarithm in X, and weights in W.

    Weights are the shares (eq. 5.21) or, of what is lit, 1.
    """
    _share(r[PART], r[W], v[TOP])
    for m in range(r[W].shape[0]):
        for p in range(PIXELS):
            lit = r[W][m, p] > 0
            weight = r[PART][m, p] if by_intensity else np.float32(1.0)
            r[W][m, p] = weight if lit else np.float32(0.0)
    _log2(bits[0], r[Y], bits[1], r[X])


@kernel(fastmath=_FAST)
def _multiply_add(total, x, y):
    """total += x y, LED by LED."""
    for m in range(x.shape[0]):
        for p in range(PIXELS):
            total[p] += x[m, p] * y[m, p]


@kernel(fastmath=_FAST)
def _sum_of(total, w, x, y):
    """The sum of w2 x y over the LEDs, in double precision: differences of these are pivots."""
    total[:] = 0
    for m in range(w.shape[0]):
        for p in range(PIXELS):
            weighted = np.float64(w[m, p]) * np.float64(x[m, p])
            total[p] += weighted * (np.float64(w[m, p]) * np.float64(y[m, p]))


@kernel
def factorise(r, v, sums):
    """Cholesky factor of H'H (eq. 5.22) and the orthonormal rows Q = L^-1 (w h)'.

    Lanes whose directions do not span space are no longer SOUND.
    """
    hx, hy, hz, w = r[HX], r[HY], r[HZ], r[W]
    _sum_of(sums[0], w, hx, hx)
    _sum_of(sums[1], w, hx, hy)
    _sum_of(sums[2], w, hx, hz)
    _sum_of(sums[3], w, hy, hy)
    _sum_of(sums[4], w, hy, hz)
    _sum_of(sums[5], w, hz, hz)
    for p in range(PIXELS):
        xx, xy, xz, yy, yz, zz = (
            sums[0][p], sums[1][p], sums[2][p], sums[3][p], sums[4][p], sums[5][p],
        )  # fmt: skip
        tiny = max(1e-10 * (xx + yy + zz), 1e-30)
        l00 = math.sqrt(max(xx, tiny))
        l10, l20 = xy / l00, xz / l00
        p11 = yy - l10 * l10
        l11 = math.sqrt(max(p11, tiny))
        l21 = (yz - l20 * l10) / l11
        p22 = zz - l20 * l20 - l21 * l21
        v[L00][p], v[L10][p], v[L11][p] = l00, l10, l11
        v[L20][p], v[L21][p], v[L22][p] = l20, l21, math.sqrt(max(p22, tiny))
        if not (xx > tiny and p11 > tiny and p22 > tiny):
            v[SOUND][p] = 0
    _orthonormalise(r, v)


@kernel(fastmath=_FAST)
def _orthonormalise(r, v):
    q0, q1, q2, w = r[Q0], r[Q1], r[Q2], r[W]
    for m in range(w.shape[0]):
        for p in range(PIXELS):
            q0[m, p] = w[m, p] * r[HX][m, p] / v[L00][p]
    for m in range(w.shape[0]):
        for p in range(PIXELS):
            q1[m, p] = (w[m, p] * r[HY][m, p] - v[L10][p] * q0[m, p]) / v[L11][p]
    for m in range(w.shape[0]):
        for p in range(PIXELS):
            q2[m, p] = w[m, p] * r[HZ][m, p] - v[L20][p] * q0[m, p]
    for m in range(w.shape[0]):
        for p in range(PIXELS):
            q2[m, p] = (q2[m, p] - v[L21][p] * q1[m, p]) / v[L22][p]


@kernel(fastmath=_FAST)
def _powers(w, x, s, y):
    """y = w exp2(s x)."""
    for m in range(x.shape[0]):
        for p in range(PIXELS):
            y[m, p] = w[m, p] * exp2(x[m, p] * s[p])


@kernel(fastmath=_FAST)
def _project_out(y, q0, q1, q2, c0, c1, c2, out):
    """out = (1 - Q Q') y, and the projections on the rows of Q in c0 to c2."""
    c0[:] = 0
    c1[:] = 0
    c2[:] = 0
    _multiply_add(c0, q0, y)
    _multiply_add(c1, q1, y)
    _multiply_add(c2, q2, y)
    for m in range(y.shape[0]):
        for p in range(PIXELS):
            out[m, p] = y[m, p] - c0[p] * q0[m, p] - c1[p] * q1[m, p] - c2[p] * q2[m, p]


@kernel
def _costs(r, v, s):
    """Eq. 5.23 at alpha = 1/s, with the best N for it, in lanes COST."""
    _powers(r[W], r[X], s, r[Y])
    _project_out(r[Y], r[Q0], r[Q1], r[Q2], v[C0], v[C1], v[C2], r[R])
    v[COST][:] = 0
    _multiply_add(v[COST], r[R], r[R])


@kernel(fastmath=_FAST)
def _slopes(r, v):
    """First and second derivative of half the cost by s (in units of ln 2)."""
    y, x, d = r[Y], r[X], r[D]
    _powers(r[W], x, v[S], y)
    for m in range(x.shape[0]):
        for p in range(PIXELS):
            d[m, p] = y[m, p] * x[m, p]
    _project_out(y, r[Q0], r[Q1], r[Q2], v[C0], v[C1], v[C2], r[R])
    _project_out(d, r[Q0], r[Q1], r[Q2], v[C0], v[C1], v[C2], r[T])
    v[FIRST][:] = 0
    v[SECOND][:] = 0
    _multiply_add(v[FIRST], r[R], r[T])
    _multiply_add(v[SECOND], r[T], r[T])
    for m in range(x.shape[0]):
        for p in range(PIXELS):
            d[m, p] *= x[m, p]
    _multiply_add(v[SECOND], r[R], d)


@kernel
def _descend(r, v):
    """The minimum between LOW and HIGH where MOVING: Newton steps, bisecting when they leave."""
    s, low, high, moving = v[S], v[LOW], v[HIGH], v[MOVING]
    for _ in range(_NEWTON_STEPS):
        _slopes(r, v)
        left = 0
        for p in range(PIXELS):
            if not moving[p] > 0:
                continue
            first, second, before = v[FIRST][p], v[SECOND][p], s[p]
            if first > 0:
                high[p] = before
            else:
                low[p] = before
            step = first / (second * np.float32(LN2)) if second > 0 else np.float32(np.inf)
            inside = low[p] <= before - step <= high[p]
            s[p] = before - step if inside else np.float32(0.5) * (low[p] + high[p])
            if abs(s[p] - before) < (_SHORT_STEP if inside else _TOLERANCE) * s[p]:
                moving[p] = 0
            else:
                left += 1
        if left == 0:
            break


@kernel(allocates=True)
def search(r, v):
    """s = 1/alpha of least cost where SOUND: the best point of the grid, then beside it.

    Of lanes that are not MOVING the S at the call stays.
    """
    trial = np.empty(PIXELS, np.float32)
    v[LEAST][:] = np.inf
    for k in range(_GRID):
        # The grid falls from s = 1 (alpha = 1) on.
        here = np.float32(ALPHA_MAX ** (-k / (_GRID - 1)))
        below = np.float32(ALPHA_MAX ** (-min(k + 1, _GRID - 1) / (_GRID - 1)))
        above = np.float32(ALPHA_MAX ** (-max(k - 1, 0) / (_GRID - 1)))
        trial[:] = here
        _costs(r, v, trial)
        for p in range(PIXELS):
            if v[MOVING][p] > 0 and v[COST][p] < v[LEAST][p]:
                v[LEAST][p] = v[COST][p]
                v[S][p], v[LOW][p], v[HIGH][p] = here, below, above
    _descend(r, v)


@kernel(allocates=True)
def follow(r, v):
    """S after a refinement: the minimum near the last one, or the grid's where that is gone."""
    floor, ceiling = np.empty(PIXELS, np.float32), np.empty(PIXELS, np.float32)
    for p in range(PIXELS):
        floor[p] = max(v[S][p] / _STRIDE, _S_MIN)
        ceiling[p] = min(v[S][p] * _STRIDE, _S_MAX)
        v[LOW][p], v[HIGH][p] = floor[p], ceiling[p]
        v[MOVING][p] = v[SOUND][p]
    _descend(r, v)
    lost = 0
    for p in range(PIXELS):
        gone = not floor[p] * _INSIDE < v[S][p] < ceiling[p] / _INSIDE
        v[MOVING][p] = v[SOUND][p] if gone else np.float32(0.0)
        lost += v[MOVING][p] > 0
    if lost:
        search(r, v)


@kernel
def powers(r, v):
    """w exp2(s x) in row Y."""
    _powers(r[W], r[X], v[S], r[Y])


@kernel
def solve(r, v):
    """The direction of eq. 5.22's N at S in N0 to N2, and its LENGTH."""
    powers(r, v)
    for c, q in ((v[C0], r[Q0]), (v[C1], r[Q1]), (v[C2], r[Q2])):
        c[:] = 0
        _multiply_add(c, q, r[Y])
    for p in range(PIXELS):
        z = v[C2][p] / v[L22][p]
        y = (v[C1][p] - v[L21][p] * z) / v[L11][p]
        x = (v[C0][p] - v[L10][p] * y - v[L20][p] * z) / v[L00][p]
        length = max(np.float32(math.sqrt(x * x + y * y + z * z)), np.float32(1e-30))
        v[N0][p], v[N1][p], v[N2][p], v[LENGTH][p] = x / length, y / length, z / length, length


@kernel(fastmath=_FAST)
def dot(x, y, z, n0, n1, n2, out):
    """Scalar products of the LEDs' vectors with the pixels'."""
    for m in range(x.shape[0]):
        for p in range(PIXELS):
            out[m, p] = x[m, p] * n0[p] + y[m, p] * n1[p] + z[m, p] * n2[p]
