"""Pixels finer than the cells: what they add, and what they must not."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from treadlight.geometry import CylinderGrid
from treadlight.integrate import (
    FirstSurface,
    Joined,
    LaserSections,
    ViewNormals,
    bands_of,
    profile_of,
    sampled,
    solve_capture,
    solved_grid,
    thinned,
    width_of_cells,
)
from treadlight.integrate.edges import Photometry
from treadlight.integrate.patches import Patches
from treadlight.integrate.relief import Upsampled, relief, smooth_cells

RADIUS = 300.0
STEP = 0.1
WIDTH = 3
LASER_STD = 0.05
TILT_STD = np.radians(1.0)
TEXTURE_MM, WAVE_MM = 0.01, 0.7


def true_radius(theta, z):
    """A groove 6 mm deep with walls of 1 mm, waves, texture finer than three cells."""
    along = theta * RADIUS
    r = RADIUS - 0.002 * z**2 + 0.1 * np.sin(along / 4) * np.cos(z / 3)
    r = r + TEXTURE_MM * np.sin(2 * np.pi * along / WAVE_MM) * np.sin(2 * np.pi * z / WAVE_MM)
    return r - 6.0 * np.clip(4.5 - np.abs(z - 2), 0, 1)


def true_slopes(theta, z, step=1e-4):
    ahead = true_radius(theta + step / RADIUS, z) - true_radius(theta - step / RADIUS, z)
    along = true_radius(theta, z + step) - true_radius(theta, z - step)
    return ahead / (2 * step), along / (2 * step)


def make_view(grid, rng):
    theta, z = np.meshgrid(grid.theta, grid.z, indexing="ij")
    p, q = true_slopes(theta, z)
    normal = np.stack([np.ones_like(p), -p, -q], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    normal[..., 1:] += rng.normal(0, TILT_STD, (*p.shape, 2))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    covariance = np.zeros((*p.shape, 3))
    covariance[..., [0, 2]] = TILT_STD**2
    none = np.zeros(p.shape, bool)
    material = np.full((*p.shape, 3), 0.3)
    return ViewNormals(
        normal, covariance, true_radius(theta, z), theta, z, material, none, none, none
    )


@pytest.fixture(scope="module")
def capture():
    rng = np.random.default_rng(7)
    grid = CylinderGrid.sector((0.1, 0.1 + 50 / RADIUS), (-14.0, 14.0), STEP, RADIUS)
    theta = np.linspace(grid.theta[8], grid.theta[-9], 8)[:, None] + 0 * grid.z
    z = np.broadcast_to(grid.z, theta.shape)
    r = true_radius(theta, z) + rng.normal(0, LASER_STD, theta.shape)
    sections = LaserSections(r, theta, z, np.full(r.shape, LASER_STD), -theta[:, 0], 1.0)
    columns = [np.interp(grid.theta, theta[:, 0], r[:, j]) for j in range(len(grid.z))]
    first = FirstSurface(np.stack(columns, axis=1), np.full(grid.shape, LASER_STD))
    return grid, sections, first, [make_view(grid, rng)]


@pytest.fixture(scope="module")
def found(capture):
    grid, sections, first, views = capture
    width = width_of_cells(grid, 10**9)
    assert width == WIDTH
    cells = solved_grid(grid, width)
    place = np.ix_(*sampled(grid, cells))
    first = FirstSurface(first.r[place], first.r_std[place])
    return solve_capture(views, thinned(sections, width), first, cells, 0)


@pytest.fixture(scope="module")
def profile(capture, found):
    grid, sections, _, views = capture
    return profile_of(found, views, sections, grid)


def truth_on(grid):
    return true_radius(*np.meshgrid(grid.theta, grid.z, indexing="ij"))


def tops_of(grid):
    return (np.abs(grid.z - 2) > 6.5) & (np.abs(grid.z) < 13)


def test_pixels_show_texture_that_cells_cannot(capture, found, profile):
    grid = capture[0]
    tops = tops_of(grid)
    theta, z = np.meshgrid(grid.theta, grid.z[tops], indexing="ij")
    wave = np.sin(2 * np.pi * theta * RADIUS / WAVE_MM) * np.sin(2 * np.pi * z / WAVE_MM)

    def amplitude(r):
        inner = slice(20, -20)
        own = r[:, tops] - truth_on(grid)[:, tops]
        return TEXTURE_MM + float((own * wave)[inner].sum() / (wave**2)[inner].sum())

    cells = Upsampled.between(found.grid, grid).linear(found.top)
    assert amplitude(profile.r) == pytest.approx(TEXTURE_MM, rel=0.15)
    assert amplitude(cells) < 0.7 * TEXTURE_MM


def test_heights_stay_those_of_the_cells_where_they_are_smooth(capture, found, profile):
    grid = capture[0]
    error = (profile.r - truth_on(grid))[:, tops_of(grid)]
    assert abs(np.median(error)) < 0.01
    assert np.sqrt(np.mean(error**2)) < LASER_STD / 2
    floor = np.abs(grid.z - 2) < 2.5
    assert np.median(np.abs((profile.r - truth_on(grid))[:, floor])) < LASER_STD / 2


def test_walls_stand_where_pixels_see_them(capture, profile):
    """Half way down the wall to within a pixel; cells are three times as wide."""
    grid = capture[0]
    wanted = RADIUS - 0.002 * grid.z**2 - 3.0
    for side in (-4.0, 4.0):
        near = np.flatnonzero(np.abs(grid.z - 2 - side) < 1.5)
        over = (profile.r > wanted)[10:-10, near]
        z = grid.z[near[0]] + STEP * (np.count_nonzero(over == over[:, :1], axis=1) - 0.5)
        assert np.abs(z - 2 - side).max() <= STEP


def test_uncertainty_and_flags_come_from_the_cells_and_light_from_the_pixels(capture, profile):
    grid, sections, _, _ = capture
    error = np.abs(profile.r - truth_on(grid))[:, tops_of(grid)]
    ratio = error / profile.r_std[:, tops_of(grid)]
    assert np.mean(ratio < 2) > 0.9
    assert np.median(profile.r_std) < LASER_STD
    assert profile.laser.sum() == sections.r.size
    assert profile.laser_points == sections.r.size
    assert profile.photometric.mean() > 0.99
    assert profile.step[:, np.abs(np.abs(grid.z - 2) - 4) < 0.3].mean() > 0.5
    np.testing.assert_allclose(profile.material, 0.3, rtol=1e-5)


def test_bands_are_what_all_pixels_at_once_are(capture, found, profile):
    grid, sections, _, views = capture
    joined = Joined(grid.shape, np.empty)
    bands = list(bands_of(grid, WIDTH, 40_000))
    assert len(bands) > 2
    for band in bands:
        joined.add(profile_of(found, views, sections, band.grid, band.core), band)
    parts = joined.profile(found.proof)
    away = np.abs(parts.r - profile.r)
    assert away.max() < 0.1 * TEXTURE_MM
    np.testing.assert_array_equal(parts.laser, profile.laser)
    assert parts.laser_points == profile.laser_points
    np.testing.assert_array_equal(parts.photometric, profile.photometric)
    np.testing.assert_allclose(parts.normal, profile.normal, atol=0.02)


def test_a_wave_around_a_whole_turn_is_one_between_cells():
    grid = CylinderGrid.whole_turn((0.0, 12.0), 1.0, 20.0)
    cells = solved_grid(grid, 3)
    up = Upsampled.between(cells, grid)
    wave = np.cos(cells.theta)[:, None] + 0 * cells.z
    assert np.abs(up.linear(wave) - np.cos(grid.theta)[:, None]).max() < 0.02
    np.testing.assert_allclose(up.along(wave[:, 0]), up.linear(wave)[:, 0], atol=1e-12)


def test_slots_are_cut_into_the_relief_as_deep_as_in_the_cells(capture, found):
    """Their slopes, which are of the walls, do not tell of the tread that is closed over them."""
    grid, sections, _, (view,) = capture
    label = np.zeros(found.grid.shape, np.int32)
    label[60:72, 5:25] = 1
    closed = replace(
        found.closed,
        slots=Patches(label, 1),
        opening=label.astype(np.float32),
        met=np.ones(1, bool),
    )
    none = np.full(label.shape, np.nan)
    depth, std = (np.where(label > 0, x, none) for x in (3.0, 0.4))
    slotted = replace(found, closed=closed, depth=depth, depth_std=std)
    up = Upsampled.between(found.grid, grid)
    inside, beside = up.nearest(label > 0), up.nearest(ndimage.maximum_filter(label, 5) > 0)
    tilted = view.normal.copy()
    tilted[inside] = np.array([1, -0.8, 0.8]) / np.sqrt(2.28)
    profile = profile_of(slotted, [replace(view, normal=tilted)], sections, grid)
    floor = up.nearest(ndimage.minimum_filter(label, 3) > 0)
    below = truth_on(grid) - profile.r
    assert np.abs(below[floor] - 3.0).max() < 0.1
    assert np.abs(below[~beside & tops_of(grid)]).max() < 0.2
    np.testing.assert_allclose(profile.r_std[floor], 0.4, rtol=0.05)
    assert not profile.photometric[floor].any()


def test_views_count_in_a_band_as_they_do_in_the_whole(capture, found):
    """A band sees no more than a part of a view: where its middle is the solve knows."""
    grid, sections, _, (view,) = capture
    other = replace(view, material=0.5 * view.material)
    half = np.linspace(0, 1, found.grid.shape[0])
    shared = replace(found, blends=[half, 1 - half])
    band = grid.part(np.arange(100, 200))
    profile = profile_of(shared, [view, other], sections, band)
    share = np.interp(band.theta, found.grid.theta, half)
    expected = 0.3 * share + 0.15 * (1 - share)
    np.testing.assert_allclose(profile.material[0][:, 50], expected, atol=1e-3)


@pytest.mark.parametrize("n", [1250, 2995, 3000, 3005])
def test_bands_over_a_turns_end_lie_among_its_cells(n):
    """Where the first pixel's row comes out a rounding error below zero."""
    theta = -np.pi + np.arange(n) * (2 * np.pi / n)
    grid = CylinderGrid(theta, np.arange(4.0), 300.0)
    cells = solved_grid(grid, 5)
    values = np.cos(cells.theta)
    bands = list(bands_of(grid, 5, 4 * n // 3))
    assert len(bands) > 2
    for band in bands:
        up = Upsampled.between(cells, band.grid)
        np.testing.assert_allclose(up.along(values), np.cos(band.grid.theta), atol=1e-4)
        nearest = up.nearest(values[:, None] + np.zeros(cells.shape[1]))[:, 0]
        assert np.abs(nearest - np.cos(band.grid.theta)).max() < 0.51 * cells.step_theta


def test_the_rim_of_the_last_cells_goes_on_as_they_rise():
    grid = CylinderGrid.sector((0.0, 0.1), (0.0, 9.0), 0.2, 100.0)
    cells = solved_grid(grid, 5)
    up = Upsampled.between(cells, grid)
    rise = 0.3 * cells.z + 7.0 * cells.theta[:, None]
    expected = 0.3 * grid.z + 7.0 * grid.theta[:, None]
    np.testing.assert_allclose(up.linear(rise), expected, atol=1e-9)


def test_cells_that_are_not_known_lend_nothing_to_those_beside():
    cells = CylinderGrid.sector((0.0, 0.1), (0.0, 9.0), 1.0, 100.0)
    grid = CylinderGrid.sector((0.0, 0.1), (0.0, 9.0), 0.25, 100.0)
    values = np.full(cells.shape, 5.0)
    values[:, 4:] = np.nan
    found = Upsampled.between(cells, grid).linear(values)
    known = np.isfinite(found)
    assert (known == (grid.z < 3.5)[None]).all()
    assert (found[known] == 5.0).all()


def test_cells_are_smooth_on_a_shoulder_and_not_at_a_lip():
    cells = CylinderGrid.sector((0.0, 0.2), (0.0, 20.0), 1.0, 100.0)
    shoulder = 100.0 - 1.2 * cells.z + 0 * cells.theta[:, None]
    none = np.zeros(cells.shape, bool)
    assert smooth_cells(shoulder, none, cells)[:, 2:-2].all()
    lip = shoulder - 3.0 * (cells.z > 10)
    smooth = smooth_cells(lip, none, cells)
    assert not smooth[:, 9:13].any()
    assert smooth[:, 2:7].all()
    cut = none.copy()
    cut[5, 5] = True
    assert not smooth_cells(shoulder, cut, cells)[4:7, 4:7].any()


@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize("width", [2, 3, 10])
def test_pixels_near_a_mask_of_cells_are_those_of_a_filter(whole, width):
    if whole:
        grid = CylinderGrid.whole_turn((0.0, 20.0), 1.0, 20.2)
        assert grid.shape[0] % 4 == 3
    else:
        grid = CylinderGrid.sector((0.0, 3.0), (0.0, 20.0), 1.0, 20.0)
    cells = solved_grid(grid, width)
    mask = np.random.default_rng(width).random(cells.shape) < 0.1
    mask[0, 0] = True
    up = Upsampled.between(cells, grid)
    expected = ndimage.maximum_filter(up.nearest(mask), 7, mode=grid.filter_mode)
    np.testing.assert_array_equal(up.near(mask, 3), expected)


def test_what_slopes_say_next_to_nothing_of_stays_near_the_cells():
    """A patch at a step that slopes as uncertain as they are steep lead up to on all sides."""
    grid = CylinderGrid.sector((0.0, 0.04), (0.0, 12.0), 0.1, RADIUS)
    slope, variance = np.zeros((2, *grid.shape), np.float32), np.full((2, *grid.shape), 1e-6)
    around = np.s_[49:61, 49:61]
    slope[0, 49, 50:60], slope[0, 60, 50:60] = 1e4, -1e4
    slope[1, 50:60, 49], slope[1, 50:60, 60] = 1e4, -1e4
    rim = np.zeros(grid.shape, bool)
    rim[around] = True
    rim[50:60, 50:60] = False
    variance[:, rim] = 1e14
    seen = Photometry(slope, variance.astype(np.float32), *np.zeros((2, 3, *grid.shape)))
    up = Upsampled.between(solved_grid(grid, 3), grid)
    smooth, height = np.zeros(up.cells.shape, bool), np.full(up.cells.shape, 0.5)
    found = relief(np.full(grid.shape, RADIUS), smooth, height, seen, up, grid)
    assert np.abs(found[50:60, 50:60]).max() < 0.01


def test_no_pixel_at_a_step_leaves_the_cells_around_it():
    """A slope that is as certain as it is wrong."""
    grid = CylinderGrid.sector((0.0, 0.04), (0.0, 12.0), 0.1, RADIUS)
    slope, variance = np.zeros((2, *grid.shape), np.float32), np.full((2, *grid.shape), 1e-6)
    slope[1, :, 50:] = 20.0
    seen = Photometry(slope, variance.astype(np.float32), *np.zeros((2, 3, *grid.shape)))
    up = Upsampled.between(solved_grid(grid, 3), grid)
    smooth, height = np.zeros(up.cells.shape, bool), np.full(up.cells.shape, 0.5)
    smooth[:, :5] = True
    found = relief(np.full(grid.shape, RADIUS), smooth, height, seen, up, grid)
    assert np.abs(found).max() == pytest.approx(1.0)


def test_texture_finer_than_cells_is_no_less_where_these_are_flat():
    grid = CylinderGrid.sector((0.0, 0.04), (0.0, 12.0), 0.1, RADIUS)
    cells = solved_grid(grid, 3)
    q = np.where(np.arange(grid.shape[1]) % 2, 0.03, -0.03) + 0 * grid.theta[:, None]
    slope = np.stack([0 * q, q]).astype(np.float32)
    variance = np.full(slope.shape, 1e-2, np.float32)
    seen = Photometry(slope, variance, *np.zeros((2, 3, *grid.shape)))
    slope[1, :, 40:42] = 0.03
    surface, up = np.full(grid.shape, RADIUS), Upsampled.between(cells, grid)
    smooth, flat = np.ones(cells.shape, bool), np.zeros(cells.shape)
    found = relief(surface, smooth, flat, seen, up, grid)
    higher = relief(surface, smooth, flat + 1.0, seen, up, grid)
    assert np.ptp(higher) > 1e-3
    np.testing.assert_allclose(found, higher, atol=1e-5)


def test_where_no_slope_is_known_pixels_follow_the_cells():
    grid = CylinderGrid.sector((0.0, 0.02), (0.0, 4.0), 0.1, RADIUS)
    surface = RADIUS + 0.1 * grid.z**2 + 0 * grid.theta[:, None]
    dark = Photometry(*(np.full((k, *grid.shape), np.nan, np.float32) for k in (2, 2, 3, 3)))
    cells = solved_grid(grid, 3)
    smooth, height = np.ones(cells.shape, bool), np.zeros(cells.shape)
    found = relief(surface, smooth, height, dark, Upsampled.between(cells, grid), grid)
    np.testing.assert_allclose(found, 0, atol=1e-4)
