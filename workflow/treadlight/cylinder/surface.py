"""The first surface: r(theta, z) between the laser sections, along the grooves."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt

from treadlight.compiling import kernel
from treadlight.cylinder.extent import Extent
from treadlight.cylinder.registration import Sections
from treadlight.cylinder.smoothing import resample_sections
from treadlight.geometry import CylinderGrid
from treadlight.geometry.axis import wrap_angle
from treadlight.spool import IN_MEMORY, Memory, Spool

SURFACE_FLAGS = ("laser", "interpolated", "extrapolated", "step", "nominal")
LASER, INTERPOLATED, EXTRAPOLATED, STEP, NOMINAL = (1 << k for k in range(len(SURFACE_FLAGS)))

# Sections as far as this many spacings still tell of a cell.
_REACH_SPACINGS = 3.0
# Neighbours agree within this many standard deviations of their usual difference.
_AGREE_SIGMA = 4.0
# A slot or bar that only one section met is narrower than two spacings; if its width is evenly
# likely up to one, it ends on average a quarter of the way to the next section.
_LONE_SHIFT = 0.25
# Without a laser the tread lies within a new tire's tread depth of the nominal cylinder.
_NOMINAL_STD_MM = 8.0
_CLIPPING_ROUNDS = 10
# Filled at a time.
_COLUMNS = 512
_ROWS = 1024


@dataclass(frozen=True)
class Surface:
    """r(theta, z) on a grid.

    Attributes
    ----------
    r, r_std : (n_theta, n_z) float32
        mm; NaN where nothing supports a value.
    laser_r : (n_theta, n_z) float32
        Only in cells that hold a laser section's point, else NaN; mm.
    quality : (n_theta, n_z) uint8
        Bits of SURFACE_FLAGS.
    """

    r: np.ndarray
    r_std: np.ndarray
    laser_r: np.ndarray
    quality: np.ndarray


def lay_surface(
    sections: Sections,
    views: Sequence[Extent],
    grid: CylinderGrid,
    line_mm: float,
    memory: Memory | Spool = IN_MEMORY,
) -> Surface:
    """The first surface from whatever there is: sections, or views alone.

    Parameters
    ----------
    sections : Sections
    views : sequence of Extent
        Where LED frames see the tread.
    grid : CylinderGrid
    line_mm : float
        Sigma of the laser line on the tread: nothing finer along z is in the sections.
    memory : Memory or Spool
        Where the surface lies.
    """
    if not np.isfinite(sections.r).any():
        return nominal_surface(grid)
    seen = np.zeros(grid.shape[0], bool)
    for view in views:
        middle = view.start + 0.5 * view.length
        seen |= np.abs(wrap_angle(grid.theta - middle)) <= 0.5 * (view.length + grid.step_theta)
    return first_surface(sections, grid, line_mm, seen, memory)


def nominal_surface(grid: CylinderGrid) -> Surface:
    """The nominal cylinder, for a capture without laser frames."""
    shape = grid.shape
    return Surface(
        np.full(shape, grid.nominal_radius_mm, np.float32),
        np.full(shape, _NOMINAL_STD_MM, np.float32),
        np.full(shape, np.nan, np.float32),
        np.full(shape, NOMINAL, np.uint8),
    )


def first_surface(
    sections: Sections,
    grid: CylinderGrid,
    line_mm: float,
    seen: np.ndarray | None = None,
    memory: Memory | Spool = IN_MEMORY,
) -> Surface:
    """Interpolate the sections along theta at equal z, that is, along the grooves.

    Parameters
    ----------
    sections : Sections
        At least one point.
    grid : CylinderGrid
    line_mm : float
        Sigma of the laser line on the tread: the scale of smoothing along z within a section.
    seen : (n_theta,) bool, optional
        Rows that a view sees, where the surface is carried on however far the sections are.
    memory : Memory or Spool
        Where the surface lies; besides it, a few hundred columns at a time are worked on.
    """
    row, r, variance = resample_sections(sections, grid, line_mm)
    spacing = _row_spacing(sections, grid)
    step = _usual_step(r)
    drift = max(0.0, step**2 - 2 * float(np.nanmedian(variance)))
    n_theta, n_z = grid.shape
    told = (n_theta, grid.periodic, spacing, _REACH_SPACINGS * spacing, _AGREE_SIGMA * step, drift)
    surface, var, laser = (memory.empty(grid.shape, np.float32) for _ in range(3))
    quality = memory.empty(grid.shape, np.uint8)
    blocks = [slice(first, first + _COLUMNS) for first in range(0, n_z, _COLUMNS)]
    known = np.zeros(n_theta, bool)
    for own in blocks:
        filled = fill_columns(row[:, own], r[:, own], variance[:, own], *told)
        for into, values in zip((surface, var, laser, quality), filled, strict=True):
            into[:, own] = values
        known |= np.isfinite(filled[0]).any(axis=1)
        memory.release()
    lost = ~known & (False if seen is None else seen)
    if lost.any():
        away = _rows_away(known, grid.periodic)[lost] / spacing
        for own in blocks:
            _carry_to_views(surface[:, own], var[:, own], quality[:, own], lost, away, step)
            memory.release()
    usual = _usual_profile(r)
    for first in range(0, n_theta, _ROWS):
        rows = slice(first, first + _ROWS)
        if usual is not None:
            _fill_along_z(surface[rows], var[rows], quality[rows], usual, step)
        np.sqrt(var[rows], out=var[rows])
        memory.release()
    return Surface(surface, var, laser, quality)


def _row_spacing(sections: Sections, grid: CylinderGrid) -> float:
    """Usual distance of sections in grid rows; a lone section gets its own degree and a half."""
    if len(sections.encoder) < 2:
        return math.radians(1.5) / grid.step_theta
    return max(1.0, float(np.median(np.diff(sections.encoder))) / grid.step_theta)


def _usual_step(r: np.ndarray) -> float:
    """Standard deviation of the difference of neighbouring sections on one surface, mm."""
    step = np.abs(np.diff(r, axis=0))
    step = step[np.isfinite(step)]
    if not len(step):
        return 1.0
    # Slots and sipes are a good part of all steps: they are cut off until the rest is stable.
    usual = 1.4826 * float(np.median(step))
    for _ in range(_CLIPPING_ROUNDS):
        usual = 1.4826 * float(np.median(step[step <= 3 * usual]))
    return max(1e-3, usual)


@kernel(allocates=True)
def _lone_sections(value, agree, periodic):
    """1.0 for each section of a column that agrees with neither neighbour, else 0.0."""
    count = len(value)
    alone = np.ones(count)
    closed = periodic and count > 2
    for k in range(count):
        if (k > 0 or closed) and abs(value[k] - value[k - 1]) <= agree:
            alone[k] = 0.0
        if (k < count - 1 or closed) and abs(value[k] - value[(k + 1) % count]) <= agree:
            alone[k] = 0.0
    return alone


@kernel(allocates=True)
def fill_columns(row, r, variance, n_theta, periodic, spacing, reach, agree, drift):
    """Along theta, column by column: linear where neighbours agree, else the nearer one.

    About 30 operations and 25 bytes written per cell.

    The variance is that of a Brownian bridge: between two sections it grows by `drift` per
    spacing, and by what the two disagree.

    Parameters
    ----------
    row, r, variance : (sections, n_z) float64
        Fractional row, mm, mm2; NaN where there is none.
    n_theta : int
    periodic : bool
    spacing, reach : float
        Usual and greatest distance of sections, rows.
    agree : float
        Greatest difference of agreeing neighbours, mm.
    drift : float
        Variance that a spacing adds, mm2.

    Returns
    -------
    r, variance, laser_r : (n_theta, n_z) float64
    quality : (n_theta, n_z) uint8
    """
    n_z = r.shape[1]
    surface = np.full((n_theta, n_z), np.nan)
    var = np.full((n_theta, n_z), np.nan)
    laser = np.full((n_theta, n_z), np.nan)
    quality = np.zeros((n_theta, n_z), np.uint8)
    for j in range(n_z):
        known = np.flatnonzero(np.isfinite(r[:, j]))
        count = len(known)
        if count == 0:
            continue
        at = row[known, j]
        if periodic:
            at = at % n_theta
        order = np.argsort(at, kind="mergesort")
        at = at[order]
        value = r[known, j][order]
        spread = variance[known, j][order]
        alone = _lone_sections(value, agree, periodic)
        b = 0
        for i in range(n_theta):
            while b < count and at[b] < i:
                b += 1
            a = b - 1
            at_a, at_b = -np.inf, np.inf
            ia, ib = a, b
            if a >= 0:
                at_a = at[a]
            elif periodic:
                ia = count - 1
                at_a = at[ia] - n_theta
            if b < count:
                at_b = at[b]
            elif periodic:
                ib = 0
                at_b = at[0] + n_theta
            to_a, to_b = i - at_a, at_b - i
            if to_a + to_b <= reach:
                gap = max(to_a + to_b, 1e-9)
                x = to_a / gap
                off = value[ib] - value[ia]
                bridge = x * (1 - x) * (drift * gap / spacing + off * off)
                if abs(off) <= agree:
                    surface[i, j] = (1 - x) * value[ia] + x * value[ib]
                    var[i, j] = (1 - x) ** 2 * spread[ia] + x * x * spread[ib] + bridge
                    quality[i, j] = INTERPOLATED
                else:
                    border = 0.5 - _LONE_SHIFT * alone[ia] + _LONE_SHIFT * alone[ib]
                    near = ia if x < border else ib
                    surface[i, j] = value[near]
                    var[i, j] = spread[near] + bridge
                    quality[i, j] = INTERPOLATED | STEP
            elif min(to_a, to_b) <= 0.5 * reach:
                inwards = -1 if to_a <= to_b else 1
                near = ia if to_a <= to_b else ib
                far = min(to_a, to_b) / spacing
                # A slot that only the last section met goes on no further than towards the next.
                told = near
                while far > 0.5 - _LONE_SHIFT and alone[told] > 0 and 0 <= told + inwards < count:
                    told += inwards
                if alone[told] > 0:
                    told = near
                surface[i, j] = value[told]
                var[i, j] = spread[told] + drift * far * (1 + far)
                quality[i, j] = EXTRAPOLATED
        for k in range(count):
            cell = int(np.rint(at[k]))
            if periodic:
                cell = cell % n_theta
            if 0 <= cell < n_theta:
                # Sections that share a cell: their weighted mean.
                if np.isnan(laser[cell, j]):
                    laser[cell, j], var[cell, j] = value[k], spread[k]
                else:
                    total = 1 / var[cell, j] + 1 / spread[k]
                    laser[cell, j] = (laser[cell, j] / var[cell, j] + value[k] / spread[k]) / total
                    var[cell, j] = 1 / total
                surface[cell, j] = laser[cell, j]
                quality[cell, j] = LASER
    return surface, var, laser, quality


def _carry_to_views(
    surface: np.ndarray,
    var: np.ndarray,
    quality: np.ndarray,
    lost: np.ndarray,
    away: np.ndarray,
    step: float,
) -> None:
    """Carry each column's median on to rows that a view sees but no section reaches, in place.

    Those rows `lost` (n,), of which each is so far `away` from the sections, in their distances.
    """
    columns = np.isfinite(surface).any(axis=0)
    # The median over theta is the tread's section of revolution, sipes and slots aside.
    profile, spread = np.full((2, surface.shape[1]), np.nan)
    if columns.any():
        known = surface[:, columns].astype(np.float64)
        profile[columns] = np.nanmedian(known, axis=0)
        spread[columns] = np.nanvar(known, axis=0) + step**2
    surface[lost] = profile
    var[lost] = spread + step**2 * away[:, None]
    quality[lost] |= np.where(columns, EXTRAPOLATED, 0).astype(np.uint8)


def _rows_away(known: np.ndarray, periodic: bool) -> np.ndarray:
    """Distance (n,) of each row to the nearest known one, rows."""
    n = len(known)
    tiled = np.concatenate([known] * 3) if periodic else known
    away = distance_transform_edt(~tiled)
    return away[n : 2 * n] if periodic else away


def _usual_profile(r: np.ndarray) -> np.ndarray | None:
    """Median (n_z,) of the sections (s, n_z), between known columns interpolated; None without."""
    columns = np.isfinite(r).any(axis=0)
    if not columns.any():
        return None
    index = np.arange(r.shape[1])
    return np.interp(index, index[columns], np.nanmedian(r[:, columns], axis=0))


def _fill_along_z(
    surface: np.ndarray, var: np.ndarray, quality: np.ndarray, profile: np.ndarray, step: float
) -> None:
    """Fill cells between known ones along z by the nearest column plus the tread's own profile."""
    for i in range(len(surface)):
        known = np.isfinite(surface[i])
        if known.all() or not known.any():
            continue
        have = np.flatnonzero(known)
        miss = np.flatnonzero(~known)
        right = np.clip(np.searchsorted(have, miss), 0, len(have) - 1)
        left = np.maximum(right - 1, 0)
        near = np.where(
            np.abs(have[right] - miss) <= np.abs(have[left] - miss), have[right], have[left]
        )
        jump = profile[miss] - profile[near]
        surface[i, miss] = surface[i, near] + jump
        var[i, miss] = var[i, near] + step**2 * np.abs(miss - near) + (0.5 * jump) ** 2
        quality[i, miss] |= EXTRAPOLATED
