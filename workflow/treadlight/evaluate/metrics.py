"""A result against its truth, as evaluation.md defines every figure."""

from typing import Any

import numpy as np
from scipy import ndimage

from treadlight.evaluate.surface import (
    CLASSES,
    Surface,
    classify,
    interpolate_at,
    look_up,
    masked_mean,
    normals_at,
    outer_envelope,
)
from treadlight.evaluate.truth import Profile
from treadlight.geometry import CylinderGrid
from treadlight.geometry.axis import wrap_angle

# The definitions of evaluation.md.
_FIT_LIMIT_MM = 1.0
_DETAIL_SIGMA_MM = 3.0
_EDGE_DEPTH_MM = 2.5
_EDGE_REACH_CELLS = 1.5
NORMAL_BLUR_CELLS = 0.7
_MIN_FACING = 0.85

Figures = dict[str, Any]


def evaluate_profile(
    truth: Profile,
    theta: np.ndarray,
    z: np.ndarray,
    r: np.ndarray,
    r_std: np.ndarray | None = None,
    seams: np.ndarray | None = None,
) -> Figures:
    """All figures of a profile that need no camera.

    Parameters
    ----------
    truth : Profile
    theta, z : (n,) rad and (m,) mm float
        Cell centres of the result.
    r : (n, m) float
        Measured radius, mm; NaN where there is none.
    r_std : (n, m) float, optional
        Its standard uncertainty, mm.
    seams : (k,) float, optional
        Angles, rad, at which the view changes.

    Returns
    -------
    dict
        ``absolute`` and ``shape`` by class (`error_figures`), ``shape_fit``, ``detail``,
        ``edges``, ``extent``, ``r_std``, ``seams``.
    """
    r = np.asarray(r, np.float64)
    surface = look_up(truth, theta, z)
    grid = CylinderGrid(theta, z, float(np.nanmedian(surface.r)) if _any(surface.r) else 1.0)
    error = r - surface.r
    support = surface.classes["top"] | surface.classes["floor"]
    fit = fit_shape(error, theta, z, support)
    shape = error - evaluate_shape(fit, theta, z)
    found: Figures = {
        "absolute": _by_class(error, surface),
        "shape": _by_class(shape, surface),
        "shape_fit": dict(zip(_SHAPE_TERMS, fit.tolist(), strict=True)),
        "detail": detail(r, surface, grid),
        "edges": edges(r, surface),
        "extent": surface.extent,
    }
    if r_std is not None:
        found["r_std"] = {
            name: inside_sigma(shape, r_std, surface.classes[name]) for name in ("top", "floor")
        }
    if seams is not None and len(seams):
        found["seams"] = seam_steps(error, grid, seams)
    return found


def _any(values: np.ndarray) -> bool:
    return bool(np.isfinite(values).any())


def _by_class(error: np.ndarray, surface: Surface) -> Figures:
    cells = {name: surface.classes[name] for name in CLASSES}
    cells["all"] = np.isfinite(surface.r)
    return {name: error_figures(error, mask) for name, mask in cells.items()}


def error_figures(error: np.ndarray, mask: np.ndarray) -> Figures:
    """Median, median absolute, RMS, 95th percentile of |e| (mm) and coverage over a mask."""
    values = error[mask]
    finite = values[np.isfinite(values)]
    cells = int(mask.sum())
    if not finite.size:
        return {
            "bias_mm": None,
            "median_abs_mm": None,
            "rms_mm": None,
            "p95_mm": None,
            "coverage": 0.0 if cells else None,
            "cells": cells,
        }
    return {
        "bias_mm": float(np.median(finite)),
        "median_abs_mm": float(np.median(np.abs(finite))),
        "rms_mm": float(np.sqrt(np.mean(finite**2))),
        "p95_mm": float(np.percentile(np.abs(finite), 95)),
        "coverage": finite.size / cells,
        "cells": cells,
    }


_SHAPE_TERMS = ("one", "cos", "sin", "z", "z_cos", "z_sin")


