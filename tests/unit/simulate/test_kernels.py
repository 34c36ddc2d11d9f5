"""Lens, height field, ray march and reflection against closed forms."""

import numpy as np
import pytest

from treadlight.geometry import Camera
from treadlight.simulate import kernels
from treadlight.simulate.tire import HeightField

RADIUS = 355.0


def smooth_field(step_mm: float = 0.25, groove=None) -> HeightField:
    """A cylinder about z, with one rectangular groove (z from, z to, depth) if wanted."""
    count = int(2 * np.pi * RADIUS / 2.0)
    z = np.arange(-40, 40 + step_mm / 2, step_mm)
    grid = np.full((count, len(z)), RADIUS, np.float32)
    if groove:
        grid[:, (z > groove[0]) & (z < groove[1])] -= groove[2]
    meta = np.zeros(9)
    meta[kernels.INV_STEP_THETA] = count / (2 * np.pi)
    meta[kernels.Z0] = z[0]
    meta[kernels.INV_STEP_Z] = 1 / step_mm
    meta[kernels.R_MAX] = grid.max() + 0.01
    meta[kernels.R_MIN] = grid.min() - 0.01
    meta[kernels.WRAPS] = 1
    meta[kernels.STEP_MM] = step_mm
    return HeightField(grid, np.full((2, len(z)), RADIUS), meta)


def test_fast_atan2_is_atan2(rng):
    y, x = rng.normal(size=(2, 2000))
    found = np.array([kernels.fast_atan2(b, a) for b, a in zip(y, x, strict=True)])
    assert np.abs(found - np.arctan2(y, x)).max() < 1e-7


def test_lens_is_the_camera_of_the_package(rng):
    matrix = np.array([[965.0, 0, 97.2], [0, 965.0, 141.9], [0, 0, 1]])
    camera = Camera(matrix, np.array([-0.09, 0.06, 5e-4, -4e-4, 0.0]), (192, 288))
    lens = np.array([965.0, 965.0, 97.2, 141.9, *camera.distortion])
    uv = rng.uniform([0, 0], [192, 288], (200, 2))
    found = np.array([kernels.undistorted(u, v, lens) for u, v in uv])
    assert np.abs(found - camera.rays(uv)[:, :2]).max() < 1e-9


def test_ray_meets_a_cylinder_where_the_equation_says(rng):
    field = smooth_field()
    origin = np.array([1155.0, 4.0, -3.0])
    for _ in range(50):
        target = np.array([RADIUS, *rng.uniform(-30, 30, 2)])
        d = (target - origin) / np.linalg.norm(target - origin)
        a, b = d[:2] @ d[:2], origin[:2] @ d[:2]
        expected = (-b - np.sqrt(b * b - a * (origin[:2] @ origin[:2] - RADIUS**2))) / a
        t = kernels.first_hit(field.grid, field.envelope, field.meta, origin, *d)
        assert t == pytest.approx(expected, abs=0.002)


def test_ray_beside_the_tire_meets_nothing():
    field = smooth_field()
    origin = np.array([1155.0, 0.0, 0.0])
    for target in ([0.0, 400.0, 0.0], [RADIUS, 0.0, 60.0]):
        d = (np.array(target) - origin) / np.linalg.norm(np.array(target) - origin)
        assert kernels.first_hit(field.grid, field.envelope, field.meta, origin, *d) < 0


def test_groove_wall_casts_its_shadow_as_far_as_the_light_is_low():
    """Light at 45 degrees over an 8 mm wall: 8 mm of the floor lie in shadow."""
    field = smooth_field(groove=(-10.0, 10.0, 8.0))
    low = np.array([1, 0, 1]) / np.sqrt(2)
    for z, lit in ((-9.0, True), (1.0, True), (3.0, False), (9.0, False)):
        found = kernels.is_lit(field.grid, field.envelope, field.meta, RADIUS - 8.0, 0.0, z, *low)
        assert found == lit


def test_open_surface_is_lit_from_everywhere_above(rng):
    field = smooth_field()
    for _ in range(50):
        way = rng.normal(size=3)
        way[0] = abs(way[0]) + 0.3
        way /= np.linalg.norm(way)
        args = (field.grid, field.envelope, field.meta, RADIUS, 0.0, 0.0, *way)
        assert kernels.is_lit(*args)


def directions(rng, count):
    way = rng.normal(size=(count, 3))
    way[:, 2] = np.abs(way[:, 2]) + 0.01
    return way / np.linalg.norm(way, axis=1, keepdims=True)


def reflected(light, view, albedo=0.05, roughness=0.27, f0=0.045):
    half = light + view
    half = half / np.linalg.norm(half)
    return kernels.reflect(albedo, roughness**2, f0, light[2], view[2], half[2], float(view @ half))


def test_reflection_is_reciprocal_and_positive(rng):
    """pi f cos changes with the direction that carries the cosine, f itself does not."""
    pairs = zip(directions(rng, 300), directions(rng, 300), strict=True)
    for light, view in pairs:
        there, back = reflected(light, view) / light[2], reflected(view, light) / view[2]
        assert there > 0
        assert there == pytest.approx(back, rel=1e-12)


@pytest.mark.parametrize("roughness", [0.1, 0.27, 0.6])
def test_no_more_light_leaves_than_arrives(roughness):
    """A black base under a perfect mirror's facets keeps below 1 from every direction."""
    edge = (np.arange(80) + 0.5) / 80
    cosines, around = np.meshgrid(edge, 2 * np.pi * edge)
    sines = np.sqrt(1 - cosines**2)
    ways = np.stack([sines * np.cos(around), sines * np.sin(around), cosines], axis=-1)
    for angle in (0.0, 40.0, 75.0):
        view = np.array([np.sin(np.radians(angle)), 0, np.cos(np.radians(angle))])
        values = [reflected(way, view, 0.0, roughness, 1.0) for way in ways.reshape(-1, 3)]
        total = 2 * np.mean(values)  # over the hemisphere, 2 pi times the mean, over pi
        assert 0.5 < total < 1.02


def test_value_noise_closes_after_its_period(rng):
    tile = rng.uniform(-1, 1, (64, 32)).astype(np.float32)
    for y in rng.uniform(-50, 50, 20):
        a, b = kernels.value_noise(tile, 1e-9, y, 1000), kernels.value_noise(tile, 1000.0, y, 1000)
        assert a == pytest.approx(b, abs=1e-6)
