"""Camera calibration from corners whose truth is known."""

import cv2
import numpy as np
import pytest

from treadlight.calibrate.camera import board_pose, calibrate_camera
from treadlight.calibrate.corners import find_corners, object_points, symmetric_orders
from treadlight.calibrate.saddle import fit_saddles
from treadlight.errors import CalibrationError


def corner_pairs(bench, count, noise_px, rng):
    board = object_points(bench.inner, bench.square_mm)
    return [
        (
            bench.camera.project(board @ rotation.T + translation)
            + rng.normal(0, noise_px, (len(board), 2)),
            board,
        )
        for rotation, translation in bench.poses(count)
    ]


def test_focal_length_is_unbiased_and_its_uncertainty_covers(bench, rng):
    errors, claimed = [], []
    for _ in range(12):
        found = calibrate_camera(corner_pairs(bench, 12, 0.03, rng), bench.size_px)
        errors.append(found.camera.matrix[0, 0] - bench.focal)
        claimed.append(np.sqrt(found.covariance[0, 0]))
    assert abs(np.mean(errors)) < 3 * np.mean(claimed) / np.sqrt(len(errors))
    assert np.std(errors) == pytest.approx(np.mean(claimed), rel=0.6)


def test_rms_is_the_noise_of_the_corners(bench, rng):
    found = calibrate_camera(corner_pairs(bench, 12, 0.05, rng), bench.size_px)
    assert found.rms_px == pytest.approx(0.05 * np.sqrt(2), rel=0.15)
    assert found.poses == 12


def test_pose_with_wrong_corners_is_left_out(bench, rng):
    pairs = corner_pairs(bench, 10, 0.03, rng)
    pairs[3] = (pairs[3][0] + rng.normal(0, 2.0, pairs[3][0].shape), pairs[3][1])
    found = calibrate_camera(pairs, bench.size_px)
    assert found.poses == 9
    assert found.camera.matrix[0, 0] == pytest.approx(bench.focal, rel=0.005)


def test_distortion_that_noise_hides_is_held_at_zero(bench, rng):
    found = calibrate_camera(corner_pairs(bench, 10, 0.3, rng), bench.size_px)
    assert abs(found.camera.distortion[4]) < 50
    assert found.covariance[8, 8] == 0 or found.camera.distortion[4] != 0


def test_parallel_boards_are_refused(bench, rng):
    board = object_points(bench.inner, bench.square_mm)
    pairs = []
    for k in range(6):
        points = board - board.mean(axis=0) + [3.0 * k, -2.0 * k, 800.0]
        pairs.append((bench.camera.project(points) + rng.normal(0, 0.1, (len(board), 2)), board))
    with pytest.raises(CalibrationError, match="tilted"):
        calibrate_camera(pairs, bench.size_px)


def test_too_few_boards_are_refused(bench, rng):
    with pytest.raises(CalibrationError, match=r"found in 3 frames, 4 are needed"):
        calibrate_camera(corner_pairs(bench, 3, 0.03, rng), bench.size_px)


def test_board_pose_recovers_plane_and_board_coordinates(bench):
    board = object_points(bench.inner, bench.square_mm)
    for rotation, translation in bench.poses(4):
        points = board @ rotation.T + translation
        pose = board_pose(bench.camera, bench.camera.project(points), board)
        assert pose.rms_px < 1e-4
        assert np.allclose(pose.to_board(points), board, atol=1e-3)
        assert np.abs(pose.plane.distance(points)).max() < 1e-3
        assert pose.plane.distance(np.zeros(3)) > 0


def corner_errors(found, true):
    order = np.argmin(np.linalg.norm(found[:, None] - true, axis=2), axis=1)
    assert sorted(order) == list(range(len(true)))
    return found - true[order]


def test_corners_are_unbiased_and_certain_to_a_fiftieth_of_a_pixel(bench):
    board = object_points(bench.inner, bench.square_mm)
    errors = []
    for rotation, translation in bench.poses(3):
        found = find_corners(bench.board(rotation, translation), bench.inner)
        true = bench.camera.project(board @ rotation.T + translation)
        errors.append(corner_errors(found, true))
    errors = np.concatenate(errors)
    assert np.abs(errors.mean(axis=0)).max() < 0.01
    assert errors.std() < 0.02


def test_corners_are_as_certain_as_opencvs_or_more(bench):
    """Side by side on the same images: cornerSubPix with the window that served it best."""
    board = object_points(bench.inner, bench.square_mm)
    ours, theirs = [], []
    for rotation, translation in bench.poses(4):
        image = bench.board(rotation, translation)
        true = bench.camera.project(board @ rotation.T + translation)
        found = find_corners(image, bench.inner)
        stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-4)
        start = found.astype(np.float32).reshape(-1, 1, 2)
        gradient = cv2.cornerSubPix(image, start, (9, 9), (-1, -1), stop).reshape(-1, 2)
        ours.append(corner_errors(found, true))
        theirs.append(corner_errors(gradient.astype(float), true))
    assert np.std(ours) < 0.7 * np.std(theirs)


def test_soft_boards_in_large_images_are_found_in_smaller_ones(bench):
    rotation, translation = bench.poses(1)[0]
    small = bench.board(rotation, translation)
    large = cv2.resize(small, (1931, 2563), interpolation=cv2.INTER_CUBIC)
    scale = np.array([1931 / 240, 2563 / 320])
    a, b = find_corners(small, bench.inner), find_corners(large, bench.inner)
    offset = (b + 0.5) / scale - 0.5 - a
    assert np.abs(offset.mean(axis=0)).max() < 0.01
    assert np.abs(offset).max() < 0.1


def test_images_without_boards_have_no_corners(bench):
    assert find_corners(np.zeros((96, 128), np.float32), bench.inner) is None


@pytest.mark.parametrize("shift", [0.0, 0.37])
def test_saddle_at_the_border_of_the_image_is_placed_as_well(shift):
    """Half of the disk lies outside; a blurred edge product that the test renders itself."""
    at = np.array([[[5.2 + shift, 4.1], [25.2 + shift, 4.1]], [[5.2, 24.1], [25.2, 24.1]]])
    y, x = np.mgrid[:30, :31] + 0.0
    spacing = np.pi / 20
    across, down = np.sin((x - 5.2 - shift) * spacing), np.sin((y - 4.1) * spacing)
    image = np.tanh(6 * across) * np.tanh(6 * down)
    found = fit_saddles(image.astype(np.float32), np.round(at), 8)
    assert np.abs(found.position[:2] - at[0]).max() < 0.03


def test_symmetric_orders_turn_the_board_in_its_plane():
    assert len(symmetric_orders((9, 6))) == 2
    assert len(symmetric_orders((6, 6))) == 4
    board = object_points((5, 4), 10.0)
    half_turn = board[symmetric_orders((5, 4))[1]]
    assert np.allclose(half_turn[:, :2], board[:, :2].max(axis=0) - board[:, :2])


@pytest.mark.shared
def test_photographed_boards_calibrate_as_published(shared_real):
    """OpenCV's left sample camera: 0.41 px RMS and f = 536.1 px were computed elsewhere."""
    files = sorted((shared_real / "checkerboards").rglob("left*.jpg"))
    assert len(files) >= 10
    images = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) / np.float32(255) for path in files]
    board = object_points((9, 6), 25.0)
    found = calibrate_camera([(find_corners(image, (9, 6)), board) for image in images], (640, 480))
    assert found.rms_px <= 0.2  # 0.19 by cornerSubPix
    assert found.camera.matrix[0, 0] == pytest.approx(535, rel=0.01)
