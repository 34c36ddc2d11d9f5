"""Sub-pixel position of the laser line: several candidate peaks per image row.

The dissertation takes the centroid of a row above half its maximum (eq. 3.4). Speckle makes that
a poor estimator, so here the line is the zero crossing of an antisymmetric filter whose weights
are the best linear ones for the noise that the line itself shows (`line_model`). What these draw
a narrow line to the pixels by is taken back, and where an edge of the albedo runs along the line
its place is that of a model (`albedo`).
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import maximum_filter1d, median_filter

from treadlight.compiling import kernel
from treadlight.laser.albedo import places_at_edges

PEAKS = 4
"""Candidates kept per row: the line, and up to three reflections or neighbouring stripes."""

FLAGS = ("none", "multiple", "saturated", "weak", "ghost", "outlier")
NONE, MULTIPLE, SATURATED, WEAK, GHOST, OUTLIER = (1 << k for k in range(len(FLAGS)))

# A peak must stand this many standard deviations of the noise over zero: one false alarm in
# more than a million pixels of Gaussian noise.
_DETECTION_SIGMA = 5.0
# Second peaks below this share of the first do not make a row ambiguous.
_RIVAL_SHARE = 0.2
# Shapes within this many standard deviations of the usual one are not odd.
_ODD_SIGMA = 2.0
# A step between rows of a quarter of the line's width is no noise.
_CALM_SIGMA = 0.25
# Zero crossings are found to this: far below what any line shows.
_TOLERANCE_PX, _MOST_SECANTS = 1e-5, 40
# Peaks are looked for at so many places per sigma.
_PLACES_PER_SIGMA = 2.0
# Full width at half maximum of a Gaussian, in sigmas.
FWHM = 2.3548
# The core of the line: filters of this many nodes (1.5 sigma) see nothing of its flanks.
_CORE_NODES = 3
# Wide and core filter may differ by this many standard deviations of the core's.
_DISAGREEMENT_SIGMA = 3.0
# Smoothing along the rows ends there: further out a bright row would light a dark one.
_ROW_REACH_SIGMA = 2.0
# Peaks closer than this many line sigmas are one peak: two equal Gaussians merge at 2 sigma.
_RESOLVED_SIGMA = 2.0


@dataclass(frozen=True)
class LineModel:
    """What the capture's own frames say about line and noise.

    Attributes
    ----------
    sigma_px : float
        Width of the line across, as filtered: standard deviation of the Gaussian of equal
        half-width, `blur_px` included.
    blur_px : float
        Smoothing across the line before the filter, for lines too narrow for the pixels.
    noise : float
        Standard deviation of the dark pixels' noise, in units of intensity.
    width_spread, skew_spread : float
        Robust standard deviations of ln(width) and of skew over bright rows.
    node_px : float
        Spacing of the filter's nodes.
    weights : (n, n) float64
        Row m - 1 holds the filter that uses nodes 1..m (at node_px * k off the centre, zero at
        the centre and beyond, linear between, antisymmetric); zero from node m + 1.
    std_px : (n,) float64
        Standard deviation of the position that each of these filters gives on a bright row.
    locking_px : (4,) float64
        How far the filters draw a line to places in the pixel: the amplitudes of `place_waves`.
    """

    sigma_px: float
    blur_px: float
    noise: float
    width_spread: float
    skew_spread: float
    node_px: float
    weights: np.ndarray
    std_px: np.ndarray
    locking_px: np.ndarray

    @property
    def unblurred_sigma_px(self) -> float:
        """Width of the line across in the image itself."""
        return math.sqrt(max(0.0, self.sigma_px**2 - self.blur_px**2))

    @property
    def row_sigma_px(self) -> float:
        """Smoothing along the rows: half the line's width, so that corners stay."""
        return 0.5 * self.unblurred_sigma_px


@dataclass(frozen=True)
class Candidates:
    """The peaks of one section; along the last axis strongest first, NaN where there are fewer.

    Attributes
    ----------
    u, u_std : (lines, PEAKS) float32
        Position across the line and its standard deviation, px.
    width : (lines, PEAKS) float32
        Full width at half maximum over 2.355, px.
    strength : (lines, PEAKS) float32
        Smoothed intensity at the peak; 1 is full scale.
    skew : (lines, PEAKS) float32
        Left minus right half-width over their sum; 0 for a symmetric stripe.
    flags : (lines,) uint8
        Bits of FLAGS that detection can know: none, multiple, saturated, weak.
    """

    u: np.ndarray
    u_std: np.ndarray
    width: np.ndarray
    strength: np.ndarray
    skew: np.ndarray
    flags: np.ndarray
    saturated: np.ndarray


