import dataclasses

import numpy as np
import pytest

from treadlight.cylinder import FLAGS, closure_mm, on_tops, register_sections
from treadlight.geometry import CylinderGrid
from treadlight.tread import find_regions

NOMINAL = 300.0
GHOST, OUTLIER, NONE = (1 << FLAGS.index(name) for name in ("ghost", "outlier", "none"))


def in_camera(rig, encoder, r, lines=80):
    """Candidates (sections, lines, 1, 3) of a surface with r per section and line."""
    z = np.linspace(-20, 20, lines)
    theta = np.full(lines, 0.05) - encoder[:, None]
    points = rig.axis.to_camera(theta, z, r, encoder[:, None])
    return points[:, :, None, :]


def register(rig, points, path, encoder, flags=None, deviation=None):
    flags = np.zeros(path.shape, np.uint8) if flags is None else flags
    deviation = np.zeros(points.shape) if deviation is None else deviation
    return register_sections(points, deviation, path, flags, encoder, rig.axis, NOMINAL)


@pytest.fixture
def encoder():
    return np.radians(np.arange(12) * 2.0)


@pytest.fixture
def tread(rng):
    r = np.full((12, 80), NOMINAL) + 0.03 * rng.standard_normal((12, 80))
    r[:, 30:50] -= 8
    return r


def test_points_come_back_in_the_tire_frame(rig, encoder, tread):
    points = in_camera(rig, encoder, tread)
    found = register(rig, points, np.zeros(tread.shape, int), encoder)
    np.testing.assert_allclose(found.r, tread, atol=1e-9)
    np.testing.assert_allclose(found.theta, np.broadcast_to(0.05 - encoder[:, None], tread.shape))
    np.testing.assert_allclose(found.z[0], np.linspace(-20, 20, 80), atol=1e-9)
    assert not found.quality.any()


def test_reflection_in_a_groove_gives_way_to_the_floor_that_the_neighbours_see(rig, encoder, tread):
    ghost = tread.copy()
    ghost[5, 32:48] += 4.5
    points = np.concatenate([in_camera(rig, encoder, r) for r in (ghost, tread)], axis=2)
    found = register(rig, points, np.zeros(tread.shape, int), encoder)
    np.testing.assert_allclose(found.r, tread, atol=1e-9)
    assert np.all(found.quality[5, 32:48] & GHOST)
    assert np.sum(found.quality & GHOST > 0) == 16


def test_stripe_split_at_a_slot_that_some_neighbours_share_is_left_out(rig, encoder, tread):
    split = tread.copy()
    split[5, 5:10] -= 2
    # Six of eight neighbours vouch for the top; two have a slot there as well.
    split[[3, 8], 4:11] -= 6
    whole = tread.copy()
    points = np.concatenate([in_camera(rig, encoder, r) for r in (split, whole)], axis=2)
    found = register(rig, points, np.zeros(tread.shape, int), encoder)
    assert np.isnan(found.r[5, 5:10]).all()
    assert np.all(found.quality[5, 5:10] == GHOST | NONE)


def test_lateral_slot_of_one_section_is_kept(rig, encoder, tread):
    tread[6, 60:70] -= 7
    found = register(rig, in_camera(rig, encoder, tread), np.zeros(tread.shape, int), encoder)
    np.testing.assert_allclose(found.r, tread, atol=1e-9)


def test_single_stray_points_and_impossible_radii_are_outliers(rig, encoder, tread):
    wrong = tread.copy()
    wrong[4, 20] += 3
    wrong[7, 60:70] = 2 * NOMINAL
    found = register(rig, in_camera(rig, encoder, wrong), np.zeros(tread.shape, int), encoder)
    lost = np.zeros(tread.shape, bool)
    lost[4, 20] = True
    lost[7, 60:70] = True
    assert np.array_equal(np.isnan(found.r), lost)
    assert np.all(found.quality[lost] & OUTLIER)
    assert not np.any(found.quality[~lost])


