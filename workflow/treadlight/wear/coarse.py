"""Rotation and axial shift by correlation of the tread patterns over the full circle."""

from dataclasses import dataclass

import numpy as np
from scipy import fft

from treadlight.geometry import CylinderGrid

# Blocks, lateral grooves and their pitch are some millimetres wide; finer cells only cost time.
_STEP_MM = 1.0
# How far a tire can sit from where it sat before, along the axis.
_AXIAL_RANGE_MM = 30.0
# Share of the smaller pattern that a match must cover. Pitch sequences repeat in stretches: a
# quarter of a sector can match elsewhere as well as where it belongs.
_LEAST_OVERLAP = 0.4
# Peaks are as wide as lateral grooves along theta, and wider along z.
_PEAK_MM = (4.0, 12.0)


@dataclass(frozen=True)
class Candidate:
    """A place where the patterns match: rad, mm, and the correlation there."""

    rotation_rad: float
    axial_mm: float
    correlation: float


Pattern = tuple[CylinderGrid, np.ndarray]


def find_candidates(first: Pattern, current: Pattern, count: int = 6) -> list[Candidate]:
    """Best matches of two patterns, of which each may be a sector of the turn.

    Normalised correlation under masks (Padfield, IEEE Trans. Image Process. 21, 2012), circular
    along theta; each z column's mean is taken out first, or the circumferential grooves, which
    know no angle, would decide. Matches are ranked by significance, atanh(correlation) times
    the root of the overlap, as good matches over little overlap are common by chance.

    Parameters
    ----------
    first, current : grid and pattern (n, m), 0 .. 1, NaN = missing
    count : int
        Of candidates at most.

    Returns
    -------
    list of Candidate
        Best first; empty if there is no pattern to compare.
    """
    cells = (first[0], current[0])
    radius = first[0].nominal_radius_mm
    step = max(_STEP_MM, *(1.5 * max(g.step_z, g.step_theta * radius) for g in cells))
    rows = round(2 * np.pi * radius / step)
    z_0 = min(g.z[0] for g in cells)
    columns = int((max(g.z[-1] for g in cells) - z_0) / step) + 2
    (f_1, m_1), (f_2, m_2) = (
        _coarse(*pattern, rows, columns, z_0, step) for pattern in (first, current)
    )
    significance, correlation = _masked_correlation(f_1, m_1, f_2, m_2)
    lag = np.arange(significance.shape[1])
    lag = np.where(lag > len(lag) // 2, lag - len(lag), lag)
    significance[:, np.abs(lag) * step > _AXIAL_RANGE_MM] = -np.inf
    found = []
    reach = [max(1, round(size / step)) for size in _PEAK_MM]
    for _ in range(count):
        i, j = np.unravel_index(np.argmax(significance), significance.shape)
        if not significance[i, j] > 0:
            break
        found.append(
            Candidate(2 * np.pi * i / rows, float(lag[j]) * step, float(correlation[i, j]))
        )
        around = np.ix_(
            np.arange(i - reach[0], i + reach[0] + 1) % significance.shape[0],
            np.arange(j - reach[1], j + reach[1] + 1) % significance.shape[1],
        )
        significance[around] = -np.inf
    return found


def _coarse(
    grid: CylinderGrid, pattern: np.ndarray, rows: int, columns: int, z_0: float, step: float
) -> tuple[np.ndarray, np.ndarray]:
    """The pattern on a whole turn of coarse cells, without its column means; and its mask."""
    i, j = np.nonzero(np.isfinite(pattern))
    row = np.floor((grid.theta[i] % (2 * np.pi)) / (2 * np.pi) * rows).astype(int) % rows
    column = np.floor((grid.z[j] - z_0) / step).astype(int)
    cell = row * columns + column
    count = np.bincount(cell, minlength=rows * columns).reshape(rows, columns)
    total = np.bincount(cell, pattern[i, j], minlength=rows * columns)
    mask = (count > 0).astype(np.float64)
    mean = total.reshape(rows, columns) / np.maximum(count, 1)
    level = mean.sum(axis=0) / np.maximum(mask.sum(axis=0), 1)
    return (mean - level) * mask, mask


def _masked_correlation(
    f_1: np.ndarray, m_1: np.ndarray, f_2: np.ndarray, m_2: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Significance and correlation for each shift of the second onto the first."""
    shape = (f_1.shape[0], fft.next_fast_len(2 * f_1.shape[1]))

    def spectrum(values: np.ndarray) -> np.ndarray:
        return fft.rfft2(values, shape)

    def correlate(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return fft.irfft2(a * np.conj(b), shape)

    s_1, s_m1, s_q1 = spectrum(f_1), spectrum(m_1), spectrum(f_1**2)
    s_2, s_m2, s_q2 = spectrum(f_2), spectrum(m_2), spectrum(f_2**2)
    overlap = np.maximum(np.round(correlate(s_m1, s_m2)), 1.0)
    sum_1, sum_2 = correlate(s_1, s_m2), correlate(s_m1, s_2)
    var_1 = correlate(s_q1, s_m2) - sum_1**2 / overlap
    var_2 = correlate(s_m1, s_q2) - sum_2**2 / overlap
    product = np.maximum(var_1, 0) * np.maximum(var_2, 0)
    # Cells differ by 0 to 1: less spread than this is a pattern without features.
    flat = product <= (1e-4 * overlap) ** 2
    value = (correlate(s_1, s_2) - sum_1 * sum_2 / overlap) / np.sqrt(np.where(flat, 1, product))
    value = np.where(flat, 0.0, np.clip(value, -0.999, 0.999))
    enough = overlap >= _LEAST_OVERLAP * min(m_1.sum(), m_2.sum())
    return np.where(enough, np.arctanh(value) * np.sqrt(overlap), -np.inf), value
