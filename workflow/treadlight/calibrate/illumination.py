"""How strongly each LED lights the reference plane, from a card of known albedo.

The card's frames hold the beams and the lens; `treadlight.calibrate.beams` tells them apart, and
the maps here are what the beams' own shape leaves: lamps are not quite round.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from treadlight.errors import CalibrationError
from treadlight.geometry import Camera, Plane

# The card is taken in blocks: that many along the longer side hold any smooth beam.
_BLOCKS = 48
# Blocks darker than this share of the bright ones show no card.
_CARD_SHARE = 0.3
_MAX_DEGREE = 4
MIN_BLOCKS = 30
# Tukey's biweight: 95 % efficient on Gaussian noise.
_TUKEY = 4.685
_MAX_NODES = 1_000_000


@dataclass(frozen=True)
class CardFrame:
    """The card under one LED.

    Attributes
    ----------
    led : int
        The LED's number.
    intensity : (h, w) float32
        Linear, divided by exposure.
    saturated : (h, w) bool
    """

    led: int
    intensity: np.ndarray
    saturated: np.ndarray


@dataclass(frozen=True)
class PlaneSamples:
    """Radiant intensity of one LED at blocks of the image, on the reference plane.

    Attributes
    ----------
    pixels : (n, 2) float64
    values : (n,) float64
        E d2, mm2.
    """

    pixels: np.ndarray
    values: np.ndarray


def plane_samples(
    frame: CardFrame, position: np.ndarray, plane: Plane, camera: Camera, albedo: float
) -> PlaneSamples:
    """E d2 = I d2 / (exposure albedo cos) on the reference plane, block by block.

    Blocks that hold a saturated pixel, or are much darker than the bright ones (no card there),
    are left out.

    Parameters
    ----------
    frame : CardFrame
    position : (3,) float
        Of the LED, {C}, mm.
    plane : Plane
        The reference plane, normal towards the camera.
    camera : Camera
    albedo : float
        Of the Lambertian card.
    """
    height, width = frame.intensity.shape
    block = max(1, -(-max(height, width) // _BLOCKS))
    rows, columns = height // block, width // block
    part = frame.intensity[: rows * block, : columns * block]
    mean = cv2.resize(part, (columns, rows), interpolation=cv2.INTER_AREA).astype(np.float64)
    clipped = frame.saturated[: rows * block, : columns * block]
    blocks = clipped.reshape(rows, block, columns, block).any(axis=(1, 3))
    v, u = np.mgrid[:rows, :columns]
    pixels = (np.column_stack([u.ravel(), v.ravel()]) + 0.5) * block - 0.5
    points = plane.intersect(camera.rays(pixels))
    offset = position - points
    squared = np.sum(offset**2, axis=1)
    cosine = offset @ plane.normal / np.sqrt(squared)
    with np.errstate(divide="ignore", invalid="ignore"):
        values = mean.ravel() * squared / (albedo * cosine)
    bright = mean.ravel() > _CARD_SHARE * np.percentile(mean, 90)
    good = bright & ~blocks.ravel() & np.isfinite(values) & (cosine > 0) & (values > 0)
    return PlaneSamples(pixels[good], values[good])


def require_blocks(samples: PlaneSamples) -> None:
    """Refuse samples that are too few for a map or a beam.

    Raises
    ------
    CalibrationError
    """
    if len(samples.values) < MIN_BLOCKS:
        raise CalibrationError(
            f"card frames: only {len(samples.values)} blocks of the image show the card, unclipped"
            " and lit. Check the exposure, and that the card covers the field of view."
        )


def relative_intensities(samples: Sequence[PlaneSamples]) -> np.ndarray:
    """Intensity (n,) of each LED relative to their mean: the median over its samples."""
    medians = [float(np.median(s.values)) if len(s.values) else np.nan for s in samples]
    intensities = np.array(medians)
    if not np.isfinite(intensities).any():
        return np.ones(len(samples))
    intensities = np.where(np.isfinite(intensities), intensities, np.nanmean(intensities))
    return intensities / intensities.mean()


@dataclass(frozen=True)
class SmoothMap:
    """A polynomial in the image for the logarithm of a map.

    Attributes
    ----------
    coefficients : (n,) float64
    degree : int
    low, high : (2,) float64
        Pixels between which it was fitted; it is held constant beyond.
    residual : float
        Relative, root mean square over the blocks used.
    """

    coefficients: np.ndarray
    degree: int
    low: np.ndarray
    high: np.ndarray
    residual: float

    def __call__(self, pixels: np.ndarray) -> np.ndarray:
        """Values (n,) at pixels (n, 2)."""
        return np.exp(_terms(pixels, self.low, self.high, self.degree) @ self.coefficients)


def _terms(pixels: np.ndarray, low: np.ndarray, high: np.ndarray, degree: int) -> np.ndarray:
    """Products of Legendre polynomials up to a total degree, (n, terms)."""
    unit = 2 * (np.clip(pixels, low, high) - low) / np.maximum(high - low, 1) - 1
    along = [np.polynomial.legendre.legvander(unit[:, k], degree) for k in range(2)]
    pairs = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    return np.stack([along[0][:, i] * along[1][:, j] for i, j in pairs], axis=1)


def fit_smooth_map(samples: PlaneSamples) -> SmoothMap:
    """A smooth map through samples, robust against dirt and the card's border.

    Of polynomials up to degree `_MAX_DEGREE` the one with the least Bayesian criterion is
    taken: a beam and a lens are smoother than that, noise and texture are not theirs.

    Raises
    ------
    CalibrationError
        There are too few samples.
    """
    require_blocks(samples)
    low, high = samples.pixels.min(axis=0), samples.pixels.max(axis=0)
    level = np.log(samples.values)
    best, least = None, np.inf
    for degree in range(_MAX_DEGREE + 1):
        terms = _terms(samples.pixels, low, high, degree)
        coefficients, weights = _tukey_fit(terms, level)
        # The same bounded loss for all degrees, or each would drop what it cannot explain.
        residual = level - terms @ coefficients
        spread = np.sqrt(np.average(residual**2, weights=weights))
        criterion = 2 * len(level) * np.log(max(spread, 1e-9)) + terms.shape[1] * np.log(len(level))
        if criterion < least:
            best, least = SmoothMap(coefficients, degree, low, high, float(spread)), criterion
    assert best is not None
    return best


def _tukey_fit(terms: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    weights = np.ones(len(values))
    coefficients = np.zeros(terms.shape[1])
    for _ in range(30):
        weighted = terms.T * weights
        # Legendre products over a rectangle are nearly orthogonal: the system is well posed.
        ridge = 1e-12 * len(values) * np.eye(terms.shape[1])
        solved = np.linalg.solve(weighted @ terms + ridge, weighted @ values)
        residual = np.abs(values - terms @ solved)
        scale = max(1.4826 * float(np.median(residual)), 1e-6)
        weights = np.maximum(0, 1 - (residual / (_TUKEY * scale)) ** 2) ** 2
        done = np.allclose(solved, coefficients, rtol=0, atol=1e-7)
        coefficients = solved
        if done:
            break
    return coefficients, np.maximum(weights, 1e-12)


def map_step(size_px: tuple[int, int]) -> int:
    """Distance between a map's nodes, pixels: 1 up to a megapixel, then as needed for that."""
    return max(1, int(np.ceil(np.sqrt(size_px[0] * size_px[1] / _MAX_NODES))))
