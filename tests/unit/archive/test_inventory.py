import hashlib
import json

import pytest

from treadlight.archive import read_capture
from treadlight.archive.inventory import angular_coverage, inventory
from treadlight.cli import main


def inspect(folder):
    capture = read_capture(folder)
    digests = {
        f.file: hashlib.sha256((folder / f.file).read_bytes()).hexdigest() for f in capture.frames
    }
    return inventory(capture, digests)


def test_counts_angles_and_exposures_of_a_measurement(make):
    found = inspect(make())
    assert {k: v["frames"] for k, v in found["kinds"].items()} == {"laser": 1, "led": 2, "dark": 1}
    assert found["kinds"]["led"]["exposure_s"] == {"min": 0.3, "max": 0.3}
    assert found["encoder_deg"]["laser"]["first"] == 1.5
    assert found["sections"] == 1
    assert found["views"][0]["missing_leds"] == [2, 3]
    assert found["mileage"] == {"value": 200.0, "unit": "mi"}


def test_the_digest_of_a_kind_changes_with_its_images_only(make):
    folder = make()
    before = inspect(folder)["kinds"]
    (folder / "b.png").write_bytes(b"other")
    after = inspect(folder)["kinds"]
    assert before["led"]["digest"] != after["led"]["digest"]
    assert before["laser"]["digest"] == after["laser"]["digest"]


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (["a.png,laser,0,,1,0.1,"], "There are no LED frames"),
        (["a.png,led,0,0,1,0.1,"], "There are no laser frames"),
        (["a.png,laser,0,,1,0.1,"], "There is no dark frame"),
        (["a.png,led,3,0,1,0.1,"], "View 3 has 1 LED frames, fewer than 4"),
        (["a.png,led,0,0,1,,", "b.png,led,0,1,1,0.1,"], "1 of 2 led frames have no exposure_s"),
    ],
)
def test_what_a_measurement_lacks_is_said(make, rows, said):
    assert any(said in text for text in inspect(make(rows=rows))["missing"])


def test_a_view_that_lacks_some_leds_names_them(make):
    rows = [f"{name}.png,led,0,{k},1,0.1," for k, name in enumerate("abcd")]
    found = inspect(make(changes={"leds": 6}, rows=rows))["missing"]
    assert "View 0 lacks frames of these LEDs: 4, 5." in found


def test_a_whole_measurement_lacks_nothing(make):
    rows = [f"{name}.png,led,0,{k},1,0.1," for k, name in enumerate("abcd")]
    rows += ["e.png,laser,0,,1,0.1,", "f.png,dark,,,,,"]
    assert inspect(make(rows=rows))["missing"] == []


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("board", "the camera cannot be calibrated"),
        ("board_laser", "no laser plane"),
        ("axis_board", "no rotation axis"),
        ("reference_board", "no reference plane"),
        ("balls", "no LED positions"),
        ("card", "the illumination is taken as even"),
    ],
)
def test_what_a_calibration_lacks_is_said(make, kind, said):
    folder = make("calibration")
    lines = (folder / "frames.csv").read_text().splitlines()
    kept = [line for line in lines if line.split(",")[1] != kind]
    (folder / "frames.csv").write_text("\n".join(kept) + "\n")
    missing = inspect(folder)["missing"]
    assert any(said in text and f"no {kind} frames" in text for text in missing)


def test_leds_without_balls_and_lines_without_boards_are_named(make):
    rows = ["a.png,balls,,0,,,", "b.png,balls,,2,,,", "c.png,board_laser,5,,,,"]
    missing = inspect(make("calibration", rows=rows))["missing"]
    assert "There are no balls frames of these LEDs: 1, 3." in missing
    assert "These board_laser poses have no board frame: 5." in missing


def test_a_digest_that_differs_is_damage(make):
    good = hashlib.sha256(b"image a").hexdigest()
    rows = [f"a.png,laser,0,,1,,{good}", f"b.png,laser,1,,2,,{good}"]
    damaged = inspect(make(rows=rows))["damaged"]
    assert len(damaged) == 1
    assert damaged[0].startswith("b.png: its content differs")


def test_coverage_of_a_whole_turn_and_of_a_sector():
    turn = angular_coverage([1.8 * k for k in range(200)])
    assert turn["whole_turn"]
    assert turn["median_step"] == pytest.approx(1.8)
    sector = angular_coverage([350.0, 355.0, 0.0, 5.0, 10.0])
    assert not sector["whole_turn"]
    assert sector["span"] == pytest.approx(20.0)
    one = angular_coverage([12.0])
    assert one["span"] == 0
    assert one["median_step"] is None


def test_the_command_writes_digests_of_all_files(make, tmp_path):
    folder, out = make(), tmp_path / "out" / "inventory.json"
    assert main(["inspect", str(folder), "--out", str(out)]) == 0
    found = json.loads(out.read_text())
    assert found["files"]["a.png"] == hashlib.sha256(b"image a").hexdigest()
    assert (out.parent / "inventory.json.provenance.json").is_file()


def test_the_command_refuses_a_bad_capture_with_its_sentence(make, tmp_path):
    folder, out = make(rows=[]), tmp_path / "inventory.json"
    assert main(["inspect", str(folder), "--out", str(out)]) == 0
    assert "lists no frame" in json.loads(out.read_text())["refused"]