def estimate_noise(intensity: np.ndarray) -> float:
    """Noise of the dark part of a laser frame, in units of intensity.

    From differences of neighbouring pixels (a frame under the laser alone is mostly dark);
    never below the rounding of the stored numbers.

    Parameters
    ----------
    intensity : (h, w) float32
    """
    step = np.abs(np.diff(intensity, axis=1)).ravel()
    moving = step[step > 0]
    rounding = (
        float(moving.min()) / math.sqrt(12) if len(moving) else float(np.finfo(np.float32).eps)
    )
    return max(float(np.median(step)) / (0.6745 * math.sqrt(2)), rounding)


def smooth_frame(intensity: np.ndarray, model: LineModel) -> np.ndarray:
    """The image (h, w) that the filters see, float32: smoothed from row to row, and across."""
    return _blur(intensity, model.blur_px, model.row_sigma_px)


def _blur(intensity: np.ndarray, sigma_u: float, sigma_v: float) -> np.ndarray:
    size = (2 * math.ceil(4 * sigma_u) + 1, 2 * math.ceil(_ROW_REACH_SIGMA * sigma_v) + 1)
    image = np.ascontiguousarray(intensity, np.float32)
    return cv2.GaussianBlur(
        image, size, max(sigma_u, 1e-6), sigmaY=max(sigma_v, 1e-6), borderType=cv2.BORDER_REPLICATE
    )


def detect_section(intensity: np.ndarray, saturated: np.ndarray, model: LineModel) -> Candidates:
    """All candidate peaks of one laser frame whose sections cross the rows.

    Parameters
    ----------
    intensity : (lines, width) float32
    saturated : (lines, width) bool
    model : LineModel
    """
    smooth = smooth_frame(intensity, model)
    found = _coarse_peaks(smooth, model)
    fields = refine_peaks(
        smooth,
        found,
        np.ascontiguousarray(saturated),
        model.weights,
        model.std_px,
        model.node_px,
        model.sigma_px,
        model.noise * _row_gain(model),
    )
    u, u_std, width, strength, skew, clipped = fields
    weak = 2 * _DETECTION_SIGMA * model.noise * _row_gain(model)
    u -= (place_waves(u) @ model.locking_px).astype(np.float32)
    flags = _row_flags(strength, clipped, weak)
    calm = calm_rows(u[:, 0], flags, model)
    filter_std = u_std[:, 0]
    u_std = np.hypot(u_std, _misshape(width, skew, calm, model)).astype(np.float32)
    width = np.sqrt(np.maximum(width**2 - np.float32(model.blur_px**2), 0))
    clear = np.where(flags == 0, u[:, 0], np.nan)
    place, std = places_at_edges(intensity, clear, model.unblurred_sigma_px, model.noise)
    proven = np.isfinite(place)
    u[proven, 0], u_std[proven, 0] = place[proven], np.maximum(std, filter_std)[proven]
    return Candidates(u, u_std, width, strength, skew, flags, clipped)


