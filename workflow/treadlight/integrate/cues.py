"""What of a view tells a cut from the tread around it: misfit, tilt and darkness, cell by cell."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from treadlight.geometry import CylinderGrid
from treadlight.integrate.gather import POOR_FIT, ViewField

_MOST_TILTED = 100.0
# Steeper cells are walls of something, not tread with a deviation.
_WALL_SLOPE = 0.35
_ROUNDS = 4
_TUKEY = 3.0
# Over four of the tread's standard deviations somewhere, and over two wherever a line is drawn.
_SURELY_DARK = 4.0
_DARK = 2.0
# Beyond half of its darkest a cell lies for the greater part in a dark line: lines that are
# narrower than a pixel never get as dark as the wide ones. Within these cells around it.
_MID_SLOPE = 0.5
_REACH = 5
MAD_TO_STD = 1.4826


@dataclass(frozen=True)
class Cues:
    """Means over the views of a cell, (n, m) float32; 0 where there is none.

    Attributes
    ----------
    poor : share of the pixels that do not fit the model
    tilted : squared deviations of both slopes from the tread around, over the usual one
    dark : share of the light that is missing against the tread around, below 1
    """

    poor: np.ndarray
    tilted: np.ndarray
    dark: np.ndarray


def read_cues(fields: Sequence[ViewField], spacing: float, grid: CylinderGrid) -> Cues:
    """Cues of all views, each weighted by its blend where it sees the cell.

    Parameters
    ----------
    fields : sequence of ViewField
    spacing : float
        Distance of sections, cells along theta: the tread around is half of it wide for slopes,
        which drift, and all of it for light.
    grid : CylinderGrid
    """
    total = np.zeros((3, *grid.shape), np.float32)
    seen = np.zeros((3, *grid.shape), np.float32)
    for field in fields:
        light = field.material[0] + field.material[1]
        sloped = np.isfinite(field.slope).any(axis=0)
        values = (
            (field.flags[POOR_FIT], sloped | (field.flags > 0).any(axis=0)),
            (_tilt(field.slope, 2 * round(spacing / 4) + 1), sloped),
            (_darkness(light, 2 * round(spacing / 2) + 1), light > 0),
        )
        for k, (value, known) in enumerate(values):
            blend = field.blend[:, None] * known
            total[k][field.rows] += blend * value
            seen[k][field.rows] += blend
    total /= np.maximum(seen, np.finfo(np.float32).tiny)
    return Cues(*total)


def dark_lines(dark: np.ndarray, grid: CylinderGrid) -> np.ndarray:
    """Share (n, m) of the way from a dark line's edge to its middle: 0 outside, 1 where darkest.

    The edge is the middle of the slope of its darkness, which the blur of a camera does not move.
    """
    mode = grid.filter_mode
    known = dark[dark != 0]
    if not known.size:
        return np.zeros_like(dark)
    usual = MAD_TO_STD * float(np.median(np.abs(known - np.median(known)))) + 1e-12
    darkest = ndimage.maximum_filter(dark, _REACH, mode=mode)
    inside = (dark > _MID_SLOPE * darkest) & (dark > _DARK * usual)
    inside &= darkest > _SURELY_DARK * usual
    share = (dark / np.maximum(darkest, 1e-6) - _MID_SLOPE) / (1 - _MID_SLOPE)
    return np.where(inside, share, 0)


def _darkness(light: np.ndarray, window: int) -> np.ndarray:
    """Share of the light (k, m) that is missing against the robust mean around."""
    known = np.isfinite(light) & (light > 0)
    if not known.any():
        return np.zeros_like(light)
    level = np.log(np.where(known, light, 1))
    return np.where(known, 1 - np.exp(level - _local_mean(level, known, window)), 0)


def _tilt(slope: np.ndarray, window: int) -> np.ndarray:
    """Squared deviations of both slopes (2, k, m) from the tread around, over the usual one."""
    total = np.zeros(slope.shape[1:], np.float32)
    for component in slope:
        known = np.isfinite(component)
        # A shoulder is steep all around the tire, a cut's wall is not.
        component = component - _usual_of_columns(component)
        tread = known & (np.abs(component) < _WALL_SLOPE)
        if not tread.any():
            continue
        deviation = component - _local_mean(component, tread, window)
        usual = MAD_TO_STD * np.median(np.abs(deviation[tread])) + 1e-12
        total += np.where(known, np.minimum((deviation / usual) ** 2, _MOST_TILTED), 0)
    return total


def _usual_of_columns(values: np.ndarray) -> np.ndarray:
    """Median of each column (m,); 0 where nothing is known."""
    usual = np.zeros(values.shape[1], np.float32)
    seen = np.isfinite(values).any(axis=0)
    usual[seen] = np.nanmedian(values[:, seen], axis=0)
    return usual


def _local_mean(values: np.ndarray, tread: np.ndarray, window: int) -> np.ndarray:
    """Robust mean (Tukey's biweight) over a square window of cells (k, m)."""
    values = np.where(tread, values, 0).astype(np.float32)
    weight, mean = tread.astype(np.float32), np.zeros_like(values)
    for _ in range(_ROUNDS):
        total = ndimage.uniform_filter(weight, window, mode="nearest")
        mean = ndimage.uniform_filter(weight * values, window, mode="nearest")
        mean /= np.maximum(total, 1e-6)
        deviation = np.abs(values - mean)
        usual = MAD_TO_STD * np.median(deviation[tread]) + 1e-12
        weight = tread * np.maximum(1 - (deviation / (_TUKEY * usual)) ** 2, 0) ** 2
    return mean
