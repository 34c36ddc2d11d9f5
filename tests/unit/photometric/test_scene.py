"""Scene points on known surfaces, and shadows of known walls."""

import math

import numpy as np
import pytest

from treadlight.geometry import CylinderGrid
from treadlight.photometric.scene import SurfacePatch, cast, coarsen, cut_patch, lit

RADIUS = 100.0


def patch_of(r, step=0.25, r_std=0.0, phi_0=None, z_0=None):
    """A patch around phi = 0, z = 0 with square cells."""
    rows, columns = r.shape
    phi_0 = -(rows - 1) / 2 * step / RADIUS if phi_0 is None else phi_0
    z_0 = -(columns - 1) / 2 * step if z_0 is None else z_0
    std = np.full(r.shape, r_std, np.float32)
    return SurfacePatch(phi_0, step / RADIUS, z_0, step, r.astype(np.float32), std)


def test_rays_meet_a_cylinder_where_algebra_says(rng):
    patch = patch_of(np.full((400, 400), RADIUS))
    camera = np.array([400.0, 5.0, -10.0])
    phi, z = rng.uniform(-0.4, 0.4, 500), rng.uniform(-45, 45, 500)
    points = np.column_stack([RADIUS * np.cos(phi), RADIUS * np.sin(phi), z])
    found = cast(patch, camera, points - camera)
    np.testing.assert_allclose(found[:, 0], phi, atol=1e-6)
    np.testing.assert_allclose(found[:, 1], z, atol=1e-4)
    np.testing.assert_allclose(found[:, 2], RADIUS, atol=1e-4)


def test_rays_meet_a_wavy_surface_where_they_should(rng):
    """A point of the surface is found again, unless a wave before it hides it."""
    step = 0.1
    z = (np.arange(801) - 400) * step
    phi = (np.arange(801) - 400) * step / RADIUS
    r = RADIUS + np.sin(z[None, :] / 3) + 0.5 * np.cos(phi[:, None] * 30)
    patch = patch_of(r, step)
    i, j = rng.integers(100, 700, (2, 300))
    target = np.column_stack([r[i, j] * np.cos(phi[i]), r[i, j] * np.sin(phi[i]), z[j]])
    camera = np.array([500.0, 0, 0])
    found = cast(patch, camera, target - camera)
    np.testing.assert_allclose(found[:, 2], r[i, j], atol=2e-3)
    np.testing.assert_allclose(found[:, 1], z[j], atol=2e-3)


def test_a_ray_beside_the_surface_or_through_a_hole_finds_nothing():
    r = np.full((200, 200), RADIUS)
    r[:100] = np.nan
    patch = patch_of(r)
    camera = np.array([400.0, 0, 0])
    targets = np.array([[RADIUS, -5.0, 0], [RADIUS, 5.0, 0], [RADIUS, 0, 80.0], [0, 300.0, 0]])
    found = cast(patch, camera, targets - camera)
    assert np.isnan(found[[0, 2, 3]]).all()
    assert np.isfinite(found[1]).all()


def test_a_ray_that_meets_the_surface_from_below_a_hole_is_not_trusted():
    """It must have met something unknown before."""
    z = (np.arange(400) - 200) * 0.25
    r = np.repeat(np.where(z < 0, RADIUS - 20, RADIUS)[None], 200, axis=0)
    r[:, (z > -5) & (z < 5)] = np.nan
    camera, target = np.array([160.0, 0, -40.0]), np.array([RADIUS - 10, 0, 10.0])
    assert np.isnan(cast(patch_of(r), camera, (target - camera)[None])).all()


@pytest.mark.parametrize("zenith_deg", [20.0, 45.0, 65.0])
def test_a_wall_shadows_as_far_as_the_light_is_low(zenith_deg):
    """A 6 mm step up at z = 0: the floor is dark to 6 tan(zenith) before it, half a cell at most
    is forgiven."""
    step, height = 0.1, 6.0
    z = (np.arange(601) - 300) * step
    patch = patch_of(np.repeat(np.where(z < 0, RADIUS - height, RADIUS)[None], 41, axis=0), step)
    far = 1e5
    led = np.array([[RADIUS + far, 0, far * math.tan(math.radians(zenith_deg))]])
    reach = height * math.tan(math.radians(zenith_deg))
    at = np.arange(-25.0, -0.5, 0.05)
    points = np.column_stack([0 * at, at, np.full(at.shape, RADIUS - height)])
    seen = lit(patch, points, led)[0]
    edge = at[~seen].min()
    assert seen.any()
    forgiven = 0.5 * step * math.tan(math.radians(zenith_deg))
    assert reach - forgiven - 2 * step < -edge < reach + step
    assert not seen[at > edge].any()
    assert lit(patch, points, led * [1, 1, -1]).all()


