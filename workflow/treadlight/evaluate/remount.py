"""Wear and the alignment behind it, against truth."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from treadlight.evaluate.metrics import (
    correlation,
    evaluate_shape,
    fit_shape,
    inside_sigma,
)
from treadlight.evaluate.surface import interpolate, look_up
from treadlight.evaluate.truth import Profile
from treadlight.geometry.axis import wrap_angle

# The definitions of evaluation.md.
_WORN_MM = 0.02
_BLOCK_MM = 5.0
_BLOCK_FILL = 0.5
PARAMETERS = (
    "rotation_rad",
    "axial_mm",
    "tilt_x_rad",
    "tilt_y_rad",
    "offset_x_mm",
    "offset_y_mm",
    "radial_mm",
)

Figures = dict[str, Any]


@dataclass(frozen=True)
class Mounting:
    """How a rendered tire sits on the rig: X_T = rotation X_tire + shift, r_tire + radius_change.

    Attributes
    ----------
    rotation : (3, 3) float
    shift : (3,) float
        mm, {T} at encoder zero.
    radius_change_mm : float
    """

    rotation: np.ndarray
    shift: np.ndarray
    radius_change_mm: float


def read_mounting(truth: dict[str, Any]) -> Mounting | None:
    """The mounting that a truth/rig.yaml tells, or None.

    X_T = Rx(tilt0) Ry(tilt1) Rz(rotation) X_tire + (ecc0, ecc1, hub_z + axial).
    """
    told = truth.get("mounting")
    if not isinstance(told, dict):
        return None
    tilt_x, tilt_y = np.radians(told["tilt_deg"])
    rotation = _rx(tilt_x) @ _ry(tilt_y) @ _rz(np.radians(told["rotation_deg"]))
    axial = float(truth.get("hub_z_mm", 0.0)) + float(told["axial_mm"])
    shift = np.array([*told["ecc_mm"], axial], float)
    return Mounting(rotation, shift, float(told["radius_change_mm"]))


def _rx(a: float) -> np.ndarray:
    c, s = np.cos(a), np.sin(a)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def _ry(a: float) -> np.ndarray:
    c, s = np.cos(a), np.sin(a)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def _rz(a: float) -> np.ndarray:
    c, s = np.cos(a), np.sin(a)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def true_alignment(first: Mounting, later: Mounting) -> np.ndarray:
    """The seven parameters that take the later capture's tire into the first one's frame.

    X' = Rz(rotation) Rx(tilt_x) Ry(tilt_y) X + (offset_x, offset_y, axial), r' = r + radial,
    in the order of `PARAMETERS`.
    """
    turn = first.rotation @ later.rotation.T
    shift = first.shift - turn @ later.shift
    rotation = np.arctan2(-turn[0, 1], turn[1, 1])
    tilt_x = np.arcsin(np.clip(turn[2, 1], -1, 1))
    tilt_y = np.arctan2(-turn[2, 0], turn[2, 2])
    radial = first.radius_change_mm - later.radius_change_mm
    return np.array([rotation, shift[2], tilt_x, tilt_y, shift[0], shift[1], radial])


def alignment_figures(found: np.ndarray, true: np.ndarray, radius_mm: float) -> Figures:
    """Found minus true, by parameter, and the rotation as an arc on the tread, mm."""
    error = np.asarray(found, float) - true
    error[0] = wrap_angle(error[0])
    figures: Figures = {name: float(e) for name, e in zip(PARAMETERS, error, strict=True)}
    figures["rotation_arc_mm"] = float(error[0] * radius_mm)
    return figures


def evaluate_wear(
    true_wear: Profile,
    first_truth: Profile | None,
    theta: np.ndarray,
    z: np.ndarray,
    wear: np.ndarray,
    wear_std: np.ndarray | None = None,
) -> Figures:
    """Measured wear against the true map, in the first capture's frame.

    Parameters
    ----------
    true_wear : Profile
        `r` holds the wear, mm.
    first_truth : Profile, optional
        The first capture's true surface: tells tops and floors for ``wear_std``.
    theta, z : (n,) rad and (m,) mm float
    wear, wear_std : (n, m) float
        mm, NaN where there is none.

    Returns
    -------
    dict
        ``mean_error_mm``, ``true_mean_mm``, ``measured_mean_mm``, ``median_abs_mm``,
        ``coverage`` over cells with true wear above 0.02 mm; ``blocks`` {n, rms_mm,
        correlation}; ``wear_std`` by class, as it is and after the shape fit.
    """
    true = interpolate(true_wear, true_wear.r, theta, z)
    wear = np.asarray(wear, np.float64)
    with np.errstate(invalid="ignore"):
        worn = true > _WORN_MM
    use = worn & np.isfinite(wear)
    error = wear - true
    figures: Figures = {
        "mean_error_mm": _mean(error[use]),
        "true_mean_mm": _mean(true[use]),
        "measured_mean_mm": _mean(wear[use]),
        "median_abs_mm": float(np.median(np.abs(error[use]))) if use.any() else None,
        "coverage": float(use.sum() / worn.sum()) if worn.any() else None,
        "cells": int(worn.sum()),
        "blocks": _block_figures(wear, true, use, _block_shape(theta, z, first_truth)),
    }
    if wear_std is not None and first_truth is not None:
        classes = look_up(first_truth, theta, z).classes
        fit = fit_shape(error, theta, z, classes["top"] | classes["floor"])
        shape = error - evaluate_shape(fit, theta, z)
        figures["wear_std"] = {
            name: {
                "absolute": inside_sigma(error, wear_std, classes[name]),
                "shape": inside_sigma(shape, wear_std, classes[name]),
            }
            for name in ("top", "floor")
        }
    return figures


def _mean(values: np.ndarray) -> float | None:
    return float(values.mean()) if values.size else None


def _block_shape(theta: np.ndarray, z: np.ndarray, first_truth: Profile | None) -> tuple[int, int]:
    """Cells per 5 mm block; without the true surface the cells are taken as square."""
    step_z = float(z[-1] - z[0]) / (len(z) - 1)
    step_theta = step_z
    if first_truth is not None:
        radius = float(np.nanmedian(first_truth.r))
        step_theta = float(theta[-1] - theta[0]) / (len(theta) - 1) * radius
    return max(1, round(_BLOCK_MM / step_theta)), max(1, round(_BLOCK_MM / step_z))


def _block_figures(
    wear: np.ndarray, true: np.ndarray, use: np.ndarray, block: tuple[int, int]
) -> Figures:
    count = _block_sums(use.astype(float), block)
    filled = count > _BLOCK_FILL * block[0] * block[1]
    if not filled.any():
        return {"n": 0, "rms_mm": None, "correlation": None}
    measured = _block_sums(np.where(use, wear, 0.0), block)[filled] / count[filled]
    wanted = _block_sums(np.where(use, true, 0.0), block)[filled] / count[filled]
    return {
        "n": int(filled.sum()),
        "rms_mm": float(np.sqrt(np.mean((measured - wanted) ** 2))),
        "correlation": correlation(measured, wanted),
    }


def _block_sums(values: np.ndarray, block: tuple[int, int]) -> np.ndarray:
    """Sums over whole blocks and the smaller ones at the far borders."""
    rows = np.arange(0, values.shape[0], block[0])
    columns = np.arange(0, values.shape[1], block[1])
    return np.add.reduceat(np.add.reduceat(values, rows, axis=0), columns, axis=1)
