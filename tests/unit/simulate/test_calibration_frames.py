"""Boards, balls and cards: what is drawn is where the truth says."""

import cv2
import numpy as np
import pytest

from treadlight.simulate import calibration, sensor
from treadlight.simulate.rig import BEAM_COS_POWER, make_rig
from treadlight.simulate.settings import preset


@pytest.fixture(scope="module")
def sim():
    return make_rig(preset("demo", leds=3, seed=2))


def true_corners(sim, board, pose):
    nx, ny = board.inner_corners
    x, y = np.meshgrid(np.arange(nx) - (nx - 1) / 2, np.arange(ny) - (ny - 1) / 2)
    flat = np.column_stack([x.ravel(), y.ravel(), np.zeros(nx * ny)]) * board.square_mm
    return sim.camera.project(flat @ pose[:3, :3].T + pose[:3, 3])


def corner_errors(sim, board, pose):
    """Found minus true corners; the image is doubled, since the detector wants large squares."""
    image = sensor.blur(calibration.render_board(sim, board, pose))
    large = cv2.resize((255 * np.clip(image, 0, 1)).astype(np.uint8), None, fx=2, fy=2)
    good, corners = cv2.findChessboardCornersSB(large, board.inner_corners)
    assert good
    found = (corners.reshape(-1, 2) + 0.5) / 2 - 0.5
    true = true_corners(sim, board, pose)
    nearest = np.linalg.norm(found[:, None] - true, axis=2).argmin(axis=1)
    assert len(set(nearest)) == len(true)
    return found - true[nearest]


def test_board_corners_are_where_the_pose_puts_them(sim):
    errors = np.concatenate([corner_errors(sim, sim.board, p) for p in sim.board_poses[:4]])
    assert np.abs(errors.mean(axis=0)).max() < 0.03
    assert np.sqrt(np.mean(errors**2)) < 0.08


def test_axis_board_turns_about_the_axis(sim):
    """Its corners keep their place in {T}, and it is found at the first and last angle."""
    board, places = sim.axis_board, []
    for encoder in sim.axis_encoders_deg:
        pose = sim.axis_board_pose(encoder)
        theta, z, r = sim.axis.to_tire(pose[:3, 3], np.radians(encoder))
        places.append([np.cos(theta), np.sin(theta), z, r])
    assert np.ptp(np.array(places), axis=0).max() < 1e-9
    for encoder in (sim.axis_encoders_deg[0], sim.axis_encoders_deg[-1]):
        errors = corner_errors(sim, board, sim.axis_board_pose(encoder))
        assert np.sqrt(np.mean(errors**2)) < 0.1


@pytest.mark.parametrize("size", [(128, 192), (288, 192), (384, 256), (320, 320), (512, 768)])
@pytest.mark.parametrize("scan", ["rows", "columns"])
def test_boards_and_balls_are_inside_every_kind_of_image(size, scan):
    sim = make_rig(preset("demo", size_px=size, scan=scan, seed=3))
    points = [true_corners(sim, sim.board, p) for p in (*sim.board_poses, sim.reference_pose)]
    points += [
        true_corners(sim, sim.axis_board, sim.axis_board_pose(e)) for e in sim.axis_encoders_deg
    ]
    points.append(sim.camera.project(sim.ball_centres))
    points = np.concatenate(points)
    assert np.all(points > 0)
    assert np.all(points < np.array(size) - 1)


def test_laser_on_a_board_lies_in_the_laser_plane(sim):
    pose = sim.board_poses[1]
    image = calibration.render_board_laser(sim, sim.board, pose).astype(float)
    rows = np.nonzero(image.max(axis=1) > 0.5)[0]
    assert len(rows) > 40
    u = (image[rows] * np.arange(image.shape[1])).sum(axis=1) / image[rows].sum(axis=1)
    rays = sim.camera.rays(np.column_stack([u, rows]))
    normal, origin = pose[:3, 2], pose[:3, 3]
    points = rays * ((normal @ origin) / (rays @ normal))[:, None]
    away = sim.laser_plane.distance(points)
    assert abs(np.median(away)) < 0.02
    assert np.median(np.abs(away)) < 0.05


def test_highlights_obey_the_law_of_reflection(sim):
    led, radius = sim.rig.leds[1], 0.5 * sim.ball_diameter_mm
    points = calibration.highlight_points(sim.ball_centres, radius, led)
    normals = (points - sim.ball_centres) / radius
    assert np.linalg.norm(normals, axis=1) == pytest.approx(np.ones(len(points)))
    seen = points / np.linalg.norm(points, axis=1, keepdims=True)
    mirrored = seen - 2 * np.sum(seen * normals, axis=1, keepdims=True) * normals
    to_led = led.position - points
    to_led /= np.linalg.norm(to_led, axis=1, keepdims=True)
    assert np.abs(mirrored - to_led).max() < 1e-6


def test_balls_rest_on_the_reference_plane(sim):
    away = sim.reference_plane.distance(sim.ball_centres)
    assert away == pytest.approx(np.full(len(away), sim.ball_diameter_mm / 2))


def test_highlights_are_the_brightest_spots_of_their_balls(sim):
    light = 0.3 * calibration.render_balls(sim, 0)
    image = calibration.add_highlights(light, sim, 0, 0.9)
    points = calibration.highlight_points(
        sim.ball_centres, 0.5 * sim.ball_diameter_mm, sim.rig.leds[0]
    )
    for u, v in sim.camera.project(points):
        column, row = round(u), round(v)
        patch = image[row - 4 : row + 5, column - 4 : column + 5].astype(float)
        patch = np.maximum(patch - 0.1, 0)
        y, x = np.mgrid[row - 4 : row + 5, column - 4 : column + 5]
        assert (patch * x).sum() / patch.sum() == pytest.approx(u, abs=0.1)
        assert (patch * y).sum() / patch.sum() == pytest.approx(v, abs=0.1)


def test_balls_are_dark_before_the_card_and_cast_shadows(sim):
    card, balls = calibration.render_card(sim, 0), calibration.render_balls(sim, 0)
    assert np.all(balls <= card + 1e-6)
    for u, v in sim.camera.project(sim.ball_centres):
        assert balls[round(v), round(u)] < 0.5 * card[round(v), round(u)]


def test_card_is_lambertian_under_a_near_light(sim):
    uv = np.array([[20, 30], [96, 144], [180, 250]])
    points = sim.reference_plane.intersect(sim.camera.rays(uv))
    image = calibration.render_card(sim, 2)
    led = sim.rig.leds[2]
    to_led = led.position - points
    distance = np.linalg.norm(to_led, axis=1)
    cosine = -(to_led @ sim.beams[2]) / distance
    facing = to_led @ sim.reference_plane.normal / distance
    light = led.intensity * cosine**BEAM_COS_POWER * facing * (400 / distance) ** 2
    expected = calibration.CARD_ALBEDO * light
    assert image[uv[:, 1], uv[:, 0]] == pytest.approx(expected, rel=1e-4)
