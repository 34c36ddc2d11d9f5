"""The calibration commands, from a rendered capture to calibration.json and illumination.zarr."""

import json
from pathlib import Path

import numpy as np
import pytest

from treadlight import store
from treadlight.cli import main
from treadlight.geometry import Plane


def calibrate(capture: Path, out: Path) -> dict:
    """All calibration commands, as the pipeline runs them."""
    parts = {name: out / f"{name}.json" for name in ("camera", "laser_plane", "axis", "leds")}
    camera = ["--camera", str(parts["camera"])]
    calls = [
        ["calibrate-camera", str(capture), "--out", str(parts["camera"])],
        ["calibrate-laser-plane", str(capture), *camera, "--out", str(parts["laser_plane"])],
        ["calibrate-axis", str(capture), *camera, "--out", str(parts["axis"])],
        ["calibrate-leds", str(capture), *camera, "--out", str(parts["leds"])],
    ]
    joined = ["calibrate", str(capture), *camera, "--laser-plane", str(parts["laser_plane"])]
    joined += ["--axis", str(parts["axis"]), "--leds", str(parts["leds"])]
    calls.append([*joined, "--out", str(out / "calibration.json")])
    maps = ["calibrate-illumination", str(capture), "--calibration", str(out / "calibration.json")]
    calls.append([*maps, "--out", str(out / "illumination.zarr" / "zarr.json")])
    for call in calls:
        assert main([*call, "--threads", "2"]) == 0
    return json.loads((out / "calibration.json").read_text())


def without(capture: Path, copy: Path, kinds: set[str]) -> Path:
    """A capture's copy without the frames of some kinds."""
    copy.mkdir()
    for image in capture.glob("*.png"):
        (copy / image.name).write_bytes(image.read_bytes())
    (copy / "capture.yaml").write_text((capture / "capture.yaml").read_text())
    header, *rows = (capture / "frames.csv").read_text().splitlines()
    kept = [row for row in rows if row.split(",")[1] not in kinds]
    (copy / "frames.csv").write_text("\n".join([header, *kept]) + "\n")
    return copy


@pytest.fixture(scope="module")
def calibrated(calibration_capture, tmp_path_factory):
    out = tmp_path_factory.mktemp("calibrated")
    return calibrate(calibration_capture, out), out


def angle(a: np.ndarray, b: np.ndarray) -> float:
    """Degrees between two lines."""
    return float(np.degrees(np.arccos(np.clip(abs(np.dot(a, b)), 0, 1))))


def test_camera_of_the_rendered_bench_is_found(bench, calibrated):
    found = np.array(calibrated[0]["camera"]["matrix"])
    assert found[0, 0] == pytest.approx(bench.focal, rel=0.004)
    assert found[:2, 2] == pytest.approx(bench.camera.matrix[:2, 2], abs=5)
    assert calibrated[0]["camera"]["poses"] >= 12
    assert calibrated[0]["camera"]["reprojection_rms_px"] < 0.1


def test_planes_and_axis_of_the_rendered_bench_are_found(bench, calibrated):
    content = calibrated[0]
    laser = np.array(content["laser_plane"]["coefficients"])
    assert angle(laser[:3], bench.laser_plane.normal) < 0.2
    assert np.linalg.norm(laser[:3]) == pytest.approx(1, abs=1e-9)
    reference = np.array(content["reference_plane"]["coefficients"])
    assert angle(reference[:3], bench.reference_plane.normal) < 0.5
    assert reference[3] == pytest.approx(bench.reference_plane.offset, rel=0.005)
    direction = np.array(content["axis"]["direction"])
    assert direction @ bench.axis.direction > 0
    assert angle(direction, bench.axis.direction) < 0.3
    offset = np.array(content["axis"]["point"]) - bench.axis.point
    assert np.linalg.norm(np.cross(offset, bench.axis.direction)) < 5


def test_leds_of_the_rendered_bench_are_found(bench, calibrated):
    leds = calibrated[0]["leds"]
    assert [led["led"] for led in leds] == list(range(6))
    error = np.array([led["position"] for led in leds]) - bench.leds
    assert np.linalg.norm(error, axis=1).mean() < 8
    assert np.mean([led["intensity"] for led in leds]) == pytest.approx(1)
    assert [led["intensity"] for led in leds] == pytest.approx(list(bench.led_power), rel=0.1)
    assert all(led["balls"] >= 10 for led in leds)
    assert all(led["residual_mm"]["mean"] <= led["residual_mm"]["max"] for led in leds)


