"""The error budget: what a capture's profile would be, were a source of its errors none."""

from typing import Any

import numpy as np

from treadlight.evaluate.metrics import NORMAL_BLUR_CELLS, evaluate_profile
from treadlight.evaluate.surface import (
    classify,
    interpolate_at,
    outer_envelope,
    true_normals,
)
from treadlight.evaluate.truth import Profile

# In the order of the table; the key is what `treadlight budget --json` calls it.
SOURCES = {
    "measured": "as measured",
    "calibration": "true calibration",
    "laser": "true laser points",
    "photometry": "true normals",
    "both": "true laser points and normals",
}

Figures = dict[str, Any]


def true_points(truth: Profile, r: np.ndarray, theta: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Radii of laser points without their error, mm; outside the truth as they are.

    Parameters
    ----------
    r, theta, z : (...) float
        mm, rad, mm; NaN where there is no point.
    """
    true = interpolate_at(truth, truth.r, theta, z)
    return np.where(np.isfinite(r) & np.isfinite(true), true, r)


def smooth_normals(truth: Profile, cell_mm: float) -> np.ndarray:
    """True normals (n, m, 3) of block tops and groove floors on the truth's cells, else NaN.

    Beside walls a pixel sees both, and its mean is nobody's truth.

    Parameters
    ----------
    truth : Profile
    cell_mm : float
        The cell of the result, which is about a pixel.
    """
    classes = classify(truth, outer_envelope(truth))
    normals = true_normals(truth, NORMAL_BLUR_CELLS * cell_mm)
    return np.where((classes["top"] | classes["floor"])[..., None], normals, np.nan)


def without_error(
    truth: Profile, smooth: np.ndarray, normal: np.ndarray, theta: np.ndarray, z: np.ndarray
) -> np.ndarray:
    """A view's normals, (v, u, 3) float32, on block tops and groove floors without their error.

    Parameters
    ----------
    truth : Profile
    smooth : (n, m, 3) float
        See `smooth_normals`.
    normal : (v, u, 3) float
        Measured, NaN where there is none.
    theta, z : (v, u) float
        Scene points, rad and mm.
    """
    true = np.stack([interpolate_at(truth, smooth[..., k], theta, z) for k in range(3)], axis=-1)
    true /= np.linalg.norm(true, axis=-1, keepdims=True)
    known = np.isfinite(normal).all(axis=-1) & np.isfinite(true).all(axis=-1)
    return np.where(known[..., None], true, normal).astype(np.float32)


def budget_row(
    truth: Profile, theta: np.ndarray, z: np.ndarray, r: np.ndarray, seen: np.ndarray
) -> Figures:
    """Shape errors on tops and floors, of all rows and of those that a view sees; edges found.

    Parameters
    ----------
    truth : Profile
    theta, z : (n,) rad and (m,) mm float
    r : (n, m) float
        mm.
    seen : (n,) bool
        Rows that a view sees: what the others lack is the sampling's share.

    Returns
    -------
    dict
        ``all`` and ``seen``, each with ``top`` and ``floor`` (`error_figures`); ``edges``.
    """
    whole = evaluate_profile(truth, theta, z, r)
    part = evaluate_profile(truth, theta, z, np.where(seen[:, None], r, np.nan))
    classes = ("top", "floor")
    return {
        "all": {name: whole["shape"][name] for name in classes},
        "seen": {name: part["shape"][name] for name in classes},
        "edges": whole["edges"]["found"],
    }