def fit_shape(
    error: np.ndarray, theta: np.ndarray, z: np.ndarray, support: np.ndarray
) -> np.ndarray:
    """Coefficients (6,) of {1, cos, sin, z, z cos, z sin} fitted to the errors.

    Least squares over the cells of `support` whose error is below 1 mm; the first three in mm,
    the others in mm per mm. Of a sector too short to tell them apart the smallest is taken.
    All zero where fewer than six cells hold an error.
    """
    with np.errstate(invalid="ignore"):
        use = support & (np.abs(error) < _FIT_LIMIT_MM)
    rows, columns = np.nonzero(use)
    if len(rows) < len(_SHAPE_TERMS):
        return np.zeros(len(_SHAPE_TERMS))
    scale = float(np.abs(z).max()) or 1.0
    around = np.stack([np.ones(len(theta)), np.cos(theta), np.sin(theta)], axis=1)[rows]
    design = np.hstack([around, around * (z[columns] / scale)[:, None]])
    fit = np.linalg.lstsq(design, error[use], rcond=None)[0]
    return fit / np.array([1, 1, 1, scale, scale, scale])


def evaluate_shape(fit: np.ndarray, theta: np.ndarray, z: np.ndarray) -> np.ndarray:
    """The fitted motion of the frame at all cells, (n, m) mm."""
    around = np.stack([np.ones(len(theta)), np.cos(theta), np.sin(theta)], axis=1)
    return (around @ fit[:3])[:, None] + (around @ fit[3:])[:, None] * z


def detail(r: np.ndarray, surface: Surface, grid: CylinderGrid) -> Figures:
    """Texture of the tops: what a 3 mm Gaussian mean over the tops leaves, against the truth's."""
    mask = surface.classes["top"] & np.isfinite(r)
    if mask.sum() < 2:
        return {"correlation": None, "rms_mm": None}
    step = grid.step_theta * grid.nominal_radius_mm
    sigma = (_DETAIL_SIGMA_MM / step, _DETAIL_SIGMA_MM / grid.step_z)
    measured = (r - masked_mean(r, mask, sigma, grid.periodic))[mask]
    true = (surface.r - masked_mean(surface.r, mask, sigma, grid.periodic))[mask]
    return {
        "correlation": correlation(measured, true),
        "rms_mm": float(np.sqrt(np.mean((measured - true) ** 2))),
    }


def correlation(a: np.ndarray, b: np.ndarray) -> float | None:
    """Pearson's; None where one of them does not vary."""
    if len(a) < 2 or not np.std(a) or not np.std(b):
        return None
    return float(np.corrcoef(a, b)[0, 1])


def edges(r: np.ndarray, surface: Surface) -> Figures:
    """Share of the true 2.5 mm depth crossings that have a measured one within 1.5 cells.

    Both depths are against the true envelope. A crossing lies midway between two neighbouring
    cells with finite depths, along either axis.
    """
    true = _crossings(surface.envelope - surface.r)
    count = int(true.sum())
    if not count:
        return {"found": None, "edges": 0}
    measured = _crossings(surface.envelope - r)
    if not measured.any():
        return {"found": 0.0, "edges": count}
    # The lattice of crossings has half a cell as its step.
    near = ndimage.distance_transform_edt(~measured) <= 2 * _EDGE_REACH_CELLS
    return {"found": float(near[true].mean()), "edges": count}


def _crossings(depth: np.ndarray) -> np.ndarray:
    """Where the depth crosses, on a lattice of half cells, (2 n - 1, 2 m - 1) bool."""
    n, m = depth.shape
    lattice = np.zeros((2 * n - 1, 2 * m - 1), bool)
    known = np.isfinite(depth)
    with np.errstate(invalid="ignore"):
        below = depth > _EDGE_DEPTH_MM
    lattice[1::2, ::2] = (below[1:] != below[:-1]) & known[1:] & known[:-1]
    lattice[::2, 1::2] = (below[:, 1:] != below[:, :-1]) & known[:, 1:] & known[:, :-1]
    return lattice


def inside_sigma(error: np.ndarray, std: np.ndarray, mask: np.ndarray) -> Figures:
    """Share of the errors inside one and two standard uncertainties, and its median, mm."""
    use = mask & np.isfinite(error) & np.isfinite(std)
    if not use.any():
        return {"inside_1": None, "inside_2": None, "median_std_mm": None}
    size, sigma = np.abs(error[use]), np.asarray(std, np.float64)[use]
    return {
        "inside_1": float(np.mean(size <= sigma)),
        "inside_2": float(np.mean(size <= 2 * sigma)),
        "median_std_mm": float(np.median(sigma)),
    }


