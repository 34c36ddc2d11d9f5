"""Rendered light against formulas, and the stripe against the plane that draws it."""

import numpy as np
import pytest

from treadlight import threads
from treadlight.simulate import kernels, laser, render
from treadlight.simulate.rig import make_rig
from treadlight.simulate.settings import preset
from treadlight.simulate.tire import HeightField, Mounting, height_field, make_tire

ENCODER = 25.0


@pytest.fixture(scope="module")
def sim():
    return make_rig(preset("tiny", leds=4, seed=9))


def scene_of(sim, field):
    mounting = Mounting(10.0, 0.3, (0.1, -0.1), (0.1, -0.2), 0.0, sim.hub_z_mm)
    return render.Scene(sim, field, mounting, np.zeros((8, 8), np.float32))


@pytest.fixture(scope="module")
def smooth(sim):
    """A cylinder of 355 mm without any pattern."""
    grid = np.full((4000, 449), 355.0, np.float32)
    meta = np.array([0, 4000 / (2 * np.pi), -112.0, 2.0, 0, 355.01, 354.99, 1, 0.5])
    return scene_of(sim, HeightField(grid, np.full((2, 449), 355.0), meta))


@pytest.fixture(scope="module")
def tread(sim):
    return scene_of(sim, height_field(make_tire(9, "t1"), 0.1, 0.4))


def body_points(scene, uv):
    """Where the rays of pixels meet the smooth cylinder, {B}, and the camera there."""
    rotation, shift = scene.to_body(ENCODER)
    d = scene.sim.camera.rays(uv) @ rotation.T
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    a, b = np.sum(d[:, :2] ** 2, axis=1), d[:, :2] @ shift[:2]
    t = (-b - np.sqrt(b * b - a * (shift[:2] @ shift[:2] - 355.0**2))) / a
    return shift + t[:, None] * d, shift


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def test_smooth_cylinder_shines_as_the_formula_says(sim, smooth):
    """Near light, beam, inverse square and gloss, written again with arrays."""
    images = render.render_leds(smooth, ENCODER)
    uv = np.array([[40.0, 60.0], [64.0, 96.0], [90.0, 120.0]])
    points, eye = body_points(smooth, uv)
    rotation, shift = smooth.to_body(ENCODER)
    n = unit(points * [1, 1, 0])
    view = unit(eye - points)
    for k, led in enumerate(sim.rig.leds):
        to_led = rotation @ led.position + shift - points
        distance = np.linalg.norm(to_led, axis=1)
        light, half = unit(to_led), unit(unit(to_led) + view)
        nl, nv, nh = (np.sum(n * a, axis=1) for a in (light, view, half))
        vh = np.sum(view * half, axis=1)
        a2 = render.ROUGHNESS**2
        fresnel = render.F0 + (1 - render.F0) * (1 - vh) ** 5
        density = a2 / (np.pi * (nh**2 * (a2 - 1) + 1) ** 2)
        lam = [0.5 * (np.sqrt(1 + a2 * (1 / c**2 - 1)) - 1) for c in (nl, nv)]
        gloss = density * fresnel / (1 + lam[0] + lam[1]) / (4 * nl * nv)
        cosine = -light @ (rotation @ sim.beams[k])
        arriving = led.intensity * cosine**1.25 * (400 / distance) ** 2
        expected = arriving * nl * (render.ALBEDO + np.pi * gloss)
        found = images[k, uv[:, 1].astype(int), uv[:, 0].astype(int)]
        assert found == pytest.approx(expected, rel=0.01)


def test_bands_join_to_the_whole_image(tread):
    whole = render.render_leds(tread, ENCODER)
    parts = [render.render_leds(tread, ENCODER, rows) for rows in ((0, 70), (70, 192))]
    assert np.array_equal(whole, np.concatenate(parts, axis=1))


