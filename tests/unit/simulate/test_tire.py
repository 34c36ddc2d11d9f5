"""The made-up tire: wear where wear belongs, mountings that move it and nothing else."""

import numpy as np
import pytest

from treadlight.simulate.tire import (
    Mounting,
    height_field,
    make_mounting,
    make_tire,
    mounted_profile,
)

STEP = 0.4


@pytest.fixture(scope="module")
def tire():
    return make_tire(3, "t1")


@pytest.fixture(scope="module")
def whole(tire):
    return height_field(tire, 0.12, STEP)


def test_turn_closes(whole):
    z = np.linspace(-100, 100, 400)
    gap = np.abs(whole(np.full(400, 1e-4), z) - whole(np.full(400, 2 * np.pi - 1e-4), z))
    assert np.median(gap) < 0.01


def test_sector_is_a_part_of_the_turn(tire, whole):
    sector = height_field(tire, 0.12, STEP, sector=(0.5, 1.2))
    theta, z = np.meshgrid(np.linspace(0.55, 1.15, 200), np.linspace(-90, 90, 200))
    assert np.median(np.abs(sector(theta, z) - whole(theta, z))) < 0.005
    assert np.isnan(sector(0.4, 0.0))
    assert np.isnan(whole(0.7, 130.0))


def test_wear_takes_the_tops_and_leaves_groove_floors(tire, whole):
    worn = height_field(tire, 0.36, STEP)
    loss = whole.grid - worn.grid
    depth = whole.envelope[0] - whole.grid
    z = np.arange(loss.shape[1]) / whole.meta[3] + whole.meta[2]
    tread = np.abs(z) < 85
    assert np.abs(loss[:, tread][depth[:, tread] > 4]).max() < 1e-4
    tops = loss[:, tread][depth[:, tread] < 1]
    assert tops.mean() == pytest.approx(0.24, rel=0.1)
    assert tops.min() > 0.1
    assert tops.std() > 0.02


def test_grooves_are_deep_enough_and_have_wear_bars(tire, whole):
    for middle, _, depth, _ in tire.grooves:
        j = round((middle - whole.meta[2]) * whole.meta[3])
        below = whole.grid[:, j - 40 : j + 40].max() - whole.grid[:, j]
        assert np.median(below) == pytest.approx(depth, abs=1.3)
        bars = below < np.median(below) - 1.0
        assert 0.01 < bars.mean() < 0.1


def test_other_seeds_and_names_are_other_tires(tire):
    assert not np.array_equal(tire.pitches, make_tire(4, "t1").pitches)
    assert not np.array_equal(tire.pitches, make_tire(3, "t2").pitches)
    assert np.array_equal(tire.tile, make_tire(3, "t1").tile)


def test_unmoved_tire_keeps_its_profile(whole):
    still = Mounting(0.0, 0.0, (0.0, 0.0), (0.0, 0.0), 0.0, 0.0)
    theta, z = np.linspace(0.1, 0.4, 50), np.linspace(-80, 80, 60)
    found = mounted_profile(whole, still, theta, z)
    assert np.abs(found - whole(theta[:, None], z[None])).max() < 1e-3


def test_mounted_points_lie_on_the_tire(whole, rng):
    """Carried back by the inverse motion, every point of the profile is on the surface."""
    mounting = make_mounting(rng, 4.0)
    field = whole.with_radial(mounting.radius_change_mm)
    theta, z = np.linspace(-3, 3, 60), np.linspace(-80, 80, 70)
    r = mounted_profile(field, mounting, theta, z).astype(float)
    x = r * np.cos(theta)[:, None], r * np.sin(theta)[:, None], np.broadcast_to(z, r.shape)
    body = (np.stack(x, axis=-1) - mounting.shift) @ mounting.rotation
    radius = np.hypot(body[..., 0], body[..., 1])
    expected = whole(np.arctan2(body[..., 1], body[..., 0]), body[..., 2])
    assert np.isfinite(r).all()
    assert np.abs(radius - expected - mounting.radius_change_mm).max() < 0.01


def test_mounting_is_a_rigid_motion(rng):
    rotation = make_mounting(rng, 0.0).rotation
    assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)
