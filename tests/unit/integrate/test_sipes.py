"""A ribbed tread with a narrow dark cut that sections break in, and a dark line painted on it."""

import numpy as np
import pytest

from treadlight.geometry import CylinderGrid
from treadlight.integrate import FirstSurface, LaserSections, ViewNormals, integrate_capture
from treadlight.integrate.cues import dark_lines
from treadlight.integrate.gather import view_field
from treadlight.integrate.patches import find_patches
from treadlight.integrate.sight import bridged_surface, seen_on

RADIUS = 300.0
STEP = 0.5
LASER_STD = 0.1
TILT_STD = np.radians(1.5)
LIGHT = 0.3
HALF_WIDTH = 0.75
GROOVE = (14.0, 3.0)
GROOVE_MM = 8.0
# Middles at z = 0, mm along the tread.
SIPES, UNMET, PAINT = (23.0, 85.0), 72.0, 48.0
# Lines along theta per mm of z: the sipe crosses sections, which run along z.
LEAN = 0.5
CAMERA = np.array([1100.0, 0.25, 0.0])


def across(theta, z, middle):
    return np.abs((theta - 0.1) * RADIUS - middle - LEAN * z)


def on_rib(z):
    return np.abs(z) < 10


def top_radius(z):
    return RADIUS - 0.002 * z**2 - GROOVE_MM * (np.abs(z - GROOVE[0]) < GROOVE[1])


@pytest.fixture(scope="module")
def grid():
    return CylinderGrid.sector((0.1, 0.1 + 100 / RADIUS), (-20.0, 20.0), STEP, RADIUS)


@pytest.fixture(scope="module")
def places(grid):
    return np.meshgrid(grid.theta, grid.z, indexing="ij")


