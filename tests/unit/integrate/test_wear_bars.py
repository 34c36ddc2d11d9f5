"""Wear bars on the floor of a groove, which few sections cross or none, seen obliquely."""

from dataclasses import replace

import numpy as np
import pytest

from treadlight.geometry import CylinderGrid
from treadlight.integrate import FirstSurface, LaserSections, ViewNormals, integrate_capture
from treadlight.integrate.edges import build_edges, mixed_variance
from treadlight.integrate.laser import LaserCells
from treadlight.integrate.sight import seen_on
from treadlight.integrate.solve import Problem, integrate

RADIUS, STEP = 300.0, 0.3
LASER_STD, TILT_STD = 0.05, np.radians(1.0)
HEIGHT, DEPTH = 1.6, 8.0
# Arc lengths at which bars stand, mm: sections, 4 mm apart, cross the second one only.
BARS = (18.0, 40.0)
RAMP, HALF_TOP = 2.4, 0.9
SECTIONS = np.arange(0, 61, 4.0)
# 35 degrees off the bars' normals.
CAMERA = np.array([700.0, 0.1 - 0.35, 0.0])


def bars(arc):
    """Height over the floor, mm, and its slope."""
    rise, slope = np.zeros_like(arc), np.zeros_like(arc)
    for bar in BARS:
        away = np.abs(arc - bar) - HALF_TOP
        rise += HEIGHT * np.clip(1 - away / RAMP, 0, 1)
        ramp = (away > 0) & (away < RAMP)
        slope -= np.where(ramp, np.sign(arc - bar) * HEIGHT / RAMP, 0)
    return rise, slope


def true_radius(theta, z, high=True):
    rise, _ = bars((theta - 0.1) * RADIUS)
    return RADIUS - np.where(np.abs(z) < 4, DEPTH - high * rise, 0) + 0 * theta


@pytest.fixture(scope="module")
def grid():
    return CylinderGrid.sector((0.1, 0.1 + 60 / RADIUS), (-10.0, 10.0), STEP, RADIUS)


