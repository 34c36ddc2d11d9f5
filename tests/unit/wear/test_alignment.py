import numpy as np
import pytest

from treadlight.wear import Motion, Surface, align, relief_from
from treadlight.wear.alignment import Alignment

RADIUS = 100.0


def relief(tire, grid, motion=None, wear=0.0, noise=0.02, seed=0, spoil=None):
    rng = np.random.default_rng(seed)
    r = tire.mileage(grid, motion, wear) + noise * rng.standard_normal(grid.shape)
    if spoil is not None:
        spoil(r, rng)
    return relief_from(Surface.of_arrays(r, np.full(grid.shape, noise), grid))


def uneven(theta, z):
    """0.05 to 0.25 mm: more on one shoulder and on one side of the turn."""
    return 0.15 + 0.05 * np.cos(theta) + 0.05 * z / 45


@pytest.mark.parametrize("rotation", [np.pi / 2, -2.9])
def test_a_remounted_worn_tire_is_brought_back(tire, make_grid, make_remount, rotation):
    """Rotation within 0.02 degree, axial 0.1 mm, radial and off-centre 10 um, tilt 0.1 mrad."""
    grid = make_grid("whole")
    motion = make_remount(rotation)
    found = align(relief(tire, grid), relief(tire, grid, motion, uneven, seed=1))
    assert found.reason is None
    error = found.motion.values - motion.values
    error[0] = (error[0] + np.pi) % (2 * np.pi) - np.pi
    assert abs(error[0]) < np.deg2rad(0.02)
    assert abs(error[1]) < 0.1
    assert np.abs(error[2:4]).max() < 1e-4
    assert np.abs(error[4:7]).max() < 0.01


def test_noise_gaps_and_ghosts_do_not_break_it(tire, make_grid, make_remount):
    def spoil(r, rng):
        r[rng.random(r.shape) < 0.15] = np.nan
        r[100:130] += 2.0
        r[:, 40:44] = np.nan

    grid = make_grid("whole")
    motion = make_remount(1.9)
    first = relief(tire, grid, noise=0.15, spoil=spoil)
    found = align(first, relief(tire, grid, motion, uneven, noise=0.15, seed=1, spoil=spoil))
    error = found.motion.values - motion.values
    assert abs(error[0]) < np.deg2rad(0.02)
    assert abs(error[1]) < 0.1
    assert abs(error[6]) < 0.02
    std = np.sqrt(np.diag(found.covariance))
    assert np.all(np.abs(error) < 5 * std + 1e-5)


def test_sectors_that_overlap_in_part_are_matched(tire, make_grid, make_remount):
    motion = make_remount(np.pi / 2)
    grid, other = make_grid((0.0, 1.5)), make_grid((0.5 - np.pi / 2, 2.0 - np.pi / 2))
    found = align(relief(tire, grid), relief(tire, other, motion, uneven, seed=1))
    assert found.reason is None
    assert abs(found.motion.values[0] - motion.values[0]) < 2e-3
    # Off-centre and radius are nearly one on a sector: none may run away.
    assert np.abs(found.motion.values[4:]).max() < 1.0


def test_different_pixel_sizes_do_not_matter(tire, make_grid, make_remount):
    motion = make_remount(-0.7)
    found = align(
        relief(tire, make_grid("whole")),
        relief(tire, make_grid("whole", 0.5), motion, uneven, seed=1),
    )
    assert abs(found.motion.values[0] - motion.values[0]) < np.deg2rad(0.02)
    assert abs(found.motion.values[6] - motion.values[6]) < 0.01


def test_sectors_without_overlap_are_refused_with_a_sentence(tire, make_grid):
    found = align(relief(tire, make_grid((0.0, 1.2))), relief(tire, make_grid((3.0, 4.2))))
    assert "matches the first capture's nowhere" in found.reason
    assert np.isnan(found.motion.values).all()


def test_a_tread_without_pattern_has_no_rotation(make_tire, make_grid):
    ribbed = make_tire(blocks=np.array([-50.0, -49.0]))
    grid = make_grid("whole", 1.5)
    found = align(relief(ribbed, grid, noise=0.0), relief(ribbed, grid, noise=0.0))
    assert "nothing that fixes the rotation" in found.reason


