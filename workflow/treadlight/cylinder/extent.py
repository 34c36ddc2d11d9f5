"""The grid of a profile: what sections and views cover of the circumference, and how finely."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from treadlight.cylinder.registration import Sections
from treadlight.errors import CaptureError
from treadlight.geometry import CylinderGrid, Rig
from treadlight.geometry.axis import wrap_angle

# Sections further apart than this many times the usual spacing leave a gap.
_GAP_SPACINGS = 3.0
# A line belongs to the tread where this share of the sections sees a point.
_SEEN_SHARE = 0.1
# Beyond the tread's width, the shoulders belong to a profile by this share.
_SHOULDER_SHARE = 0.1


@dataclass(frozen=True)
class Extent:
    """An arc of the circumference and a range of z: theta from `start` over `length`, rad; mm."""

    start: float
    length: float
    z_low: float
    z_high: float


def pixel_size_mm(rig: Rig, nominal_radius_mm: float) -> float:
    """Size of a pixel on the tread where the camera looks at it squarely."""
    assert rig.axis is not None
    depth = float(np.linalg.norm(rig.axis.point)) - nominal_radius_mm
    return depth / float(0.5 * (rig.camera.matrix[0, 0] + rig.camera.matrix[1, 1]))


def view_extent(rig: Rig, encoder: float, nominal_radius_mm: float) -> Extent:
    """What a view sees of the nominal cylinder, from the rays of the image's border.

    Raises
    ------
    CaptureError
        The camera does not see the cylinder.
    """
    assert rig.axis is not None
    width, height = rig.camera.size_px
    u, v = np.linspace(0, width - 1, 33), np.linspace(0, height - 1, 33)
    border = np.concatenate(
        [np.column_stack([u, np.full_like(u, edge)]) for edge in (0, (height - 1) / 2, height - 1)]
        + [np.column_stack([np.full_like(v, edge), v]) for edge in (0, width - 1)]
    )
    points = _meet_cylinder(rig, border, nominal_radius_mm)
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        raise CaptureError(
            "The camera does not see the tire at its nominal radius. Check"
            " tire.nominal_radius_mm and the calibration of the axis."
        )
    # At encoder zero the camera looks at theta = 0: no wrap within a view.
    theta, z, _ = rig.axis.to_tire(points, 0.0)
    low, high = float(theta.min()), float(theta.max())
    return Extent(low - encoder, high - low, float(z.min()), float(z.max()))


def _meet_cylinder(rig: Rig, pixels: np.ndarray, radius: float) -> np.ndarray:
    """First points (n, 3) of pixels' rays on the nominal cylinder, {C}; NaN where they miss."""
    assert rig.axis is not None
    rays = rig.camera.rays(pixels)
    direction, foot = rig.axis.direction, rig.axis.point
    across = rays - np.outer(rays @ direction, direction)
    a = np.sum(across * across, axis=1)
    b = across @ foot
    c = foot @ foot - radius**2
    with np.errstate(invalid="ignore"):
        depth = (b - np.sqrt(b * b - a * c)) / a
    return np.where(depth > 0, depth, np.nan)[:, None] * rays


def choose_grid(
    sections: Sections,
    views: Sequence[Extent],
    step_mm: float,
    nominal_radius_mm: float,
    tread_width_mm: float,
) -> CylinderGrid:
    """The profile's grid: a whole turn if sections or views go all the way round, else a sector.

    Parameters
    ----------
    sections : Sections
    views : sequence of Extent
    step_mm : float
    nominal_radius_mm, tread_width_mm : float
        Of the tire.

    Raises
    ------
    CaptureError
        Neither sections nor views show the tread.
    """
    arcs = _section_arcs(sections)
    reach = [(view.start, view.length) for view in views]
    if not arcs and not reach:
        raise CaptureError("Neither laser nor LED frames show the tread. Check the calibration.")
    z_range = _z_range(sections, views, tread_width_mm)
    spacing = _spacing(sections)
    # Sections stand for the tread up to the next one, unless it is missing.
    bridging = [
        (start - 0.5 * _GAP_SPACINGS * spacing, _GAP_SPACINGS * spacing + length)
        for start, length in arcs
    ]
    if widest_gap(bridging + reach)[1] <= 0:
        return CylinderGrid.whole_turn(z_range, step_mm, nominal_radius_mm)
    gap_start, gap = widest_gap(arcs + reach)
    low = gap_start + gap
    return CylinderGrid.sector((low, low + 2 * np.pi - gap), z_range, step_mm, nominal_radius_mm)


def _section_arcs(sections: Sections) -> list[tuple[float, float]]:
    """(start, length) of what each section covers itself; its points differ by the sheet's tilt."""
    arcs = []
    for theta in sections.theta:
        known = theta[np.isfinite(theta)]
        if len(known):
            middle = known[len(known) // 2]
            low, high = np.percentile(wrap_angle(known - middle), [1, 99])
            arcs.append((float(middle + low), float(high - low)))
    return arcs


def _spacing(sections: Sections) -> float:
    """Usual angle between neighbouring sections, rad; 0 for fewer than two."""
    return float(np.median(np.diff(sections.encoder))) if len(sections.encoder) > 1 else 0.0


def widest_gap(arcs: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """Start and length of the widest angle that no arc (start, length) covers; 0 if none."""
    ordered = sorted((start % (2 * np.pi), length) for start, length in arcs)
    # Twice round: an arc may reach over zero, and the first has a predecessor then.
    twice = ordered + [(start + 2 * np.pi, length) for start, length in ordered]
    end = ordered[0][0]
    best = (end, -np.inf)
    for start, length in twice:
        if start - end > best[1]:
            best = (end, start - end)
        end = max(end, start + length)
    return best


def _z_range(
    sections: Sections, views: Sequence[Extent], tread_width_mm: float
) -> tuple[float, float]:
    known = np.isfinite(sections.z)
    seen = known.sum(axis=0) >= max(1.0, _SEEN_SHARE * len(sections.z))
    if len(sections.z) and seen.any():
        z = np.where(known, sections.z, np.nan)[:, seen]
        middle = np.nanmedian(z, axis=0)
        return float(middle.min()), float(middle.max())
    low, high = min(v.z_low for v in views), max(v.z_high for v in views)
    half = (0.5 + _SHOULDER_SHARE) * tread_width_mm
    return max(low, -half), min(high, half)
