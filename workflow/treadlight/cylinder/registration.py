"""Laser points of all sections in {T}: which candidate is the tread, and how certain it is."""

from dataclasses import dataclass

import numpy as np

from treadlight.geometry import Axis
from treadlight.tread import TOP, Regions
from treadlight.tread.robust import solve_robust

FLAGS = ("none", "multiple", "saturated", "weak", "ghost", "outlier")
NONE, MULTIPLE, SATURATED, WEAK, GHOST, OUTLIER = (1 << k for k in range(len(FLAGS)))

# Neighbour sections on each side that a point is held against.
_NEIGHBOURS = 4
# Points agree within this many standard deviations of their difference.
_AGREE_SIGMA = 4.0
# Where this share of the neighbours vouches for another candidate, and none for the chosen, the
# chosen is in doubt; from the second share on the other one takes its place.
_DOUBT_SHARE = 0.5
_SURE_SHARE = 0.9
# A radius further than this share from the nominal one is no tread.
_RADIUS_SHARE = 0.2
# No prior, and a variance (mm2) to divide by where a point claims to have none.
_ANYTHING = np.array([np.inf])
_NOTHING = 1e-6
# Where a point sits within its pixel is unknown by the deviation of a uniform distribution.
_PIXEL_STD = 0.29


@dataclass(frozen=True)
class Sections:
    """One point per section and line, in {T}; sections in order of encoder.

    Attributes
    ----------
    encoder : (n,) float64
        Rad.
    theta, z, r, r_std : (n, lines) float64
        Rad, mm, mm, mm; NaN where there is none.
    chosen : (n, lines) int
        Which candidate it is, -1 for none.
    quality : (n, lines) uint8
        Bits of FLAGS.
    """

    encoder: np.ndarray
    theta: np.ndarray
    z: np.ndarray
    r: np.ndarray
    r_std: np.ndarray
    chosen: np.ndarray
    quality: np.ndarray


def register_sections(
    points: np.ndarray,
    deviation: np.ndarray,
    path: np.ndarray,
    flags: np.ndarray,
    encoder: np.ndarray,
    axis: Axis,
    nominal_radius_mm: float,
) -> Sections:
    """Turn each section by its encoder angle and settle which candidate is the tread.

    The tread turns rigidly, so a groove's floor or a rib has its radius in the neighbour
    sections too; a reflection has not, since where it falls depends on what faces it.
    Where the line's candidate has no support there and another has, they change places, or
    neither is kept.

    Parameters
    ----------
    points, deviation : (sections, lines, peaks, 3) float
        {C} at the section's encoder angle, mm; the displacement for one standard deviation.
    path : (sections, lines) int
        The candidate that continuity along the rows chose, -1 for none.
    flags : (sections, lines) uint8
        Bits of FLAGS known so far.
    encoder : (sections,) float
        Rad, ascending.
    axis : Axis
    nominal_radius_mm : float
    """
    theta, z, r = axis.to_tire(points, encoder[:, None, None])
    radial, _, axial = np.moveaxis(
        axis.vectors_to_local(deviation, theta, encoder[:, None, None]), -1, 0
    )
    with np.errstate(invalid="ignore"):
        off = np.abs(r - nominal_radius_mm) > _RADIUS_SHARE * nominal_radius_mm
    r = np.where(off, np.nan, r)
    chosen = np.where(np.isfinite(_take(r, path)), path, -1)
    quality = np.where(_take(off, path) == 1, flags | OUTLIER, flags)
    chosen, quality = _unmask(r, chosen, quality)
    stray = _strays(_take(r, chosen), _tolerance(_take(r, chosen)))
    quality = np.where(stray, quality | OUTLIER, quality)
    chosen = np.where(stray, -1, chosen)
    quality = np.where(chosen < 0, quality | NONE, quality).astype(np.uint8)
    found = _take(r, chosen)
    spread = _radial_std(found, _take(z, chosen), _take(radial, chosen), _take(axial, chosen))
    return Sections(encoder, _take(theta, chosen), _take(z, chosen), found, spread, chosen, quality)


def _take(values: np.ndarray, index: np.ndarray) -> np.ndarray:
    """values[..., index] along the last axis, NaN where the index is negative."""
    taken = np.take_along_axis(values.astype(float), np.maximum(index, 0)[..., None], -1)[..., 0]
    return np.where(index >= 0, taken, np.nan)


def _tolerance(r: np.ndarray) -> float:
    """How far apart neighbours of one surface lie at most, mm: from sections side by side."""
    if len(r) < 2:
        return np.inf
    step = np.abs(np.diff(r, axis=0))
    step = step[np.isfinite(step)]
    return _AGREE_SIGMA * 1.4826 * float(np.median(step)) if len(step) else np.inf


