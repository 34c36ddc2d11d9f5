"""Frames that can be read but do not show what they should: dark, blinded, moved or swapped.

Frames of one field of view differ in their light alone, and frames of one LED are lit alike in
every field of view, since camera and LEDs stand still. What breaks either rule was taken wrongly.

How far healthy frames differ is learned from the frames themselves, and each threshold says how
often it calls a healthy frame wrong.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations
from typing import TypeVar

import cv2
import numpy as np

from treadlight.images.frames import LinearFrame
from treadlight.images.outliers import low_outliers

V = TypeVar("V")

# How often a healthy frame fits another shift better, in the poorest field of view that is
# judged: the upper 0.1 % of the normal distribution.
_LEAST_LEAD_SIGMAS = 3.1
# Edges are blurred with 1 px: from 4 px on they have nothing in common with themselves.
_LOBE_PX = 4
# How often two healthy fields of view give LEDs whose light is an outlier. A view is accused
# where most others disagree with it, which takes the rate down further with every other view.
_SWAPPED_RATE = 1e-2
# The bright parts of a frame are its brightest tenth of blocks, its dim parts the dimmest.
_TENTH = 0.1
_BLOCK_PX = 16.0
# A single pixel of the bright parts is told from an unlit one with this many sigma; one block of
# them (of 256 pixels) with 16 times as many.
_LIT_SIGMAS = 3.0
# What a frame tells goes with its light squared: one under this share of the usual light tells
# less than 1/2500 of what another does, so nothing is lost where it was only dim.
_DARK_SHARE = 0.02
# Images are compared at this size of their longer side.
_COMPARED_PX = 512
# Fisher's transform of a full correlation is infinite.
_FULL = 1 - 1e-6
# Of logarithms of light: far below what any sensor tells.
_LEAST_MISFIT = 1e-12
# Cells of a light pattern along each side.
PATTERN_CELLS = 8
# Medians of larger images are taken of evenly spaced rows, about so many pixels: the median of a
# pattern's cell, a 64th of them, is then known to 1/100 of the spread within it.
_SAMPLE_PX = 1 << 20


@dataclass(frozen=True)
class Look:
    """What is kept of a frame to compare it with others.

    Attributes
    ----------
    level : float
        How light its bright parts are: upper decile of block means; 1 is full scale.
    noise : float
        Standard deviation of a pixel, from differences of neighbours; texture adds to it.
    saturated : float
        Share of saturated pixels.
    small : (h, w) float32
        The image, reduced.
    pattern : (cells, cells) float64
        `light_pattern`.
    reduction : float
        Pixels of the image per pixel of `small`.
    """

    level: float
    noise: float
    saturated: float
    small: np.ndarray
    pattern: np.ndarray
    reduction: float


def look_at(frame: LinearFrame) -> Look:
    """Reduce a frame to what comparisons need.

    Its saturated pixels become full scale, in place: a copy would take longer than all the rest.
    """
    image = np.ascontiguousarray(frame.intensity)
    np.copyto(image, np.float32(1), where=frame.saturated)
    height, width = image.shape
    reduction = max(1.0, max(height, width) / _COMPARED_PX)
    small = _reduce(image, reduction)
    level = float(np.quantile(_reduce(image, _BLOCK_PX), 1 - _TENTH))
    saturated = float(frame.saturated.mean())
    return Look(level, _noise(image), saturated, small, light_pattern(image), reduction)


def _noise(image: np.ndarray) -> float:
    """Sigma of normal noise whose differences have the median size of those of neighbours."""
    differences = np.abs(np.diff(_some_rows(image), axis=1))
    return float(np.median(differences)) / (0.6745 * np.sqrt(2)) if differences.size else 0.0


def _some_rows(image: np.ndarray) -> np.ndarray:
    """Evenly spaced rows of an image (h, w): all, or about `_SAMPLE_PX` pixels."""
    return image[:: max(1, image.size // _SAMPLE_PX)]


def _reduce(image: np.ndarray, times: float) -> np.ndarray:
    size = tuple(max(round(side / times), 1) for side in image.shape[::-1])
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA)


def doubts_of_view(looks: dict[str, Look], scan: str) -> dict[str, str]:
    """Frames of one field of view that do not show what they should: why, by file.

    Parameters
    ----------
    looks : dict of file to Look
    scan : str
        Of the laser; ``rows`` where travel runs along the image rows.
    """
    found = unlit_frames(looks)
    good = {file: look for file, look in looks.items() if file not in found}
    for file, shift in _moved(good, scan).items():
        found[file] = (
            f"{file}: shows the tread {shift:.0f} px off the other frames of its view, as if taken"
            " at another angle. Correct its pose and encoder_deg, or drop its row."
        )
    return found


def unlit_frames(looks: dict[str, Look]) -> dict[str, str]:
    """Frames of one kind, each under one LED, that are dark or saturated all over: why, by file.

    Dark is what holds no light above its own noise, or next to none of the usual light: without
    an LED the upper decile of blocks of 256 pixels lies near 1.3/16 of the noise, far below
    the bound, and lit frames lie above it unless a pixel of their bright parts means nothing.
    Saturated all over is what has no dim tenth left.
    """
    found = {}
    usual = float(np.median([look.level for look in looks.values()])) if looks else 0.0
    for file, look in looks.items():
        if look.saturated > 1 - _TENTH:
            found[file] = f"{file}: is saturated all over. Expose it less, or drop its row."
        elif look.level <= max(_LIT_SIGMAS * look.noise, _DARK_SHARE * usual):
            found[file] = f"{file}: is dark, as if its LED was not lit. Drop its row."
    return found


def _moved(looks: dict[str, Look], scan: str) -> dict[str, float]:
    """How many pixels frames are off the others of their view, by file.

    Edges across the direction of travel are correlated with those of all other frames
    (Fourier), where only shifts along it count. A frame's lead is its correlation without shift
    over that with the best other shift, both by Fisher's transform, in units of their
    difference's standard deviation: where fields have nothing in common, their correlation
    spreads as it does over all shifts (Bartlett 1946). A frame has moved where its lead is
    negative. A healthy one of usual lead falls there with the normal distribution's tail beyond
    it, so only views of enough lead are judged (`_LEAST_LEAD_SIGMAS`).
    """
    if len(looks) < 3:
        return {}
    edges = {k: _edges(v.small if scan == "rows" else v.small.T) for k, v in looks.items()}
    spectra = {file: np.fft.rfft2(edge) for file, edge in edges.items()}
    whole = np.sum(list(spectra.values()), axis=0)
    leads, shifts = {}, {}
    for file, spectrum in spectra.items():
        shape = edges[file].shape
        others = whole - spectrum
        size = edges[file].size * np.std(edges[file]) * np.std(np.fft.irfft2(others, shape))
        if size <= 0 or shape[1] <= 2 * _LOBE_PX:
            continue
        match = np.fft.irfft2(others * np.conj(spectrum), shape) / size
        leads[file], shifts[file] = _lead(match)
    if not leads or np.median(list(leads.values())) < _LEAST_LEAD_SIGMAS:
        return {}
    return {file: shifts[file] * looks[file].reduction for file in leads if leads[file] < 0}


def _lead(match: np.ndarray) -> tuple[float, int]:
    """The lead (see `_moved`) of no shift in a map of correlations, and the best other shift."""
    along = np.arctanh(np.clip(np.max(match[[0, 1, -1]], axis=0), -_FULL, _FULL))
    best = _LOBE_PX + int(np.argmax(along[_LOBE_PX : 1 - _LOBE_PX]))
    lead = (along[0] - along[best]) / (np.sqrt(2) * np.std(match))
    return float(lead), min(best, len(along) - best)


def _edges(small: np.ndarray) -> np.ndarray:
    """Strength of edges across the image rows, without what a row shares."""
    light = np.log(np.maximum(np.ascontiguousarray(small), 1e-3))
    relief = cv2.GaussianBlur(light, (0, 0), 1) - cv2.GaussianBlur(light, (0, 0), 6)
    steep = np.abs(np.gradient(relief, axis=1)) if min(relief.shape) > 1 else relief
    return steep - steep.mean(axis=1, keepdims=True)


def light_pattern(frame: np.ndarray) -> np.ndarray:
    """How the light is spread over an image: log of block medians, (cells, cells) float64."""
    known = np.nan_to_num(np.asarray(_some_rows(frame), np.float32), nan=1.0)
    rows = np.array_split(known, PATTERN_CELLS, axis=0)
    medians = [[np.median(c) for c in np.array_split(row, PATTERN_CELLS, axis=1)] for row in rows]
    return np.log(np.maximum(medians, 1e-4))


def pattern_centres(size_px: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Pixel coordinates (u, v) of the middles of a light pattern's columns and rows."""
    width, height = size_px
    steps = np.arange(PATTERN_CELLS) + 0.5
    return steps * width / PATTERN_CELLS - 0.5, steps * height / PATTERN_CELLS - 0.5


