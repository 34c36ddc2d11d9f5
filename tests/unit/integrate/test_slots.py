"""A ribbed tread with cuts across: slots that sections meet, one that none meets, a sipe."""

from dataclasses import replace

import numpy as np
import pytest

from treadlight.geometry import CylinderGrid
from treadlight.integrate import FirstSurface, LaserSections, ViewNormals, integrate_capture
from treadlight.integrate.gather import view_field
from treadlight.integrate.laser import LaserCells, laser_cells
from treadlight.integrate.patches import find_patches
from treadlight.integrate.slots import _briefly, _cut_lines, _lost_share, _off_tread, close_cuts

RADIUS = 300.0
STEP = 0.5
LASER_STD = 0.1
TILT_STD = np.radians(1.5)
SLOT_MM = 6.0
# Middle of each cut at z = 0, mm along the tread, and half its width; cuts lean by LEAN mm per mm.
SLOTS = ((11.0, 2.0), (36.0, 2.0), (61.0, 2.0))
UNMET = (83.5, 2.0)
SIPE = (48.0, 0.5)
LEAN = 0.15
GROOVE = (14.0, 3.0)


def across(theta, z, cut):
    """Distance (mm) from the middle of a cut."""
    return np.abs((theta - 0.1) * RADIUS - cut[0] - LEAN * z)


def inside(theta, z, cut):
    return (across(theta, z, cut) < cut[1]) & (np.abs(z) < 10)


def true_radius(theta, z):
    r = RADIUS - 0.002 * z**2 - 8.0 * (np.abs(z - GROOVE[0]) < GROOVE[1])
    for cut in (*SLOTS, UNMET):
        r = r - SLOT_MM * inside(theta, z, cut)
    return r - 4.0 * inside(theta, z, SIPE)


def top_radius(z):
    return RADIUS - 0.002 * z**2


@pytest.fixture(scope="module")
def grid():
    return CylinderGrid.sector((0.1, 0.1 + 100 / RADIUS), (-20.0, 20.0), STEP, RADIUS)