def _coarse_peaks(smooth: np.ndarray, model: LineModel) -> np.ndarray:
    """Columns (lines, PEAKS) int32 of the peaks of a frame that is smoothed across as well.

    A wide line's are looked for among means of a few columns.
    """
    each = max(1, int(model.sigma_px / _PLACES_PER_SIGMA))
    lines, count = smooth.shape[0], smooth.shape[1] // each
    means = smooth
    if each > 1:
        means = cv2.resize(smooth[:, : count * each], (count, lines), interpolation=cv2.INTER_AREA)
    across = _blur(means, model.sigma_px / each, 0.0)
    threshold = _DETECTION_SIGMA * model.noise * _noise_gain(model)
    found = find_peaks(across, threshold, _RESOLVED_SIGMA * model.sigma_px / each)
    return np.where(found < 0, found, each * found + each // 2).astype(np.int32)


def place_waves(u: np.ndarray) -> np.ndarray:
    """Cosine and sine of one turn per pixel, then of two: (..., 4), of columns `u` (...)."""
    turn = 2 * np.pi * u
    return np.stack([np.cos(turn), np.sin(turn), np.cos(2 * turn), np.sin(2 * turn)], axis=-1)


def apart_rows(model: LineModel) -> int:
    """How many rows further on the smoothing along the rows shares nothing any more."""
    return max(1, math.ceil(5 * model.row_sigma_px))


def calm_rows(u: np.ndarray, flags: np.ndarray, model: LineModel) -> np.ndarray:
    """Rows (lines,) around which the strongest peak `u` (lines,) goes on without a step or a gap.

    Rows near a step tell of the tread, not of the noise.
    """
    u = np.where(flags == 0, u, np.nan).astype(float)
    step = np.abs(np.diff(u, append=np.nan))
    step = np.where(np.isfinite(step), step, np.inf)
    around = 2 * apart_rows(model) + 5
    return maximum_filter1d(step, around, mode="nearest") < _CALM_SIGMA * model.sigma_px


def _misshape(
    width: np.ndarray, skew: np.ndarray, calm: np.ndarray, model: LineModel
) -> np.ndarray:
    """How far a stripe of odd shape may be from the line's middle, (lines, PEAKS) px.

    A wall or a slot cuts a stripe on one side, a reflection beside it widens it. Speckle makes
    odd shapes as well, another one in every row: where the line goes on calmly, its position is
    no worse for them, and only an oddness that lasts counts.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        odd = np.log(width / model.sigma_px)
    off = _off_middle(odd, skew, model)
    if calm.any():
        around = 2 * apart_rows(model) + 1
        odd_around, skew_around = (
            median_filter(_filled(x[:, 0]), around, mode="nearest") for x in (odd, skew)
        )
        off[calm, 0] = _off_middle(odd_around, skew_around, model)[calm]
    return off


def _filled(values: np.ndarray) -> np.ndarray:
    """Without NaN, which would spoil the running median for all rows behind."""
    return np.where(np.isfinite(values), values, np.float32(0))


def _off_middle(odd: np.ndarray, skew: np.ndarray, model: LineModel) -> np.ndarray:
    """Half of what ln(width) is off beyond its usual spread, and of what one side is longer, px."""
    too_odd = np.abs(odd) - _ODD_SIGMA * model.width_spread
    lopsided = np.abs(skew) - _ODD_SIGMA * model.skew_spread
    half = 0.5 * FWHM * model.sigma_px
    return half * np.hypot(np.maximum(too_odd, 0), np.maximum(lopsided, 0))


def _row_gain(model: LineModel) -> float:
    """By what factor the smoothing along the rows changes white noise."""
    return _gaussian_gain(model.row_sigma_px)


def _noise_gain(model: LineModel) -> float:
    return _row_gain(model) * _gaussian_gain(math.hypot(model.sigma_px, model.blur_px))


def _gaussian_gain(sigma_px: float) -> float:
    """Root of the sum of the squared taps of a Gaussian."""
    return min(1.0, 1 / math.sqrt(2 * math.sqrt(math.pi) * sigma_px))


def _row_flags(strength: np.ndarray, clipped: np.ndarray, weak_below: float) -> np.ndarray:
    first = strength[:, 0]
    found = np.isfinite(first)
    with np.errstate(invalid="ignore"):
        rival = strength[:, 1] > _RIVAL_SHARE * first
        weak = first < weak_below
    flags = np.where(found, 0, NONE)
    flags |= np.where(rival, MULTIPLE, 0)
    flags |= np.where(found & clipped[:, 0], SATURATED, 0)
    flags |= np.where(weak, WEAK, 0)
    return flags.astype(np.uint8)


@kernel(allocates=True)
def find_peaks(across, threshold, apart):
    """Columns of the strongest local maxima of each row.

    4 bytes read and about 3 operations per pixel.

    Parameters
    ----------
    across : (h, w) float32
        Smoothed intensity.
    threshold : float
        Peaks below do not count.
    apart : float
        Of peaks closer than this, px, the weaker is dropped.

    Returns
    -------
    (h, PEAKS) int32
        Strongest first, -1 where there are fewer.
    """
    h, w = across.shape
    found = np.full((h, PEAKS), -1, np.int32)
    for v in range(h):
        row = across[v]
        for u in range(1, w - 1):
            value = row[u]
            if value < threshold or value < row[u - 1] or value <= row[u + 1]:
                continue
            _insert(found[v], row, u, apart)
    return found


@kernel
def _insert(found, row, u, apart):
    """Put the peak at column `u` into the list, strongest first; rivals too close give way."""
    for k in range(len(found)):
        if found[k] >= 0 and abs(found[k] - u) < apart and row[found[k]] >= row[u]:
            return
    kept = 0
    for k in range(len(found)):
        if found[k] >= 0 and abs(found[k] - u) >= apart:
            found[kept] = found[k]
            kept += 1
    found[kept:] = -1
    place = 0
    while place < len(found) and found[place] >= 0 and row[found[place]] >= row[u]:
        place += 1
    if place == len(found):
        return
    for k in range(len(found) - 1, place, -1):
        found[k] = found[k - 1]
    found[place] = u


@kernel(allocates=True)
def with_integral(weights, node_px):
    """Filters (m, n) at the nodes from the middle to one past the last, and their integrals.

    (2, m, n + 2): what lies between is linear in the first, and its integral from the middle, px,
    quadratic.
    """
    count, nodes = weights.shape
    taps = np.zeros((2, count, nodes + 2))
    for m in range(count):
        for k in range(nodes + 1):
            if k < nodes:
                taps[0, m, k + 1] = weights[m, k]
            mean = 0.5 * (taps[0, m, k] + taps[0, m, k + 1])
            taps[1, m, k + 1] = taps[1, m, k] + node_px * mean
    return taps


@kernel
def _integral(x, weight, integral, node_px):
    """Of the filter from its middle to x >= 0, px."""
    last = len(weight) - 1
    at = min(x / node_px, float(last))
    k = min(int(at), last - 1)
    share = at - k
    rise = weight[k] + 0.5 * share * (weight[k + 1] - weight[k])
    return integral[k] + node_px * share * rise


@kernel
def filter_response(row, centre, weight, integral, nodes, node_px):
    """Antisymmetric filter at a sub-pixel centre: positive where the light lies to the right.

    A pixel counts by the filter's mean over it: one that only its middle is weighed by would
    feel where in its pixel a narrow line is.
    """
    reach = (nodes + 1) * node_px + 0.5
    low = max(0, math.ceil(centre - reach))
    high = min(len(row) - 1, math.floor(centre + reach))
    total = 0.0
    before = _integral(abs(low - 0.5 - centre), weight, integral, node_px)
    for u in range(low, high + 1):
        after = _integral(abs(u + 0.5 - centre), weight, integral, node_px)
        total += (after - before) * row[u]
        before = after
    return total


@kernel
def _gain(centre, weight, integral, nodes, node_px):
    """Root of the sum of the squared weights at a centre."""
    reach = (nodes + 1) * node_px + 0.5
    total = 0.0
    low = math.ceil(centre - reach)
    before = _integral(abs(low - 0.5 - centre), weight, integral, node_px)
    for u in range(low, math.floor(centre + reach) + 1):
        after = _integral(abs(u + 0.5 - centre), weight, integral, node_px)
        total += (after - before) ** 2
        before = after
    return math.sqrt(total)


@kernel
def zero_crossing(row, start, weight, integral, nodes, node_px, search):
    """Where the filter's response falls through zero within `search` px of `start`.

    Returns the position and the slope of the response there (per px, negative), or NaN.
    """
    low, high = start - search, start + search
    at_low = filter_response(row, low, weight, integral, nodes, node_px)
    at_high = filter_response(row, high, weight, integral, nodes, node_px)
    if not (at_low > 0.0 and at_high < 0.0):
        return np.nan, np.nan
    # The Illinois method: secants that cannot leave the bracket.
    centre, side = start, 0
    for _ in range(_MOST_SECANTS):
        before = centre
        centre = (low * at_high - high * at_low) / (at_high - at_low)
        if abs(centre - before) < _TOLERANCE_PX:
            break
        response = filter_response(row, centre, weight, integral, nodes, node_px)
        if response > 0.0:
            low, at_low = centre, response
            at_high = 0.5 * at_high if side > 0 else at_high
            side = 1
        else:
            high, at_high = centre, response
            at_low = 0.5 * at_low if side < 0 else at_low
            side = -1
    step = 0.5 * node_px
    ahead = filter_response(row, centre + step, weight, integral, nodes, node_px)
    behind = filter_response(row, centre - step, weight, integral, nodes, node_px)
    return centre, (ahead - behind) / (2 * step)


@kernel
def _crossing_with_std(row, start, taps, std_px, nodes, node_px, search, noise):
    weight, integral = taps[0, nodes - 1], taps[1, nodes - 1]
    centre, slope = zero_crossing(row, start, weight, integral, nodes, node_px, search)
    if np.isnan(centre) or not slope < 0.0:
        return np.nan, np.inf
    additive = noise * _gain(centre, weight, integral, nodes, node_px) / -slope
    return centre, math.sqrt(std_px[nodes - 1] ** 2 + additive**2)


@kernel
def _best_crossing(row, start, taps, std_px, nodes, node_px, search, noise):
    """The crossing of the filter with the least variance; of the core where the flanks mislead.

    The wide filters weigh the line's flanks, which a wall's reflection spoils first: where
    wide and core disagree by more than their noise allows, the core is right (a Hausman test).
    """
    core, core_std = _crossing_with_std(
        row, start, taps, std_px, _CORE_NODES, node_px, search, noise
    )
    best, best_std = core, core_std
    for m in range(_CORE_NODES + 1, nodes + 1):
        centre, spread = _crossing_with_std(row, start, taps, std_px, m, node_px, search, noise)
        if spread < best_std:
            best, best_std = centre, spread
    if not np.isnan(core) and abs(best - core) > _DISAGREEMENT_SIGMA * core_std:
        return core, core_std
    return best, best_std


@kernel
def _half_width(row, centre, level, direction):
    """Distance from the centre to where the row falls below `level`, px, linear between."""
    u = math.floor(centre) if direction < 0 else math.ceil(centre)
    while 0 <= u < len(row) and row[u] >= level:
        u += direction
    if u < 0 or u >= len(row):
        return abs(u - centre)
    inner = u - direction
    if inner < 0 or inner >= len(row) or row[inner] <= row[u]:
        return abs(u - centre)
    share = (row[inner] - level) / (row[inner] - row[u])
    return max(0.0, abs(inner - centre + direction * min(max(share, 0.0), 1.0)))


@kernel(allocates=True)
def refine_peaks(smooth, found, saturated, weights, std_px, node_px, sigma_px, noise):
    """Sub-pixel position, its standard deviation, width, strength and skew of found peaks.

    About 20 filter evaluations of 8 sigma taps per peak; nothing per pixel.

    Each peak takes the widest filter that stays on its own side of the nearest rival, since
    a rival's flank inside the filter would pull the position.
    """
    h, w = smooth.shape
    shape = found.shape
    u_out = np.full(shape, np.nan, np.float32)
    std_out = np.full(shape, np.nan, np.float32)
    width_out = np.full(shape, np.nan, np.float32)
    strength_out = np.full(shape, np.nan, np.float32)
    skew_out = np.full(shape, np.nan, np.float32)
    clipped_out = np.zeros(shape, np.bool_)
    all_nodes = len(std_px)
    taps = with_integral(weights, node_px)
    for v in range(h):
        row = smooth[v]
        kept = 0
        for k in range(shape[1]):
            at = found[v, k]
            if at < 0:
                break
            clear = min(float(at), float(w - 1 - at))
            search = 1.5 * sigma_px
            for other in range(shape[1]):
                rival = found[v, other]
                if rival < 0 or other == k or row[rival] < _RIVAL_SHARE * row[at]:
                    continue
                half = 0.5 * abs(rival - at)
                clear = min(clear, half)
                search = min(search, 0.5 * half)
            nodes = min(all_nodes, max(_CORE_NODES, int(clear / node_px) - 1))
            centre, spread = _best_crossing(
                row, float(at), taps, std_px, nodes, node_px, search, noise
            )
            if np.isnan(centre):
                continue
            level = 0.5 * row[at]
            left = _half_width(row, centre, level, -1)
            right = _half_width(row, centre, level, 1)
            u_out[v, kept] = centre
            std_out[v, kept] = spread
            width_out[v, kept] = (left + right) / FWHM
            strength_out[v, kept] = row[at]
            skew_out[v, kept] = (left - right) / max(left + right, 1e-6)
            reach = max(1, int(sigma_px))
            for u in range(max(0, at - reach), min(w, at + reach + 1)):
                clipped_out[v, kept] |= saturated[v, u]
            kept += 1
    return u_out, std_out, width_out, strength_out, skew_out, clipped_out