def swapped_leds(
    patterns: dict[int, np.ndarray], others: dict[int, np.ndarray]
) -> list[tuple[int, int]]:
    """Pairs of LEDs whose light in one field of view is the other's in another.

    For every LED the best partner is sought: the one with which an exchange changes the misfit of
    the two patterns to the largest part, in logarithm. Healthy LEDs give values about or above
    zero with one spread, that of what the surface adds. Two are exchanged where both are outliers
    (`_SWAPPED_RATE`), each is the other's best partner, and the exchange fits better.

    Parameters
    ----------
    patterns, others : dict of int to (cells, cells) float64
        `light_pattern` by LED number, of the two fields of view.
    """
    leds = sorted(patterns.keys() & others.keys())
    if len(leds) < 3:
        return []
    one, two = (np.stack(_light_alone(light, leds)) for light in (patterns, others))
    misfit = np.mean((one[:, None] - two[None]) ** 2, axis=(2, 3)) + _LEAST_MISFIT
    own = np.diag(misfit)
    exchange = np.log((misfit + misfit.T) / (own[:, None] + own[None]))
    np.fill_diagonal(exchange, np.inf)
    odd = sorted(low_outliers(exchange.min(axis=1).tolist(), _SWAPPED_RATE))
    return [
        (leds[a], leds[b])
        for a, b in combinations(odd, 2)
        if exchange[a].argmin() == b and exchange[b].argmin() == a and exchange[a, b] < 0
    ]


