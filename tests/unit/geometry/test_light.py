"""Irradiance from maps: against a plain numpy twin and against an exact source."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from treadlight.geometry import Camera, Illumination, Led, Plane, Vignetting
from treadlight.geometry.light import map_nodes

CAMERA = Camera(
    np.array([[500.0, 0, 61.0], [0, 510.0, 47.0], [0, 0, 1]]),
    np.array([-0.1, 0.05, 0.001, -0.002, 0.01]),
    (120, 90),
)
PLANE = Plane(np.array([0.0, 0.0, -1.0]), 800.0)
LEDS = (Led(0, np.array([200.0, 30.0, 400.0]), 1.0), Led(5, np.array([-50.0, 90.0, 450.0]), 0.5))


def maps(rng, step=1):
    rows, columns = map_nodes(CAMERA.size_px, step)
    smooth = 1 + 0.003 * rows[:, None] + 0.002 * columns + 1e-5 * rows[:, None] * columns
    return np.stack([smooth, 2 * smooth[::-1]]).astype(np.float32)


def plain_irradiance(light, index, points):
    """The definition, step by step."""
    position = light.leds[index].position
    offset = points - position
    reach = -light.reference_plane.distance(position) / (offset @ light.reference_plane.normal)
    pixel = light.camera.project(position + reach[..., None] * offset) / light.step_px
    strength = map_coordinates(
        light.radiant_intensity[index].astype(float),
        np.moveaxis(pixel[..., ::-1], -1, 0),
        order=1,
        mode="nearest",
    )
    return light.vignetting(points) * strength / np.sum(offset**2, axis=-1)


@pytest.mark.parametrize("step", [1, 7])
def test_kernel_is_the_definition(rng, step):
    lens = Vignetting(-2.0, 3.0, 0.02)
    light = Illumination(LEDS, PLANE, CAMERA, maps(rng, step), step, lens)
    points = rng.uniform([-120, -90, 700], [120, 90, 820], (40, 5, 3))
    for index in range(2):
        assert light.irradiance(index, points) == pytest.approx(
            plain_irradiance(light, index, points), rel=1e-6
        )


def test_constant_map_is_an_inverse_square_law(rng):
    light = Illumination(LEDS, PLANE, CAMERA, np.full((2, 90, 120), 3.0, np.float32))
    points = rng.uniform([-40, -40, 700], [40, 40, 820], (50, 3))
    squared = np.sum((points - LEDS[1].position) ** 2, axis=1)
    assert light.irradiance(1, points) == pytest.approx(3.0 / squared, rel=1e-6)


def test_point_off_the_plane_takes_its_own_direction(rng):
    """A beam that depends on the direction is met exactly 40 mm above the plane too."""
    rows, columns = map_nodes(CAMERA.size_px, 1)
    u, v = np.meshgrid(columns, rows)
    rays = CAMERA.rays(np.column_stack([u.ravel(), v.ravel()]))

    def beam(points):
        offset = points - LEDS[0].position
        return (offset[..., 2] / np.linalg.norm(offset, axis=-1)) ** 3

    table = beam(PLANE.intersect(rays)).reshape(1, *u.shape).astype(np.float32)
    light = Illumination(LEDS[:1], PLANE, CAMERA, table)
    points = rng.uniform([-30, -30, 760], [30, 30, 760], (50, 3))
    squared = np.sum((points - LEDS[0].position) ** 2, axis=1)
    assert light.irradiance(0, points) * squared == pytest.approx(beam(points), rel=2e-3)


def test_vignetting_is_the_pixels_and_constant_beyond_its_reach():
    """cos^4 of the angle off the optical axis, to second order, wherever on the ray."""
    lens = Vignetting(-2.0, 3.0, 0.04)
    points = np.array([[0.0, 0, 500], [0, 50, 500], [60, -80, 1000], [300, 0, 1000]])
    q = np.array([0, 0.01, 0.01, 0.04])
    assert lens(points) == pytest.approx(1 - 2 * q + 3 * q**2)
    assert lens(points[:3]) == pytest.approx((1 + q[:3]) ** -2, abs=1e-5)
    assert Vignetting()(points) == pytest.approx(1)


def test_unknown_points_stay_unknown_and_those_behind_the_led_are_dark(rng):
    light = Illumination(LEDS, PLANE, CAMERA, maps(rng))
    points = np.array([[np.nan, 0, 800], [0.0, 0, 300], [200.0, 100, 400], [0, 0, 800]])
    found = light.irradiance(0, points)
    assert np.isnan(found[0])
    assert list(found[1:3]) == [0, 0]
    assert found[3] > 0


def test_nodes_reach_over_the_whole_image():
    rows, columns = map_nodes((120, 90), 7)
    assert rows[0] == columns[0] == 0
    assert rows[-1] >= 89
    assert columns[-1] >= 119
    rows, columns = map_nodes((120, 90), 1)
    assert (len(rows), len(columns)) == (90, 120)
