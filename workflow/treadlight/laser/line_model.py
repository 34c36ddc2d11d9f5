"""What a capture's own frames say about the laser line: its width, its noise, its best filter."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import nnls

from treadlight.compiling import kernel
from treadlight.errors import NoLineError
from treadlight.laser.detection import (
    LineModel,
    apart_rows,
    calm_rows,
    detect_section,
    estimate_noise,
    place_waves,
    smooth_frame,
)
from treadlight.laser.peak_kernels import FWHM, filter_response, with_integral

# The filter reaches three sigmas: the light further out is haze and reflection.
_REACH_SIGMA = 3.0
# Until the line is known, one as narrow as a lens can draw is looked for.
_SEED_SIGMA_PX = 1.0
# The width has settled when a round changes it by less than this share, mostly the third does.
_SETTLED = 0.02
_MOST_ROUNDS = 8
# So many lines or up to twice as many tell the width.
_WIDTH_LINES = 16_000
# Below the first sigma a Gaussian line keeps over 17 % of its contrast at the pixels' Nyquist
# frequency: it is smoothed to the second. There (0.1 %) nothing hangs on the line's place in its
# pixel any more, but the noise is larger: a line between the two is smoothed only to tell its
# course, and what the best filter draws it to the pixels by.
_UNDERSAMPLED_SIGMA_PX, _UNDRAWN_SIGMA_PX = 0.6, 1.2
# The median line is drawn this far from its middle, in the sigma of the round before.
_PROFILE_REACH_SIGMA = 8.0
# Its light is gathered in bins that tell the places in a pixel apart.
_BINS_PER_PX = 4
# A row's place in it is the median of so many rows either side, and one more per pixel of sigma.
_MEDIAN_ROWS = 5
# The line's course over this many rows either side tells where a row's line should be, and over
# more where more share their speckle.
_COURSE_ROWS, _COURSE_GRAINS, _MOST_COURSE_ROWS = 10, 4, 20
# Each of the filter's unknowns wants this many rows before its noise can be told.
_ROWS_PER_NODE = 25
# Shrinks the filter towards one that trusts all nodes alike, against a spare sample of rows.
_RIDGE = 0.1
# Rows whose squared distance is beyond this many medians stand on an edge or a reflection.
_TRIM_AT = 2.5
_TRIMMING_ROUNDS = 3
# Huber's limit of differences of two filters, in their medians; less than a thousandth of a pixel
# apart they are the same.
_OUTLYING, _TINY_PX = 2.0, 1e-3
# What a filter draws a line to places in its pixel by before anything is known, standard deviation.
_LOCKING_PX = 0.02
# Variance of responses, whose amplitude is 1: rows that are alike to a millionth differ by what
# single precision rounds, another way on every machine.
_ROUNDING = 1e-12


def learn_line_model(frames: Sequence[tuple[np.ndarray, np.ndarray]]) -> LineModel:
    """Width of the line, noise, and the best antisymmetric filter, from some laser frames.

    Among antisymmetric filters w, the zero crossing of the response has the least variance
    for w proportional to C^-1 d, where d is the derivative of the mean response to a shift of
    the line and C the covariance of the responses about it (Gauss-Markov); both come from rows
    whose course is known from the rows around them. Where too few rows are clean, the filter
    is the derivative of a Gaussian of twice the line's sigma. What the filter draws a narrow line
    to the pixels by is told (`_unlocked`); one too narrow for them is smoothed instead.

    Parameters
    ----------
    frames : sequence of ((lines, width) float32, (lines, width) bool)
        Intensity and saturation of frames spread over the capture.

    Raises
    ------
    CaptureError
        No frame shows a line.
    """
    noise = float(np.median([estimate_noise(intensity) for intensity, _ in frames]))
    sigma = _SEED_SIGMA_PX
    # Of large frames a few hold lines enough.
    few = frames[:: max(1, sum(len(intensity) for intensity, _ in frames) // _WIDTH_LINES)]
    # Wide lines are seen broken into speckles by a narrow filter: it grows into them.
    for _ in range(_MOST_ROUNDS):
        model = _gaussian_model(sigma, 0.0, np.inf, np.inf, noise)
        before = sigma
        sigma, width_spread, skew_spread = _measure_shape(few, model)
        if abs(math.log(sigma / before)) < _SETTLED:
            break
    model = _gaussian_model(sigma, 0.0, width_spread, skew_spread, noise)
    undrawn = _undrawn_model(model)
    if sigma < _UNDERSAMPLED_SIGMA_PX:
        return _measure_std(frames, undrawn)
    best = _measure_std(frames, _best_model(frames, model, undrawn))
    return _unlocked(frames, best, undrawn) if undrawn.blur_px else best


def _gaussian_model(
    sigma_px: float, blur_px: float, width_spread: float, skew_spread: float, noise: float
) -> LineModel:
    """Derivative of a Gaussian of twice the line's sigma, of sigma itself for a blurred line."""
    node_px = max(0.5 * sigma_px, 0.5)
    # Rounded, since 3.0000000000000004 nodes are no fourth.
    count = max(3, math.ceil(round(_REACH_SIGMA * sigma_px / node_px, 6)))
    at = node_px * np.arange(1, count + 1)
    # Cut off where it is not yet small, a filter would feel each pixel come and go.
    scale = sigma_px if blur_px else 2 * sigma_px
    taps = at * np.exp(-0.5 * (at / scale) ** 2)
    weights = np.tril(np.ones((count, count))) * taps
    # A start only: `_measure_std` scales it to what the rows show.
    std = np.full(count, 0.1 * sigma_px)
    unlocked = np.zeros(4)
    return LineModel(
        sigma_px, blur_px, noise, width_spread, skew_spread, node_px, weights, std, unlocked
    )


