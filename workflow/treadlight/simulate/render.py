"""What the camera sees of a mounted tire under each LED: ray casting, near light, shadows."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from treadlight.compiling import kernel
from treadlight.simulate import kernels
from treadlight.simulate.rig import SimulatedRig
from treadlight.simulate.settings import NOMINAL_RADIUS_MM
from treadlight.simulate.tire import HeightField, Mounting, Tire
from treadlight.threads import by_ranges

# Inverse squares are given against this distance, so that irradiances are about 1.
REFERENCE_DISTANCE_MM = 400.0
# Dark rubber: diffuse albedo, GGX roughness, reflectance at normal incidence.
ALBEDO, ROUGHNESS, F0 = 0.05, 0.27, 0.045
CARD_ALBEDO = 0.18
# A pixel is the mean of 2x2 rays; one alone where pixels are finer than what is rendered.
_RAYS = 2
MANY_PIXELS = 4_000_000


@dataclass(frozen=True)
class Scene:
    """A mounted tire before a rig.

    Attributes
    ----------
    sim : SimulatedRig
    field : HeightField
        Of the tire at its wear, the mounting's radius change in it.
    mounting : Mounting
    tile : (n, m) float32
        The tire's lattice noise, for its colour and gloss.
    """

    sim: SimulatedRig
    field: HeightField
    mounting: Mounting
    tile: np.ndarray

    @classmethod
    def of(cls, sim: SimulatedRig, tire: Tire, field: HeightField, mounting: Mounting) -> "Scene":
        return cls(sim, field, mounting, tire.tile)

    def to_body(self, encoder_deg: float) -> tuple[np.ndarray, np.ndarray]:
        """Rotation (3, 3) and shift (3,) that take points of {C} at an encoder angle to {B}."""
        angle = np.radians(encoder_deg)
        c, s = np.cos(angle), np.sin(angle)
        unturn = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        axis = self.sim.axis
        rotation = self.mounting.rotation.T @ unturn @ axis.basis
        shift = -rotation @ axis.point - self.mounting.rotation.T @ self.mounting.shift
        return rotation, shift

    @cached_property
    def led_table(self) -> np.ndarray:
        """(n, 7): position and beam in {C}, intensity."""
        rows = [
            [*led.position, *beam, led.intensity]
            for led, beam in zip(self.sim.rig.leds, self.sim.beams, strict=True)
        ]
        return np.array(rows)


def render_leds(
    scene: Scene, encoder_deg: float, rows: tuple[int, int] | None = None
) -> np.ndarray:
    """The tire under each LED alone.

    Parameters
    ----------
    scene : Scene
    encoder_deg : float
    rows : (int, int) or None
        First image row and the one after the last; None is all of them.

    Returns
    -------
    (n_leds, rows, w) float32
        Reflected light: 1 is a Lambertian surface of albedo 1 that faces an LED of intensity
        1 at 400 mm, in its beam.
    """
    width, height = scene.sim.camera.size_px
    first, last = rows or (0, height)
    rotation, shift = scene.to_body(encoder_deg)
    leds = scene.led_table.copy()
    leds[:, :3] = leds[:, :3] @ rotation.T + shift
    leds[:, 3:6] = leds[:, 3:6] @ rotation.T
    out = np.zeros((len(leds), last - first, width), np.float32)
    field = scene.field
    by_ranges(
        _render_rows,
        last - first,
        1,
        out,
        _RAYS if width * height < MANY_PIXELS else 1,
        first,
        scene.sim.lens,
        shift,
        rotation,
        field.grid,
        field.envelope,
        field.meta,
        leds,
        scene.tile,
    )
    return out


@kernel
def material(tile, theta, z, r, envelope_r):
    """Albedo and squared roughness at a point: patchy, dull and dusty down in the grooves."""
    period = round(2 * np.pi * NOMINAL_RADIUS_MM / 4.0)
    x = theta / (2 * np.pi) * period
    patch = kernels.value_noise(tile, x, z / 4.0 + 61.3, period)
    deep = min(max((envelope_r - r - 1.0) / 4.0, 0.0), 1.0)
    albedo = ALBEDO * (1.0 + 0.15 * patch + 0.3 * deep)
    roughness = ROUGHNESS * (1.0 + 0.1 * patch + 0.4 * deep)
    return albedo, roughness * roughness


@kernel
def _render_rows(begin, end, out, rays, first, lens, o, rotation, grid, envelope, meta, leds, tile):
    weight = 1.0 / (rays * rays)
    for i in range(begin, end):
        for u in range(out.shape[2]):
            for sub in range(rays * rays):
                su = u + (sub % rays + 0.5) / rays - 0.5
                sv = first + i + (sub // rays + 0.5) / rays - 0.5
                dx, dy, dz = kernels.ray(su, sv, lens, rotation)
                t = kernels.first_hit(grid, envelope, meta, o, dx, dy, dz)
                if t < 0.0:
                    continue
                px, py, pz = o[0] + t * dx, o[1] + t * dy, o[2] + t * dz
                r = np.sqrt(px * px + py * py)
                theta = kernels.fast_atan2(py, px)
                nr, nt, nz = kernels.normal_at(grid, meta, theta, pz, r)
                nx, ny = (nr * px - nt * py) / r, (nr * py + nt * px) / r
                nv = -(nx * dx + ny * dy + nz * dz)
                if nv <= 0.0:
                    continue
                top = kernels.envelope_at(envelope, meta, pz)
                albedo, alpha2 = material(tile, theta, pz, r, top)
                for k in range(leds.shape[0]):
                    lx, ly, lz = leds[k, 0] - px, leds[k, 1] - py, leds[k, 2] - pz
                    d2 = lx * lx + ly * ly + lz * lz
                    scale = 1.0 / np.sqrt(d2)
                    lx, ly, lz = lx * scale, ly * scale, lz * scale
                    nl = nx * lx + ny * ly + nz * lz
                    beam = -(leds[k, 3] * lx + leds[k, 4] * ly + leds[k, 5] * lz)
                    if nl <= 0.0 or beam <= 0.0:
                        continue
                    if not kernels.is_lit(grid, envelope, meta, px, py, pz, lx, ly, lz):
                        continue
                    hx, hy, hz = lx - dx, ly - dy, lz - dz
                    inverse = 1.0 / np.sqrt(hx * hx + hy * hy + hz * hz)
                    nh = (nl + nv) * inverse
                    vh = (1.0 - (lx * dx + ly * dy + lz * dz)) * inverse
                    arriving = beam_irradiance(leds[k, 6], beam, d2)
                    reflected = kernels.reflect(albedo, alpha2, F0, nl, nv, nh, vh)
                    out[k, i, u] += weight * arriving * reflected


@kernel
def beam_irradiance(intensity, cosine, d2):
    """Irradiance facing an LED; `cosine` is off its beam, cos^1.25 by two square roots."""
    beam = cosine * np.sqrt(np.sqrt(cosine))
    return intensity * beam * REFERENCE_DISTANCE_MM * REFERENCE_DISTANCE_MM / d2
