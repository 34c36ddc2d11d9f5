import numpy as np
import pytest

from treadlight.evaluate import surface
from treadlight.evaluate.truth import Profile


def test_envelope_bridges_grooves_and_follows_the_crown(truth):
    envelope = surface.outer_envelope(truth)
    crown = 355.0 - truth.z**2 / 2000
    outside = np.abs(np.abs(truth.z) - 14) > 5
    inner = np.abs(truth.z) < 19  # at the border the closing has one side only
    assert np.abs(envelope - crown)[outside & inner].max() < 0.15
    bottom = np.abs(np.abs(truth.z) - 14) < 3
    assert (envelope - truth.r[0])[bottom].min() > 7.0


def test_classes_are_where_the_tread_was_built(truth):
    found = surface.classify(truth, surface.outer_envelope(truth))
    along = truth.theta * 355.0
    groove = np.abs(np.abs(truth.z) - 14) < 2
    assert found["floor"][:, groove].mean() > 0.99
    assert found["floor"][:, np.abs(truth.z) < 9].sum() == 0
    middle = np.ix_(np.abs(along - 20) < 0.7, np.abs(truth.z) < 7)
    assert found["slot"][middle].all()
    assert found["wall"][np.ix_(np.abs(along + 20) < 0.4, np.abs(truth.z) < 7)].all()
    assert found["top"][np.ix_(np.abs(along) < 15, np.abs(truth.z) < 7)].all()
    assert np.array_equal(found["deep"], found["floor"] | found["slot"])


def test_tops_keep_one_millimetre_from_walls(truth):
    found = surface.classify(truth, surface.outer_envelope(truth))
    rows, columns = np.nonzero(found["wall"])
    for row, column in list(zip(rows, columns, strict=True))[::501]:
        near = np.hypot((truth.theta - truth.theta[row])[:, None] * 355, truth.z - truth.z[column])
        assert not found["top"][near < 0.9].any()


def test_texture_is_no_wall(rng):
    theta, z = np.arange(100) * 0.001, np.arange(100) * 0.35
    truth = Profile(theta, z, 355 + rng.normal(0, 0.05, (100, 100)))
    found = surface.classify(truth, surface.outer_envelope(truth))
    assert found["wall"].mean() < 0.01
    assert found["top"].mean() > 0.97


def test_missing_truth_belongs_to_no_class(truth):
    truth.r[:, :20] = np.nan
    truth.r[50, 60] = np.nan
    found = surface.look_up(truth, truth.theta, truth.z)
    for mask in found.classes.values():
        assert not mask[:, :20].any()
        assert not mask[50, 60]
    assert np.isfinite(found.r[:, 20:50]).all()


def test_interpolation_is_linear_and_stops_at_the_border(truth):
    plane = truth.theta[:, None] * 3 + truth.z[None, :] * 0.5
    theta = np.array([truth.theta[3] + 0.3e-3, truth.theta[-1] + 1e-3])
    z = np.array([truth.z[5] + 0.17, truth.z[-1], truth.z[0] - 0.1])
    found = surface.interpolate(truth, plane, theta, z)
    assert found[0, :2] == pytest.approx(theta[0] * 3 + z[:2] * 0.5, abs=1e-12)
    assert np.isnan(found[1]).all()
    assert np.isnan(found[0, 2])


def test_a_missing_neighbour_without_a_share_brings_no_nan(truth):
    values = truth.r.copy()
    values[11, 21] = np.nan
    found = surface.interpolate(truth, values, truth.theta[10:11], truth.z[20:21])
    assert found[0, 0] == values[10, 20]
    halfway = surface.interpolate(truth, values, truth.theta[10:12].mean()[None], truth.z[21:22])
    assert np.isnan(halfway[0, 0])


@pytest.mark.parametrize("turns", [-2, -1, 1])
def test_angles_are_compared_modulo_a_turn(truth, turns):
    found = surface.look_up(truth, truth.theta + 2 * np.pi * turns, truth.z)
    assert np.nanmax(np.abs(found.r - truth.r)) < 1e-6
    assert found.extent["top"] == 1.0


def test_scattered_points_agree_with_the_grid(truth, rng):
    theta = rng.uniform(truth.theta[0], truth.theta[-1], 40)
    z = rng.uniform(truth.z[0], truth.z[-1], 40)
    grid = surface.interpolate(truth, truth.r, theta, z)
    assert surface.interpolate_at(truth, truth.r, theta, z) == pytest.approx(np.diag(grid))


def test_a_whole_turn_has_no_border(whole_turn):
    between = np.array([np.pi - 0.3 * (2 * np.pi / 471)])
    found = surface.interpolate(whole_turn, whole_turn.r, between, whole_turn.z)
    expected = 0.7 * whole_turn.r[0] + 0.3 * whole_turn.r[-1]
    assert found[0] == pytest.approx(expected, abs=1e-6)


def test_classes_of_a_whole_turn_do_not_depend_on_where_it_starts(whole_turn):
    rolled = Profile(whole_turn.theta, whole_turn.z, np.roll(whole_turn.r, 200, axis=0))
    here = surface.classify(whole_turn, surface.outer_envelope(whole_turn))
    there = surface.classify(rolled, surface.outer_envelope(rolled))
    for name in surface.CLASSES:
        assert np.array_equal(np.roll(here[name], 200, axis=0), there[name])


def test_extent_tells_what_a_small_grid_leaves_out(truth):
    found = surface.look_up(truth, truth.theta[: len(truth.theta) // 2], truth.z)
    assert found.extent["floor"] == pytest.approx(0.5, abs=0.01)
    assert surface.look_up(truth, truth.theta, truth.z).extent["floor"] == 1.0


def test_normals_of_a_cone_lean_by_its_slope():
    theta, z = np.arange(60) * 0.001, np.arange(50) * 0.3
    cone = Profile(theta, z, np.broadcast_to(300 + 0.2 * z, (60, 50)).copy())
    normal = surface.true_normals(cone, 0.2)[5:-5, 5:-5]
    assert normal[..., 2] / normal[..., 0] == pytest.approx(-0.2, abs=1e-6)
    assert np.abs(normal[..., 1]).max() < 1e-12


def test_normals_of_an_eccentric_cylinder_lean_along_theta():
    theta, z = np.linspace(-0.5, 0.5, 400), np.arange(20) * 0.5
    r = np.repeat((300 + 2 * np.sin(theta))[:, None], 20, axis=1)
    normal = surface.true_normals(Profile(theta, z, r), 0.1)[10:-10, 10]
    expected = -2 * np.cos(theta) / (300 + 2 * np.sin(theta))
    assert normal[:, 1] / normal[:, 0] == pytest.approx(expected[10:-10], abs=1e-6)