@pytest.fixture(scope="module")
def view(places):
    """Level normals that fit everywhere; a tenth of the light comes back from the dark lines."""
    rng = np.random.default_rng(3)
    theta, z = places
    p, q = rng.normal(0, TILT_STD, (2, *theta.shape))
    normal = np.stack([np.ones_like(p), -p, 0.004 * z - q], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    covariance = np.zeros((*p.shape, 3))
    covariance[..., [0, 2]] = TILT_STD**2
    light = LIGHT * np.exp(rng.normal(0, 0.1, p.shape))
    for middle in (*SIPES, UNMET, PAINT):
        light[(across(theta, z, middle) < HALF_WIDTH) & on_rib(z)] *= 0.1
    none = np.zeros(p.shape, bool)
    material = np.stack([light, light, 10 + 0 * light], axis=-1)
    return ViewNormals(normal, covariance, top_radius(z), theta, z, material, none, none, none)


@pytest.fixture(scope="module")
def sections(grid):
    """They cross two sipes, where the line breaks, and the paint, where it does not."""
    rng = np.random.default_rng(4)
    at = np.array([4.0, 12, 20, 28, 36, 44, 52, 60, 89, 97])
    theta = (0.1 + at / RADIUS)[:, None] + 0 * grid.z
    z = np.broadcast_to(grid.z, theta.shape)
    r = top_radius(z) + rng.normal(0, LASER_STD, theta.shape)
    std = np.full(r.shape, LASER_STD)
    broken = np.zeros(r.shape, bool)
    for middle in SIPES:
        broken |= (across(theta, z, middle) < HALF_WIDTH) & on_rib(z)
    r[broken] += rng.uniform(-2, 2, broken.sum())
    std[broken] = 1.5
    return LaserSections(r, theta, z, std, -theta[:, 0], 1.0)


@pytest.fixture(scope="module")
def surface(grid):
    r = np.broadcast_to(top_radius(grid.z), grid.shape).copy()
    return FirstSurface(r, np.full(r.shape, LASER_STD))


@pytest.fixture(scope="module")
def profile(grid, view, sections, surface):
    return integrate_capture(iter([view]), sections, surface, grid, 0)


@pytest.mark.parametrize("middle", [*SIPES, UNMET])
def test_a_dark_line_in_which_sections_break_is_a_cut(profile, places, middle):
    """Of unknown depth: between its own width and the depth of the grooves."""
    theta, z = places
    inside = (across(theta, z, middle) < 0.5 * STEP) & (np.abs(z) < 8)
    depth = (top_radius(z) - profile.r)[inside]
    assert np.all(depth > 2 * HALF_WIDTH)
    assert np.all(depth < GROOVE_MM)
    # A uniform distribution over what is possible has this spread.
    usual = (GROOVE_MM - 2 * HALF_WIDTH) / np.sqrt(12)
    assert np.median(profile.r_std[inside]) == pytest.approx(usual, rel=0.25)


@pytest.mark.parametrize("middle", [*SIPES, UNMET])
def test_lips_of_a_cut_lie_in_the_middle_of_the_slope_of_its_darkness(profile, places, middle):
    theta, z = places
    rows = np.abs(z[0]) < 8
    near = across(theta, z, middle) < 4
    cut = near & (top_radius(z) - profile.r > 0.5)
    width = cut[:, rows].sum(axis=0) * STEP
    assert np.mean(width) == pytest.approx(2 * HALF_WIDTH, abs=STEP)


def test_a_painted_line_on_which_sections_find_the_tread_is_no_cut(profile, places):
    theta, z = places
    near = (across(theta, z, PAINT) < 4) & (np.abs(z) < 9)
    error = (profile.r - top_radius(z))[near]
    assert np.abs(error).max() < 4 * LASER_STD
    assert np.median(profile.r_std[near]) < LASER_STD


def test_tops_beside_narrow_cuts_stay_level(profile, places):
    theta, z = places
    top = np.abs(z) < 9
    for middle in (*SIPES, UNMET):
        top &= across(theta, z, middle) > HALF_WIDTH + 2 * STEP
    error = (profile.r - top_radius(z))[top]
    assert np.isfinite(error).all()
    assert np.sqrt(np.mean(error**2)) < LASER_STD


def test_lips_lean_towards_their_cut_at_the_resolution_of_a_pixel(profile, places):
    """By as much as the profile blurred by 0.7 cells does; two cells off they are level."""
    theta, z = places
    along = (theta - 0.1) * RADIUS - SIPES[0] - LEAN * z
    rib = np.abs(z) < 8
    lean = np.degrees(np.arctan2(profile.normal[..., 1], profile.normal[..., 0]))
    ahead = rib & (along > HALF_WIDTH + STEP) & (along < HALF_WIDTH + 2 * STEP)
    behind = rib & (along < -HALF_WIDTH - STEP) & (along > -HALF_WIDTH - 2 * STEP)
    assert np.median(lean[ahead]) < -2
    assert np.median(lean[behind]) > 2
    level = rib & (np.abs(along) > HALF_WIDTH + 5 * STEP) & (np.abs(along) < 8)
    assert abs(np.median(lean[level])) < 0.5


def test_a_line_narrower_than_a_cell_is_as_wide_as_its_brightness_falls_halfway():
    grid = CylinderGrid.sector((0.0, 0.2), (-10.0, 10.0), STEP, RADIUS)
    rng = np.random.default_rng(1)
    dark = rng.normal(0, 0.01, grid.shape).astype(np.float32)
    middle = grid.shape[0] // 2
    dark[middle - 1 : middle + 2] += np.array([0.2, 0.6, 0.2])[:, None]
    share = dark_lines(dark, grid)
    assert np.all(share[middle] > 0.8)
    assert np.count_nonzero(share) == grid.shape[1]


def test_patches_know_their_cells_and_the_share_of_a_mask_in_them():
    grid = CylinderGrid.sector((0.0, 0.2), (-10.0, 10.0), STEP, RADIUS)
    mask = np.zeros(grid.shape, bool)
    mask[5:9, 2:12] = mask[20:24, 10:30] = True
    mask[60, 3] = True
    patches = find_patches(mask, grid)
    assert [len(cells) for cells in patches.cells()] == [40, 80]
    half = np.zeros(grid.shape, bool)
    half[:, :20] = True
    np.testing.assert_allclose(patches.share(half), [1, 0.5])
    assert patches.select(np.array([False, True])).mask.sum() == 80


def test_pixels_that_were_placed_in_a_block_are_seen_where_their_rays_meet_the_tread(places, grid):
    """The camera looks in obliquely: the floor of a block hides behind its lip."""
    theta, z = places
    x = np.stack([RADIUS * np.cos(theta), RADIUS * np.sin(theta), z], axis=-1)
    centre = np.array([CAMERA[0] * np.cos(CAMERA[1]), CAMERA[0] * np.sin(CAMERA[1]), 0.0])
    deep = x + 0.006 * (x - centre)
    none = np.zeros(theta.shape, bool)
    empty = np.zeros((*theta.shape, 3))
    placed = np.arctan2(deep[..., 1], deep[..., 0])
    view = ViewNormals(
        one_normal(placed), empty, np.hypot(deep[..., 0], deep[..., 1]), placed,
        deep[..., 2], empty, none, none, none, CAMERA,
    )  # fmt: skip
    assert np.abs(view.z - z).max() > 0.1
    assert np.abs(placed - theta).max() > 1e-3
    moved = seen_on(view, np.full(grid.shape, RADIUS), grid)
    np.testing.assert_allclose(moved.r, RADIUS)
    np.testing.assert_allclose(moved.theta, theta, atol=1e-9)
    np.testing.assert_allclose(moved.z, z, atol=1e-9)
    np.testing.assert_allclose(moved.normal, one_normal(theta), atol=1e-9)


def one_normal(theta):
    """The same direction, 0.5 rad around the axis and leaning along it, in every local basis."""
    around = 0.5 - theta
    return np.stack(
        [0.8 * np.cos(around), 0.8 * np.sin(around), np.full(theta.shape, 0.6)], axis=-1
    )


def test_blocks_of_single_sections_are_bridged_and_wide_grooves_stay(grid):
    spacing = 16.0
    start = np.full(grid.shape, RADIUS)
    start[:, 60:66] -= GROOVE_MM
    bridged = start.copy()
    start[90:106, 10:40] -= 6.0
    np.testing.assert_array_equal(bridged_surface(start, LASER_STD, spacing, grid), bridged)
    wide = bridged.copy()
    wide[60:140, 10:40] -= 6.0
    np.testing.assert_array_equal(bridged_surface(wide, LASER_STD, spacing, grid), wide)


def test_a_view_without_a_camera_stays_where_it_is(view, grid):
    assert seen_on(view, np.full(grid.shape, RADIUS + 5), grid) is view
    assert view_field([view], grid) is not None