def test_images_are_the_same_on_one_core_and_on_all(tread):
    together = render.render_leds(tread, ENCODER), laser.render_laser(tread, ENCODER)
    cores = threads.cores()
    threads.use_cores(1)
    try:
        alone = render.render_leds(tread, ENCODER), laser.render_laser(tread, ENCODER)
    finally:
        threads.use_cores(cores)
    assert np.array_equal(together[0], alone[0])
    assert np.array_equal(together[1], alone[1])


def test_some_of_the_tread_lies_in_shadow(tread):
    """Each LED leaves other pixels dark; what all light is most of the tread."""
    lit = render.render_leds(tread, ENCODER)[:, 40:150] > 0.002
    assert 0.7 < lit.all(axis=0).mean() < 0.99
    assert not np.array_equal(lit[0], lit[1])


def test_stripe_on_a_cylinder_triangulates_to_its_radius(sim, smooth):
    image = laser.render_laser(smooth, ENCODER).astype(float)[25:165]
    columns = np.arange(image.shape[1])
    u = (image * columns).sum(axis=1) / image.sum(axis=1)
    rays = sim.camera.rays(np.column_stack([u, np.arange(25, 165)]))
    points = sim.laser_plane.intersect(rays)
    rotation, shift = smooth.to_body(ENCODER)
    body = points @ rotation.T + shift
    error = np.hypot(body[:, 0], body[:, 1]) - 355.0
    assert abs(error.mean()) < 0.03
    assert error.std() < 0.03


def test_stripe_is_as_wide_as_the_sheet(sim, smooth):
    """Second moment across the stripe at the middle row, seen from the front."""
    row = laser.render_laser(smooth, ENCODER)[96].astype(float)
    columns = np.arange(len(row))
    u = (row * columns).sum() / row.sum()
    sigma = np.sqrt((row * (columns - u) ** 2).sum() / row.sum())
    thickness = sim.laser_fwhm_mm / 2.355 / np.cos(np.radians(22))
    pixel = (800.0 / sim.lens[0]) ** 2 / 12
    expected = np.sqrt(thickness**2 + pixel) * sim.lens[0] / 800.0
    assert sigma == pytest.approx(expected, rel=0.06)


def test_laser_leaves_gaps_behind_groove_walls(tread):
    """Rows between the first and the last lit one, but in the shadow of a slot's wall."""
    peaks = laser.render_laser(tread, ENCODER).max(axis=1)
    rows = np.nonzero(peaks > 0.01)[0]
    assert (peaks[rows[0] : rows[-1]] > 0.01).mean() > 0.8
    assert rows[-1] - rows[0] > 150


def test_speckle_has_mean_one_and_fades_in_wide_pixels(sim):
    wide = laser.speckle(sim, np.random.default_rng(1))
    assert wide.mean() == pytest.approx(1, abs=0.01)
    assert wide.std() == pytest.approx(0.16 / (800 / sim.lens[0]), rel=0.05)
    fine = laser.speckle(
        make_rig(preset("tiny", size_px=(512, 1600), leds=1)), np.random.default_rng(1)
    )
    assert fine.mean() == pytest.approx(1, abs=0.02)
    assert fine.std() > 0.5


@pytest.mark.parametrize("scan", ["rows", "columns"])
def test_ghosts_are_weak_and_beside_the_stripe(scan):
    stripe = np.zeros((100, 120), np.float32)
    stripe[:, 60] = 1
    image = stripe if scan == "rows" else np.ascontiguousarray(stripe.T)
    rng = np.random.default_rng(5)
    found = [laser.add_ghosts(image, scan, rng) - image for _ in range(10)]
    ghosts = np.array([g if scan == "rows" else g.T for g in found])
    assert 0.02 < ghosts.max() < 0.35
    assert np.all(ghosts[:, :, 57:64] == 0)


def test_kernels_see_the_mounting(sim, smooth):
    """The point that a pixel shows lies on the cylinder about the tire's own axis."""
    points, _ = body_points(smooth, np.array([[64.0, 96.0]]))
    field = smooth.field
    assert abs(kernels.gap(field.grid, field.meta, *points[0])) < 1e-4
