"""The axis from corners of a turning board."""

import numpy as np
import pytest

from treadlight.calibrate.axis import calibrate_axis
from treadlight.calibrate.corners import object_points, symmetric_orders
from treadlight.errors import CalibrationError

ANGLES = np.radians([-20.0, -12.0, -3.0, 5.0, 14.0, 22.0])


def seen_corners(bench, angles, noise_px, rng, inner=None):
    inner = inner or bench.inner
    board = object_points(inner, bench.square_mm)
    rotation, translation = bench.reference_pose()
    found = []
    for angle in angles:
        turned, moved = bench.turned((rotation, translation), angle)
        exact = bench.camera.project(board @ turned.T + moved)
        found.append(exact + rng.normal(0, noise_px, exact.shape))
    return found


def degrees_off(found, true):
    return np.degrees(np.linalg.norm(np.cross(found.direction, true.direction)))


def millimetres_off(found, true):
    return np.linalg.norm(np.cross(found.point - true.point, true.direction))


def test_exact_corners_give_the_exact_axis(bench, rng):
    corners = seen_corners(bench, ANGLES, 0.0, rng)
    result = calibrate_axis(bench.camera, corners, ANGLES, bench.inner, bench.square_mm)
    assert degrees_off(result.axis, bench.axis) < 1e-4
    assert millimetres_off(result.axis, bench.axis) < 1e-3
    assert result.axis.direction @ bench.axis.direction > 0
    assert abs(result.axis.point @ result.axis.direction) < 1e-9
    assert result.frames == len(ANGLES)


def test_encoder_running_backwards_turns_the_axis_round(bench, rng):
    corners = seen_corners(bench, ANGLES, 0.0, rng)
    result = calibrate_axis(bench.camera, corners, -ANGLES, bench.inner, bench.square_mm)
    assert result.axis.direction @ bench.axis.direction < -0.999


def test_encoder_offset_and_wrap_do_not_matter(bench, rng):
    corners = seen_corners(bench, ANGLES, 0.0, rng)
    encoder = (ANGLES + np.radians(355)) % (2 * np.pi)
    result = calibrate_axis(bench.camera, corners, encoder, bench.inner, bench.square_mm)
    assert degrees_off(result.axis, bench.axis) < 1e-4


@pytest.mark.parametrize("inner", [(7, 5), (6, 6)])
def test_detector_may_start_at_any_corner(bench, rng, inner):
    orders = symmetric_orders(inner)
    corners = seen_corners(bench, ANGLES, 0.02, rng, inner)
    shuffled = [c[orders[rng.integers(len(orders))]] for c in corners]
    result = calibrate_axis(bench.camera, shuffled, ANGLES, inner, bench.square_mm)
    assert degrees_off(result.axis, bench.axis) < 0.05
    assert result.rms_px < 0.05


def test_frame_with_a_wrong_angle_is_left_out(bench, rng):
    corners = seen_corners(bench, ANGLES, 0.02, rng)
    encoder = ANGLES.copy()
    encoder[4] += np.radians(1.0)
    result = calibrate_axis(bench.camera, corners, encoder, bench.inner, bench.square_mm)
    assert result.frames == len(ANGLES) - 1
    assert degrees_off(result.axis, bench.axis) < 0.1


def test_axis_is_unbiased_and_its_uncertainty_covers(bench, rng):
    offsets, claimed = [], []
    for _ in range(20):
        corners = seen_corners(bench, ANGLES, 0.05, rng)
        result = calibrate_axis(bench.camera, corners, ANGLES, bench.inner, bench.square_mm)
        offsets.append(result.axis.point[2] - bench.axis.point[2])
        claimed.append(np.sqrt(result.covariance[5, 5]))
    assert abs(np.mean(offsets)) < 3 * np.mean(claimed) / np.sqrt(len(offsets))
    assert np.std(offsets) == pytest.approx(np.mean(claimed), rel=0.5)


def test_too_few_or_too_similar_angles_are_refused(bench, rng):
    corners = seen_corners(bench, ANGLES, 0.0, rng)
    with pytest.raises(CalibrationError, match="2 encoder angles"):
        calibrate_axis(bench.camera, corners[:2], ANGLES[:2], bench.inner, bench.square_mm)
    with pytest.raises(CalibrationError, match="span"):
        calibrate_axis(bench.camera, corners, np.linspace(0, 0.01, 6), bench.inner, bench.square_mm)