def test_r_std_is_the_radial_part_of_the_deviation_plus_the_slope_term(rig, encoder):
    r = np.full((12, 80), NOMINAL)
    r[:, 40:] += 0.5 * np.arange(40)
    points = in_camera(rig, encoder, r)
    theta = np.broadcast_to(0.05 - encoder[:, None], r.shape)
    local = np.zeros((*r.shape, 3))
    local[..., 0] = 0.1
    deviation = rig.axis.vectors_to_camera(local, theta, encoder[:, None])[:, :, None, :]
    found = register(rig, points, np.zeros(r.shape, int), encoder, deviation=deviation)
    np.testing.assert_allclose(found.r_std[:, 1:38], 0.1, rtol=1e-6)
    # A uniform place within the row: 0.29 rows of 0.5 mm.
    np.testing.assert_allclose(found.r_std[:, 45:78], np.hypot(0.1, 0.29 * 0.5), rtol=1e-6)


def test_no_sections_register_to_none(rig):
    empty = register(rig, np.empty((0, 80, 4, 3)), np.empty((0, 80), int), np.empty(0))
    assert empty.r.shape == (0, 80)
    assert np.isnan(closure_mm(empty, np.ones(empty.r.shape, bool)))


def test_closure_is_the_miss_of_overlapping_sections(sections_of, grooved):
    encoder = np.radians(np.arange(0, 367, 2.0))
    found = sections_of(grooved, encoder)
    tops = found.r > np.nanmax(found.r) - 1.0
    assert closure_mm(found, tops) == pytest.approx(0, abs=1e-3)
    last = encoder >= 2 * np.pi - 1e-9
    drifted = dataclasses.replace(found, r=found.r + np.where(last, 0.15, 0)[:, None])
    assert closure_mm(drifted, tops) == pytest.approx(0.15, abs=1e-3)
    # The rest is of no account, be it the greater part.
    few = tops & (np.arange(found.r.shape[1]) % 4 == 0)
    sunk = dataclasses.replace(found, r=found.r - np.where(few, 0, 0.3) * last[:, None])
    assert closure_mm(sunk, few) == pytest.approx(0, abs=1e-3)


def test_sure_points_count_for_more_in_the_closure_and_stray_ones_for_nothing(
    sections_of, grooved, rng
):
    encoder = np.radians(np.arange(0, 367, 2.0))
    found = sections_of(grooved, encoder)
    last = (encoder >= 2 * np.pi - 1e-9)[:, None]
    std = np.where(np.arange(found.r.shape[1]) % 2, 0.02, 0.5) * np.ones(found.r.shape)
    r = found.r + last * np.where(std > 0.1, 0.3, 0.0)
    r[-1, ::9] += 5.0
    noisy = dataclasses.replace(found, r=r, r_std=std)
    assert closure_mm(noisy, np.ones(r.shape, bool)) < 0.01


def test_closure_is_unknown_without_overlap(sections_of, grooved):
    found = sections_of(grooved, np.radians(np.arange(0, 360, 2.0)))
    assert np.isnan(closure_mm(found, np.ones(found.r.shape, bool)))


def test_tops_are_the_ribs_without_grooves_and_slots(sections_of, grooved):
    found = sections_of(grooved, np.radians(np.arange(0, 360, 2.0)))
    found.r[7, 20:30] -= 5.0
    found.r[9, 40] = np.nan
    grid = CylinderGrid(np.radians(np.arange(-180, 180, 1.0)), np.arange(-45, 45, 0.5), NOMINAL)
    regions = find_regions(grooved(*np.meshgrid(grid.theta, grid.z, indexing="ij")), grid)
    tops = on_tops(found, regions)
    inside = np.abs(found.z[0]) < 35
    expected = (np.abs(found.z - 12) > 5) & np.isfinite(found.r)
    expected[7, 20:30] = False
    wrong = (tops != expected)[:, inside]
    # A column at the groove's edge is either.
    assert wrong.any(axis=0).sum() <= 2
