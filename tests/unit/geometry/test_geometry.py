"""Camera, plane, axis and grid against numbers worked out by hand."""

import cv2
import numpy as np
import pytest

from treadlight.geometry import Axis, Camera, CylinderGrid, Plane
from treadlight.geometry.axis import wrap_angle

CAMERA = Camera(
    np.array([[500.0, 0, 60.0], [0, 510.0, 45.0], [0, 0, 1]]),
    np.array([-0.1, 0.05, 0.001, -0.002, 0.01]),
    (120, 90),
)


def test_projection_is_opencvs(rng):
    points = rng.uniform([-90, -70, 700], [90, 70, 900], (50, 3))
    expected, _ = cv2.projectPoints(
        points, np.zeros(3), np.zeros(3), CAMERA.matrix, CAMERA.distortion
    )
    assert np.allclose(CAMERA.project(points), expected[:, 0], atol=1e-9)


def test_point_on_the_optical_axis_is_at_the_principal_point():
    assert np.allclose(CAMERA.project(np.array([0.0, 0, 400])), [60, 45])
    assert np.allclose(CAMERA.rays(np.array([[60.0, 45.0]])), [[0, 0, 1]], atol=1e-9)


def test_point_behind_the_camera_has_no_pixel():
    assert np.isnan(CAMERA.project(np.array([[1.0, 2, -3], [0, 0, 0]]))).all()


def test_no_pixels_have_no_rays():
    assert CAMERA.rays(np.empty((0, 2))).shape == (0, 3)


def test_pixel_rays_are_those_of_pixel_centres():
    rays = CAMERA.pixel_rays()
    assert rays.shape == (90, 120, 3)
    assert np.allclose(rays[7, 30], CAMERA.rays(np.array([[30.0, 7.0]]))[0])


def test_plane_is_met_in_front_of_the_camera_only():
    plane = Plane(np.array([0.0, 0, -1.0]), 800.0)
    rays = np.array([[0.1, 0.2, 1.0], [0, 0, -1.0], [1.0, 0, 0]])
    met = plane.intersect(rays)
    assert np.allclose(met[0], [80, 160, 800])
    assert np.isnan(met[1:]).all()


def test_fitted_plane_holds_its_points(rng):
    points = rng.uniform(-50, 50, (30, 3))
    points[:, 2] = 0.3 * points[:, 0] - 0.2 * points[:, 1] + 700
    plane = Plane.fit(points)
    assert np.abs(plane.distance(points)).max() < 1e-9
    assert np.linalg.norm(plane.normal) == pytest.approx(1)


def test_tire_frame_as_the_format_defines_it():
    """Axis along camera y, 1000 mm away: theta is 0 towards the camera, z is the height."""
    axis = Axis.through(np.array([0.0, 2.0, 0]), np.array([0.0, 55.0, 1000.0]))
    assert np.allclose(axis.point, [0, 0, 1000])
    theta, z, r = axis.to_tire(np.array([0.0, 12.0, 650.0]), 0.0)
    assert (theta, z, r) == pytest.approx((0, 12, 350))
    # y x (towards the camera = -z) = -x: theta grows to the left of the image.
    theta, _, _ = axis.to_tire(np.array([-350.0, 0, 1000.0]), 0.0)
    assert theta == pytest.approx(np.pi / 2)
    # The camera looks at theta = -encoder.
    theta, _, _ = axis.to_tire(np.array([0.0, 0, 650.0]), 0.4)
    assert theta == pytest.approx(-0.4)


def test_local_basis_at_the_front_points_at_the_camera():
    axis = Axis.through(np.array([0.0, 1.0, 0]), np.array([0.0, 0, 1000.0]))
    local = axis.vectors_to_local(np.array([0.0, 0, -1.0]), np.array(-0.3), 0.3)
    assert np.allclose(local, [1, 0, 0])


def test_whole_turn_is_periodic_and_closes():
    grid = CylinderGrid.whole_turn((-20.0, 20.0), 5.0, 100.0)
    assert grid.periodic
    assert len(grid.theta) * grid.step_theta == pytest.approx(2 * np.pi)
    assert grid.shape == (126, 9)
    row, _ = grid.index(np.array(grid.theta[0] - grid.step_theta), np.array(0.0))
    assert row == pytest.approx(len(grid.theta) - 1)


def test_sector_past_pi_is_open_and_increasing():
    grid = CylinderGrid.sector((3.0, 3.6), (0.0, 10.0), 1.0, 100.0)
    assert not grid.periodic
    assert -np.pi <= grid.theta[0] < np.pi
    assert grid.theta[-1] > np.pi
    row, column = grid.index(np.array([3.3 - 2 * np.pi]), np.array([4.0]))
    assert row == pytest.approx(30, abs=1e-6)
    assert column == pytest.approx(4)


@pytest.mark.parametrize("rows", [np.arange(3, 9), (np.arange(20) - 7) % 126])
def test_part_of_a_turn_has_the_angles_of_its_rows(rows):
    grid = CylinderGrid.whole_turn((0.0, 5.0), 5.0, 100.0)
    part = grid.part(rows)
    assert not part.periodic
    assert part.step_theta == pytest.approx(grid.step_theta)
    assert -np.pi <= part.theta[0] < np.pi
    np.testing.assert_allclose(wrap_angle(part.theta - grid.theta[rows]), 0, atol=1e-9)
    assert grid.part(np.arange(126)) is grid


def test_wrap_keeps_minus_pi():
    assert wrap_angle(np.array([np.pi, -np.pi, 2 * np.pi])) == pytest.approx([-np.pi, -np.pi, 0])