def seam_steps(error: np.ndarray, grid: CylinderGrid, seams: np.ndarray) -> Figures:
    """RMS of the errors' first differences along theta where the view changes, and elsewhere.

    Parameters
    ----------
    error : (n, m) float
        mm.
    grid : CylinderGrid
    seams : (k,) float
        Angles, rad, compared modulo 2 pi; a change may fall into the cells on either side.
    """
    steps = np.diff(error, axis=0)
    rows, _ = grid.index(np.asarray(seams), np.zeros(len(seams)))
    middle = np.arange(len(steps)) + 0.5
    at_seam = (np.abs(middle[:, None] - rows[None, :]) <= 1.0).any(axis=1)
    return {
        "at_seams_mm": _rms(steps[at_seam]),
        "elsewhere_mm": _rms(steps[~at_seam]),
        "seams": len(seams),
    }


def _rms(values: np.ndarray) -> float | None:
    values = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(values**2))) if values.size else None


def view_changes(encoders: np.ndarray) -> np.ndarray:
    """Angles, rad, midway between neighbouring views, which look at theta = -encoder.

    Parameters
    ----------
    encoders : (k,) float
        Encoder angle of each view, rad.
    """
    looks = np.sort(wrap_angle(-np.asarray(encoders, float)))
    if len(looks) < 2:
        return np.empty(0)
    gaps = np.diff(np.append(looks, looks[0] + 2 * np.pi))
    # Only neighbours meet: over the open part of a sector no view changes into another.
    meets = gaps < 1.5 * np.median(gaps)
    return wrap_angle(looks + gaps / 2)[meets]


def normal_figures(
    truth: Profile,
    theta: np.ndarray,
    z: np.ndarray,
    normal: np.ndarray,
    towards_camera: np.ndarray,
    cell_mm: float,
) -> Figures:
    """Angles between measured and true normals, degrees, where the surface faces the camera.

    Parameters
    ----------
    truth : Profile
    theta, z : (...) float
        Scene points, rad and mm.
    normal : (..., 3) float
        Measured, local basis (r, theta, z), unit length; NaN where there is none.
    towards_camera : (..., 3) float
        Unit vectors in the same basis.
    cell_mm : float
        The cell of the result: truth is blurred by 0.7 of it.
    """
    true = normals_at(truth, theta, z, NORMAL_BLUR_CELLS * cell_mm)
    with np.errstate(invalid="ignore", divide="ignore"):
        facing = np.sum(true * towards_camera, axis=-1) > _MIN_FACING
        cosine = np.sum(true * normal, axis=-1) / np.linalg.norm(normal, axis=-1)
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))[facing]
    known = np.isfinite(angle)
    finite = angle[known]
    if not finite.size:
        names = ("mean_deg", "median_deg", "top_median_deg", "rms_deg", "p95_deg", "coverage")
        return dict.fromkeys(names)
    top = finite[_on_tops(truth, theta[facing][known], z[facing][known])]
    return {
        "mean_deg": float(np.mean(finite)),
        "median_deg": float(np.median(finite)),
        "top_median_deg": float(np.median(top)) if top.size else None,
        "rms_deg": float(np.sqrt(np.mean(finite**2))),
        "p95_deg": float(np.percentile(finite, 95)),
        "coverage": finite.size / angle.size,
    }


def _on_tops(truth: Profile, theta: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Whether scattered points (n,) lie on block tops."""
    top = classify(truth, outer_envelope(truth))["top"]
    return interpolate_at(truth, top.astype(float), theta, z) > 0.5


def towards_camera(
    theta: np.ndarray,
    z: np.ndarray,
    r: np.ndarray,
    encoder: np.ndarray | float,
    camera_distance_mm: float,
) -> np.ndarray:
    """Unit vectors (..., 3) from points of {T} to the camera, in the local basis (r, theta, z).

    At encoder angle phi the camera stands at theta = -phi, z = 0, `camera_distance_mm` from
    the axis.
    """
    away = -np.asarray(encoder) - theta
    vector = np.stack(
        np.broadcast_arrays(
            camera_distance_mm * np.cos(away) - r, camera_distance_mm * np.sin(away), -z
        ),
        axis=-1,
    )
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)


def nearest_view(theta: np.ndarray, encoders: np.ndarray) -> np.ndarray:
    """Encoder angle, rad, of the view that looks at each theta most squarely; (n,)."""
    if not len(encoders):
        return -theta
    away = np.abs(wrap_angle(theta[:, None] + np.asarray(encoders)[None, :]))
    return np.asarray(encoders)[np.argmin(away, axis=1)]
