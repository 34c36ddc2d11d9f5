"""How strong and how wide the LEDs' beams are, and what the lens leaves of the light.

The card shows the product of both. They can be told apart since a beam is a function of the
direction at the LED and vignetting one of the direction at the camera: an LED that stands
aside lights the plane in ovals, and each LED in others, while the lens darkens all frames in the
same circles.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import OptimizeResult, least_squares
from scipy.sparse import lil_matrix

from treadlight.calibrate.illumination import (
    PlaneSamples,
    SmoothMap,
    fit_smooth_map,
    map_step,
    require_blocks,
)
from treadlight.geometry import Camera, Led, Plane, Vignetting
from treadlight.geometry.light import map_nodes

# Vignetting less certain than this in the corner cannot be told from the beams.
_MOST_UNCERTAIN = 0.02
# LEDs are aimed at the scene, give or take 45 degrees; it only matters to beams without a shape.
_TILT = 1.0
_SMALLEST = 1e-3
_MAD_TO_STD = 1.4826


@dataclass(frozen=True)
class Beam:
    """An LED that is as bright all round its axis, less with the angle off it.

    Attributes
    ----------
    intensity : float
        On the axis, irradiance times squared distance, mm2.
    axis : (3,) float64
        Unit vector in {C}.
    power : float
        Of the cosine of the angle off the axis.
    """

    intensity: float
    axis: np.ndarray
    power: float

    def __call__(self, directions: np.ndarray) -> np.ndarray:
        """Radiant intensity (n,), mm2, in directions (n, 3) from the LED, of any length."""
        cosine = directions @ self.axis / np.linalg.norm(directions, axis=1)
        return self.intensity * np.maximum(cosine, _SMALLEST) ** self.power


@dataclass(frozen=True)
class Beams:
    """All beams, and the lens.

    Attributes
    ----------
    beams : tuple of Beam
    vignetting : Vignetting
        Takes nothing where the frames cannot tell it from the beams.
    corner_std : float
        Standard deviation of the vignetting at its reach; infinite where it cannot be told.
    """

    beams: tuple[Beam, ...]
    vignetting: Vignetting
    corner_std: float


def solve_beams(
    samples: Sequence[PlaneSamples], positions: np.ndarray, plane: Plane, camera: Camera
) -> Beams:
    """Beams and vignetting that explain the card best, in one fit.

    Fits the logarithm of the samples, ln P + m ln cos(angle off the beam's axis) + ln V with
    V = 1 + a q + b q^2, q = tan^2 of the angle off the optical axis; P, m and the axis are each
    LED's own, a and b the lens's. A soft L1 loss keeps dirt on the card out.

    Parameters
    ----------
    samples : sequence of PlaneSamples
        One per LED.
    positions : (n, 3) float
        Of the LEDs, {C}, mm.
    plane : Plane
        The card's, normal towards the camera.
    camera : Camera

    Raises
    ------
    CalibrationError
        An LED has too few samples.
    """
    for one in samples:
        require_blocks(one)
    problem = _Problem(samples, positions, plane, camera)
    lens = _solve(problem, vignetting=True)
    std = _corner_std(lens)
    if not std <= _MOST_UNCERTAIN:
        lens = _solve(problem, vignetting=False)
        return Beams(problem.beams(lens.x), Vignetting(), np.inf)
    a, b = lens.x[-2:] / problem.reach ** np.array([1, 2])
    vignetting = Vignetting(float(a), float(b), problem.reach)
    return Beams(problem.beams(lens.x), vignetting, std)


class _Problem:
    """Parameters are ln P, tilt (2) and m of each LED, then a and b in units of the reach."""

    def __init__(
        self, samples: Sequence[PlaneSamples], positions: np.ndarray, plane: Plane, camera: Camera
    ):
        self.count = len(samples)
        self.led = np.repeat(np.arange(self.count), [len(s.values) for s in samples])
        rays = camera.rays(np.concatenate([s.pixels for s in samples]))
        self.level = np.log(np.concatenate([s.values for s in samples]))
        directions = plane.intersect(rays) - positions[self.led]
        self.directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        squared = rays[:, 0] ** 2 + rays[:, 1] ** 2
        self.reach = float(squared.max())
        self.share = squared / self.reach
        self.middle = np.stack([self._mean(self.directions, k) for k in range(self.count)])
        first = np.cross(self.middle, [0.0, 1.0, 0.0])
        first /= np.linalg.norm(first, axis=1, keepdims=True)
        self.across = np.stack([first, np.cross(self.middle, first)])

    def _mean(self, vectors: np.ndarray, led: int) -> np.ndarray:
        mean = vectors[self.led == led].mean(axis=0)
        return mean / np.linalg.norm(mean)

    def start(self) -> np.ndarray:
        own = [[np.median(self.level[self.led == k]), 0.0, 0.0, 1.0] for k in range(self.count)]
        return np.concatenate([np.ravel(own), np.zeros(2)])

    def axes(self, x: np.ndarray) -> np.ndarray:
        own = x[:-2].reshape(-1, 4)
        axes = self.middle + own[:, 1:2] * self.across[0] + own[:, 2:3] * self.across[1]
        return axes / np.linalg.norm(axes, axis=1, keepdims=True)

    def misfit(self, x: np.ndarray) -> np.ndarray:
        own = x[:-2].reshape(-1, 4)
        cosine = np.sum(self.directions * self.axes(x)[self.led], axis=1)
        passed = 1 + x[-2] * self.share + x[-1] * self.share**2
        shape = own[self.led, 3] * np.log(np.maximum(cosine, _SMALLEST))
        lens = np.log(np.maximum(passed, _SMALLEST))
        return own[self.led, 0] + shape + lens - self.level

    def tilts(self, x: np.ndarray) -> np.ndarray:
        return x[:-2].reshape(-1, 4)[:, 1:3].ravel() / _TILT

    def pattern(self) -> lil_matrix:
        """Which residual depends on which parameter."""
        samples = len(self.led)
        pattern = lil_matrix((samples + 2 * self.count, 4 * self.count + 2), dtype=int)
        for k in range(4):
            pattern[np.arange(samples), 4 * self.led + k] = 1
        pattern[:samples, -2:] = 1
        for k in range(2 * self.count):
            pattern[samples + k, 4 * (k // 2) + 1 + k % 2] = 1
        return pattern

    def beams(self, x: np.ndarray) -> tuple[Beam, ...]:
        own, axes = x[:-2].reshape(-1, 4), self.axes(x)
        return tuple(
            Beam(float(np.exp(p[0])), axis, float(p[3])) for p, axis in zip(own, axes, strict=True)
        )


def _solve(problem: _Problem, vignetting: bool) -> OptimizeResult:
    x, pattern = problem.start(), problem.pattern().tocsr()
    free = np.ones(len(x), bool)
    free[-2:] = vignetting

    def whole(part: np.ndarray) -> np.ndarray:
        full = x.copy()
        full[free] = part
        return full

    found = None
    for _ in range(3):
        # The first round's spread is what the start leaves, shape of the beams and all.
        spread = max(_MAD_TO_STD * float(np.median(np.abs(problem.misfit(x)))), 1e-6)

        def residuals(part: np.ndarray, spread: float = spread) -> np.ndarray:
            full = whole(part)
            return np.concatenate([problem.misfit(full) / spread, problem.tilts(full)])

        found = least_squares(
            residuals,
            x[free],
            jac_sparsity=pattern[:, free],
            x_scale="jac",
            loss="soft_l1",
            f_scale=2.0,
        )
        x = whole(found.x)
    assert found is not None
    found.x = x
    return found


def _corner_std(found: OptimizeResult) -> float:
    """Of a + b: what the vignetting at the reach is uncertain by."""
    information = (found.jac.T @ found.jac).toarray()
    try:
        corner = np.linalg.inv(information)[-2:, -2:].sum()
    except np.linalg.LinAlgError:
        return np.inf
    return float(np.sqrt(corner)) if corner > 0 else np.inf


def fit_correction(
    samples: PlaneSamples,
    beam: Beam,
    vignetting: Vignetting,
    position: np.ndarray,
    plane: Plane,
    camera: Camera,
) -> SmoothMap:
    """What a lamp has beside its beam: samples over beam and lens, smoothed over the image."""
    rays = camera.rays(samples.pixels)
    known = beam(plane.intersect(rays) - position) * vignetting(rays)
    return fit_smooth_map(PlaneSamples(samples.pixels, samples.values / known))


def radiant_intensity_maps(
    leds: Sequence[Led],
    beams: dict[int, Beam],
    corrections: dict[int, SmoothMap],
    plane: Plane,
    camera: Camera,
) -> np.ndarray:
    """Maps (n_leds, m, n) float32 at the nodes of `map_nodes`, mm2, without the lens.

    Parameters
    ----------
    leds : sequence of Led
    beams, corrections : dict
        By LED number. An LED without gets a constant: its relative intensity in the scale of
        the others (1 where no LED has a beam: k_d and k_s then are relative).
    plane : Plane
        The reference plane.
    camera : Camera
    """
    rows, columns = map_nodes(camera.size_px, map_step(camera.size_px))
    u, v = np.meshgrid(columns, rows)
    pixels = np.column_stack([u.ravel(), v.ravel()]).astype(np.float64)
    points = plane.intersect(camera.rays(pixels))
    maps = np.empty((len(leds), len(rows), len(columns)), np.float32)
    for index, led in enumerate(leds):
        if led.number in beams:
            values = beams[led.number](points - led.position) * corrections[led.number](pixels)
            maps[index] = values.reshape(u.shape)
    known = [k for k, led in enumerate(leds) if led.number in beams]
    scale = np.mean([maps[k].mean(dtype=np.float64) / leds[k].intensity for k in known] or [1.0])
    for index, led in enumerate(leds):
        if led.number not in beams:
            maps[index] = scale * led.intensity
    return maps
