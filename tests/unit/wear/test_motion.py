import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from treadlight.wear import Motion
from treadlight.wear.motion import resample

motions = st.tuples(
    st.floats(-7, 7),
    st.floats(-20, 20),
    st.floats(-0.05, 0.05),
    st.floats(-0.05, 0.05),
    st.floats(-3, 3),
    st.floats(-3, 3),
    st.floats(-1, 1),
).map(lambda values: Motion(np.array(values)))


@given(motions, st.floats(-np.pi, np.pi), st.floats(-120, 120), st.floats(90, 400))
def test_undo_is_the_inverse_of_apply(motion, theta, z, r):
    moved = motion.apply(np.array(theta), np.array(z), np.array(r))
    back = motion.undo(*moved)
    assert abs(np.exp(1j * back[0]) - np.exp(1j * theta)) < 1e-12
    assert abs(back[1] - z) < 1e-9
    assert abs(back[2] - r) < 1e-9


def test_motion_follows_the_contract_axis_by_axis():
    """x is theta = 0, y theta = pi/2: the formula of results-contract, written out."""
    values = np.array([0.3, 2.0, 0.01, -0.02, 0.4, -0.5, 0.25])
    a, (b, c) = 0.3, (0.01, -0.02)
    rz = [[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]]
    rx = [[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]]
    ry = [[np.cos(c), 0, np.sin(c)], [0, 1, 0], [-np.sin(c), 0, np.cos(c)]]
    theta, z, r = 1.1, 17.0, 300.0
    point = np.array([r * np.cos(theta), r * np.sin(theta), z])
    expected = np.array(rz) @ rx @ ry @ point + [0.4, -0.5, 2.0]
    found = Motion(values).apply(np.array(theta), np.array(z), np.array(r))
    assert abs(found[0] - np.arctan2(expected[1], expected[0])) < 1e-12
    assert abs(found[1] - expected[2]) < 1e-9
    assert abs(found[2] - np.hypot(*expected[:2]) - 0.25) < 1e-9


def test_jacobian_is_the_derivative_of_the_motion(rng):
    motion = Motion(np.array([2.2, 1.0, 1e-4, -1e-4, 0.02, -0.01, 0.05]))
    theta, z, r = rng.uniform(-3, 3, 50), rng.uniform(-90, 90, 50), rng.uniform(290, 310, 50)
    moved = motion.apply(theta, z, r)
    found = motion.jacobian(*moved)
    for parameter in range(7):
        step = np.zeros(7)
        step[parameter] = 1e-6
        other = Motion(motion.values + step).apply(theta, z, r)
        for k, scale in enumerate((1.0, 300.0, 300.0)):
            numeric = (other[k] - moved[k]) / 1e-6
            assert np.abs(found[k][:, parameter] - numeric).max() < 5e-3 * scale


def test_resampling_undoes_a_remount_to_a_micrometre(tire, make_grid, make_remount):
    """Floors and tops, where linear and cubic interpolation are exact enough; any rotation."""
    for rotation in (0.0, np.pi / 2, -3.0):
        motion = make_remount(rotation)
        grid = make_grid("whole", 0.4)
        source = tire.mileage(grid, motion)
        theta = np.concatenate(
            [grid.theta[-3:] - 2 * np.pi, grid.theta, grid.theta[:3] + 2 * np.pi]
        )
        padded = np.concatenate([source[-3:], source, source[:3]])
        inner = slice(10, -10)
        moved, _ = resample(
            padded, padded, theta, grid.z, motion, grid.theta[::7], grid.z[inner], 104.0
        )
        truth = tire.mileage(grid)[::7, inner]
        error = np.abs(moved - truth)
        slope = np.hypot(*np.gradient(truth, 0.4 * 7, 0.4))
        assert np.median(error) < 1e-3
        assert np.quantile(error[slope < 0.02], 0.95) < 5e-3


def test_resampling_does_not_invent_cells(tire, make_grid):
    grid = make_grid((0.0, 1.0))
    source = tire.mileage(grid)
    source[20:30, 40:60] = np.nan
    moved, _std = resample(
        source, source, grid.theta, grid.z, Motion.none(), grid.theta, grid.z, 100.0
    )
    assert np.array_equal(np.isnan(moved), np.isnan(source))
    np.testing.assert_allclose(moved, source, atol=1e-4)
    outside, _ = resample(
        source, source, grid.theta, grid.z, Motion.none(), grid.theta + 2.0, grid.z, 100.0
    )
    assert np.isnan(outside).all()
