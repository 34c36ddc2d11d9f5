"""The sensor: optical blur, shot and read noise, black level, 12 bits in 16."""

import cv2
import numpy as np

from treadlight.simulate.random import stream

BLACK_LEVEL = 640
WHITE_LEVEL = 65520
_STEP = 16
_FULL_WELL_E = 15_000.0
_READ_NOISE_E = 4.0
_OFFSET_NOISE_E = 2.5
_PSF_SIGMA_PX = 0.45
_DARK_FRAMES = 32


def blur(image: np.ndarray) -> np.ndarray:
    """The lens's point spread, (h, w) float32 in and out."""
    return cv2.GaussianBlur(image, (5, 5), _PSF_SIGMA_PX, borderType=cv2.BORDER_REPLICATE)


def fixed_pattern(seed: int, size_px: tuple[int, int]) -> np.ndarray:
    """Offsets of the pixels in electrons, the same in every frame of a rig, (h, w) float32."""
    width, height = size_px
    rng = stream(seed, "fixed pattern")
    return np.float32(_OFFSET_NOISE_E) * rng.standard_normal((height, width), dtype=np.float32)


def expose(light: np.ndarray, pattern: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """One frame in stored counts.

    Parameters
    ----------
    light : (h, w) float32
        1 fills the sensor.
    pattern : (h, w) float32
        From `fixed_pattern`, electrons.
    rng : numpy.random.Generator
        The frame's own.

    Returns
    -------
    (h, w) uint16
        Multiples of 16, black at 640, saturated at 65520.
    """
    electrons = np.maximum(light, 0) * np.float32(_FULL_WELL_E)
    spread = np.sqrt(electrons + np.float32(_READ_NOISE_E**2))
    electrons = electrons + spread * rng.standard_normal(light.shape, dtype=np.float32) + pattern
    return _counts(electrons, _STEP)


def dark_frame(pattern: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The mean of 32 frames without light, rounded to single counts, (h, w) uint16."""
    spread = np.float32(_READ_NOISE_E / np.sqrt(_DARK_FRAMES))
    noise = spread * rng.standard_normal(pattern.shape, dtype=np.float32)
    return _counts(pattern + noise, 1)


def _counts(electrons: np.ndarray, step: int) -> np.ndarray:
    per_electron = (WHITE_LEVEL - BLACK_LEVEL) / _FULL_WELL_E
    counts = BLACK_LEVEL + np.float32(per_electron) * electrons
    steps = np.rint(np.clip(counts, 0, WHITE_LEVEL) / step)
    return (steps * step).astype(np.uint16)
