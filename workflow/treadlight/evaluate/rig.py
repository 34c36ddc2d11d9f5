"""A calibration against the true rig."""

from typing import Any

import numpy as np

from treadlight.geometry import Axis, Camera, Led, Plane, Rig

Figures = dict[str, Any]


def evaluate_rig(found: Rig, true: Rig, tread_radius_mm: float | None = None) -> Figures:
    """How far every part of a calibrated rig is from the true one.

    Parameters
    ----------
    found, true : Rig
    tread_radius_mm : float, optional
        Radius at which the tread faces the camera; the laser plane's offset is measured
        there, else where the optical axis meets the true plane.

    Returns
    -------
    dict
        ``camera``, ``laser_plane``, ``axis``, ``reference_plane``, ``leds``; None for a part
        that one of the two rigs lacks.
    """
    return {
        "camera": camera_figures(found.camera, true.camera),
        "laser_plane": _pair(
            found.laser_plane,
            true.laser_plane,
            lambda a, b: plane_figures(a, b, _tread_point(true, tread_radius_mm)),
        ),
        "axis": _pair(found.axis, true.axis, axis_figures),
        "reference_plane": _pair(
            found.reference_plane, true.reference_plane, lambda a, b: plane_figures(a, b, None)
        ),
        "leds": led_figures(found.leds, true.leds) if found.leds and true.leds else None,
    }


def _pair(found: Any, true: Any, compare: Any) -> Figures | None:
    return None if found is None or true is None else compare(found, true)


def _tread_point(true: Rig, radius_mm: float | None) -> np.ndarray | None:
    """The point of the tread that faces the camera, {C}, mm."""
    if true.axis is None or radius_mm is None:
        return None
    return true.axis.point + radius_mm * true.axis.basis[0]


def camera_figures(found: Camera, true: Camera) -> Figures:
    """Focal lengths in percent, principal point in pixels, and the rays of the whole image.

    ``ray_px``: where points on the true rays of a grid of pixels appear in the found camera,
    RMS of the distance to where they truly appear; a shift of the principal point and the
    turn of the camera that makes up for it are both in there.
    """
    focal = [100 * (found.matrix[i, i] / true.matrix[i, i] - 1) for i in range(2)]
    width, height = true.size_px
    u, v = np.meshgrid(np.linspace(0, width - 1, 17), np.linspace(0, height - 1, 17))
    uv = np.column_stack([u.ravel(), v.ravel()])
    distance = np.linalg.norm(found.project(true.rays(uv)) - uv, axis=1)
    return {
        "fx_percent": float(focal[0]),
        "fy_percent": float(focal[1]),
        "cx_px": float(found.matrix[0, 2] - true.matrix[0, 2]),
        "cy_px": float(found.matrix[1, 2] - true.matrix[1, 2]),
        "ray_px": float(np.sqrt(np.mean(distance**2))),
    }


def plane_figures(found: Plane, true: Plane, near: np.ndarray | None) -> Figures:
    """Angle between two planes, degrees, and distance of the found one from a true point, mm.

    Parameters
    ----------
    found, true : Plane
    near : (3,) float, optional
        {C}, mm; the true point is its foot on the true plane. Without it, where the optical
        axis meets the true plane.
    """
    foot = near - true.distance(near) * true.normal if near is not None else None
    if foot is None:
        foot = true.intersect(np.array([0.0, 0.0, 1.0]))
    # A plane has no side: (A, B, C, D) and its negative are the same.
    side = float(np.sign(found.normal @ true.normal)) or 1.0
    return {
        "angle_deg": _angle_deg(side * found.normal, true.normal),
        "offset_mm": float(side * found.distance(foot)),
    }


def _angle_deg(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


def axis_figures(found: Axis, true: Axis) -> Figures:
    """Angle, degrees (a wrong sense of turning is 180), and distances, mm.

    ``line_mm``: of the true axis's foot point from the found line; ``foot_mm``: between the two
    foot points, their difference by component in ``foot_xyz_mm``.
    """
    difference = found.point - true.point
    across = difference - found.direction * (difference @ found.direction)
    return {
        "angle_deg": _angle_deg(found.direction, true.direction),
        "line_mm": float(np.linalg.norm(across)),
        "foot_mm": float(np.linalg.norm(difference)),
        "foot_xyz_mm": [float(x) for x in difference],
    }


def led_figures(found: tuple[Led, ...], true: tuple[Led, ...]) -> Figures:
    """Distances of the LED positions, mm, and their relative intensities, percent.

    ``mean_vector_mm`` is the motion that all LEDs share.
    """
    wanted = {led.number: led for led in true}
    both = [(led, wanted[led.number]) for led in found if led.number in wanted]
    missing = sorted(set(wanted) - {led.number for led in found})
    if not both:
        return {"mean_mm": None, "max_mm": None, "missing": missing}
    difference = np.array([a.position - b.position for a, b in both])
    distance = np.linalg.norm(difference, axis=1)
    measured = np.array([a.intensity for a, _ in both])
    intensity = np.array([b.intensity for _, b in both])
    ratio = (measured / measured.mean()) / (intensity / intensity.mean())
    return {
        "mean_mm": float(distance.mean()),
        "max_mm": float(distance.max()),
        "mean_vector_mm": [float(x) for x in difference.mean(axis=0)],
        "intensity_rms_percent": float(100 * np.sqrt(np.mean((ratio - 1) ** 2))),
        "missing": missing,
    }
