import numpy as np
import pytest

from treadlight.geometry import Axis, Camera, Plane, Rig
from treadlight.laser import triangulate_pixels

CAMERA = Camera(
    np.array([[900.0, 0, 160], [0, 900.0, 120], [0, 0, 1]]),
    np.array([-0.05, 0.02, 1e-4, -2e-4, 0.0]),
    (320, 240),
)
NORMAL = np.array([0.96, 0.02, 0.28]) / np.linalg.norm([0.96, 0.02, 0.28])
RIG = Rig(CAMERA, Plane(NORMAL, -220.0), Axis.through([0, 1, 0], [0, 0, 1200]))


def seen_points(scan):
    """Points of the laser plane and the pixels at which the camera sees them."""
    along = np.linspace(-60, 60, 25)
    depth = np.linspace(780, 800, 25)
    x = (220.0 - NORMAL[1] * along - NORMAL[2] * depth) / NORMAL[0]
    points = np.column_stack([x, along, depth])
    return points, CAMERA.project(points)


def test_points_come_back_from_their_pixels():
    points, uv = seen_points("rows")
    # One section whose line index is fractional in truth: give each its own integer row.
    rows = np.rint(uv[:, 1]).astype(int)
    rays = CAMERA.rays(np.column_stack([uv[:, 0], rows]))
    expected = RIG.laser_plane.intersect(rays)
    u = np.full((1, 240, 1), np.nan)
    u[0, rows, 0] = uv[:, 0]
    found, _ = triangulate_pixels(u, np.full(u.shape, 0.1), "rows", RIG)
    np.testing.assert_allclose(found[0, rows, 0], expected, atol=1e-9)
    assert np.abs(RIG.laser_plane.distance(found[0, rows, 0])).max() < 1e-9
    np.testing.assert_allclose(found[0, rows, 0], points, atol=0.6)
    assert np.isnan(found[0, np.setdiff1d(np.arange(240), rows)]).all()


def test_deviation_is_the_displacement_of_one_standard_deviation():
    u = np.full((1, 240, 1), 150.0)
    std = np.full(u.shape, 0.2)
    points, deviation = triangulate_pixels(u, std, "rows", RIG)
    moved, _ = triangulate_pixels(u + 0.2, std, "rows", RIG)
    np.testing.assert_allclose(points + deviation, moved, atol=2e-3)


def test_columns_scan_takes_the_line_index_as_the_column():
    u = np.full((1, 320, 1), 100.0)
    found, _ = triangulate_pixels(u, np.ones(u.shape), "columns", RIG)
    uv = CAMERA.project(found[0, :, 0])
    np.testing.assert_allclose(uv[:, 0], np.arange(320), atol=1e-4)
    np.testing.assert_allclose(uv[:, 1], 100.0, atol=1e-4)


@pytest.mark.parametrize("shape", [(0, 240, 4), (0, 0, 4)])
def test_no_sections_give_no_points_even_without_a_laser_plane(shape):
    points, deviation = triangulate_pixels(np.empty(shape), np.empty(shape), "rows", Rig(CAMERA))
    assert points.shape == deviation.shape == (*shape, 3)
