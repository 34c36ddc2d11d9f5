"""A tread of which everything is known: a groove, a slot, a crown, texture."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from treadlight.geometry import CylinderGrid
from treadlight.integrate import (
    FirstSurface,
    LaserSections,
    ViewNormals,
    integrate_capture,
    quality_flags,
)
from treadlight.integrate.quality import FLAGS

RADIUS = 300.0
STEP = 0.5
LASER_STD = 0.1
TILT_STD = np.radians(1.5)


def true_radius(theta, z):
    """A crown, a groove 8 mm deep and 8 mm wide along theta, gentle waves."""
    r = RADIUS - 0.002 * z**2 + 0.15 * np.sin(theta * RADIUS / 4) * np.cos(z / 3)
    return r - 8.0 * (np.abs(z - 2) < 4)


def true_slopes(theta, z, step=1e-4):
    ahead = true_radius(theta + step / RADIUS, z) - true_radius(theta - step / RADIUS, z)
    along = true_radius(theta, z + step) - true_radius(theta, z - step)
    return ahead / (2 * step), along / (2 * step)


def make_grid(periodic=False):
    if periodic:
        return CylinderGrid(
            -np.pi + np.arange(200) * (2 * np.pi / 200),
            np.arange(-15, 15, STEP),
            200 * STEP / 2 / np.pi,
        )
    return CylinderGrid.sector((0.1, 0.1 + 100 / RADIUS), (-25.0, 25.0), STEP, RADIUS)


def make_view(grid, rng, rows, bias=0.0, dark=None):
    theta, z = np.meshgrid(grid.theta[rows], grid.z, indexing="ij")
    p, q = true_slopes(theta, z)
    p = p + bias + rng.normal(0, TILT_STD, p.shape)
    q = q - bias + rng.normal(0, TILT_STD, q.shape)
    normal = np.stack([np.ones_like(p), -p, -q], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    wall = np.abs(np.abs(z - 2) - 4) < 0.6
    hidden = wall if dark is None else wall | dark(theta, z)
    normal[hidden] = np.nan
    covariance = np.zeros((*p.shape, 3))
    covariance[..., [0, 2]] = TILT_STD**2
    none = np.zeros(p.shape, bool)
    material = np.full((*p.shape, 3), 0.3)
    r = true_radius(theta, z)
    return ViewNormals(normal, covariance, r, theta, z, material, hidden, none, none)


def make_sections(grid, rng, count, outliers=0.02):
    theta = np.linspace(grid.theta[3], grid.theta[-4], count)[:, None] + 0 * grid.z
    z = np.broadcast_to(grid.z, theta.shape)
    r = true_radius(theta, z) + rng.normal(0, LASER_STD, theta.shape)
    wild = rng.uniform(size=r.shape) < outliers
    r = np.where(wild, r + rng.normal(0, 3, r.shape), r)
    return LaserSections(r, theta, z, np.full(r.shape, LASER_STD), -theta[:, 0], 1.0)


def first_surface(grid, sections):
    """Interpolated along theta, outliers taken out along z, as the stage before does."""
    order = np.argsort(sections.theta[:, 0])
    steady = ndimage.median_filter(sections.r, (1, 5), mode="nearest")
    columns = [
        np.interp(grid.theta, sections.theta[order, 0], steady[order, j])
        for j in range(len(grid.z))
    ]
    r = np.stack(columns, axis=1)
    return FirstSurface(r, np.full(r.shape, LASER_STD))


def classes(grid):
    inside = np.abs(grid.z - 2)
    return inside > 5, inside < 3


@pytest.fixture(scope="module")
def capture():
    rng = np.random.default_rng(1)
    grid = make_grid()
    sections = make_sections(grid, rng, 12)
    surface = first_surface(grid, sections)
    half = len(grid.theta) // 2
    views = [
        make_view(grid, rng, np.arange(0, half + 20), bias=0.02),
        make_view(grid, rng, np.arange(half - 20, len(grid.theta)), bias=-0.02),
    ]
    return grid, sections, surface, views


@pytest.fixture(scope="module")
def profile(capture):
    grid, sections, surface, views = capture
    return integrate_capture(iter(views), sections, surface, grid, 10)


def error_of(profile, grid):
    theta, z = np.meshgrid(grid.theta, grid.z, indexing="ij")
    return profile.r - true_radius(theta, z)


def test_grooves_stay_sharp_and_heights_beat_the_laser(capture, profile):
    grid = capture[0]
    error = error_of(profile, grid)
    for columns in classes(grid):
        part = error[:, columns]
        assert abs(np.median(part)) < 0.025
        assert np.median(np.abs(part)) < 0.5 * 0.6745 * LASER_STD
        assert np.sqrt(np.mean(part**2)) < LASER_STD


def test_the_solve_may_take_other_normals_than_those_that_tell_of_cuts(capture, profile):
    grid, sections, surface, views = capture
    same = integrate_capture(iter(views), sections, surface, grid, 10, iter(views))
    np.testing.assert_array_equal(same.r, profile.r)
    half = len(grid.theta) // 2
    quiet = np.random.default_rng(2)
    rows = (np.arange(0, half + 20), np.arange(half - 20, len(grid.theta)))
    others = [make_view(grid, quiet, part) for part in rows]
    other = integrate_capture(iter(views), sections, surface, grid, 10, iter(others))
    assert np.nanmax(np.abs(other.r - profile.r)) > 0.01


def test_smooth_bias_of_the_slopes_is_taken_out(capture, profile):
    """Slopes off by a degree, oppositely in two views: 9 mm between sections are 0.18 mm."""
    grid = capture[0]
    error = error_of(profile, grid)[:, classes(grid)[0]]
    along = np.median(error, axis=1)
    assert np.max(np.abs(along - np.median(along))) < 0.12


def test_standard_uncertainty_covers_the_errors(capture, profile):
    grid = capture[0]
    error = np.abs(error_of(profile, grid))
    for columns in classes(grid):
        ratio = error[:, columns] / profile.r_std[:, columns]
        assert np.mean(ratio < 1) > 0.6
        assert np.mean(ratio < 2) > 0.9
        assert np.median(profile.r_std[:, columns]) < 1.5 * LASER_STD


def test_held_out_sections_tell_the_true_shape_error(capture, profile):
    held = profile.held_out
    assert held.n > 30
    assert abs(held.bias) < 0.05
    assert held.laser_std == pytest.approx(LASER_STD, rel=1e-6)
    assert held.shape_rms < LASER_STD


def test_no_section_is_held_out_when_none_is_asked_for(capture):
    grid, sections, surface, views = capture
    profile = integrate_capture(views[:1], sections, surface, grid, 0)
    assert profile.held_out.n == 0
    assert np.isnan(profile.held_out.rms)
    assert profile.laser_points == sections.r.size


def test_laser_only_gives_the_first_surface(capture):
    grid, sections, surface, _ = capture
    profile = integrate_capture([], sections, surface, grid, 0)
    top, floor = classes(grid)[:2]
    error = error_of(profile, grid)[:, top]
    # At a wall one section may meet the lip and the next the floor: nothing tells in between.
    assert np.isfinite(profile.r[:, top | floor]).all()
    assert np.isfinite(profile.r).mean() > 0.99
    assert not profile.photometric.any()
    assert np.median(np.abs(error)) < 2 * LASER_STD
    assert np.isnan(profile.normal_residual[0])


def test_photometry_only_gives_the_shape():
    rng = np.random.default_rng(3)
    grid = CylinderGrid.sector((0.1, 0.1 + 40 / RADIUS), (8.0, 25.0), STEP, RADIUS)
    view = make_view(grid, rng, np.arange(len(grid.theta)))
    nothing = LaserSections(*(np.empty((0, 5)) for _ in range(4)), np.empty(0), 1.0)
    flat = np.full(grid.shape, RADIUS)
    profile = integrate_capture(
        [view], nothing, FirstSurface(flat, np.full(grid.shape, 8.0)), grid, 10
    )
    error = error_of(profile, grid)
    assert np.std(error) < 0.15
    assert profile.laser_points == 0


def test_cells_that_nothing_supports_are_nan_and_refused(capture):
    grid, sections, surface, _ = capture
    r = surface.r.copy()
    r[40:60, :20] = np.nan

    def dark(theta, z):
        return np.isin(theta, grid.theta[38:62]) & (z < grid.z[22])

    view = make_view(grid, np.random.default_rng(5), np.arange(len(grid.theta)), dark=dark)
    keep = np.where(np.isfinite(sections.theta), sections.r, np.nan)
    hidden = (sections.theta > grid.theta[39]) & (sections.theta < grid.theta[60])
    keep = np.where(hidden & (sections.z < grid.z[21]), np.nan, keep)
    gappy = replace(sections, r=keep)
    profile = integrate_capture([view], gappy, FirstSurface(r, surface.r_std), grid, 0)
    flags = quality_flags(profile)
    refused = flags & (1 << FLAGS.index("refused")) > 0
    assert np.isnan(profile.r[42:58, :18]).all()
    np.testing.assert_array_equal(refused, np.isnan(profile.r))
    assert np.isfinite(profile.r[:30]).all()


def test_groove_walls_are_flagged_as_steps_and_tops_are_not(capture, profile):
    grid = capture[0]
    flags = quality_flags(profile)
    step = (flags >> FLAGS.index("step")) & 1
    assert np.mean(step[:, classes(grid)[0]]) < 0.02
    laser = (flags >> FLAGS.index("laser")) & 1
    assert laser.sum() == len(grid.z) * 12


def test_normals_follow_the_surface(capture, profile):
    grid = capture[0]
    theta, z = np.meshgrid(grid.theta, grid.z, indexing="ij")
    p, q = true_slopes(theta, z)
    top = classes(grid)[0]
    slope = -profile.normal[..., 1:] / profile.normal[..., :1]
    miss = np.degrees(np.hypot(slope[..., 0] - p, slope[..., 1] - q))[:, top]
    assert np.isfinite(miss).mean() > 0.98
    assert np.nanmedian(miss) < np.degrees(TILT_STD)
    length = np.linalg.norm(profile.normal, axis=-1)
    np.testing.assert_allclose(length[np.isfinite(length)], 1, rtol=1e-5)


def test_errors_that_neighbours_share_make_heights_less_certain(capture, profile, monkeypatch):
    grid, sections, surface, views = capture
    stds = []
    for shared in (1.0, 6.0):
        monkeypatch.setattr("treadlight.integrate.case.shared_columns", lambda *_, k=shared: k)
        found = integrate_capture(iter(views), sections, surface, grid, 0)
        stds.append(np.median(found.r_std[:, classes(grid)[0]]))
    assert stds[1] > 1.2 * stds[0]


def test_what_a_rib_leans_after_the_first_solve_is_taken_from_its_slopes(capture, monkeypatch):
    grid, sections, surface, views = capture
    top = classes(grid)[0]
    leans = []
    for lean in (0.0, 0.05):
        monkeypatch.setattr(
            "treadlight.integrate.case.lean_of_ribs", lambda *_, k=lean: np.full(len(grid.z), k)
        )
        found = integrate_capture(iter(views), sections, surface, grid, 0)
        leans.append(np.median(np.diff(found.r, axis=1)[:, top[1:] & top[:-1]]) / STEP)
    assert leans[1] - leans[0] > 0.002


def test_a_block_that_no_section_meets_stands_as_high_as_the_others(rng):
    """A dark gap cuts it off, and the last section before it met a floor 3 mm down."""
    grid = CylinderGrid.sector((0.1, 0.1 + 60 / RADIUS), (8.0, 25.0), STEP, RADIUS)
    gap, beyond = grid.theta[78:84], grid.theta[84:]

    def dark(theta, z):
        return np.isin(theta, gap)

    view = make_view(grid, rng, np.arange(len(grid.theta)), dark=dark)
    sections = make_sections(grid, rng, 12, outliers=0)
    kept = sections.theta[:, 0] < gap[0]
    few = replace(
        sections,
        **{n: getattr(sections, n)[kept] for n in ("r", "theta", "z", "r_std", "encoder")},
    )
    surface = first_surface(grid, sections)
    low = surface.r - 3.0 * (grid.theta >= gap[2])[:, None]
    found = integrate_capture([view], few, FirstSurface(low, surface.r_std), grid, 0)
    error = error_of(found, grid)[np.isin(grid.theta, beyond)]
    assert len(few.r) > 6
    assert abs(np.median(error)) < 0.5
