"""The dissertation's simulated scene: its lights, its normals, and what its images must show.

Axes: x right, y up, z towards the camera, which is far away; lights are distant. Intensities
are in units of what clips the camera.
"""

import numpy as np

from treadlight.photometric import Observations

SIDE_PX = 100
DIAMETER_PX = 80
# k_d + k_s: bright, but below what clips (k_d and k_s peak at different normals).
WHOLE = 0.95
RATIO_FIRST, RATIO_STEP, RATIOS = -2.0, 0.2, 21
COLUMNS = 4
FULL_SCALE = 65535
VIEW = np.array([0.0, 0.0, 1.0])
_GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))


def ratios() -> np.ndarray:
    """k_d / k_s of table 5.2: 10^-2, 10^-1.8 ... 10^2."""
    return 10 ** (RATIO_FIRST + RATIO_STEP * np.arange(RATIOS))


def lights(layout: str) -> np.ndarray:
    """Unit vectors (16, 3) from the surface to the lights.

    Parameters
    ----------
    layout : 'rings' or 'spread'
        The rig's rings of eight at zenith angles 15 and 35 degrees, or sixteen lights that share
        the zone from 10 to 70 degrees evenly, on a spiral.
    """
    if layout == "rings":
        zenith = np.radians(np.repeat([15.0, 35.0], 8))
        azimuth = np.tile(2 * np.pi * np.arange(8) / 8, 2)
    else:
        cosines = np.linspace(np.cos(np.radians(10)), np.cos(np.radians(70)), 16)
        zenith, azimuth = np.arccos(cosines), _GOLDEN_ANGLE * np.arange(16)
    across = np.sin(zenith)
    return np.column_stack([across * np.cos(azimuth), across * np.sin(azimuth), np.cos(zenith)])


def normals() -> tuple[np.ndarray, np.ndarray]:
    """Normals (n, 3) of the pixels whose centre shows the hemisphere, and where (h, w) these are.

    Rows run downwards, y upwards.
    """
    place = (np.arange(SIDE_PX) + 0.5 - SIDE_PX / 2) / (DIAMETER_PX / 2)
    x, y = np.meshgrid(place, -place)
    inside = x**2 + y**2 < 1
    x, y = x[inside], y[inside]
    return np.column_stack([x, y, np.sqrt(1 - x**2 - y**2)]), inside


def reflectances(ratio: float) -> tuple[float, float]:
    """k_d and k_s of a ratio."""
    return WHOLE * ratio / (1 + ratio), WHOLE / (1 + ratio)


def blinn_phong(n: np.ndarray, light: np.ndarray, ratio: float, alpha: float) -> np.ndarray:
    """Eq. 5.1: (16, n) for normals (n, 3) and lights (16, 3); 0 behind the surface."""
    return _shade(light @ n.T, ratio, np.maximum(_halfway(light) @ n.T, 0) ** alpha)


def microfacet(n: np.ndarray, light: np.ndarray, ratio: float, alpha: float) -> np.ndarray:
    """The same with a GGX lobe as wide at half its height as that of Blinn-Phong.

    D G1(l) G1(v) / (n.v) of Walter et al., "Microfacet models for refraction through rough
    surfaces" (EGSR 2007), eqs. 20, 33 and 34, without Fresnel's factor, over its value where
    n = l = v. Its tails are far longer than a power of n.h.
    """
    half2 = 2 ** (-2 / alpha)
    width2 = (1 - half2) / (np.sqrt(2) - half2)
    nl, nh, nv = light @ n.T, _halfway(light) @ n.T, n @ VIEW
    peak = (width2 / (np.maximum(nh, 0) ** 2 * (width2 - 1) + 1)) ** 2
    with np.errstate(divide="ignore", invalid="ignore"):
        gloss = np.where(nh > 0, peak * _masking(nl, width2) * _masking(nv, width2) / nv, 0)
    return _shade(nl, ratio, gloss)


def _masking(cosine: np.ndarray, width2: float) -> np.ndarray:
    cosine = np.maximum(cosine, 0)
    return 2 * cosine / (cosine + np.sqrt(width2 + (1 - width2) * cosine**2))


def _halfway(light: np.ndarray) -> np.ndarray:
    half = light + VIEW
    return half / np.linalg.norm(half, axis=1, keepdims=True)


def _shade(nl: np.ndarray, ratio: float, gloss: np.ndarray) -> np.ndarray:
    k_d, k_s = reflectances(ratio)
    return np.where(nl > 0, k_d * nl + k_s * gloss, 0.0)


def quantised(intensity: np.ndarray) -> np.ndarray:
    """What 16 bits keep of it; NaN where they are full."""
    counts = np.round(intensity * FULL_SCALE)
    return np.where(counts < FULL_SCALE, counts / FULL_SCALE, np.nan)


def tiles(picture: np.ndarray) -> np.ndarray:
    """The images (16, 100, 100), 0 to 1, in a rendered picture (400, 400, 3) uint16.

    Raises
    ------
    ValueError
        The picture has another size or depth.
    """
    rows = -(-16 // COLUMNS)
    size = (rows * SIDE_PX, COLUMNS * SIDE_PX, 3)
    if picture is None or picture.shape != size or picture.dtype != np.uint16:
        raise ValueError(f"A rendered picture must be {size} in 16 bits.")
    split = picture[..., 1].reshape(rows, SIDE_PX, COLUMNS, SIDE_PX).swapaxes(1, 2)
    return split.reshape(-1, SIDE_PX, SIDE_PX)[:16] / FULL_SCALE


def departure(seen: np.ndarray, formula: np.ndarray) -> tuple[float, float]:
    """Of intensities (16, n) that a renderer gave from those that a formula gives.

    The largest and the mean, in steps of 16 bits: rounding alone gives 0.5 and 0.
    """
    steps = (seen - formula) * FULL_SCALE
    return float(np.abs(steps).max()), float(steps.mean())


def observe(intensity: np.ndarray, light: np.ndarray) -> Observations:
    """What a method gets of pixels (16, n): no word of shadows, the noise of 16 bits."""
    count = intensity.shape[1]
    return Observations(
        intensity=intensity.astype(np.float32),
        lights=np.repeat(light[:, None], count, axis=1).astype(np.float32),
        views=np.tile(VIEW.astype(np.float32), (count, 1)),
        usable=np.isfinite(intensity),
        noise=np.full(intensity.shape, 1 / (FULL_SCALE * np.sqrt(12)), np.float32),
    )


def angles(found: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Eq. 5.29 in degrees, (n,); NaN where there is no normal."""
    chord = np.linalg.norm(found.astype(np.float64) - truth, axis=-1)
    return np.degrees(2 * np.arcsin(np.clip(chord / 2, 0, 1)))
