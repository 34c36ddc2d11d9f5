"""Unrolled maps packed for the page: 16-bit micrometres in base64."""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

_UM_PER_MM = 1000.0
_MISSING = -32768
_STOPS = 17


@dataclass(frozen=True)
class Layer:
    """The maps of one capture on the page's cells.

    Attributes
    ----------
    title : str
    height : (n, m) float
        Over the groove reference, mm; NaN = nothing measured.
    wear, wear_std : (n, m) float or None
        mm; None for the capture that wear counts from.
    theta_deg, z_mm : (float, float)
        Centre of the first cell and step.
    base_mm : (m,) float
        Radius that the heights stand on.
    whole_turn : bool
    """

    title: str
    height: np.ndarray
    wear: np.ndarray | None
    wear_std: np.ndarray | None
    theta_deg: tuple[float, float]
    z_mm: tuple[float, float]
    base_mm: np.ndarray
    whole_turn: bool


def pack(values: np.ndarray) -> str:
    """Millimetres as base64 of little-endian int16 micrometres; what does not fit is clipped."""
    counts = np.clip(np.round(values * _UM_PER_MM), _MISSING + 1, 32767)
    whole = np.where(np.isfinite(counts), counts, _MISSING).astype("<i2")
    return base64.b64encode(whole.tobytes()).decode("ascii")


def layer_data(layer: Layer) -> dict[str, Any]:
    """A layer as report.js reads it."""
    rows, columns = layer.height.shape
    return {
        "title": layer.title,
        "height": pack(layer.height),
        "wear": None if layer.wear is None else pack(layer.wear),
        "wear_std": None if layer.wear_std is None else pack(layer.wear_std),
        "theta_deg": _axis(layer.theta_deg, rows),
        "z_mm": _axis(layer.z_mm, columns),
        "base_mm": [round(float(value), 3) for value in layer.base_mm],
        "whole_turn": layer.whole_turn,
    }


def _axis(first_and_step: tuple[float, float], count: int) -> dict[str, float | int]:
    first, step = first_and_step
    return {"first": round(first, 6), "step": round(step, 9), "count": count}


def colour_scale(maps: Sequence[np.ndarray], colours: str, percentile: float) -> dict[str, Any]:
    """One colour scale for all maps: from 0 to a percentile of what is known.

    Parameters
    ----------
    maps : sequence of (n, m) float
        mm; NaN = missing.
    colours : str
        matplotlib's name of the colour map.
    percentile : float
    """
    import matplotlib

    scale = matplotlib.colormaps[colours]
    stops = np.linspace(0, 1, _STOPS)
    return {
        "low": 0.0,
        "high": round(upper_limit(maps, percentile), 4),
        "colours": [[round(float(s), 4), matplotlib.colors.to_hex(scale(s))] for s in stops],
    }


def upper_limit(maps: Sequence[np.ndarray], percentile: float) -> float:
    """This percentile of all maps together; 1 where nothing positive is known."""
    values = np.concatenate([np.zeros(0), *(m[np.isfinite(m)].ravel() for m in maps)])
    high = float(np.percentile(values, percentile)) if values.size else 0.0
    return high if high > 0 else 1.0
