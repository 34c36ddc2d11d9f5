"""The laser plane from points and from rendered lines."""

import numpy as np
import pytest

from treadlight.calibrate.camera import BoardPose
from treadlight.calibrate.laser_plane import board_line_points, fit_laser_plane
from treadlight.errors import CalibrationError


def line_groups(bench, count, noise_mm, rng):
    """Noisy points of the laser plane along lines at several depths."""
    normal = bench.laser_plane.normal
    along = np.cross(normal, [0.0, 0.0, 1.0])
    along /= np.linalg.norm(along)
    groups = []
    for k in range(count):
        across = np.cross(along, normal) * (20.0 * (k - count / 2))
        t = rng.uniform(-80, 80, (150, 1))
        points = np.array([0.0, 0.0, 800.0]) + across + t * along
        groups.append(points + rng.normal(0, noise_mm, (150, 1)) * normal)
    return groups


def test_plane_is_found_despite_outliers(bench, rng):
    groups = line_groups(bench, 6, 0.05, rng)
    groups[2][:10] += 30.0
    result = fit_laser_plane(groups)
    assert np.abs(result.plane.normal @ bench.laser_plane.normal) > 1 - 1e-7
    assert result.plane.offset == pytest.approx(bench.laser_plane.offset, abs=0.1)
    assert result.distances_mm.mean() == pytest.approx(0.05 * np.sqrt(2 / np.pi), rel=0.1)
    assert 880 <= len(result.distances_mm) <= 891
    assert result.poses == 6


def test_plane_covariance_follows_errors_that_poses_share(bench, rng):
    offsets, claimed = [], []
    for _ in range(60):
        groups = line_groups(bench, 8, 0.02, rng)
        shared = [g + rng.normal(0, 0.1) * bench.laser_plane.normal for g in groups]
        result = fit_laser_plane(shared)
        offsets.append(result.plane.offset - bench.laser_plane.offset)
        claimed.append(np.sqrt(result.covariance[3, 3]))
    assert np.std(offsets) == pytest.approx(np.median(claimed), rel=0.5)


def test_too_few_poses_and_one_single_line_are_refused(bench, rng):
    groups = line_groups(bench, 5, 0.01, rng)
    with pytest.raises(CalibrationError, match="2 boards"):
        fit_laser_plane([*groups[:2], np.empty((0, 3))])
    with pytest.raises(CalibrationError, match="coincide"):
        fit_laser_plane([groups[0], groups[0], groups[0]])


def test_points_lie_on_the_laser_plane_without_pull_by_the_squares(bench):
    offsets = []
    for rotation, translation in bench.poses(3):
        pose = BoardPose(rotation, translation, 0.0)
        image = bench.board_laser(rotation, translation)
        pixels = board_line_points(image, pose, bench.camera, bench.inner, bench.square_mm, "rows")
        assert len(pixels) > 50
        points = pose.plane.intersect(bench.camera.rays(pixels))
        offsets.append(bench.laser_plane.distance(points))
    offsets = np.concatenate(offsets)
    assert abs(np.mean(offsets)) < 0.02
    assert np.std(offsets) < 0.08


def test_dark_frame_gives_no_points(bench):
    pose = BoardPose(*bench.poses(1)[0], 0.0)
    dark = np.zeros(bench.size_px[::-1], np.float32)
    found = board_line_points(dark, pose, bench.camera, bench.inner, bench.square_mm, "rows")
    assert found.shape == (0, 2)


def test_board_outside_the_image_gives_no_points(bench):
    rotation, translation = bench.poses(1)[0]
    pose = BoardPose(rotation, translation + np.array([2000.0, 0, 0]), 0.0)
    image = np.ones(bench.size_px[::-1], np.float32)
    found = board_line_points(image, pose, bench.camera, bench.inner, bench.square_mm, "rows")
    assert len(found) == 0