def _measure_shape(
    frames: Sequence[tuple[np.ndarray, np.ndarray]], model: LineModel
) -> tuple[float, float, float]:
    """Sigma of the line, px, and the spreads of ln(width) and of skew.

    Sigma is that of the median over the rows, each taken about the course of the line: within a
    row speckle breaks the line into grains, and the half-width found there is a grain's. A factor
    on the light leaves the median's shape as it is, rows at steps and reflections hardly widen it.
    """
    widths, skews = [], []
    reach = math.ceil(_PROFILE_REACH_SIGMA * model.sigma_px)
    bins, light = [], []
    for intensity, saturated in frames:
        found = detect_section(intensity, saturated, model)
        # Told from the rows around, since a row's own is that of its brightest grain.
        course, strength = (
            _median_around(values[:, 0], model.sigma_px) for values in (found.u, found.strength)
        )
        # Only the brighter half: dim rows are oblique, blurred or haze.
        known = np.isfinite(strength)
        bright = known & (strength >= np.median(strength[known])) if known.any() else known
        widths.append(found.width[bright, 0])
        skews.append(found.skew[bright, 0])
        pixels = _light_about(intensity[bright], course[bright], strength[bright], reach)
        bins.append(pixels[0])
        light.append(pixels[1])
    width, skew = np.concatenate(widths), np.concatenate(skews)
    if not len(width):
        raise NoLineError(
            "The laser frames show no line above the noise, as if the laser was off. Check"
            " exposure and laser.channel."
        )
    sigma = max(
        0.5, _median_sigma(np.concatenate(bins), np.concatenate(light), reach, model.sigma_px)
    )
    off = np.abs(np.log(np.maximum(width, 1e-3) / sigma))
    return sigma, 1.4826 * float(np.median(off)), 1.4826 * float(np.median(np.abs(skew)))


def _median_around(values: np.ndarray, sigma_px: float) -> np.ndarray:
    """Median of the rows around each (lines,), but those its speckle reaches; it keeps steps.

    NaN where the row has no value; its own where none around has one.
    """
    skip = math.ceil(sigma_px)
    reach = 2 * skip + _MEDIAN_ROWS
    windows = np.lib.stride_tricks.sliding_window_view(
        np.pad(values.astype(float), reach, constant_values=np.nan), 2 * reach + 1
    )
    sides = np.abs(np.arange(-reach, reach + 1)) > skip
    known = np.isfinite(values)
    around = windows[known][:, sides]
    some = np.isfinite(around).any(axis=1)
    medians = values.astype(float)
    medians[np.flatnonzero(known)[some]] = np.nanmedian(around[some], axis=1)
    return medians


def _light_about(
    rows: np.ndarray, course: np.ndarray, strength: np.ndarray, reach: int
) -> tuple[np.ndarray, np.ndarray]:
    """The bin of each pixel within `reach` px of the course, and its light over its row's strength.

    Bins of 1 / _BINS_PER_PX px are counted from `reach` px to the left.
    """
    columns = np.rint(course).astype(int)[:, None] + np.arange(-reach, reach + 1)
    bins = np.floor((columns - course[:, None] + reach) * _BINS_PER_PX).astype(int)
    count = 2 * reach * _BINS_PER_PX
    inside = (columns >= 0) & (columns < rows.shape[1]) & (bins >= 0) & (bins < count)
    line = np.broadcast_to(np.arange(len(rows))[:, None], columns.shape)[inside]
    light = rows[line, columns[inside]] / strength[line]
    return bins[inside], light


