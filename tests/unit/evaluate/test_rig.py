import dataclasses

import numpy as np
import pytest

from treadlight.evaluate.rig import evaluate_rig
from treadlight.geometry import Axis, Camera, Led, Plane, Rig


@pytest.fixture
def rig():
    normal = np.array([0.96, -0.02, 0.27])
    leds = tuple(
        Led(k, np.array([200 * np.cos(k), 200 * np.sin(k), 470.0]), 0.8 + 0.1 * k) for k in range(5)
    )
    return Rig(
        camera=Camera(
            np.array([[2580.0, 0, 258], [0, 2580.0, 379], [0, 0, 1]]),
            np.array([-0.06, 0.03, 0, 0, 0]),
            (512, 768),
        ),
        laser_plane=Plane(normal / np.linalg.norm(normal), -208.0),
        axis=Axis.through(np.array([0.014, 0.9997, -0.02]), np.array([4.0, 24.0, 1156.0])),
        reference_plane=Plane(np.array([0.0, 0.0, -1.0]), 801.0),
        leds=leds,
    )


def turned(vector, axis, angle_deg):
    """Rodrigues' turn about a unit axis at right angles to the vector."""
    a = np.radians(angle_deg)
    return np.cos(a) * vector + np.sin(a) * np.cross(axis, vector)


def test_the_true_rig_has_no_error(rig):
    found = evaluate_rig(rig, rig, 355.0)
    assert found["camera"]["fx_percent"] == 0
    assert found["camera"]["ray_px"] < 1e-6
    assert found["laser_plane"]["angle_deg"] < 1e-9
    assert abs(found["laser_plane"]["offset_mm"]) < 1e-9
    assert found["axis"]["foot_mm"] == 0
    assert found["leds"]["max_mm"] == 0
    assert found["leds"]["missing"] == []


def test_focal_length_and_principal_point_are_told_apart(rig):
    matrix = rig.camera.matrix * np.array([[1.001, 1, 1], [1, 0.998, 1], [1, 1, 1]])
    matrix[0, 2] += 1.5
    camera = dataclasses.replace(rig.camera, matrix=matrix)
    found = evaluate_rig(dataclasses.replace(rig, camera=camera), rig)["camera"]
    assert found["fx_percent"] == pytest.approx(0.1)
    assert found["fy_percent"] == pytest.approx(-0.2)
    assert found["cx_px"] == pytest.approx(1.5)
    assert found["cy_px"] == pytest.approx(0)
    assert 1.4 < found["ray_px"] < 1.7


def test_a_turned_plane_is_off_by_its_angle(rig):
    point = np.array([0.0, 0.0, 208 / rig.laser_plane.normal[2]])
    axis = np.cross(rig.laser_plane.normal, [0, 1.0, 0])
    normal = turned(rig.laser_plane.normal, axis / np.linalg.norm(axis), 0.3)
    plane = Plane(normal, float(-normal @ point))
    found = evaluate_rig(dataclasses.replace(rig, laser_plane=plane), rig, 355.0)["laser_plane"]
    assert found["angle_deg"] == pytest.approx(0.3, abs=1e-6)


def test_a_shifted_plane_is_off_by_its_shift_with_either_sign(rig):
    plane = Plane(-rig.laser_plane.normal, -(rig.laser_plane.offset + 0.4))
    found = evaluate_rig(dataclasses.replace(rig, laser_plane=plane), rig, 355.0)["laser_plane"]
    assert found["angle_deg"] < 1e-6
    assert found["offset_mm"] == pytest.approx(0.4)
    card = Plane(-rig.reference_plane.normal, -(rig.reference_plane.offset - 2.0))
    found = evaluate_rig(dataclasses.replace(rig, reference_plane=card), rig)["reference_plane"]
    assert found["offset_mm"] == pytest.approx(-2.0)


def test_axis_angle_and_distances(rig):
    moved = Axis(rig.axis.direction, rig.axis.point + 0.8 * rig.axis.basis[0])
    found = evaluate_rig(dataclasses.replace(rig, axis=moved), rig)["axis"]
    assert found["angle_deg"] < 1e-9
    assert found["line_mm"] == pytest.approx(0.8)
    assert found["foot_xyz_mm"][2] < -0.75
    tilted = Axis(turned(rig.axis.direction, rig.axis.basis[0], 0.2), rig.axis.point)
    found = evaluate_rig(dataclasses.replace(rig, axis=tilted), rig)["axis"]
    assert found["angle_deg"] == pytest.approx(0.2, abs=1e-6)
    assert found["line_mm"] == pytest.approx(0, abs=1e-9)


def test_an_axis_that_turns_the_wrong_way_is_half_a_turn_off(rig):
    wrong = Axis(-rig.axis.direction, rig.axis.point)
    found = evaluate_rig(dataclasses.replace(rig, axis=wrong), rig)["axis"]
    assert found["angle_deg"] == pytest.approx(180)


def test_leds_are_matched_by_number_and_missing_ones_named(rig):
    moved = [
        dataclasses.replace(
            led, position=led.position + np.array([1.0, 2.0, 2.0]), intensity=7 * led.intensity
        )
        for led in rig.leds
    ]
    found = evaluate_rig(dataclasses.replace(rig, leds=tuple(moved[:0:-1])), rig)["leds"]
    assert found["mean_mm"] == pytest.approx(3.0)
    assert found["max_mm"] == pytest.approx(3.0)
    assert found["mean_vector_mm"] == pytest.approx([1, 2, 2])
    assert found["intensity_rms_percent"] < 1e-9
    assert found["missing"] == [0]
    other = (Led(99, np.zeros(3), 1.0),)
    alone = evaluate_rig(dataclasses.replace(rig, leds=other), rig)["leds"]
    assert alone["mean_mm"] is None
    assert alone["missing"] == [0, 1, 2, 3, 4]


def test_parts_that_one_rig_lacks_are_none(rig):
    bare = Rig(camera=rig.camera)
    found = evaluate_rig(bare, rig, 355.0)
    assert [n for n, v in found.items() if v is None] == [
        "laser_plane",
        "axis",
        "reference_plane",
        "leds",
    ]
