"""Frames that can be read but do not show what they should: dark, blinded, moved or swapped.

Frames of one field of view differ in their light alone, and frames of one LED are lit alike in
every field of view, since camera and LEDs stand still. What breaks either rule was taken wrongly.
"""

from dataclasses import dataclass
from itertools import combinations
from typing import TypeVar

import cv2
import numpy as np

from treadlight.images.frames import LinearFrame

V = TypeVar("V")

# Below this share of full scale, or of the usual frame of its view, nothing was lit.
_DARK_LEVEL = 0.002
_DARK_SHARE = 0.02
_SATURATED_SHARE = 0.9
# Images are compared at this size of their longer side.
_COMPARED_PX = 512
_LEAST_SHIFT_PX = 2.5
# Correlation without the shift, as a share of that with it: smooth images leave more.
_LEFT_SHARE = 0.7
# Cells of a light pattern along each side, and how much better an exchange must explain two
# LEDs' patterns: one of neighbouring LEDs halves the squares at least.
PATTERN_CELLS = 8
_SWAP_SHARE = 0.5


@dataclass(frozen=True)
class Look:
    """What is kept of a frame to compare it with others.

    Attributes
    ----------
    level : float
        How light its bright parts are: upper decile of block means; 1 is full scale.
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
    saturated: float
    small: np.ndarray
    pattern: np.ndarray
    reduction: float


def look_at(frame: LinearFrame) -> Look:
    """Reduce a frame to what comparisons need."""
    image = np.ascontiguousarray(np.where(frame.saturated, 1.0, frame.intensity), np.float32)
    height, width = image.shape
    reduction = max(1.0, max(height, width) / _COMPARED_PX)
    small = _reduce(image, reduction)
    level = float(np.quantile(_reduce(image, 16.0), 0.9))
    return Look(level, float(frame.saturated.mean()), small, light_pattern(image), reduction)


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
    """Frames of one kind, each under one LED, that are dark or saturated all over: why, by file."""
    found = {}
    usual = float(np.median([look.level for look in looks.values()])) if looks else 0.0
    for file, look in looks.items():
        if look.saturated > _SATURATED_SHARE:
            found[file] = f"{file}: is saturated all over. Expose it less, or drop its row."
        elif look.level < max(_DARK_LEVEL, _DARK_SHARE * usual):
            found[file] = f"{file}: is dark, as if its LED was not lit. Drop its row."
    return found


def _moved(looks: dict[str, Look], scan: str) -> dict[str, float]:
    """How many pixels frames are off the others of their view, by file.

    Edges across the direction of travel are correlated with those of all other frames
    (Fourier), where only shifts along it count.
    """
    if len(looks) < 3:
        return {}
    edges = {k: _edges(v.small if scan == "rows" else v.small.T) for k, v in looks.items()}
    spectra = {file: np.fft.rfft2(edge) for file, edge in edges.items()}
    whole = np.sum(list(spectra.values()), axis=0)
    found = {}
    for file, spectrum in spectra.items():
        shape = edges[file].shape
        others = whole - spectrum
        size = edges[file].size * np.std(edges[file]) * np.std(np.fft.irfft2(others, shape))
        if size <= 0:
            continue
        match = np.fft.irfft2(others * np.conj(spectrum), shape) / size
        along = np.max(match[[0, 1, -1]], axis=0)
        best = int(np.argmax(along))
        shift = min(best, len(along) - best)
        if shift > _LEAST_SHIFT_PX and along[0] < _LEFT_SHARE * along[best]:
            found[file] = shift * looks[file].reduction
    # Where many seem to have moved, the view is too poor in edges to tell.
    return found if len(found) <= max(1, len(looks) // 4) else {}


def _edges(small: np.ndarray) -> np.ndarray:
    """Strength of edges across the image rows, without what a row shares."""
    light = np.log(np.maximum(np.ascontiguousarray(small), 1e-3))
    relief = cv2.GaussianBlur(light, (0, 0), 1) - cv2.GaussianBlur(light, (0, 0), 6)
    steep = np.abs(np.gradient(relief, axis=1)) if min(relief.shape) > 1 else relief
    return steep - steep.mean(axis=1, keepdims=True)


def light_pattern(frame: np.ndarray) -> np.ndarray:
    """How the light is spread over an image: log of block medians, (cells, cells) float64."""
    known = np.nan_to_num(np.asarray(frame, np.float32), nan=1.0)
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

    Parameters
    ----------
    patterns, others : dict of int to (cells, cells) float64
        `light_pattern` by LED number, of the two fields of view.
    """
    leds = sorted(patterns.keys() & others.keys())
    if len(leds) < 3:
        return []
    one, two = _light_alone(patterns, leds), _light_alone(others, leds)

    def misfit(a: int, b: int) -> float:
        return float(np.mean((one[a] - two[b]) ** 2))

    return [
        (a, b)
        for a, b in combinations(leds, 2)
        if misfit(a, b) + misfit(b, a) < _SWAP_SHARE * (misfit(a, a) + misfit(b, b))
    ]


def _light_alone(patterns: dict[int, np.ndarray], leds: list[int]) -> dict[int, np.ndarray]:
    """Without what the surface adds under every LED, and without each LED's intensity."""
    surface = np.mean([patterns[led] for led in leds], axis=0)
    bare = {led: patterns[led] - surface for led in leds}
    return {led: pattern - pattern.mean() for led, pattern in bare.items()}


def views_with_swapped_leds(
    patterns: dict[V, dict[int, np.ndarray]], misfit: dict[V, float]
) -> dict[V, tuple[int, ...]]:
    """Fields of view in which LEDs are exchanged, as most others show; with the LEDs' numbers.

    Parameters
    ----------
    patterns : dict of view to (LED number to `light_pattern`)
    misfit : dict of view to float
        How badly each view's images are explained; of two that disagree, the worse is wrong.
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
        accused = [max(accused, key=lambda view: misfit[view])]
    return {
        view: tuple(sorted({led for pair in against[view] for led in pair})) for view in accused
    }
