import numpy as np
import pytest

from treadlight.evaluate import remount
from treadlight.evaluate.truth import Profile

FIRST = {
    "mounting": {
        "rotation_deg": 31.7,
        "axial_mm": 1.3,
        "tilt_deg": [0.12, -0.15],
        "ecc_mm": [0.21, -0.12],
        "radius_change_mm": 0.0,
    },
    "hub_z_mm": -16.7,
}
LATER = {
    "mounting": {
        "rotation_deg": -58.4,
        "axial_mm": -0.9,
        "tilt_deg": [-0.17, 0.06],
        "ecc_mm": [-0.08, 0.25],
        "radius_change_mm": 0.14,
    },
    "hub_z_mm": -16.7,
}


def test_alignment_takes_the_later_tire_into_the_first_frame(rng):
    first, later = remount.read_mounting(FIRST), remount.read_mounting(LATER)
    tire = rng.normal(0, 200, (50, 3))
    here = tire @ first.rotation.T + first.shift
    there = tire @ later.rotation.T + later.shift
    rot, axial, tilt_x, tilt_y, off_x, off_y, radial = remount.true_alignment(first, later)
    turn = remount._rz(rot) @ remount._rx(tilt_x) @ remount._ry(tilt_y)
    assert there @ turn.T + [off_x, off_y, axial] == pytest.approx(here, abs=1e-9)
    assert np.degrees(rot) == pytest.approx(90.1, abs=0.1)
    assert radial == pytest.approx(-0.14)


def test_errors_of_an_alignment_wrap_and_show_on_the_tread():
    true = np.array([np.pi - 0.001, 1.0, 0, 0, 0, 0, 0.1])
    found = np.array([-np.pi + 0.001, 1.5, 1e-3, 0, 0.2, 0, 0.0])
    figures = remount.alignment_figures(found, true, 350.0)
    assert figures["rotation_rad"] == pytest.approx(0.002)
    assert figures["rotation_arc_mm"] == pytest.approx(0.7)
    assert figures["axial_mm"] == pytest.approx(0.5)
    assert figures["radial_mm"] == pytest.approx(-0.1)


def test_a_rig_without_mounting_has_none():
    assert remount.read_mounting({"rig": "bench"}) is None


@pytest.fixture
def worn(truth, rng):
    """A smooth wear map that spares the grooves, at the truth's cells."""
    wear = 0.1 + 0.05 * np.sin(truth.theta * 355 / 10)[:, None] * np.cos(truth.z / 8)
    return Profile(truth.theta, truth.z, np.where(truth.r < 350, 0.0, wear))


def test_true_wear_has_no_error(truth, worn):
    found = remount.evaluate_wear(worn, truth, truth.theta, truth.z, worn.r)
    assert found["mean_error_mm"] == pytest.approx(0, abs=1e-12)
    assert found["coverage"] == 1.0
    assert found["cells"] == (worn.r > 0.02).sum()
    assert found["blocks"]["rms_mm"] < 1e-9
    assert found["blocks"]["correlation"] == pytest.approx(1.0)
    assert "wear_std" not in found


def test_wear_bias_and_noise_of_block_means(truth, worn, rng):
    measured = worn.r + 0.03 + rng.normal(0, 0.05, worn.r.shape)
    std = np.full(worn.r.shape, 0.05)
    found = remount.evaluate_wear(worn, truth, truth.theta, truth.z, measured, std)
    assert found["mean_error_mm"] == pytest.approx(0.03, abs=0.002)
    assert found["measured_mean_mm"] - found["true_mean_mm"] == pytest.approx(0.03, abs=0.002)
    # 144 cells of 0.4 mm share a block at most.
    assert found["blocks"]["rms_mm"] == pytest.approx(np.hypot(0.03, 0.05 / 12), rel=0.05)
    assert found["blocks"]["correlation"] > 0.9
    assert found["wear_std"]["top"]["shape"]["inside_1"] == pytest.approx(0.683, abs=0.02)
    assert found["wear_std"]["top"]["absolute"]["inside_1"] < 0.65


def test_blocks_count_only_when_more_than_half_filled(truth, worn):
    measured = worn.r.copy()
    full = remount.evaluate_wear(worn, truth, truth.theta, truth.z, measured)["blocks"]["n"]
    measured[::2] = np.nan
    found = remount.evaluate_wear(worn, truth, truth.theta, truth.z, measured)
    assert found["coverage"] == pytest.approx(0.5, abs=0.01)
    assert found["blocks"]["n"] < full / 2
    nothing = remount.evaluate_wear(worn, None, truth.theta, truth.z, measured * np.nan)
    assert nothing["mean_error_mm"] is None
    assert nothing["blocks"] == {"n": 0, "rms_mm": None, "correlation": None}


def test_unrelated_wear_does_not_correlate(truth, worn, rng):
    measured = 0.1 + rng.normal(0, 0.1, worn.r.shape)
    found = remount.evaluate_wear(worn, truth, truth.theta, truth.z, measured)
    assert abs(found["blocks"]["correlation"]) < 0.3
