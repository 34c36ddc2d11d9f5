"""Each laser section at the grid's z: smoothed along z within pieces that no wall divides."""

import math

import numpy as np
from scipy.ndimage import maximum_filter1d

from treadlight.compiling import kernel
from treadlight.cylinder.registration import Sections
from treadlight.geometry import CylinderGrid

# Points this many times less certain than usual sit on a wall or in a reflection: the neighbour
# sections know better.
_DOUBTFUL_TIMES = 3.0
# Half-width of the smoothing along z, in sigmas of the line.
_SMOOTHING_LINES = 3.0
# Steeper than this, two rows lie on either side of a wall (mm per mm).
_WALL_SLOPE = 1.0
# Tukey's biweight keeps 95 % efficiency at this many standard deviations.
_TUKEY = 4.685
# Steps between rows beyond this many standard deviations of their noise are walls.
_STEP_SIGMA = 4.0


def resample_sections(
    sections: Sections, grid: CylinderGrid, line_mm: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Each section at the grid's z, smoothed within pieces that no wall divides.

    Returns
    -------
    row : (sections, n_z) float64
        Fractional row of the grid.
    r, variance : (sections, n_z) float64
        mm, mm2; NaN where the section has nothing there.
    """
    count = len(sections.encoder)
    shape = (count, grid.shape[1])
    row, r, variance = (np.full(shape, np.nan) for _ in range(3))
    noise = float(np.nanmedian(sections.r_std))
    shared = shared_rows(sections, line_mm)
    for k in range(count):
        known = np.flatnonzero(sections.r_std[k] <= _DOUBTFUL_TIMES * noise)
        known = known[np.argsort(sections.z[k, known], kind="stable")]
        if not len(known):
            continue
        z, radius = sections.z[k, known], sections.r[k, known]
        piece = _pieces(z, radius, noise, grid.step_z)
        rows = grid.index(sections.theta[k, known], z)[0]
        # Rows of a section may lie on both sides of a whole turn's seam.
        base = rows[0]
        if grid.periodic:
            n = grid.shape[0]
            rows = base + (rows - base + n / 2) % n - n / 2
        row[k], r[k], variance[k] = smooth_section(
            z,
            radius,
            rows,
            sections.r_std[k, known],
            piece,
            grid.z,
            _SMOOTHING_LINES * line_mm,
            shared,
        )
    return row, r, variance


def shared_rows(sections: Sections, line_mm: float) -> float:
    """How many neighbouring rows share their noise: the sum of its correlation over all lags.

    From the bends b = r(l) - (r(l - k) + r(l + k)) / 2 at a near and a far lag, under the
    correlation exp(-(k / 2s)^2) that Gaussian smoothing by s leaves: the variance of b is
    1.5 - 2 rho(k) + rho(2k) / 2 times that of a row.
    """
    pitch = np.abs(np.diff(sections.z, axis=1))
    pitch = pitch[np.isfinite(pitch)]
    line_rows = line_mm / max(float(np.median(pitch)), 1e-6) if len(pitch) else 1.0
    near = max(1, round(line_rows))
    far = 3 * near
    close, apart = _bend(sections.r, near, far), _bend(sections.r, far, far)
    if not (close > 0 and apart > 0):
        return 1.0
    width = near * np.geomspace(0.1, 3, 60)
    rho = np.exp(-((near / (2 * width)) ** 2))
    expected = (1.5 - 2 * rho + 0.5 * rho**4) / 1.5
    best = width[np.argmin(np.abs(expected - min(1.0, close / apart) ** 2))]
    return max(1.0, 2 * math.sqrt(math.pi) * float(best))


def _bend(r: np.ndarray, lag: int, margin: int) -> float:
    """Robust size of the bends at a lag, over rows without a step within the margin, mm."""
    if r.shape[1] <= 2 * margin:
        return 0.0
    inside = slice(margin, -margin)
    step = np.abs(np.diff(r, axis=1, append=np.nan))
    step = np.where(np.isfinite(step), step, np.inf)
    steepest = maximum_filter1d(step, 2 * margin + 1, axis=1)[:, inside]
    bend = r - 0.5 * (np.roll(r, lag, axis=1) + np.roll(r, -lag, axis=1))
    bend = np.abs(bend[:, inside])
    # Calm rows: those whose steepest step is among the lower half.
    calm = np.isfinite(steepest)
    if not calm.any():
        return 0.0
    calm &= steepest <= np.median(steepest[calm])
    chosen = bend[calm & np.isfinite(bend)]
    return float(np.median(chosen)) if len(chosen) else 0.0


def _pieces(z: np.ndarray, r: np.ndarray, noise: float, step_z: float) -> np.ndarray:
    """Number of the piece that each point of a section belongs to; walls and gaps divide."""
    dz, dr = np.diff(z), np.diff(r)
    pitch = max(float(np.median(dz)) if len(dz) else step_z, 1e-6)
    # Noise between rows, as seen where the tread is calm.
    rough = 1.4826 * float(np.median(np.abs(dr))) if len(dr) else noise
    wall = np.abs(dr) > _STEP_SIGMA * min(rough, noise) + _WALL_SLOPE * dz
    return np.concatenate([[0], np.cumsum(wall | (dz > 2.5 * pitch))]).astype(np.int64)


@kernel(allocates=True)
def smooth_section(z, r, rows, std, piece, at, half_width, shared):
    """Local straight fit at each `at`, tricube in z times Tukey's biweight, within one piece.

    Two rounds over the points in reach: some 20 operations per point and target.
    """
    count = len(at)
    row_out = np.full(count, np.nan)
    r_out = np.full(count, np.nan)
    var_out = np.full(count, np.nan)
    pitch = (z[-1] - z[0]) / max(1, len(z) - 1)
    first = 0
    for j in range(count):
        while first < len(z) and z[first] < at[j] - half_width:
            first += 1
        nearest = -1
        for i in range(max(0, first - 1), len(z)):
            if nearest >= 0 and abs(z[i] - at[j]) > abs(z[nearest] - at[j]):
                break
            nearest = i
        if nearest < 0 or abs(z[nearest] - at[j]) > 0.75 * max(pitch, 1e-9):
            continue
        fit, variance = _local_fit(z, r, std, piece, at[j], half_width, nearest, first, shared)
        row_out[j] = rows[nearest]
        r_out[j] = fit
        var_out[j] = variance
    return row_out, r_out, var_out


@kernel
def _local_fit(z, r, std, piece, at, half_width, nearest, first, shared):
    fit, slope = r[nearest], 0.0
    variance = std[nearest] ** 2
    for robust in range(3):
        s0 = s1 = s2 = t0 = t1 = v0 = w0 = 0.0
        for i in range(first, len(z)):
            x = z[i] - at
            if x > half_width:
                break
            if piece[i] != piece[nearest] or abs(x) >= half_width:
                continue
            w = (1 - (abs(x) / half_width) ** 3) ** 3 / std[i] ** 2
            if robust:
                off = abs(r[i] - fit - slope * x) / (_TUKEY * std[i])
                w *= max(0.0, 1 - off * off) ** 2
            s0 += w
            s1 += w * x
            s2 += w * x * x
            t0 += w * r[i]
            t1 += w * r[i] * x
            v0 += w * w * std[i] ** 2
            w0 += w * w
        if s0 <= 0.0:
            break
        determinant = s0 * s2 - s1 * s1
        # A slope needs points on both sides; beside an edge the mean and the last slope do.
        if determinant > 1e-3 * s0 * s0 * half_width * half_width:
            fit = (s2 * t0 - s1 * t1) / determinant
            slope = (s0 * t1 - s1 * t0) / determinant
        else:
            fit, slope = t0 / s0, 0.0
        # Rows share their noise: of so many effective rows only every shared-th counts.
        rows = s0 * s0 / w0
        variance = v0 / (s0 * s0) * shared * rows / (rows + shared - 1)
    return fit, variance
