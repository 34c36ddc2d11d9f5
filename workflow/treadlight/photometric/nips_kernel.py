"""Levenberg-Marquardt on the full Blinn-Phong model, pixel by pixel, compiled.

Five unknowns: two tilts of the normal about its last place, log alpha, k_d and k_s. The last
three are held in their bounds: one that stands at a bound and is pushed outwards is frozen for
the step.
"""

import math

import numpy as np

from treadlight.compiling import kernel
from treadlight.photometric.lanes import ALPHA_MAX

# A wide lobe: it pulls the normal from further away than a narrow one.
_START_ALPHA = 10.0
_STEPS = 200
# Relative fall of the cost below which a step is the last one.
_STILL = 1e-12
# All unknowns are of order one, so damping is by the identity (Levenberg's, not Marquardt's
# diagonal): where the gloss shows little, long first steps would end at the bounds.
_LAMBDA, _EASE, _HARDEN, _HOPELESS = 0.1, 0.3, 5.0, 1e12
# Unknowns.
_TILT_1, _TILT_2, _LOG_ALPHA, _KD, _KS, UNKNOWNS = range(6)
# Columns of an LED's table: intensity, light, halfway vector, noise.
_I, _L, _H, _NOISE, _COLUMNS = 0, 1, 4, 7, 8
# Columns of the result.
NX, NY, NZ, KD, KS, ALPHA, RESIDUAL, CXX, RESULTS = *range(8), 13


@kernel(allocates=True)
def _invert(mat):
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


@kernel(allocates=True)
def _gather(table, k, intensity, lights, views, usable, noise):
    """One pixel's usable LEDs, intensities over the brightest; their number and the brightest."""
    count, brightest = 0, 0.0
    for m in range(intensity.shape[0]):
        if not (usable[m, k] and intensity[m, k] == intensity[m, k]):
            continue
        half = lights[m, k] + views[k]
        length = math.sqrt(half[0] ** 2 + half[1] ** 2 + half[2] ** 2)
        if not length > 0:
            continue
        table[count, _I], table[count, _NOISE] = intensity[m, k], noise[m, k]
        table[count, _L:_H] = lights[m, k]
        table[count, _H:_NOISE] = half / length
        brightest = max(brightest, table[count, _I])
        count += 1
    if brightest > 0:
        table[:count, _I] /= brightest
        table[:count, _NOISE] /= brightest
    return count, brightest


@kernel(allocates=True)
def _dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel(allocates=True)
def _render(led, n, x):
    """Eq. 5.1 for one LED: the whole, the gloss per k_s, n.l and n.h; all 0 behind the surface."""
    nl = _dot(n, led[_L:_H])
    if not nl > 0:
        return 0.0, 0.0, 0.0, 0.0
    nh = max(_dot(n, led[_H:_NOISE]), 0.0)
    gloss = math.exp(math.exp(x[_LOG_ALPHA]) * math.log(nh)) if nh > 0 else 0.0
    return x[_KD] * nl + x[_KS] * gloss, gloss, nl, nh


@kernel(allocates=True)
def _cost(table, count, n, x):
    total = 0.0
    for m in range(count):
        error = table[m, _I] - _render(table[m], n, x)[0]
        total += error * error
    return total


@kernel(allocates=True)
def _tangents(n, frame):
    """Two unit vectors across n, in the rows of frame."""
    least = np.argmin(np.abs(n))
    axis = np.zeros(3)
    axis[least] = 1.0
    frame[0] = np.cross(n, axis)
    frame[0] /= math.sqrt(_dot(frame[0], frame[0]))
    frame[1] = np.cross(n, frame[0])


@kernel(allocates=True)
def _linearise(table, count, n, x, frame, matrix, gradient):
    """J'J and J'r at a normal and the other unknowns."""
    matrix[:] = 0.0
    gradient[:] = 0.0
    row = np.zeros(UNKNOWNS)
    alpha = math.exp(x[_LOG_ALPHA])
    for m in range(count):
        led = table[m]
        model, gloss, nl, nh = _render(led, n, x)
        if not nl > 0:
            continue
        slope = x[_KS] * alpha * gloss / nh if nh > 0 else 0.0
        for i in range(2):
            row[i] = x[_KD] * _dot(frame[i], led[_L:_H]) + slope * _dot(frame[i], led[_H:_NOISE])
        row[_LOG_ALPHA] = x[_KS] * alpha * gloss * math.log(nh) if nh > 0 else 0.0
        row[_KD], row[_KS] = nl, gloss
        for i in range(UNKNOWNS):
            gradient[i] += row[i] * (led[_I] - model)
            for j in range(UNKNOWNS):
                matrix[i, j] += row[i] * row[j]


@kernel(allocates=True)
def _freeze(x, gradient, matrix):
    """Take out of the equations what stands at a bound and is pushed outwards."""
    for i in range(_LOG_ALPHA, UNKNOWNS):
        high = math.log(ALPHA_MAX) if i == _LOG_ALPHA else np.inf
        if (x[i] <= 0 and gradient[i] < 0) or (x[i] >= high and gradient[i] > 0):
            matrix[i, :] = 0.0
            matrix[:, i] = 0.0
            matrix[i, i] = 1.0
            gradient[i] = 0.0