def _support(r: np.ndarray, line: np.ndarray, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """How many neighbour sections agree with each candidate, and how many there are.

    Parameters
    ----------
    r : (sections, lines, peaks) float
        Candidates.
    line : (sections, lines) float
        The chosen points.

    Returns
    -------
    agreeing : (sections, lines, peaks) int
    neighbours : (sections, lines) int
    """
    sections, lines = line.shape
    around = np.full((3, sections + 2 * _NEIGHBOURS, lines), np.nan)
    inner = slice(_NEIGHBOURS, _NEIGHBOURS + sections)
    # A row's neighbours count too: the row of one z shifts a little with the radius.
    around[0, inner], around[1, inner, 1:], around[2, inner, :-1] = line, line[:, :-1], line[:, 1:]
    agreeing = np.zeros(r.shape, int)
    neighbours = np.zeros(line.shape, int)
    for shift in range(-_NEIGHBOURS, _NEIGHBOURS + 1):
        if shift == 0:
            continue
        other = around[:, _NEIGHBOURS + shift : _NEIGHBOURS + shift + sections]
        with np.errstate(invalid="ignore"):
            near = np.abs(other[..., None] - r) <= tolerance
        agreeing += near.any(axis=0)
        neighbours += np.isfinite(other[0])
    return agreeing, neighbours


def _unmask(
    r: np.ndarray, chosen: np.ndarray, quality: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    line = _take(r, chosen)
    agreeing, neighbours = _support(r, line, _tolerance(line))
    best = np.argmax(agreeing, axis=-1)
    support = np.max(agreeing, axis=-1) / np.maximum(neighbours, 2)
    doubted = (chosen >= 0) & (_take(agreeing, chosen) == 0) & (support >= _DOUBT_SHARE)
    # A slot's edge splits the stripe too: there neither part is sure, and neither is kept.
    certain = np.where(support >= _SURE_SHARE, best, -1)
    return np.where(doubted, certain, chosen), np.where(doubted, quality | GHOST, quality)


def _strays(r: np.ndarray, tolerance: float) -> np.ndarray:
    """Points that agree with no point within two rows, nor with a neighbour section."""
    padded = np.pad(r, ((1, 1), (2, 2)), constant_values=np.nan)
    sections, lines = r.shape
    friends = np.zeros(r.shape, bool)
    for ds in (-1, 0, 1):
        for dl in range(-2, 3):
            if ds == 0 and dl == 0:
                continue
            other = padded[1 + ds : 1 + ds + sections, 2 + dl : 2 + dl + lines]
            with np.errstate(invalid="ignore"):
                friends |= np.abs(other - r) <= tolerance * np.hypot(1, dl)
    return np.isfinite(r) & ~friends


def _radial_std(r: np.ndarray, z: np.ndarray, radial: np.ndarray, axial: np.ndarray) -> np.ndarray:
    """Standard deviation of r at the point's own z.

    The displacement for one standard deviation of u moves r by `radial`, and z by `axial`,
    which a slope dr/dz turns into r as well; on top comes the place within the pixel.
    """
    before = np.diff(r, axis=1, prepend=np.nan)
    after = np.diff(r, axis=1, append=np.nan)
    # The lesser of the two steps: beside an edge the point's own side tells its slope.
    step = np.where(np.abs(before) <= np.abs(after), before, after)
    step = np.where(np.isfinite(step), step, np.where(np.isfinite(before), before, after))
    step = np.nan_to_num(step)
    pitch = np.nanmedian(np.abs(np.diff(z, axis=1))) if np.isfinite(z).any() else 1.0
    slope = step / pitch if pitch > 0 else np.zeros_like(step)
    return np.hypot(radial - slope * axial, _PIXEL_STD * step)


def on_tops(sections: Sections, regions: Regions) -> np.ndarray:
    """Points (n, lines) on the tops of ribs."""
    known = np.isfinite(sections.r)
    theta = np.angle(_mean(np.exp(1j * sections.theta), known, axis=1))
    z = _mean(sections.z, known, axis=0)
    return regions.on_columns(z).classify(sections.r, theta) == TOP


def _mean(values: np.ndarray, known: np.ndarray, axis: int) -> np.ndarray:
    """Mean of what is known along an axis; 0 where nothing is."""
    total = np.where(known, values, 0).sum(axis=axis)
    return np.asarray(total / np.maximum(known.sum(axis=axis), 1))


def closure_mm(sections: Sections, tops: np.ndarray) -> float:
    """How far the last sections of a whole turn miss the first where they overlap, mm.

    Root mean square, over the sections that lie a whole turn after others, of the robust weighted
    mean (Tukey's biweight) of the differences to the radius interpolated between those, at equal
    line; NaN without overlap.

    Parameters
    ----------
    sections : Sections
    tops : (n, lines) bool
        Points on the tops of ribs: the walls of slots and grooves, a little beside where they
        were a turn ago, tell nothing.
    """
    encoder = sections.encoder
    r, variance = np.where(tops, sections.r, np.nan), sections.r_std**2
    misses = []
    for k in range(len(encoder)):
        before = encoder[k] - 2 * np.pi
        after = np.searchsorted(encoder, before)
        if len(encoder) == 0 or before < encoder[0] - 1e-9 or after >= k:
            continue
        low = max(after - 1, 0)
        gap = encoder[after] - encoder[low]
        share = (before - encoder[low]) / gap if gap > 0 else 0.0
        miss = r[k] - (1 - share) * r[low] - share * r[after]
        spread = variance[k] + (1 - share) ** 2 * variance[low] + share**2 * variance[after]
        known = np.isfinite(miss)
        if known.any():
            level, _ = solve_robust(
                np.ones((known.sum(), 1)), miss[known], _ANYTHING, 1 / (spread[known] + _NOTHING)
            )
            misses.append(float(level[0]))
    return float(np.sqrt(np.mean(np.square(misses)))) if misses else float("nan")