def test_walls_along_theta_shadow_too():
    step, height = 0.1, 5.0
    arc = (np.arange(401) - 200) * step
    r = np.repeat(np.where(arc < 0, RADIUS - height, RADIUS)[:, None], 41, axis=1)
    patch = patch_of(r, step)
    points = np.column_stack([np.array([-6.0, -1.0]) / RADIUS, [0, 0], np.full(2, RADIUS - height)])
    leds = np.array([[1100.0, 1000.0, 0], [1100.0, -1000.0, 0]])
    np.testing.assert_array_equal(lit(patch, points, leds), [[True, False], [True, True]])


def test_noise_of_the_surface_casts_no_shadow(rng):
    """Lights at 60 degrees over noise of 0.15 mm on 0.3 mm cells: 99.5 % of the points are lit."""
    r = RADIUS + 0.15 * rng.standard_normal((200, 200))
    patch = patch_of(r, step=0.3, r_std=0.15)
    i, j = rng.integers(20, 180, (2, 2000))
    points = np.column_stack(
        [patch.phi_0 + i * patch.step_phi, patch.z_0 + j * patch.step_z, r[i, j]]
    )
    leds = 1000 * np.array([[0.5, math.sqrt(0.75), 0], [0.5, 0, -math.sqrt(0.75)]]) + [RADIUS, 0, 0]
    assert lit(patch, points, leds).mean() > 0.995
    sharp = patch_of(r, step=0.3)
    assert lit(sharp, points, leds).mean() < 0.95


def test_points_that_are_not_known_are_not_lit():
    patch = patch_of(np.full((20, 20), RADIUS))
    assert not lit(patch, np.full((3, 3), np.nan), np.array([[500.0, 0, 0]])).any()


@pytest.mark.parametrize("encoder", [0.0, 1.0, math.pi, -3.0])
def test_a_patch_crosses_the_seam_of_a_whole_turn(encoder):
    """Each row of the patch shows the theta = phi - encoder that it stands for."""
    grid = CylinderGrid.whole_turn((-5, 5), 1.0, RADIUS)
    r = np.repeat(RADIUS + np.cos(grid.theta)[:, None], len(grid.z), axis=1)
    patch = cut_patch(grid, r, np.full(grid.shape, np.nan), encoder, (-0.3, 0.3))
    phi = patch.phi_0 + np.arange(len(patch.r)) * patch.step_phi
    assert phi[0] < -0.3
    assert phi[-1] > 0.3
    np.testing.assert_allclose(patch.r[:, 3], RADIUS + np.cos(phi - encoder), atol=1e-4)
    assert (patch.r_std == 0).all()


def test_a_patch_of_a_sector_ends_where_it_ends():
    grid = CylinderGrid.sector((0.0, 0.5), (-5, 5), 1.0, RADIUS)
    r = np.full(grid.shape, RADIUS)
    patch = cut_patch(grid, r, r * 0, 0.0, (-0.3, 0.3))
    assert patch.phi_0 == pytest.approx(0.0)
    assert len(patch.r) < len(grid.theta)
    nothing = cut_patch(grid, r, r * 0, 2.0, (-0.3, 0.3))
    assert np.isnan(cast(nothing, np.array([400.0, 0, 0]), np.array([[-1.0, 0, 0]]))).all()


def test_a_coarse_patch_keeps_places_and_means():
    z = np.arange(90) * 0.25
    patch = patch_of(np.repeat(RADIUS + z[None], 90, axis=0), z_0=0.0)
    coarse = coarsen(patch, 0.8)
    assert coarse.r.shape == (30, 30)
    assert coarse.step_z == pytest.approx(0.75)
    at = coarse.z_0 + np.arange(30) * coarse.step_z
    np.testing.assert_allclose(coarse.r[0], RADIUS + at, atol=1e-4)
    assert coarsen(patch, 0.1) is patch
