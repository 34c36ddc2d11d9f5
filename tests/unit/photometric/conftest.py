"""Analytic scenes: lights in two rings, Blinn-Phong pixels, a view of a smooth cylinder."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from treadlight.geometry import Axis, Camera, CylinderGrid, Led, Plane
from treadlight.photometric import Observations


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def two_rings(zeniths_deg=(15, 35), each=8):
    """Unit vectors (n, 3) to lights around x, the outward direction."""
    zenith = np.radians(np.repeat(zeniths_deg, each))
    azimuth = np.tile(2 * np.pi * np.arange(each) / each, len(zeniths_deg))
    return np.stack(
        [np.cos(zenith), np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth)], -1
    )


def blinn_phong(normals, lights, k_d, k_s, alpha):
    """Eq. 5.1 seen along x: (n_leds, n)."""
    halves = unit(lights + np.array([1.0, 0, 0]))
    diffuse = np.maximum(lights @ normals.T, 0)
    gloss = np.maximum(halves @ normals.T, 0) ** alpha
    return np.where(diffuse > 0, k_d * diffuse + k_s * gloss, 0)


def observe(intensity, lights, usable=None, noise=1e-6):
    """Observations along x of pixels under distant lights."""
    shape = intensity.shape
    return Observations(
        intensity=intensity.astype(np.float32),
        lights=np.repeat(lights[:, None], shape[1], axis=1).astype(np.float32),
        views=np.tile(np.float32([1, 0, 0]), (shape[1], 1)),
        usable=np.ones(shape, bool) if usable is None else usable,
        noise=np.full(shape, noise, np.float32),
    )


def tilted(rng, n, largest_rad=0.2):
    tilt = rng.uniform(-largest_rad, largest_rad, (n, 2))
    return np.column_stack([np.sqrt(1 - np.sum(tilt**2, axis=1)), tilt])


def degrees_between(a, b):
    return np.degrees(2 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=-1) / 2, 0, 1)))


@pytest.fixture(scope="session")
def analytic():
    """The functions above."""
    return SimpleNamespace(
        two_rings=two_rings,
        blinn_phong=blinn_phong,
        observe=observe,
        tilted=tilted,
        degrees_between=degrees_between,
        render=render,
    )


@dataclass(frozen=True)
class Bench:
    """A small rig before a smooth cylinder of 100 mm radius."""

    camera: Camera
    axis: Axis
    leds: tuple
    plane: Plane
    grid: CylinderGrid
    r: np.ndarray

    def irradiance(self, k, points):
        """Point sources without a beam shape: 40000 mm2 over the squared distance."""
        away = np.sum((points - self.leds[k].position) ** 2, axis=-1)
        return self.leds[k].intensity * 4e4 / away


@pytest.fixture(scope="session")
def bench():
    size = (64, 48)
    camera = Camera(np.array([[300.0, 0, 31.5], [0, 300.0, 23.5], [0, 0, 1]]), np.zeros(5), size)
    axis = Axis.through(np.array([0.02, 1.0, -0.01]), np.array([3.0, 0, 320.0]))
    towards = two_rings()
    leds = tuple(
        Led(k, np.array([200 * t[1], 200 * t[2], 220 - 200 * t[0]]), 1 + 0.02 * k)
        for k, t in enumerate(towards)
    )
    grid = CylinderGrid.whole_turn((-40, 40), 0.5, 100.0)
    return Bench(
        camera, axis, leds, Plane(np.array([0, 0, -1.0]), 220.0), grid, np.full(grid.shape, 100.0)
    )


def render(bench, encoder, k_d=0.02, k_s=0.4, alpha=20.0):
    """Blinn-Phong images (n_leds, h, w) of the bench's cylinder; NaN beside it."""
    rays = bench.camera.pixel_rays()
    to_axis = rays - (rays @ bench.axis.direction)[..., None] * bench.axis.direction
    foot = bench.axis.point - bench.axis.direction * (bench.axis.point @ bench.axis.direction)
    a, b = np.sum(to_axis**2, -1), to_axis @ foot
    with np.errstate(invalid="ignore"):
        depth = (b - np.sqrt(b * b - a * (foot @ foot - 100.0**2))) / a
    points = depth[..., None] * rays
    theta, _, _ = bench.axis.to_tire(points, encoder)
    outward = np.zeros((*theta.shape, 3))
    outward[..., 0] = 1
    normal = bench.axis.vectors_to_camera(outward, theta, encoder)
    images = []
    for k, led in enumerate(bench.leds):
        light = unit(led.position - points)
        half = unit(light - unit(points))
        facing = np.sum(normal * light, -1)
        gloss = np.maximum(np.sum(normal * half, -1), 0) ** alpha
        images.append(bench.irradiance(k, points) * (k_d * facing + k_s * gloss))
    return np.array(images, np.float32), points