def view_of(grid, rng, kept_slope):
    """What is placed on a first surface that knows of no bar; ramps keep a part of their slope."""
    arc = np.arange(-2.0, 62.0, 0.2)
    theta, z = np.meshgrid(0.1 + arc / RADIUS, grid.z, indexing="ij")
    groove = np.abs(z) < 4
    r = true_radius(theta, z)
    _, slope = bars((theta - 0.1) * RADIUS)
    p = np.where(groove, kept_slope * slope * RADIUS / r, 0) + rng.normal(0, TILT_STD, r.shape)
    q = rng.normal(0, TILT_STD, r.shape)
    normal = np.stack([np.ones_like(p), -p, -q], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    wall = np.abs(np.abs(z) - 4) < 0.5
    normal[wall] = np.nan
    covariance = np.zeros((*r.shape, 3))
    covariance[..., [0, 2]] = TILT_STD**2
    none = np.zeros(r.shape, bool)
    seen = ViewNormals(
        normal, covariance, r, theta, z, np.ones((*r.shape, 3)), wall, none, none, CAMERA
    )
    smooth = true_radius(*np.meshgrid(grid.theta, grid.z, indexing="ij"), high=False)
    return seen_on(seen, smooth, grid)


def inputs(grid, rng, kept_slope):
    theta, z = np.meshgrid(0.1 + SECTIONS / RADIUS, grid.z, indexing="ij")
    r = true_radius(theta, z) + rng.normal(0, LASER_STD, theta.shape)
    sections = LaserSections(r, theta, z, np.full(r.shape, LASER_STD), -theta[:, 0], 1.0)
    nearest = np.abs(grid.theta[:, None] - theta[:, 0]).argmin(axis=1)
    first = FirstSurface(r[nearest], np.full((len(nearest), r.shape[1]), LASER_STD))
    return [view_of(grid, rng, kept_slope)], sections, first


def profile_of(grid, rng, kept_slope):
    return integrate_capture(*inputs(grid, rng, kept_slope), grid, 0)


def error_at(profile, grid, bar, half):
    """Mean error over the middle of the groove, within some mm of a bar's own middle."""
    arc = (grid.theta - 0.1) * RADIUS
    theta, z = np.meshgrid(grid.theta, grid.z, indexing="ij")
    error = profile.r - true_radius(theta, z)
    return error[np.abs(arc - bar) < half][:, np.abs(grid.z) < 3].mean()


def test_a_bar_between_two_sections_is_as_high_as_its_ramps_say(grid):
    """On the floor, where the first surface has them, its ramps are a fifth too short."""
    errors = [
        error_at(profile_of(grid, np.random.default_rng(seed), 1.0), grid, BARS[0], HALF_TOP)
        for seed in range(3)
    ]
    assert abs(np.mean(errors)) < 0.15


def test_a_bar_that_a_section_crosses_is_as_high_as_the_section_says(grid, rng):
    """Of ramps a few cells wide pixels show a part; the section alone is no ghost."""
    profile = profile_of(grid, rng, kept_slope=0.5)
    assert abs(error_at(profile, grid, BARS[1], HALF_TOP)) < 0.1


def test_slopes_that_pixels_mix_give_way_to_a_section(grid, rng):
    """Ramps lose a third of their slope and say nothing of it; no step is as high as they are."""
    std, loss, middle = 0.15, 0.3, 30.0
    arc = (grid.theta - 0.1) * RADIUS
    away = np.abs(arc - middle) - 1.5
    ramp = (away > 0) & (away < 1.5)
    true = RADIUS + HEIGHT * np.clip(1 - away / 1.5, 0, 1)[:, None] + np.zeros(grid.shape)
    slope = rng.normal(0, 0.03, (2, *grid.shape)).astype(np.float32)
    slope[0] -= (1 - loss) * (np.sign(arc - middle) * ramp * HEIGHT / 1.5)[:, None]
    known = np.abs(arc[:, None] - np.arange(0, 60, 5.0)).argmin(axis=0)
    row, column = np.repeat(known, grid.shape[1]), np.tile(np.arange(grid.shape[1]), len(known))
    value = true[row, column] + rng.normal(0, std, len(row))
    laser = LaserCells(row, column, value, np.full(len(row), std), row)
    start = true[known[np.abs(np.arange(len(arc))[:, None] - known).argmin(axis=1)]]
    nothing = np.full(slope.shape, np.nan)
    variance = np.full_like(slope, 0.03**2)
    mixed = mixed_variance(slope, grid)
    edges = build_edges(slope, variance, mixed, start, nothing, nothing, grid)
    problem = Problem(edges, laser, start, np.full(grid.shape, 1e-2))
    r = integrate(problem, start, std, 0.03 * STEP).r
    assert abs((r - true)[np.abs(arc - middle) < 1.4].mean()) < 0.2


def test_texture_mixes_no_slopes(grid, rng):
    slope = rng.normal(0, 0.02, (2, *grid.shape)).astype(np.float32)
    slope[0, 100:105] += 0.8
    mixed = mixed_variance(slope, grid)
    calm = np.ones(len(grid.theta), bool)
    calm[98:107] = False
    assert np.mean(mixed[:, calm] > 0) < 1e-3
    # Where the ramp begins and ends slopes differ by all of it, in its middle by the noise.
    assert 0.5 < np.sqrt(np.median(mixed[0, [99, 100, 104, 105]])) < 0.8
    assert np.median(mixed[0, 102]) == 0
    assert not mixed_variance(slope * np.nan, grid).any()


def test_mixed_edges_know_no_direction(grid, rng):
    slope = rng.normal(0, 0.02, (2, *grid.shape)).astype(np.float32)
    slope[0, 100:105] += 0.8
    variance = np.full_like(slope, 0.02**2)
    level = np.full(grid.shape, RADIUS)
    nothing = np.full(slope.shape, np.nan)

    def edges(flip):
        turned = slope[:, ::-1] if flip else slope
        mixed = mixed_variance(turned, grid)
        return build_edges(turned, variance, mixed, level, nothing, nothing, grid)

    there, back = edges(False), edges(True)
    np.testing.assert_allclose(back.mixed[0, :-1][::-1], there.mixed[0, :-1], rtol=1e-5)
    np.testing.assert_allclose(back.weight[0, :-1][::-1], there.weight[0, :-1], rtol=1e-5)


def test_a_ghost_on_a_floor_is_no_bar(grid, rng):
    """A quarter of the floor's width, 3 mm high, in one section, where nothing fits the model."""
    views, sections, first = inputs(grid, rng, 1.0)
    at = np.abs(grid.z - 1.0) < 1.0
    row = np.argmin(np.abs(SECTIONS - 28.0))
    r = sections.r.copy()
    r[row, at] += 3.0
    near = np.abs(views[0].theta - sections.theta[row, 0]) * RADIUS < 2.0
    poor = near & (np.abs(views[0].z - 1.0) < 1.5)
    surface = first.r.copy()
    rows = np.abs(grid.theta - sections.theta[row, 0]) * RADIUS < 2.0
    surface[np.ix_(rows, at)] += 3.0
    found = integrate_capture(
        [replace(views[0], poor_fit=poor)],
        replace(sections, r=r),
        FirstSurface(surface, first.r_std),
        grid,
        0,
    )
    theta, z = np.meshgrid(grid.theta, grid.z, indexing="ij")
    error = (found.r - true_radius(theta, z))[np.ix_(rows, at)]
    assert abs(np.median(error)) < 0.3