def test_every_ray_is_told_with_its_led_and_ball(bench, calibrated):
    content = json.loads((calibrated[1] / "leds.json").read_text())
    rays = content["rays"]
    assert {(ray["led"], ray["ball"]) for ray in rays} <= {
        (led, ball["ball"]) for led in range(6) for ball in content["balls"]
    }
    for led in content["leds"]:
        used = [r["distance_mm"] for r in rays if r["led"] == led["led"] and r["used"]]
        assert len(used) == led["balls"]
        assert np.mean(used) == pytest.approx(led["residual_mm"]["mean"])
        assert max(used) == pytest.approx(led["residual_mm"]["max"])
    # A ray's pixel lies on its ball: no further from the centre than the radius.
    centres = bench.camera.project(np.array([ball["centre"] for ball in content["balls"]]))
    offsets = [ray["pixel"] - centres[ray["ball"]] for ray in rays]
    radius_px = bench.focal * bench.ball_radius / 780
    assert np.linalg.norm(offsets, axis=1).max() < radius_px


def test_covariance_is_named_symmetric_and_positive(calibrated):
    covariance = calibrated[0]["covariance"]
    matrix = np.array(covariance["matrix"])
    assert covariance["order"][:2] == ["camera.fx", "camera.fy"]
    assert covariance["order"][9:13] == [f"laser_plane.{c}" for c in "ABCD"]
    assert covariance["order"][-1] == "axis.point.z"
    assert matrix.shape == (19, 19)
    assert np.allclose(matrix, matrix.T, atol=1e-12)
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    assert np.linalg.eigvalsh(matrix / np.outer(scale, scale)).min() > -1e-6
    # The axis' depth goes with the focal length: their errors must be known to be related.
    focal, depth = covariance["order"].index("camera.fx"), -1
    correlation = matrix[focal, depth] / (scale[focal] * scale[depth])
    assert correlation > 0.5


def test_illumination_predicts_the_card(bench, calibrated):
    out = calibrated[1]
    rig = store.read_rig(out / "calibration.json")
    illumination = store.read_illumination(out / "illumination.zarr", rig)
    points = bench.reference_plane.intersect(
        bench.camera.rays(np.array([[40.0, 60.0], [120.0, 160.0], [200.0, 280.0]]))
    )
    for led in range(6):
        to_led = bench.leds[led] - points
        cosine = to_led @ bench.reference_plane.normal / np.linalg.norm(to_led, axis=1)
        # Frames were written with an exposure of 0.02 s.
        true = bench.radiance_of_plane(points, led) / 0.02 / cosine
        assert illumination.irradiance(led, points) == pytest.approx(true, rel=0.05)
    dataset = store.open_store(out / "illumination.zarr")
    assert dataset["residual"].values.max() < 0.02
    assert dataset["radiant_intensity"].shape == (6, 320, 240)
    # Its lens has no vignetting, its beams are cos^1.5.
    lens = illumination.vignetting
    assert [lens.linear, lens.quadratic, lens.reach] == list(dataset["vignetting"].values)
    assert lens(np.array([0.1, 0.14, 1.0])) == pytest.approx(1, abs=0.01)
    assert dataset["beam_power"].values == pytest.approx(1.5, abs=0.4)


def test_missing_parts_are_null(calibration_capture, tmp_path):
    kinds = {"board_laser", "axis_board", "balls", "card"}
    out = tmp_path / "out"
    content = calibrate(without(calibration_capture, tmp_path / "cameraonly", kinds), out)
    assert content["laser_plane"] is None
    assert content["axis"] is None
    assert content["leds"] is None
    assert content["camera"]["poses"] >= 8
    assert len(content["covariance"]["order"]) == 9
    rig = store.read_rig(out / "calibration.json")
    with pytest.raises(store.StoreError, match="no LEDs"):
        store.read_illumination(out / "illumination.zarr", rig)


