"""Round trips of the geometry, for any rig that makes sense."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from treadlight.geometry import Axis, Camera, CylinderGrid, Plane
from treadlight.geometry.axis import wrap_angle

settings.register_profile("quick", max_examples=60, deadline=None, derandomize=True)
settings.load_profile("quick")


def numbers(low, high):
    return st.floats(low, high, allow_nan=False, allow_infinity=False)


@st.composite
def cameras(draw):
    width, height = draw(st.integers(128, 7680)), draw(st.integers(128, 7680))
    focal = draw(numbers(2.0, 8.0)) * max(width, height)
    matrix = np.array(
        [
            [focal, 0, width * draw(numbers(0.4, 0.6))],
            [0, focal * draw(numbers(0.99, 1.01)), height * draw(numbers(0.4, 0.6))],
            [0, 0, 1],
        ]
    )
    lens = [draw(numbers(-0.2, 0.2)), draw(numbers(-0.2, 0.2))]
    lens += [draw(numbers(-0.002, 0.002)), draw(numbers(-0.002, 0.002)), draw(numbers(-0.2, 0.2))]
    return Camera(matrix, np.array(lens), (width, height))


@st.composite
def axes(draw):
    direction = np.array([draw(numbers(-0.3, 0.3)), draw(st.sampled_from([-1.0, 1.0])), 0.0])
    direction[2] = draw(numbers(-0.3, 0.3))
    point = [draw(numbers(-50, 50)), draw(numbers(-50, 50)), draw(numbers(600, 2000))]
    return Axis.through(direction, np.array(point))


@given(cameras(), numbers(0, 1), numbers(0, 1), numbers(100, 2000))
def test_pixel_to_ray_to_pixel(camera, across, down, depth):
    pixel = np.array([[across * camera.size_px[0], down * camera.size_px[1]]])
    assert np.allclose(camera.project(depth * camera.rays(pixel)), pixel, atol=1e-4)


@given(axes(), numbers(-3.1, 3.1), numbers(-200, 200), numbers(50, 500), numbers(-7, 7))
def test_tire_to_camera_to_tire(axis, theta, z, r, encoder):
    points = axis.to_camera(np.array([theta]), np.array([z]), np.array([r]), encoder)
    found_theta, found_z, found_r = axis.to_tire(points, encoder)
    assert abs(wrap_angle(found_theta - theta)) < 1e-9
    assert np.allclose([found_z, found_r], [[z], [r]], atol=1e-7)


@given(axes(), numbers(-3, 3), numbers(-7, 7), numbers(-1, 1), numbers(-1, 1))
def test_vectors_keep_length_and_come_back(axis, theta, encoder, x, y):
    vector = np.array([[x, y, 0.5]])
    local = axis.vectors_to_local(vector, np.array([theta]), encoder)
    assert np.allclose(np.linalg.norm(local), np.linalg.norm(vector))
    assert np.allclose(axis.vectors_to_camera(local, np.array([theta]), encoder), vector)


@given(axes(), numbers(-3, 3), numbers(-100, 100), numbers(100, 500), numbers(-1, 1))
def test_turning_the_tire_turns_points_right_handed_about_the_axis(axis, theta, z, r, angle):
    start = axis.to_camera(np.array([theta]), np.array([z]), np.array([r]), 0.0)[0] - axis.point
    turned = axis.to_camera(np.array([theta]), np.array([z]), np.array([r]), angle)[0] - axis.point
    v = axis.direction
    rodrigues = (
        start * np.cos(angle)
        + np.cross(v, start) * np.sin(angle)
        + v * (v @ start) * (1 - np.cos(angle))
    )
    assert np.allclose(turned, rodrigues, atol=1e-8)


@given(numbers(-0.3, 0.3), numbers(-0.3, 0.3), numbers(200, 2000), numbers(-0.2, 0.2))
def test_ray_meets_the_plane_on_the_plane(a, b, distance, slope):
    normal = np.array([a, b, -1.0]) / np.linalg.norm([a, b, -1.0])
    plane = Plane(normal, distance)
    met = plane.intersect(np.array([slope, -slope, 1.0]))
    assert abs(plane.distance(met)) < 1e-8 * distance


@given(numbers(-3.1, 3.1), numbers(0.1, 5.0), numbers(0.2, 3.0), numbers(100, 500), st.data())
def test_grid_cells_are_found_at_their_own_index(start, span, step, radius, data):
    grid = CylinderGrid.sector((start, start + span), (-20.0, 30.0), step, radius)
    i = data.draw(st.integers(0, grid.shape[0] - 1))
    j = data.draw(st.integers(0, grid.shape[1] - 1))
    turns = 2 * np.pi * data.draw(st.integers(-2, 2))
    row, column = grid.index(np.array(grid.theta[i] + turns), np.array(grid.z[j]))
    assert abs(row - i) < 1e-6
    assert abs(column - j) < 1e-9


@given(numbers(0.2, 5.0), numbers(50, 500), st.data())
def test_whole_turn_index_wraps(step, radius, data):
    grid = CylinderGrid.whole_turn((-5.0, 5.0), step, radius)
    i = data.draw(st.integers(0, grid.shape[0] - 1))
    turns = 2 * np.pi * data.draw(st.integers(-2, 2))
    row, _ = grid.index(np.array(grid.theta[i] + turns), np.array(0.0))
    assert min(abs(row - i), len(grid.theta) - abs(row - i)) < 1e-6
    assert grid.periodic