def _median_sigma(bins: np.ndarray, light: np.ndarray, reach: int, sigma_px: float) -> float:
    """Full width at half maximum of the median profile over 2.355, px."""
    order = np.lexsort((light, bins))
    filled, first, count = np.unique(bins[order], return_index=True, return_counts=True)
    at = (filled + 0.5) / _BINS_PER_PX - reach
    median = light[order][first + count // 2]
    # A line that stays at one place in its pixel fills one bin in four.
    offset = np.linspace(at[0], at[-1], 16 * len(filled))
    profile = np.interp(offset, at, median)
    top = float(profile[np.abs(offset) <= 0.25 * sigma_px].mean())
    return float(np.mean(profile > 0.5 * top) * (at[-1] - at[0])) / FWHM


def _undrawn_model(model: LineModel) -> LineModel:
    """The model of the line smoothed across until what it finds is not drawn to the pixels."""
    blur = math.sqrt(max(0.0, _UNDRAWN_SIGMA_PX**2 - model.sigma_px**2))
    if blur == 0:
        return model
    spreads = model.width_spread, model.skew_spread
    return _gaussian_model(math.hypot(model.sigma_px, blur), blur, *spreads, model.noise)


def _best_model(
    frames: Sequence[tuple[np.ndarray, np.ndarray]], model: LineModel, undrawn: LineModel
) -> LineModel:
    # Neighbouring rows lie at one place in their pixels: a course that is drawn aside with them
    # would teach that.
    responses, shifted = [], []
    for intensity, saturated in frames:
        found = detect_section(intensity, saturated, undrawn)
        clean = ~found.saturated[:, 0] & (found.flags == 0)
        u = np.where(clean, found.u[:, 0], np.nan).astype(float)
        course = line_course(u, undrawn)
        rows = np.flatnonzero(np.isfinite(course))
        smooth = smooth_frame(intensity, model)
        at, ahead, behind = _node_responses(
            smooth[rows], course[rows], model.weights.shape[0], model.node_px
        )
        amplitude = found.strength[rows, :1]
        responses.append(at / amplitude)
        shifted.append((ahead - behind) / amplitude)
    return _solve(np.concatenate(responses), np.concatenate(shifted) / model.node_px, model)


def _unlocked(
    frames: Sequence[tuple[np.ndarray, np.ndarray]], best: LineModel, undrawn: LineModel
) -> LineModel:
    """The best model with what it draws lines to places in their pixels by.

    From what it finds beside what the `undrawn` model of the smoother line finds, by the place of
    the line's course: a row's own place is where its noise took it.
    """
    places, apart = [], []
    for intensity, saturated in frames:
        one, other = (detect_section(intensity, saturated, m) for m in (best, undrawn))
        clean = (one.flags == 0) & (other.flags == 0)
        course = line_course(np.where(clean, other.u[:, 0], np.nan).astype(float), undrawn)
        rows = np.isfinite(course)
        places.append(course[rows])
        apart.append((one.u - other.u)[rows, 0].astype(float))
    drawn = np.concatenate(apart)
    design = np.column_stack([place_waves(np.concatenate(places)), np.ones(len(drawn))])
    if len(drawn) < _ROWS_PER_NODE * design.shape[1]:
        return best
    # Rows that share grains count as one.
    variance = (1.4826 * float(np.median(np.abs(drawn)))) ** 2 * apart_rows(best)
    prior = max(variance, _TINY_PX**2) / _LOCKING_PX**2 * np.diag([1, 1, 1, 1, 0])
    limit = max(_OUTLYING * float(np.median(np.abs(drawn))), _TINY_PX)
    fit = np.zeros(design.shape[1])
    for _ in range(_TRIMMING_ROUNDS):
        weight = np.minimum(1, limit / np.maximum(np.abs(drawn - design @ fit), _TINY_PX))
        weighted = design.T * weight
        fit = np.linalg.solve(weighted @ design + prior, weighted @ drawn)
    return replace(best, locking_px=fit[:-1])


def _solve(responses: np.ndarray, slopes: np.ndarray, model: LineModel) -> LineModel:
    """The Gauss-Markov filters of every reach from responses and their slopes, (rows, nodes).

    Weights are kept from going negative: lobes of both signs would hang on the exact shape of
    the line's foot.
    """
    count = responses.shape[1]
    if len(responses) < _ROWS_PER_NODE * count:
        return model
    covariance = trimmed_covariance(responses)
    covariance += _RIDGE * np.diag(np.diag(covariance)) + _ROUNDING * np.eye(count)
    slope = -slopes.mean(axis=0)
    weights = np.zeros((count, count))
    std = np.zeros(count)
    for m in range(1, count + 1):
        root = np.linalg.cholesky(covariance[:m, :m])
        taps, _ = nnls(root.T, np.linalg.solve(root, slope[:m]))
        weights[m - 1, :m] = taps / taps.max()
        std[m - 1] = 1 / math.sqrt(float(slope[:m] @ taps))
    return replace(model, weights=weights, std_px=std)


def trimmed_covariance(samples: np.ndarray) -> np.ndarray:
    """Covariance (n, n) of samples (rows, n) without those far out (concentration steps)."""
    kept = samples
    for _ in range(_TRIMMING_ROUNDS):
        covariance = np.cov(kept.T) + 1e-12 * np.eye(samples.shape[1])
        offset = samples - kept.mean(axis=0)
        distance = np.einsum("ij,ij->i", offset @ np.linalg.inv(covariance), offset)
        kept = samples[distance < _TRIM_AT * np.median(distance)]
    return np.atleast_2d(np.cov(kept.T))


def _measure_std(frames: Sequence[tuple[np.ndarray, np.ndarray]], model: LineModel) -> LineModel:
    """Scale the filters' standard deviations to the spread that rows show about their course.

    From u(v) - (u(v - L) + u(v + L)) / 2, with L beyond what smoothing shares: its variance is
    1.5 times that of a row, and a course that is straight over 2 L drops out.
    """
    lag = apart_rows(model)
    ratios = []
    for intensity, saturated in frames:
        found = detect_section(intensity, saturated, model)
        u = np.where(found.flags == 0, found.u[:, 0], np.nan).astype(float)
        calm = calm_rows(found.u[:, 0], found.flags, model)
        if len(u) > 2 * lag:
            bend = u[lag:-lag] - 0.5 * (u[: -2 * lag] + u[2 * lag :])
            ratio = bend / math.sqrt(1.5) / found.u_std[lag:-lag, 0]
            ratios.append(ratio[calm[lag:-lag]])
    ratio = np.abs(np.concatenate(ratios)) if ratios else np.zeros(0)
    ratio = ratio[np.isfinite(ratio)]
    if len(ratio) < _ROWS_PER_NODE:
        return model
    # The share of a normal distribution inside one sigma: heavy tails of speckle count in it.
    return replace(model, std_px=model.std_px * float(np.percentile(ratio, 68.27)))


def line_course(u: np.ndarray, model: LineModel) -> np.ndarray:
    """Where the rows around say that each row's line is: a parabola's fit without the row itself.

    Parameters
    ----------
    u : (lines,) float64
        Positions, NaN where not known.
    model : LineModel
        Rows nearer than what its smoothing shares with the row are left out.

    Returns
    -------
    (lines,) float64
        NaN where half of the neighbours on either side are missing or one strays from the fit, as
        at steps.
    """
    skip = apart_rows(model)
    side = min(max(_COURSE_ROWS, _COURSE_GRAINS * skip), _MOST_COURSE_ROWS)
    reach = skip + side
    offsets = np.concatenate([np.arange(-reach, -skip), np.arange(skip + 1, reach + 1)])
    course = np.full(len(u), np.nan)
    if len(u) <= 2 * reach:
        return course
    windows = np.lib.stride_tricks.sliding_window_view(u, 2 * reach + 1)
    around = windows[:, offsets + reach]
    known = np.isfinite(around).astype(float)
    filled = np.nan_to_num(around)
    powers = (offsets[:, None] / reach) ** np.arange(5)
    moments = known @ powers
    # Where next to nothing is known, nothing is said below.
    normal = moments[:, np.add.outer(np.arange(3), np.arange(3))] + 1e-9 * np.eye(3)
    fit = np.linalg.solve(normal, (filled @ powers[:, :3])[..., None])[..., 0]
    residual = known * (filled - fit @ powers[:, :3].T)
    stray = np.maximum(np.abs(residual).max(axis=1), np.abs(u[reach:-reach] - fit[:, 0]))
    # Told by one side alone, a parabola may go anywhere.
    fewest = np.minimum(known[:, :side].sum(axis=1), known[:, side:].sum(axis=1))
    good = (2 * fewest >= side) & (stray < max(model.sigma_px, 1.0))
    course[reach:-reach] = np.where(good, fit[:, 0], np.nan)
    return course


@kernel(allocates=True)
def _node_responses(smooth, course, count, node_px):
    """Responses of each node's hat at the course, half a node ahead and half a node behind."""
    rows = len(course)
    at = np.zeros((rows, count))
    ahead = np.zeros((rows, count))
    behind = np.zeros((rows, count))
    hats = with_integral(np.eye(count), node_px)
    step = 0.5 * node_px
    for i in range(rows):
        row, centre = smooth[i], course[i]
        for k in range(count):
            hat, integral = hats[0, k], hats[1, k]
            at[i, k] = filter_response(row, centre, hat, integral, count, node_px)
            ahead[i, k] = filter_response(row, centre + step, hat, integral, count, node_px)
            behind[i, k] = filter_response(row, centre - step, hat, integral, count, node_px)
    return at, ahead, behind