def test_leds_without_a_reference_plane_are_null_and_said(
    calibration_capture, tmp_path, calibrated, capsys
):
    camera = dict(json.loads((calibrated[1] / "camera.json").read_text()), reference_plane=None)
    (tmp_path / "camera.json").write_text(json.dumps(camera))
    out = str(tmp_path / "leds.json")
    arguments = [str(calibration_capture), "--camera", str(tmp_path / "camera.json"), "--out", out]
    assert main(["calibrate-leds", *arguments]) == 0
    assert json.loads(Path(out).read_text()) == {"leds": None}
    assert "reference_board" in capsys.readouterr().err


def test_without_a_card_the_maps_are_relative(calibration_capture, tmp_path, calibrated):
    copy = without(calibration_capture, tmp_path / "nocard", {"card"})
    camera = ["--camera", str(calibrated[1] / "camera.json")]
    assert main(["calibrate-leds", str(copy), *camera, "--out", str(tmp_path / "leds.json")]) == 0
    leds = json.loads((tmp_path / "leds.json").read_text())["leds"]
    known = [led["intensity"] for led in calibrated[0]["leds"]]
    assert [led["intensity"] for led in leds] == pytest.approx(known, rel=0.05)
    content = dict(calibrated[0], leds=leds)
    (tmp_path / "calibration.json").write_text(json.dumps(content))
    out = tmp_path / "illumination.zarr"
    arguments = ["--calibration", str(tmp_path / "calibration.json"), "--out", str(out)]
    assert main(["calibrate-illumination", str(copy), *arguments]) == 0
    maps = store.open_store(out)["radiant_intensity"].values
    assert maps.mean(axis=(1, 2)) == pytest.approx([led["intensity"] for led in leds], rel=1e-5)


def test_capture_without_boards_is_refused_in_one_sentence(calibration_capture, tmp_path):
    copy = without(calibration_capture, tmp_path / "noboard", {"board", "board_laser"})
    out = tmp_path / "camera.json"
    assert main(["calibrate-camera", str(copy), "--out", str(out)]) == 0
    assert "no frames of kind 'board'" in store.refused_reason(out)
    laser = tmp_path / "laser_plane.json"
    arguments = [str(copy), "--camera", str(out), "--out", str(laser)]
    assert main(["calibrate-laser-plane", *arguments]) == 0
    assert store.refused_reason(laser) == store.refused_reason(out)


def test_reference_board_that_is_not_found_is_refused(bench, capture_writer, tmp_path):
    writer = capture_writer(tmp_path / "dark", bench)
    for pose, placed in enumerate(bench.poses(5)):
        writer.add("board", bench.board(*placed), pose=pose)
    writer.add("reference_board", np.zeros((320, 240)))
    out = tmp_path / "camera.json"
    assert main(["calibrate-camera", str(writer.finish()), "--out", str(out)]) == 0
    assert "reference_board" in store.refused_reason(out)


def test_columns_and_srgb_bytes_give_the_same_laser_plane(bench, capture_writer, tmp_path):
    """The laser crosses columns of a camera on its side; images are 8-bit sRGB RGB."""
    writer = capture_writer(tmp_path / "srgb", bench, scan="columns", encoding="srgb")
    turned = Plane(bench.laser_plane.normal[[1, 0, 2]], bench.laser_plane.offset)
    upright, bench.__dict__["laser_plane"] = bench.laser_plane, turned
    try:
        for pose, placed in enumerate(bench.poses(8)):
            writer.add("board", bench.board(*placed), pose=pose)
            writer.add("board_laser", bench.board_laser(*placed), pose=pose)
    finally:
        bench.__dict__["laser_plane"] = upright
    folder = writer.finish()
    camera, laser = tmp_path / "camera.json", tmp_path / "laser_plane.json"
    assert main(["calibrate-camera", str(folder), "--out", str(camera)]) == 0
    # The true camera, or eight small boards' error in the principal point would be measured.
    content = json.loads(camera.read_text())
    content["camera"]["matrix"] = bench.camera.matrix.tolist()
    content["camera"]["distortion"] = bench.camera.distortion.tolist()
    store.write_json(camera, content)
    arguments = [str(folder), "--camera", str(camera), "--out", str(laser)]
    assert main(["calibrate-laser-plane", *arguments]) == 0
    found = json.loads(laser.read_text())["laser_plane"]
    assert angle(np.array(found["coefficients"][:3]), turned.normal) < 0.15
    assert found["poses"] >= 7
    assert found["residual_mm"]["mean"] < 0.1