@kernel(allocates=True)
def _start(x):
    """Half of the brightest LED's light diffuse, half gloss."""
    x[:] = 0.0
    x[_LOG_ALPHA] = math.log(_START_ALPHA)
    x[_KD], x[_KS] = 0.5, 0.5


@kernel(allocates=True)
def _step(n, x, frame, step, n_new, x_new):
    for i in range(3):
        n_new[i] = n[i] + step[_TILT_1] * frame[0, i] + step[_TILT_2] * frame[1, i]
    n_new /= math.sqrt(_dot(n_new, n_new))
    for i in range(_LOG_ALPHA, UNKNOWNS):
        x_new[i] = max(x[i] + step[i], 0.0)
    x_new[_LOG_ALPHA] = min(x_new[_LOG_ALPHA], math.log(ALPHA_MAX))


@kernel(allocates=True)
def _fit(table, count, view, n, x, frame, matrix, gradient):
    """Levenberg-Marquardt from n and x, which it moves; returns the cost.

    A step to a normal that faces away from the camera is none: what is seen faces it.
    """
    damped = np.zeros((UNKNOWNS, UNKNOWNS))
    n_new, x_new = np.zeros(3), np.zeros(UNKNOWNS)
    damping = _LAMBDA
    cost = _cost(table, count, n, x)
    fresh = True
    for _ in range(_STEPS):
        if fresh:
            _tangents(n, frame)
            _linearise(table, count, n, x, frame, matrix, gradient)
            _freeze(x, gradient, matrix)
        for i in range(UNKNOWNS):
            for j in range(UNKNOWNS):
                damped[i, j] = matrix[i, j]
            damped[i, i] += damping
        _invert(damped)
        _step(n, x, frame, damped @ gradient, n_new, x_new)
        trial = _cost(table, count, n_new, x_new)
        fresh = trial < cost and _dot(n_new, view) > 0
        if not fresh:
            damping *= _HARDEN
            if damping > _HOPELESS:
                break
            continue
        done = cost - trial <= _STILL * cost
        n[:], x[:], cost = n_new, x_new, trial
        damping = max(damping * _EASE, 1e-12)
        if done:
            break
    return cost


@kernel(allocates=True)
def _covariance(table, count, n, x, frame, matrix, gradient, cost, out):
    """Of the normal, from J'J and what the fit leaves, but no less than the noise."""
    _tangents(n, frame)
    _linearise(table, count, n, x, frame, matrix, gradient)
    _freeze(x, gradient, matrix)
    _invert(matrix)
    noise2 = np.mean(table[:count, _NOISE] ** 2)
    variance = max(cost / max(count - UNKNOWNS, 1), noise2)
    k = CXX
    for i in range(3):
        for j in range(i, 3):
            out[k] = 0.0
            for p in range(2):
                for q in range(2):
                    out[k] += variance * frame[p, i] * matrix[p, q] * frame[q, j]
            k += 1


@kernel(allocates=True)
def _residual(table, count, n, x):
    """Eq. 5.30 as a mean over the LEDs above three sigma of the noise."""
    relative, bright = 0.0, 0
    for m in range(count):
        if table[m, _I] > 3 * table[m, _NOISE]:
            relative += abs(table[m, _I] - _render(table[m], n, x)[0]) / table[m, _I]
            bright += 1
    return relative / bright if bright else np.nan


@kernel(allocates=True)
def fit_pixels(begin, end, intensity, lights, views, usable, noise, start, out):
    """The full model at pixels begin to end - 1.

    Parameters
    ----------
    intensity, lights, views, usable, noise : as in `Observations`, float64
    start : (n, 3) float64
        Normals to start from; NaN where there is none, and then no fit.
    out : (n, RESULTS) float64
        Written here: see the column names above; NaN where there is no normal.
    """
    table = np.zeros((len(intensity), _COLUMNS))
    matrix, gradient = np.zeros((UNKNOWNS, UNKNOWNS)), np.zeros(UNKNOWNS)
    frame, n, x = np.zeros((2, 3)), np.zeros(3), np.zeros(UNKNOWNS)
    for k in range(begin, end):
        out[k, :] = np.nan
        count, brightest = _gather(table, k, intensity, lights, views, usable, noise)
        if count < UNKNOWNS or not brightest > 0 or np.isnan(start[k, 0]):
            continue
        for i in range(3):
            n[i] = start[k, i]
        _start(x)
        cost = _fit(table, count, views[k], n, x, frame, matrix, gradient)
        out[k, NX : NZ + 1] = n
        out[k, KD], out[k, KS] = brightest * x[_KD], brightest * x[_KS]
        out[k, ALPHA] = math.exp(x[_LOG_ALPHA])
        out[k, RESIDUAL] = _residual(table, count, n, x)
        _covariance(table, count, n, x, frame, matrix, gradient, cost, out[k])