@pytest.fixture(scope="module")
def view(grid):
    """Normals of the tread; in and beside cuts they lean towards the wall and do not fit."""
    rng = np.random.default_rng(3)
    theta, z = np.meshgrid(grid.theta, grid.z, indexing="ij")
    p = rng.normal(0, TILT_STD, theta.shape)
    q = -0.004 * z + rng.normal(0, TILT_STD, theta.shape)
    poor = np.zeros(theta.shape, bool)
    for cut in (*SLOTS, UNMET, SIPE):
        near = (across(theta, z, cut) < cut[1] + STEP) & (np.abs(z) < 10)
        p = np.where(near, 0.4, p)
        poor |= inside(theta, z, cut)
    normal = np.stack([np.ones_like(p), -p, -q], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    normal[np.abs(np.abs(z - GROOVE[0]) - GROOVE[1]) < 0.6] = np.nan
    covariance = np.zeros((*p.shape, 3))
    covariance[..., [0, 2]] = TILT_STD**2
    none = np.zeros(p.shape, bool)
    material = np.full((*p.shape, 3), 0.3)
    return ViewNormals(normal, covariance, top_radius(z), theta, z, material, none, none, poor)


@pytest.fixture(scope="module")
def sections(grid):
    """Twelve sections; they meet the slots' middles and pass by the one slot and the sipe."""
    rng = np.random.default_rng(4)
    at = np.array([2.5, 11, 19, 28, 36, 43, 53, 61, 69, 77, 90.5, 97])
    theta = (0.1 + at / RADIUS)[:, None] + 0 * grid.z
    # The lines follow the cuts' lean, as on a tire whose slots run along the axis.
    theta = theta + LEAN * np.clip(grid.z, -10, 10) / RADIUS
    z = np.broadcast_to(grid.z, theta.shape)
    r = true_radius(theta, z) + rng.normal(0, LASER_STD, theta.shape)
    return LaserSections(r, theta, z, np.full(r.shape, LASER_STD), -theta[:, 0], 1.0)


@pytest.fixture(scope="module")
def surface(grid, sections):
    """The nearest section's point in each column: cuts are blocks as wide as the spacing."""
    r = np.empty(grid.shape)
    for j in range(grid.shape[1]):
        nearest = np.abs(grid.theta[:, None] - sections.theta[:, j]).argmin(axis=1)
        r[:, j] = sections.r[nearest, j]
    return FirstSurface(r, np.full(r.shape, LASER_STD))


@pytest.fixture(scope="module")
def profile(grid, view, sections, surface):
    return integrate_capture(iter([view]), sections, surface, grid, 0)


@pytest.fixture(scope="module")
def places(grid):
    theta, z = np.meshgrid(grid.theta, grid.z, indexing="ij")
    return theta, z


def test_tops_stay_level_up_to_the_edges_of_slots(grid, profile, places):
    theta, z = places
    top = np.abs(z) < 9
    for cut in (*SLOTS, UNMET, SIPE):
        top &= across(theta, z, cut) > cut[1] + 3 * STEP
    error = (profile.r - true_radius(theta, z))[top]
    assert np.isfinite(error).all()
    assert abs(np.median(error)) < 0.03
    assert np.sqrt(np.mean(error**2)) < LASER_STD


@pytest.mark.parametrize("cut", SLOTS)
def test_slots_are_as_deep_as_the_sections_that_met_them_say(profile, places, cut):
    theta, z = places
    floor = (across(theta, z, cut) < cut[1] - 2 * STEP) & (np.abs(z) < 8)
    error = (profile.r - true_radius(theta, z))[floor]
    assert np.median(np.abs(error)) < 0.15
    assert np.max(np.abs(error)) < 0.6


def test_a_slot_that_no_section_met_is_as_deep_as_its_like(profile, places):
    theta, z = places
    floor = (across(theta, z, UNMET) < UNMET[1] - 2 * STEP) & (np.abs(z) < 8)
    assert np.median(profile.r[floor]) == pytest.approx(RADIUS - SLOT_MM, abs=0.3)


def test_a_sipe_of_unknown_depth_has_no_radius(profile, places):
    theta, z = places
    middle = (across(theta, z, SIPE) < 0.5 * STEP) & (np.abs(z) < 8)
    assert np.isnan(profile.r[middle]).mean() > 0.9
    beside = (across(theta, z, SIPE) > SIPE[1] + 3 * STEP) & (across(theta, z, SIPE) < 4)
    assert np.isfinite(profile.r[beside & (np.abs(z) < 8)]).all()


def test_edges_of_slots_lie_where_the_photometry_sees_them(profile, places):
    """The sections alone leave them open by half their distance, 4 mm."""
    theta, z = places
    rows = np.abs(z[0]) < 8
    deep = np.nan_to_num(top_radius(z) - profile.r) > 0.5 * SLOT_MM
    for cut in SLOTS:
        near = across(theta, z, cut) < 8
        width = (deep & near)[:, rows].sum(axis=0) * STEP
        assert np.median(width) == pytest.approx(2 * cut[1], abs=2 * STEP)


def test_grooves_are_no_cuts(profile, places):
    _, z = places
    floor = np.abs(z - GROOVE[0]) < GROOVE[1] - 1
    error = (profile.r - (top_radius(z) - 8.0))[floor]
    assert np.isfinite(error).all()
    assert np.median(np.abs(error)) < LASER_STD


def test_cuts_across_the_end_of_a_whole_turn_are_one():
    n = 240
    grid = CylinderGrid(
        -np.pi + np.arange(n) * (2 * np.pi / n), np.arange(-5, 5, STEP), n * STEP / 2 / np.pi
    )
    theta, z = np.meshgrid(grid.theta, grid.z, indexing="ij")
    rng = np.random.default_rng(5)
    normal = np.zeros((*theta.shape, 3))
    normal[..., 0] = 1
    normal[..., 1:] = rng.normal(0, TILT_STD, (*theta.shape, 2))
    cut = np.pi - np.abs(theta) < 4 * grid.step_theta
    none = np.zeros(theta.shape, bool)
    radius = grid.nominal_radius_mm
    view = ViewNormals(
        normal, np.full((*theta.shape, 3), TILT_STD**2), np.full(theta.shape, radius), theta, z,
        normal, none, none, cut,
    )  # fmt: skip
    line = np.linspace(-np.pi, np.pi, 20, endpoint=False)[:, None] + 0 * grid.z
    depth = np.where(np.pi - np.abs(line) < 4 * grid.step_theta, SLOT_MM, 0)
    laser = laser_cells(
        radius - depth, line, np.broadcast_to(grid.z, line.shape), np.full(line.shape, LASER_STD),
        np.zeros((2, *grid.shape)), grid,
    )  # fmt: skip
    start = np.full(grid.shape, radius)
    start[cut] -= SLOT_MM
    closed = close_cuts(
        [view_field([view], grid)], start, LASER_STD, laser, lambda r: 0 * r, 12.0, 1.0, grid
    )
    assert closed.slots.count == 1
    assert closed.in_slot.sum() == len(grid.z)
    np.testing.assert_allclose(closed.r, radius, atol=1e-9)


@pytest.mark.parametrize("rows", [np.arange(240), np.r_[:90, 200:240]])
def test_a_lip_that_is_broken_all_around_is_not_interpolated_from_a_slots_mouth(rng, rows):
    """Nor where it is broken for a part of the turn that is long beside the sections' distance."""
    grid = CylinderGrid((np.arange(240) - 120) * STEP / RADIUS, np.arange(0, 20, STEP), RADIUS)
    theta, z = np.meshgrid(grid.theta, grid.z, indexing="ij")
    lip = np.zeros(grid.shape, bool)
    lip[rows, 20:23] = True
    normal = np.stack([np.ones_like(theta), *rng.normal(0, TILT_STD, (2, *grid.shape))], axis=-1)
    none = np.zeros(theta.shape, bool)
    view = ViewNormals(
        normal, np.full((*theta.shape, 3), TILT_STD**2), np.full(theta.shape, RADIUS), theta, z,
        normal, none, none, lip,
    )  # fmt: skip
    mouth = slice(40, 52)
    start = np.full(grid.shape, RADIUS)
    start[mouth, 20:23] -= SLOT_MM
    # No section lies in the mouth: nothing says that the first surface there is not the tread.
    met = np.setdiff1d(np.arange(4, 240, 12), [40])
    line = grid.theta[met, None] + 0 * grid.z
    laser = laser_cells(
        start[met], line, np.broadcast_to(grid.z, line.shape), np.full(line.shape, LASER_STD),
        np.zeros((2, *grid.shape)), grid,
    )  # fmt: skip
    closed = close_cuts(
        [view_field([view], grid)], start, LASER_STD, laser, lambda r: (RADIUS - r) / 8, 12.0,
        1.0, grid,
    )  # fmt: skip
    away = np.r_[:24, 68:240]
    np.testing.assert_allclose(closed.r[away], RADIUS, atol=1e-9)


@pytest.mark.parametrize("periodic", [False, True])
@pytest.mark.parametrize("last", [1, 6])
def test_a_cut_at_a_grids_end_is_one_as_anywhere(periodic, last):
    step = 2 * np.pi / 240 if periodic else STEP / RADIUS
    grid = CylinderGrid(-np.pi + np.arange(240) * step, np.arange(0, 5, STEP), STEP / step)
    mask = np.zeros(grid.shape, bool)
    mask[-last:] = mask[100:106] = True
    np.testing.assert_array_equal(_briefly(mask, np.ones(240, bool), grid), mask)


def test_the_tread_is_where_sections_pass_by_the_slots_even_if_most_meet_one(rng):
    """Five of seven neighbouring sections lie in slots: their median is a slot's floor."""
    grid = CylinderGrid((np.arange(240) - 120) * STEP / RADIUS, np.arange(-5, 5, STEP), RADIUS)
    theta, z = np.meshgrid(grid.theta, grid.z, indexing="ij")
    at = (np.arange(-58, 59, 6) + 0.25) / RADIUS
    met = np.abs(np.arange(len(at)) - 9.5) < 4
    met[[7, 12]] = False
    cut = (np.abs(theta[..., None] - at[met]) < 4 * STEP / RADIUS).any(axis=-1)
    normal = np.zeros((*theta.shape, 3))
    normal[..., 0] = 1
    normal[..., 1:] = rng.normal(0, TILT_STD, (*theta.shape, 2))
    none = np.zeros(theta.shape, bool)
    view = ViewNormals(
        normal, np.full((*theta.shape, 3), TILT_STD**2), np.full(theta.shape, RADIUS), theta, z,
        normal, none, none, cut,
    )  # fmt: skip
    line = at[:, None] + 0 * grid.z
    value = RADIUS - SLOT_MM * met[:, None] + 0 * line
    laser = laser_cells(
        value, line, np.broadcast_to(grid.z, line.shape), np.full(line.shape, LASER_STD),
        np.zeros((2, *grid.shape)), grid,
    )  # fmt: skip
    start = value[np.abs(grid.theta[:, None] - at).argmin(axis=1)]
    closed = close_cuts(
        [view_field([view], grid)], start, LASER_STD, laser, lambda r: 0 * r, 12.0, 1.0, grid
    )
    assert met.sum() > 5
    np.testing.assert_allclose(closed.r, RADIUS, atol=1e-9)
    np.testing.assert_array_equal(closed.on_tread, laser.value == RADIUS)


def test_a_slot_is_closed_where_its_section_lost_the_line(grid, view, sections, surface, places):
    """The first surface holds there what it took from the columns beside: the slot's floor."""
    theta, z = places
    lost = np.abs(grid.z - 1.0) < 1.1 * STEP
    r = sections.r.copy()
    r[4, lost] = np.nan
    broken = replace(sections, r=r)
    profile = integrate_capture(iter([view]), broken, surface, grid, 0)
    near = lost[None] & (across(theta, z, SLOTS[1]) < 6) & (across(theta, z, SLOTS[1]) > 3)
    assert near.sum() > 20
    assert np.abs(profile.r - true_radius(theta, z))[near].max() < 5 * LASER_STD


def test_a_dark_ring_is_no_cut_even_where_views_see_less_than_half_of_it(rng):
    """Two of five rows are seen; all laser points there are lost, so that only length tells."""
    grid = CylinderGrid((np.arange(200) - 100) * 0.4 / 300, (np.arange(60) - 30) * 0.4, 300.0)
    dark = np.zeros(grid.shape, np.float32)
    dark[:80] = rng.normal(0, 0.02, (80, 60))
    dark[:80, 40] += 0.5
    dark[30:50, 10] += 0.5
    rows = np.arange(5, 200, 10)
    row, column = np.concatenate([rows, rows]), np.repeat([40, 10], len(rows))
    flat, number = np.full(len(row), 300.0), np.tile(np.arange(len(rows)), 2)
    laser = LaserCells(row, column, flat, np.full(len(row), 0.1), number)
    lines = _cut_lines(dark, laser, np.ones(len(row), bool), grid)
    assert not lines[:, 40].any()
    assert (lines[32:48, 10] > 0).all()


@pytest.mark.parametrize(("row", "is_cut"), [(31, True), (34, False)])
def test_a_section_that_brushes_a_slots_rim_says_little_of_it(row, is_cut):
    """Five of nine points are on the tread: at the rim that is the lip, in the middle no cut is."""
    grid = CylinderGrid((np.arange(100) - 50) * STEP / RADIUS, np.arange(20) * STEP, RADIUS)
    mask = np.zeros(grid.shape, bool)
    mask[31:39, 1:18] = mask[61:69, 1:18] = True
    brushed, met = np.arange(5, 14), np.arange(5, 16)
    column = np.concatenate([brushed, met])
    rows = np.repeat([row, 65], [len(brushed), len(met)])
    lost = np.concatenate([brushed >= 10, np.ones(len(met), bool)])
    laser = LaserCells(rows, column, 0.0 * rows, 0.0 * rows, rows)
    share = _lost_share(find_patches(mask, grid), laser, lost, grid)
    assert share[1] > 0.9
    assert (share[0] > 0.5) == is_cut


def test_a_lips_few_calm_points_in_a_groove_do_not_make_the_tread_one():
    """Of a column that a lip breaks nearly all around, the unbroken part lies in a wider groove."""
    grid = CylinderGrid((np.arange(240) - 120) * STEP / RADIUS, np.arange(-5, 5, STEP), RADIUS)
    broken = np.ones(grid.shape, bool)
    broken[100:140] = False
    row = np.arange(4, 240, 8)
    deep = ~broken[row, 3]
    value = RADIUS - SLOT_MM * deep
    count = len(row)
    laser = LaserCells(row, np.full(count, 3), value, np.full(count, LASER_STD), np.arange(count))
    depth = np.zeros(grid.shape[1])
    off = _off_tread(laser, find_patches(broken, grid), depth, LASER_STD, grid)
    assert deep.sum() >= 3
    assert not off[~deep].any()
