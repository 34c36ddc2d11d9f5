"""Irregular wear in the terms of ASTM F1426, each as a figure with its uncertainty."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

_SIGMAS = 2.0
_TILE_DEG = 10.0
_LEAST_TILES = 3
# A block is longer than a sipe's land, and shorter than any stretch of a rib without a slot.
_BLOCK_MM = (8.0, 90.0)
_LEAST_BLOCKS = 3
# Share of a block (or of a rib's width) that counts as its edge.
_EDGE_SHARE = 0.2
_SIDE_SHARE = 0.25
# Waves shorter than this are blocks, longer ones are the tire's or the rig's runout.
_WAVE_MM = (40.0, 800.0)
_BIN_MM = 5.0
_NEIGHBOURS = 8
_FLAT_DEG = 5.0
# What two standard deviations leave out of a normal distribution.
_CHANCE = float(2 * stats.norm.sf(_SIGMAS))
# Millimetres from which detected wear is called by the word.
WORDS = ((0.0, "slight"), (0.5, "moderate"), (1.0, "severe"))


@dataclass(frozen=True)
class WornTread:
    """Wear of the rib tops between two captures, on cells of about a millimetre.

    Attributes
    ----------
    wear : (n, m) float
        mm, positive where material went; NaN off the tops and where nothing is known.
    slot : (n, m) bool
        Cells that are known not to be tops: slots, sipes, walls.
    theta : (n,) float
        Cell centres, rad, increasing.
    rib : (m,) int
        Number of the rib of each column, 0 = none.
    floor : (n,) float
        What the grooves' floors seem to have worn, mean of each row, mm. They did not: it is what
        the comparison errs by.
    step_mm : float
        Cell size along z.
    radius_mm : float
    whole_turn : bool
    """

    wear: np.ndarray
    slot: np.ndarray
    theta: np.ndarray
    rib: np.ndarray
    floor: np.ndarray
    step_mm: float
    radius_mm: float
    whole_turn: bool

    @property
    def arc_step_mm(self) -> float:
        return float(self.theta[1] - self.theta[0]) * self.radius_mm


@dataclass(frozen=True)
class Finding:
    """One figure of irregular wear.

    Attributes
    ----------
    term : str
        As ASTM F1426 names it.
    place : str
        Region, such as ``rib-2``.
    value_mm, std_mm : float
        NaN where it could not be found; `note` says why.
    limit_mm : float
        Values of less than this are chance.
    note : str
        What the sign means, or where the wave or spot is.
    """

    term: str
    place: str
    value_mm: float
    std_mm: float
    limit_mm: float
    note: str = ""

    @property
    def word(self) -> str:
        """not known, not detected, slight, moderate or severe."""
        if not np.isfinite(self.value_mm) or not np.isfinite(self.limit_mm):
            return "not known"
        size = abs(self.value_mm)
        if size < self.limit_mm:
            return "not detected"
        return [word for least, word in WORDS if size >= least][-1]


def heel_and_toe(tread: WornTread, rib: int, rolling: int = 0) -> Finding:
    """Mean step of wear between the two ends of a rib's blocks.

    A block is a run of tops along theta, in one column, between two slots. Its step is the mean
    wear of its last fifth less that of its first.

    Parameters
    ----------
    tread : WornTread
    rib : int
    rolling : +1, -1 or 0
        Where the tire's tread moves to in theta when it rolls; 0 = not known. Points that move
        towards +theta lead with their +theta edge.

    Returns
    -------
    Finding
        Positive: the trailing edge wore more; if rolling is not known, the +theta edge did.
    """
    steps, places = _block_steps(tread, rib)
    note = "trailing less leading edge" if rolling else "+theta less \u2212theta edge"
    if len(steps) < _LEAST_BLOCKS:
        return _unknown("heel-and-toe", rib, "no blocks between slots were found on this rib")
    mean, std = _tile_mean(steps if rolling <= 0 else -steps, places)
    return Finding("heel-and-toe", f"rib-{rib}", mean, std, _SIGMAS * std, note)


def _block_steps(tread: WornTread, rib: int) -> tuple[np.ndarray, np.ndarray]:
    steps, places = [], []
    for column in np.flatnonzero(tread.rib == rib):
        wear, slot = tread.wear[:, column], tread.slot[:, column]
        edges = np.flatnonzero(np.diff(np.concatenate([[0], np.isfinite(wear), [0]])))
        for start, stop in zip(edges[::2], edges[1::2], strict=True):
            closed = start > 0 and stop < len(wear) and slot[start - 1] and slot[stop]
            length = (stop - start) * tread.arc_step_mm
            if closed and _BLOCK_MM[0] <= length <= _BLOCK_MM[1]:
                edge = max(1, round(_EDGE_SHARE * (stop - start)))
                block = wear[start:stop]
                steps.append(block[-edge:].mean() - block[:edge].mean())
                places.append(tread.theta[(start + stop) // 2])
    return np.array(steps), np.array(places)


def feathering(tread: WornTread, rib: int, slope_std: float = 0.0, outboard: int = 0) -> Finding:
    """Step of wear across a rib: its upper quarter in z less its lower.

    Parameters
    ----------
    tread : WornTread
    rib : int
    slope_std : float
        Standard uncertainty of wear's slope along z that all ribs share, mm per mm: a tilt of
        the remounted tire that the alignment left.
    outboard : +1, -1 or 0
        Which side of z is outboard; 0 = not known.

    Returns
    -------
    Finding
        Positive: the outboard (if not known, the +z) edge wore more.
    """
    columns = np.flatnonzero(tread.rib == rib)
    side = max(1, round(_SIDE_SHARE * len(columns)))
    if len(columns) < 4:
        return _unknown("feathering", rib, "the rib is too narrow")
    upper, lower = (
        _row_means(tread.wear[:, columns[-side:]]),
        _row_means(tread.wear[:, columns[:side]]),
    )
    mean, std = _tile_mean((upper - lower) * (outboard or 1), tread.theta)
    std = float(np.hypot(std, slope_std * (len(columns) - side) * tread.step_mm))
    note = "outboard less inboard edge" if outboard else "+z less \u2212z edge"
    return Finding("feathering", f"rib-{rib}", mean, std, _SIGMAS * std, note)


def cupping(tread: WornTread, rib: int, bias_std_mm: float = 0.0) -> Finding:
    """Largest amplitude of a wave of wear around a rib, 40 to 800 mm long.

    Its uncertainty joins what noise alone shows, from the median amplitude of the waves of
    similar length (Rayleigh's distribution; a single spot raises them all, and is no cupping),
    the amplitude of the same wave on the grooves' floors, and the bias of the rib's mean wear,
    which may as well change around the turn. The limit is what the largest of as many amplitudes
    exceeds by chance.
    """
    bins = max(1, round(_BIN_MM / tread.arc_step_mm))
    theta, wear = _binned(tread.theta, _row_means(tread.wear[:, tread.rib == rib]), bins)
    _, floor = _binned(tread.theta, tread.floor, bins)
    span = (theta[-1] - theta[0]) * len(theta) / max(1, len(theta) - 1)
    arc = span * tread.radius_mm
    orders = np.arange(np.ceil(arc / _WAVE_MM[1]), np.floor(arc / _WAVE_MM[0]) + 1)
    orders = orders[orders >= (2 if tread.whole_turn else 1)]
    if len(orders) < 4 or np.isfinite(wear).sum() < 4 * len(orders):
        return _unknown("cupping", rib, "too little of the turn is known")
    waves = orders * 2 * np.pi / span
    amplitude = _amplitudes(theta, wear, waves, tread.whole_turn)
    noise = _neighbours_median(amplitude) / np.sqrt(2 * np.log(2))
    apparent = np.hypot(_amplitudes(theta, floor, waves, tread.whole_turn), bias_std_mm)
    std = np.hypot(noise, apparent)
    limit = std * np.sqrt(2 * np.log(len(orders) / _CHANCE))
    best = int(np.argmax(amplitude))
    note = f"amplitude of the wave of {arc / orders[best]:.0f} mm"
    place = f"rib-{rib}"
    return Finding(
        "cupping", place, float(amplitude[best]), float(std[best]), float(limit[best]), note
    )


def _neighbours_median(amplitude: np.ndarray) -> np.ndarray:
    """Median of the orders around each but for itself and its two neighbours, or of all if more."""
    order = np.arange(len(amplitude))
    away = np.abs(order[:, None] - order)
    near = (away > 1) & (away <= _NEIGHBOURS)
    return np.fmax(np.median(amplitude), [np.median(amplitude[mask]) for mask in near])


def _amplitudes(
    theta: np.ndarray, values: np.ndarray, waves: np.ndarray, whole_turn: bool
) -> np.ndarray:
    """Amplitude of each wave (per rad) in the known values; nil where too few are known."""
    known = np.isfinite(values)
    if known.sum() < 4 * len(waves):
        return np.zeros(len(waves))
    slow_out = _without_slow(theta[known], values[known], whole_turn)
    phase = np.outer(waves, theta[known] - theta[0])
    return 2 / known.sum() * np.abs(np.exp(-1j * phase) @ slow_out)


def flat_spot(tread: WornTread) -> Finding:
    """Largest wear of 5 degrees of the tread over its neighbours' mean."""
    rows = max(1, round(np.radians(_FLAT_DEG) * tread.radius_mm / tread.arc_step_mm))
    theta, wear = _binned(tread.theta, _row_means(tread.wear[:, tread.rib > 0]), rows)
    known = np.isfinite(wear)
    if known.sum() < 8:
        return Finding("flat spot", "tread", np.nan, np.nan, np.nan, "too little is known")
    theta, wear = theta[known], _without_slow(theta[known], wear[known], tread.whole_turn)
    std = float(1.4826 * np.median(np.abs(wear - np.median(wear))))
    limit = std * float(stats.norm.isf(_CHANCE / 2 / len(wear)))
    worst = int(np.argmax(wear))
    note = f"at {np.degrees(theta[worst]):.0f} degrees".replace("-", "\u2212")
    return Finding("flat spot", "tread", float(wear[worst]), std, limit, note)


def one_sided(wear: Sequence[float], std: Sequence[float], outboard: int = 0) -> Finding:
    """Wear of the outermost ribs against each other.

    Parameters
    ----------
    wear, std : (k,) float
        Mean wear of the ribs by increasing z and its standard uncertainty, mm. They are added
        in quadrature: an upper bound, as common parts cancel.
    outboard : +1, -1 or 0
        Which side of z is outboard; 0 = not known.

    Returns
    -------
    Finding
        Positive: the outboard (if not known, the +z) side wore more.
    """
    if len(wear) < 2:
        return Finding("one-sided wear", "tread", np.nan, np.nan, np.nan, "there is one rib only")
    value = (wear[-1] - wear[0]) * (outboard or 1)
    spread = float(np.hypot(std[0], std[-1]))
    note = "outboard less inboard rib" if outboard else "+z less \u2212z outer rib"
    return Finding("one-sided wear", "tread", value, spread, _SIGMAS * spread, note)


def shoulder_or_centre(wear: Sequence[float], std: Sequence[float]) -> Finding:
    """Mean wear of the two outermost ribs less that of the others; as `one_sided`.

    Returns
    -------
    Finding
        ``shoulder wear`` where the shoulders wore more (positive), else ``centre wear``.
    """
    if len(wear) < 3:
        return Finding(
            "centre/shoulder wear", "tread", np.nan, np.nan, np.nan, "there is no inner rib"
        )
    inner = len(wear) - 2
    value = 0.5 * (wear[0] + wear[-1]) - float(np.mean(wear[1:-1]))
    outer = 0.5 * np.hypot(std[0], std[-1])
    spread = float(np.hypot(outer, np.sqrt(np.sum(np.square(std[1:-1]))) / inner))
    note = "shoulder ribs less inner ribs"
    return Finding("centre/shoulder wear", "tread", value, spread, _SIGMAS * spread, note)


def _unknown(term: str, rib: int, why: str) -> Finding:
    return Finding(term, f"rib-{rib}", np.nan, np.nan, np.nan, why)


def _row_means(cells: np.ndarray) -> np.ndarray:
    """Mean of the known cells of each row; NaN where fewer than half are known."""
    known = np.isfinite(cells)
    count = known.sum(axis=1)
    mean = np.where(known, cells, 0).sum(axis=1) / np.maximum(count, 1)
    return np.where(2 * count >= cells.shape[1], mean, np.nan)


def _tile_mean(values: np.ndarray, theta: np.ndarray) -> tuple[float, float]:
    """Mean over tiles of 10 degrees and its standard uncertainty from their scatter."""
    known = np.isfinite(values)
    tile = np.floor(np.degrees(theta[known]) / _TILE_DEG).astype(int)
    _, member = np.unique(tile, return_inverse=True)
    if not len(member) or member.max() + 1 < _LEAST_TILES:
        return np.nan, np.nan
    means = np.bincount(member, values[known]) / np.bincount(member)
    return float(means.mean()), float(means.std(ddof=1) / np.sqrt(len(means)))


def _binned(theta: np.ndarray, values: np.ndarray, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Means over this many rows; what is left over at the end is dropped."""
    count = len(values) // rows
    cut = values[: count * rows].reshape(count, rows)
    return theta[: count * rows].reshape(count, rows).mean(axis=1), _row_means(cut)


def _without_slow(theta: np.ndarray, values: np.ndarray, whole_turn: bool) -> np.ndarray:
    """Values without their mean and first harmonic or, on a sector, their straight line."""
    parts = [np.cos(theta), np.sin(theta)] if whole_turn else [theta - theta.mean()]
    basis = np.column_stack([np.ones_like(theta), *parts])
    return values - basis @ np.linalg.lstsq(basis, values, rcond=None)[0]
