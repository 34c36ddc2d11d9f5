"""Scene points on known surfaces, and shadows of known walls."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy import ndimage

from treadlight.geometry import CylinderGrid
from treadlight.photometric.scene import (
    SurfacePatch,
    block_tops,
    cast,
    coarsen,
    cut_patch,
    lit,
)

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


def blocky(seed, hole, size=150, step=0.25):
    """A patch of blocks and noise, with a hole."""
    rng = np.random.default_rng(seed)
    blocks = rng.uniform(-8, 0, (size // 10, size // 10)) * (rng.random((size // 10, 1)) < 0.5)
    blocks[size // 20] = rng.uniform(-8, 0, size // 10)
    r = RADIUS + np.kron(blocks, np.ones((10, 10))) + 0.05 * rng.standard_normal((size, size))
    r[hole : hole + 12, hole : hole + 7] = np.nan
    return patch_of(r, step, r_std=0.05), rng


def height_at(patch, field, phi, z):
    """Bilinear, NaN beside what is unknown."""
    row, column = (phi - patch.phi_0) / patch.step_phi, (z - patch.z_0) / patch.step_z
    inside = (row >= 0) & (column >= 0) & (row < len(field) - 1) & (column < field.shape[1] - 1)
    i, j = (np.where(inside, k, 0).astype(int) for k in (row, column))
    a, b = row - i, column - j
    top = field[i, j] + b * (field[i, j + 1] - field[i, j])
    bottom = field[i + 1, j] + b * (field[i + 1, j + 1] - field[i + 1, j])
    return np.where(inside, top + a * (bottom - top), np.nan)


def walk(patch, camera, ray):
    """Distances (in ray lengths) before and at the first step at or below the surface.

    Half a cell at a time from the largest radius on; None if there is none, or if it is not known
    what was before it.
    """
    a, b = ray[:2] @ ray[:2], ray[:2] @ camera[:2]
    roots = [
        np.sqrt(max(b * b - a * (camera[:2] @ camera[:2] - radius**2), 0))
        for radius in (patch.r_max, patch.r_min)
    ]
    enter, end = ((-b - root) / a for root in roots)
    entry = camera + enter * ray
    phi = math.atan2(entry[1], entry[0])
    outward, along = np.array([np.cos(phi), np.sin(phi)]), np.array([-np.sin(phi), np.cos(phi)])
    tangential = ray[:2] @ along
    steps = 4 + int(2 * (end - enter) * math.hypot(tangential, ray[2]) / patch.step_mm)
    t = enter + (end - enter) * np.arange(steps + 1) / steps
    at = camera + t[:, None] * ray
    turned = phi + np.arctan2(at[:, :2] @ along, at[:, :2] @ outward)
    gap = np.hypot(at[:, 0], at[:, 1]) - height_at(patch, patch.r, turned, at[:, 2])
    below = np.flatnonzero(gap <= 0)
    if not len(below) or (below[0] and np.isnan(gap[below[0] - 1])):
        return None
    return t[max(below[0] - 1, 0)], t[below[0]]


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), hole=st.integers(0, 138))
def test_a_ray_finds_what_a_plain_walk_finds(seed, hole):
    """Over grooves, holes and borders it leaves out no step that meets something."""
    patch, rng = blocky(seed, hole)
    camera = np.array([300.0, *rng.uniform(-120, 120, 2)])
    phi, z = rng.uniform(-0.25, 0.25, 200), rng.uniform(-25, 25, 200)
    rays = np.column_stack([95 * np.cos(phi), 95 * np.sin(phi), z]) - camera
    hits = 0
    for ray, hit in zip(rays, cast(patch, camera, rays), strict=True):
        steps = walk(patch, camera, ray)
        assert np.isnan(hit).all() == (steps is None)
        if steps is not None:
            place = np.array([hit[2] * np.cos(hit[0]), hit[2] * np.sin(hit[0]), hit[1]])
            t = (place - camera) @ ray / (ray @ ray)
            assert steps[0] - 1e-9 <= t <= steps[1] + 1e-9
            np.testing.assert_allclose(camera + t * ray, place, atol=1e-6)
            hits += 1
    assert hits > 20


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10_000), hole=st.integers(0, 138), pitch=st.floats(0.02, 0.5))
def test_rays_find_alone_what_they_find_among_their_neighbours(seed, hole, pitch):
    """What the rays of a square start from together leaves out no hit: bit for bit."""
    patch, rng = blocky(seed, hole)
    width = int(rng.integers(3, 60))
    v, u = np.mgrid[:41, :width]
    middle = rng.uniform(-10, 10, 2)
    phi, z = (middle[0] + v * pitch) / RADIUS, middle[1] + u * pitch
    camera = np.array([300.0, *rng.uniform(-120, 120, 2)])
    target = np.stack([95 * np.cos(phi), 95 * np.sin(phi), z], axis=-1).reshape(-1, 3)
    rays = (target - camera)[: rng.integers(width, target.size // 3)]
    together = cast(patch, camera, rays, width)
    alone = np.concatenate([cast(patch, camera, ray[None]) for ray in rays])
    np.testing.assert_array_equal(together, alone)
    assert np.isfinite(together).any()


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10_000), hole=st.integers(0, 138))
def test_points_are_lit_alone_as_they_are_among_their_neighbours(seed, hole):
    """What is found out for a tile of pixels together holds of each: bit for bit."""
    patch, rng = blocky(seed, hole)
    width = int(rng.integers(20, 90))
    v, u = np.mgrid[:40, :width]
    phi = (v - 20) * 0.4 / RADIUS + 0.001 * rng.standard_normal(v.shape)
    z = (u - width / 2) * 0.3
    r = height_at(patch, patch.r, phi, z)
    points = np.stack([phi, z, r], axis=-1).reshape(-1, 3)
    leds = rng.uniform([150, -300, -300], [500, 300, 300], (6, 3))
    # Light so low that the blocks throw shadows, whatever the others do.
    leds[0] = [RADIUS + 20, 0, 300]
    together = lit(patch, points, leds, width)
    alone = np.stack([lit(patch, point[None], leds)[:, 0] for point in points], axis=1)
    np.testing.assert_array_equal(together, alone)
    assert together.any()
    assert not together[0].all()


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


@pytest.mark.parametrize("shape", [(64, 96), (41, 75), (50, 3), (1, 150)])
@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_pixels_finer_than_the_surface_are_lit_as_they_are_alone_but_for_edges_of_shadows(
    shape, seed
):
    """Squares of pixels about as wide as a cell are judged by their corners."""
    patch, rng = blocky(seed, 70)
    v, u = np.mgrid[: shape[0], : shape[1]]
    phi, z = (v - shape[0] / 2) * 0.1 / RADIUS, (u - shape[1] / 2) * 0.1
    points = np.stack([phi, z, height_at(patch, patch.r, phi, z)], axis=-1).reshape(-1, 3)
    leds = rng.uniform([150, -300, -300], [500, 300, 300], (6, 3))
    leds[0] = [RADIUS + 20, 0, 300]
    together = lit(patch, points, leds, shape[1]).reshape(6, *shape)
    alone = np.stack([lit(patch, point[None], leds)[:, 0] for point in points], axis=1)
    alone = alone.reshape(together.shape)
    # An LED that all or nobody sees tells nothing.
    assume(0 < alone[0].mean() < 1)
    near_edge = ndimage.maximum_filter(alone, (1, 9, 9)) != ndimage.minimum_filter(alone, (1, 9, 9))
    np.testing.assert_array_equal(together[~near_edge], alone[~near_edge])
    assert (together != alone).mean() < 0.02


def test_an_image_that_ends_within_a_row_is_lit_as_far_as_it_goes(rng):
    patch, _ = blocky(3, 70)
    v, u = np.mgrid[:24, :40]
    phi, z = (v - 12) * 0.1 / RADIUS, (u - 20) * 0.1
    points = np.stack([phi, z, height_at(patch, patch.r, phi, z)], axis=-1).reshape(-1, 3)
    leds = rng.uniform([150, -300, -300], [500, 300, 300], (6, 3))
    whole, part = (lit(patch, points[:count], leds, 40) for count in (960, 930))
    # Squares of the last rows are judged by other corners.
    np.testing.assert_array_equal(part[:, : 20 * 40], whole[:, : 20 * 40])
    assert part.any()


def test_scattered_points_do_not_speak_for_those_between_them():
    """Every fourth one lies high up, the others behind a rib."""
    step = 0.25
    z = (np.arange(241) - 120) * step
    patch = patch_of(np.repeat(np.where(abs(z) < 1, RADIUS, RADIUS - 6)[None], 81, axis=0), step)
    at = np.where(np.arange(33) % 4 == 0, 0.0, -1.5)
    points = np.column_stack([0 * at, at, np.where(at == 0, RADIUS, RADIUS - 6)])
    seen = lit(patch, points, np.array([[RADIUS + 100.0, 0, 200.0]]))[0]
    np.testing.assert_array_equal(seen, at == 0)


def test_what_is_highest_is_lit_whatever_its_neighbours_are():
    """A tile of pixels on both sides of a wall: those on top leave the surface where they are."""
    step = 0.1
    z = (np.arange(601) - 300) * step
    patch = patch_of(np.repeat(np.where(z < 0, RADIUS - 6, RADIUS)[None], 41, axis=0), step)
    at = np.linspace(-1, 1.2, 32)
    points = np.column_stack([0 * at, at, np.where(at < 0, RADIUS - 6, RADIUS)])
    seen = lit(patch, points, np.array([[RADIUS + 200.0, 0, 200]]))[0]
    np.testing.assert_array_equal(seen, at > 0)


@pytest.mark.parametrize("side", [-1, 1])
def test_a_ridge_with_nothing_higher_behind_it_shadows_a_whole_tile(side):
    """What is highest ahead of a tile begins at the tile, not behind the ridge."""
    step = 0.1
    z = (np.arange(601) - 300) * step
    ridge = (side * z > 2) & (side * z < 3)
    patch = patch_of(np.repeat(np.where(ridge, RADIUS, RADIUS - 6)[None], 81, axis=0), step)
    v, at = (x.ravel() for x in np.meshgrid(0.05 * np.arange(32), np.linspace(-0.8, 0.8, 32)))
    points = np.column_stack([v / RADIUS, at, np.full(at.shape, RADIUS - 6)])
    led = np.array([[RADIUS + 20, 0.0, side * 200]])
    assert not lit(patch, points, led, 32).any()
    assert lit(patch, points, led * [1, 1, -1], 32).all()


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


def test_cells_of_a_coarse_patch_are_means_of_whole_cells_and_unknown_where_one_is(rng):
    r = RADIUS + rng.random((131, 92), dtype=np.float32)
    r[40, 50] = np.nan
    coarse = coarsen(patch_of(r), 0.8)
    means = r[:129, :90].reshape(43, 3, 30, 3).astype(float).mean(axis=(1, 3))
    np.testing.assert_allclose(coarse.r, means, rtol=1e-6)
    assert np.isnan(coarse.r).sum() == 1


@pytest.mark.parametrize("shape", [(64, 128), (71, 130), (1, 9), (8, 3), (300, 40)])
def test_blocks_are_as_high_as_what_is_interpolated_in_them(rng, shape):
    field = rng.random(shape, dtype=np.float32)
    field[rng.random(shape) < 0.3] = np.nan
    tops = block_tops(field, 8)
    assert tops.shape == tuple(-(-n // 8) for n in shape)
    for i, j in np.ndindex(tops.shape):
        block = field[8 * i : 8 * i + 9, 8 * j : 8 * j + 9]
        assert tops[i, j] == np.nanmax(block, initial=-np.inf)


def test_tops_of_large_blocks_are_those_of_the_small_ones_in_them(rng):
    patch = patch_of(RADIUS + rng.random((200, 90), dtype=np.float32))
    far = block_tops(patch.r, 64)
    around = [np.max(far[max(i - 1, 0) : i + 2]) for i in range(len(far))]
    np.testing.assert_array_equal(patch.tops[1], np.repeat(np.array(around)[:, None], 2, axis=1))
