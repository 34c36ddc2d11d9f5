"""The main job on the rendered sample archive, which no one in this project made."""

import json

import pytest

pytestmark = pytest.mark.shared

CAPTURES = ("t7-00100", "t7-00200")


@pytest.fixture(scope="module")
def report(processed, sample_archive, tmp_path_factory):
    results = tmp_path_factory.mktemp("sample") / "results"
    processed.snakemake("--config", f"archive={sample_archive}", f"results={results}")
    done = processed.run("treadlight", "evaluate", str(results), str(sample_archive), "--json")
    return json.loads(done.stdout)


def test_calibration_is_found(report):
    found = report["calibrations"]["bench-1-2020-01"]
    assert abs(found["camera"]["fx_percent"]) < 0.05
    assert abs(found["camera"]["fy_percent"]) < 0.05
    assert found["laser_plane"]["angle_deg"] < 0.05
    assert found["axis"]["angle_deg"] < 0.05
    assert found["axis"]["line_mm"] < 0.5
    assert found["axis"]["foot_mm"] < 1
    assert found["reference_plane"]["angle_deg"] < 0.2
    assert found["leds"]["mean_mm"] < 1.5
    assert found["leds"]["max_mm"] < 5


@pytest.mark.parametrize("capture", CAPTURES)
def test_profile_has_the_true_radius_and_shape(report, capture):
    figures = report["captures"][capture]
    assert figures["absolute"]["top"]["median_abs_mm"] < 0.2
    for name, limit in (("top", 0.05), ("floor", 0.06)):
        shape = figures["shape"][name]
        assert shape["median_abs_mm"] < limit
        assert shape["coverage"] > 0.97


def test_wear_is_unbiased(report):
    wear = report["wear"]["t7"]["t7-00200"]
    assert abs(wear["mean_error_mm"]) < 0.025
    assert wear["blocks"]["rms_mm"] < 0.055
    assert wear["blocks"]["correlation"] > 0.35
    assert abs(wear["alignment"]["rotation_arc_mm"]) < 0.05