def _light_alone(patterns: dict[int, np.ndarray], leds: list[int]) -> list[np.ndarray]:
    """Without what the surface adds under every LED, and without each LED's intensity."""
    surface = np.mean([patterns[led] for led in leds], axis=0)
    bare = [patterns[led] - surface for led in leds]
    return [pattern - pattern.mean() for pattern in bare]


def views_with_swapped_leds(
    patterns: dict[V, dict[int, np.ndarray]], misfit: Callable[[V], float]
) -> dict[V, tuple[int, ...]]:
    """Fields of view in which LEDs are exchanged, as most others show; with the LEDs' numbers.

    Parameters
    ----------
    patterns : dict of view to (LED number to `light_pattern`)
    misfit : function of a view
        How badly its images are explained; asked of two that disagree: the worse is wrong.
    """
    against: dict[V, list[tuple[int, int]]] = {view: [] for view in patterns}
    votes = dict.fromkeys(patterns, 0)
    for one, two in combinations(patterns, 2):
        pairs = swapped_leds(patterns[one], patterns[two])
        for view in (one, two) if pairs else ():
            against[view] += pairs
            votes[view] += 1
    others = len(patterns) - 1
    accused = [view for view in patterns if 2 * votes[view] > others]
    if others == 1 and accused:
        accused = [max(accused, key=misfit)]
    return {
        view: tuple(sorted({led for pair in against[view] for led in pair})) for view in accused
    }