def test_without_grooves_the_pattern_still_gives_rotation_and_axial_shift(
    make_tire, make_grid, make_remount
):
    slick = make_tire(grooves=())
    grid = make_grid("whole")
    motion = make_remount(0.8, radial=0.0)
    found = align(relief(slick, grid), relief(slick, grid, motion, seed=1))
    assert found.reason is None
    assert abs(found.motion.values[0] - 0.8) < np.deg2rad(0.05)
    assert found.groove_std_mm == 0.0


def test_the_floors_texture_tells_what_walls_in_whole_cells_do_not(
    make_tire, make_grid, make_remount
):
    """Walls stand 0.6 mm off in some parts of the turn, 0.1 mm elsewhere."""
    grid, motion = make_grid("whole"), make_remount(1.9)
    far, near = (
        Motion(motion.values + np.array([0, shift, 0, 0, 0, 0, 0])) for shift in (0.6, 0.1)
    )
    aside = (np.floor(grid.theta / np.pi * 6) % 2 == 0)[:, None]

    def profile(tire, mount):
        walls = np.where(aside, tire.mileage(grid, far), tire.mileage(grid, near))
        true = tire.mileage(grid, mount)
        r = np.where(walls < true.max() - 7.0, true, walls)
        noise = 0.02 * np.random.default_rng(1).standard_normal(grid.shape)
        return relief_from(Surface.of_arrays(r + noise, np.full(grid.shape, 0.02), grid))

    errors = []
    for texture_mm in (0.0, 0.05):
        tire = make_tire(texture_mm=texture_mm)
        found = align(relief(tire, grid), profile(tire, motion))
        errors.append(found.motion.values[1] - motion.values[1])
    # Without texture the walls lead astray, else this would show nothing.
    assert errors[0] > 0.1
    assert abs(errors[1]) < 0.05


def test_ripples_of_the_rig_are_no_texture_of_the_tire(tire, make_grid, make_remount):
    """Sections every 4 mm leave scallops that stay with the rig: 0.15 of them off after the turn.

    Walls stand 0.4 mm off along theta, in parts of the turn one way or the other.
    """
    grid, count = make_grid("whole"), 157
    motion = make_remount(47.15 * 2 * np.pi / count)
    turn = np.array([0.4 / RADIUS, 0, 0, 0, 0, 0, 0])
    aside = (np.floor(grid.theta / np.pi * 6) % 2 == 0)[:, None]
    ripples = 0.03 * np.cos(count * grid.theta)[:, None]

    def measured(r, seed):
        noise = 0.02 * np.random.default_rng(seed).standard_normal(grid.shape)
        return relief_from(Surface.of_arrays(r + noise, np.full(grid.shape, 0.02), grid))

    there, back = (tire.mileage(grid, Motion(motion.values + k * turn)) for k in (1, -1))
    walls = np.where(aside, there, back)
    plain = align(measured(tire.mileage(grid), 1), measured(walls, 2))
    found = align(measured(tire.mileage(grid) + ripples, 1), measured(walls + ripples, 2))
    assert abs(found.motion.values[0] - plain.motion.values[0]) < 3e-4
    assert found.covariance[0, 0] > 0.5 * plain.covariance[0, 0]


def test_identity_is_certain():
    assert not Alignment.identity().covariance.any()
    assert Alignment.identity().reason is None


def test_wild_coarse_cells_do_not_hide_a_match(tire, make_grid, make_remount):
    """At 0.85 mm a cell is wider than the finest smoothing: single ones are no other pattern."""

    def spoil(r, rng):
        r[rng.random(r.shape) < 0.25] -= 4.0

    grid = make_grid("whole", 0.85)
    motion = make_remount(1.1)
    first = relief(tire, grid, spoil=spoil)
    found = align(first, relief(tire, grid, motion, uneven, seed=1, spoil=spoil))
    assert found.reason is None
    assert abs(found.motion.values[0] - motion.values[0]) < np.deg2rad(0.05)
