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

from treadlight.laser.albedo import places_at_edges
from treadlight.laser.peak_kernels import FWHM, RIVAL_SHARE, find_peaks, refine_peaks

FLAGS = ("none", "multiple", "saturated", "weak", "ghost", "outlier")
NONE, MULTIPLE, SATURATED, WEAK, GHOST, OUTLIER = (1 << k for k in range(len(FLAGS)))

# A peak must stand this many standard deviations of the noise over zero: one false alarm in
# more than a million pixels of Gaussian noise.
_DETECTION_SIGMA = 5.0
# Shapes within this many standard deviations of the usual one are not odd.
_ODD_SIGMA = 2.0
# A step between rows of a quarter of the line's width is no noise.
_CALM_SIGMA = 0.25
# Peaks are looked for at so many places per sigma.
_PLACES_PER_SIGMA = 2.0
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
        rival = strength[:, 1] > RIVAL_SHARE * first
        weak = first < weak_below
    flags = np.where(found, 0, NONE)
    flags |= np.where(rival, MULTIPLE, 0)
    flags |= np.where(found & clipped[:, 0], SATURATED, 0)
    flags |= np.where(weak, WEAK, 0)
    return flags.astype(np.uint8)
