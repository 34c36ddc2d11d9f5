"""Synthetic laser frames whose line is known, one stripe across each row, as a camera sees it.

The light of the stripe is integrated over each pixel. Speckle is not a factor on the image but
made as optics make it: the light leaves the surface with a random phase at every point, a round
aperture lets the low frequencies of its field through, rubber scatters it into two polarisations,
and the pixel adds up their intensity (Goodman, Speckle Phenomena in Optics, chs. 3 and 4). So
grains have the aperture's size, hang together from row to row, and have a contrast below 1.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import fft
from scipy.special import ndtr

ROWS, WIDTH, FRAMES = 480, 192, 24
SIGMAS_PX = (1.0, 2.0, 4.0)
SEED = 20261124
# Of a 12 bit camera.
_LEVELS = 4095
_READ_NOISE = 5e-4
# Lambda times the f-number over the pixel: f/7 and f/14 with 655 nm on 3.5 um.
_GRAIN_PX, _COARSE_GRAIN_PX = 1.3, 2.6
_POLARISATIONS = 2
# Twice per pixel is twice what the aperture lets through of any grain above 1 px.
_OVERSAMPLING = 2
_SATURATED_PEAK = 1.6


@dataclass(frozen=True)
class Scene:
    """What the frames of one row of the table show.

    Attributes
    ----------
    peak : float
        Mean light in the middle of the stripe; 1 is full scale.
    noise : float
        Standard deviation of the additive noise; a camera without any does not round either.
    grain_px : float
        Size of the speckle, lambda times the f-number over the pixel; 0 for none.
    slope : float
        Columns that the line moves per row.
    dim_share : float
        Light of the rows of every second band, as a share of the others'.
    ghost : bool
        A second line of 0.15 to 0.45 of the light, 6 to 10 sigmas beside the first.
    edges : bool
        Edges to half the albedo that lie within the stripe and run along it.
    """

    peak: float = 0.5
    noise: float = _READ_NOISE
    grain_px: float = 0.0
    slope: float = 0.0
    dim_share: float = 1.0
    ghost: bool = False
    edges: bool = False


@dataclass(frozen=True)
class Frame:
    """Intensity (ROWS, WIDTH) float32, saturated (ROWS, WIDTH) bool, true columns u (ROWS,)."""

    intensity: np.ndarray
    saturated: np.ndarray
    u: np.ndarray


_PLAIN = {
    "clean": Scene(noise=0.0),
    "noise 1 %": Scene(noise=0.005),
    "noise 5 %": Scene(noise=0.025),
}
_BOTH = {
    "saturation": Scene(peak=_SATURATED_PEAK),
    "ghost": Scene(ghost=True),
    "dim rows": Scene(dim_share=0.05),
    "slope": Scene(slope=0.25),
    "albedo edges across": Scene(dim_share=0.25),
    "albedo edges along": Scene(edges=True),
}
SCENES: dict[str, Scene] = {
    **_PLAIN,
    "speckle": Scene(grain_px=_GRAIN_PX),
    "coarse speckle": Scene(grain_px=_COARSE_GRAIN_PX),
    **_BOTH,
    **{f"{name}, speckle": replace(one, grain_px=_GRAIN_PX) for name, one in _BOTH.items()},
}


def draw_frames(scene: Scene, sigma_px: float) -> list[Frame]:
    """Frames whose lines stand at places spread evenly over the pixel; always the same ones."""
    rng = np.random.default_rng([SEED, list(SCENES.values()).index(scene), round(10 * sigma_px)])
    return [_draw(scene, sigma_px, k / FRAMES, rng) for k in range(FRAMES)]


def _draw(scene: Scene, sigma_px: float, place: float, rng: np.random.Generator) -> Frame:
    u = WIDTH // 2 + place + scene.slope * (np.arange(ROWS) - ROWS / 2)
    light = _stripe(u, sigma_px, scene.grain_px, rng)
    if scene.ghost:
        beside = u + rng.choice([-1, 1]) * rng.uniform(6, 10) * sigma_px
        light += rng.uniform(0.15, 0.45) * _stripe(beside, sigma_px, scene.grain_px, rng)
    light *= _albedo(scene, u, sigma_px, rng)
    image = scene.peak * light
    if scene.noise:
        image += scene.noise * rng.standard_normal(image.shape)
        image = np.round(_LEVELS * image) / _LEVELS
    return Frame(np.clip(image, 0, 1).astype(np.float32), image >= 1, u)


def _albedo(scene: Scene, u: np.ndarray, sigma_px: float, rng: np.random.Generator) -> np.ndarray:
    """Of every pixel, in bands of twenty rows."""
    band = np.arange(ROWS) // 20
    albedo = np.where(band % 2, scene.dim_share, 1.0)[:, None] * np.ones(WIDTH)
    if scene.edges:
        # As many on either side, so that their draw has no bias of its own.
        count = (band[-1] + 1) // 2
        offset = sigma_px * rng.uniform(-2, 2, count)
        order = rng.permutation(2 * count)
        edge = u + np.concatenate([offset, -offset])[order][band]
        side = np.repeat([1, -1], count)[order][band]
        # Of the pixel that an edge crosses a part lies beyond.
        beyond = np.clip(side[:, None] * (np.arange(WIDTH) - edge[:, None]) + 0.5, 0, 1)
        albedo *= 1 - 0.5 * beyond
    return albedo


def _stripe(
    u: np.ndarray, sigma_px: float, grain_px: float, rng: np.random.Generator
) -> np.ndarray:
    """Light of a Gaussian stripe, (ROWS, WIDTH), 1 on the mean in its middle."""
    if grain_px:
        return _speckled(u, sigma_px, grain_px, rng)
    edges = np.arange(WIDTH + 1) - 0.5
    return sigma_px * np.sqrt(2 * np.pi) * np.diff(ndtr((edges - u[:, None]) / sigma_px), axis=1)


def _speckled(
    u: np.ndarray, sigma_px: float, grain_px: float, rng: np.random.Generator
) -> np.ndarray:
    rows, columns = (
        (np.arange(_OVERSAMPLING * n) - 0.5 * (_OVERSAMPLING - 1)) / _OVERSAMPLING
        for n in (ROWS, WIDTH)
    )
    course = np.polyval(np.polyfit(np.arange(ROWS), u, 1), rows)
    # The field's amplitude is the root of the light.
    amplitude = np.exp(-0.25 * ((columns - course[:, None]) / sigma_px) ** 2)
    along, across = (fft.fftfreq(n, 1 / _OVERSAMPLING) for n in amplitude.shape)
    aperture = np.hypot(along[:, None], across) < 0.5 / grain_px
    pixel = np.sinc(along)[:, None] * np.sinc(across)
    light = np.zeros(amplitude.shape)
    for _ in range(_POLARISATIONS):
        real, imaginary = rng.standard_normal((2, *amplitude.shape))
        field = fft.ifft2(fft.fft2(amplitude * (real + 1j * imaginary)) * aperture)
        light += np.abs(field) ** 2
    light /= 2 * _POLARISATIONS * aperture.mean()
    # The pixel's centre lies half a sample beside one: the turn of phase takes it there.
    half = 0.5 * (_OVERSAMPLING - 1) / _OVERSAMPLING
    turn = np.exp(2j * np.pi * half * (along[:, None] + across))
    seen = fft.ifft2(fft.fft2(light) * pixel * turn).real
    return seen[::_OVERSAMPLING, ::_OVERSAMPLING]


def speckle_contrast(grain_px: float) -> float:
    """Standard deviation over mean of what a pixel sees of an evenly lit surface."""
    wide = np.full(ROWS, WIDTH / 2)
    seen = _speckled(wide, 1e6, grain_px, np.random.default_rng(SEED))
    return float(seen.std() / seen.mean())
