"""Whole archives: valid, the same every time, and true."""

import dataclasses
import hashlib
import json
import sys

import numpy as np
import pytest

from treadlight import threads
from treadlight.archive import find_archive, read_capture
from treadlight.cli import main
from treadlight.errors import ConfigError
from treadlight.evaluate.truth import read_true_profile, read_true_rig, read_true_wear
from treadlight.images import FrameReader
from treadlight.simulate import Simulation, SimulationSettings, plan, preset, write_archive
from treadlight.simulate.tire import Mounting

SMALL = preset("tiny", leds=2, views=1, sections=6, seed=4, mileages=(100, 400))


def silent(line: str) -> None:
    pass


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    out = tmp_path_factory.mktemp("simulated") / "archive"
    assert write_archive(SMALL, out, force=False, say=silent)
    return out


def digests(folder):
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in files
    }


def test_archive_is_valid_and_complete(archive):
    found = find_archive(archive)
    assert not found.refused
    assert not found.warnings
    assert list(found.measurements) == ["t1-00100", "t1-00400"]
    calibration = next(iter(found.calibrations.values()))
    kinds = {frame.kind for frame in calibration.frames}
    assert kinds == {
        "board", "board_laser", "axis_board", "reference_board", "balls", "card", "dark",
    }  # fmt: skip
    for capture in (calibration, *found.measurements.values()):
        reader = FrameReader(capture)
        for frame in capture.frames:
            assert reader.read(frame).intensity.shape == (192, 128)


def test_led_frames_use_the_range_and_saturate_in_few_places(archive):
    capture = read_capture(archive / "t1-00100")
    reader = FrameReader(capture)
    frames = [reader.read(frame) for frame in capture.of_kind("led")]
    light = np.stack([frame.intensity for frame in frames])
    assert 0.1 < np.median(light) < 0.4
    assert 0.5 < np.percentile(light, 99) <= 1
    assert np.mean([frame.saturated.mean() for frame in frames]) < 0.01


def test_second_run_finds_all_there(archive):
    before = digests(archive)
    assert not write_archive(SMALL, archive, force=False, say=silent)
    assert digests(archive) == before


def test_one_core_and_a_resumed_run_give_the_same_bytes(archive, tmp_path):
    cores = threads.cores()
    threads.use_cores(1)
    try:
        simulation = Simulation(SMALL)
        simulation.write("t1-00400", tmp_path, silent)
    finally:
        threads.use_cores(cores)
    assert digests(tmp_path / "t1-00400") == digests(archive / "t1-00400")


def test_other_settings_are_refused_without_force(archive):
    other = dataclasses.replace(SMALL, seed=5)
    with pytest.raises(ConfigError, match="other settings"):
        write_archive(other, archive, force=False, say=silent)


def test_foreign_folder_is_left_alone(tmp_path):
    (tmp_path / "thesis.txt").write_text("mine")
    with pytest.raises(ConfigError, match="not made by simulate"):
        write_archive(SMALL, tmp_path, force=True, say=silent)


def test_force_renders_anew_and_removes_what_was_rendered_before(tmp_path):
    size = (96, 144)
    laser_only = preset("tiny", size_px=size, leds=1, views=0, sections=1, mileages=(100,))
    assert write_archive(laser_only, tmp_path / "a", force=False, say=silent)
    other = dataclasses.replace(laser_only, seed=8, mileages=(200.0,))
    assert write_archive(other, tmp_path / "a", force=True, say=silent)
    found = find_archive(tmp_path / "a")
    assert list(found.measurements) == ["t1-00200"]
    assert list(found.calibrations) == ["sim-8-2026-01"]
    capture = found.measurements["t1-00200"]
    assert not capture.of_kind("led")


def test_laser_stripe_lies_on_the_true_surface(archive):
    """Triangulated with the truth, brightest pixels are on the tread within half a pixel."""
    capture = read_capture(archive / "t1-00400")
    rig = read_true_rig(capture.folder / "truth/rig.yaml")
    profile = read_true_profile(capture.folder / "truth/profile.npz")
    reader, errors = FrameReader(capture), []
    for frame in capture.of_kind("laser"):
        image = np.maximum(reader.read(frame).intensity - 0.02, 0).astype(float)
        peak = image.argmax(axis=1)
        rows = np.nonzero(image.max(axis=1) > 0.1)[0]
        near = np.clip(peak[rows, None] + np.arange(-3, 4), 0, image.shape[1] - 1)
        weight = image[rows[:, None], near]
        u = (weight * near).sum(axis=1) / weight.sum(axis=1)
        points = rig.laser_plane.intersect(rig.camera.rays(np.column_stack([u, rows])))
        theta, z, r = rig.axis.to_tire(points, np.radians(frame.encoder_deg))
        i = np.rint((theta - profile.theta[0]) / np.diff(profile.theta)[0]).astype(int)
        j = np.rint((z - profile.z[0]) / np.diff(profile.z)[0]).astype(int)
        inside = (i >= 0) & (i < len(profile.theta)) & (np.abs(z) < 80)
        errors.append(r[inside] - profile.r[i[inside], j[inside]])
    errors = np.concatenate(errors)
    pixel_mm = 1.25 / np.tan(np.radians(22))
    assert len(errors) > 300
    assert abs(np.nanmedian(errors)) < 0.05 * pixel_mm
    assert np.nanmedian(np.abs(errors)) < 0.1 * pixel_mm


def mounting_of(capture):
    import yaml

    truth = yaml.safe_load((capture.folder / "truth/rig.yaml").read_text())
    return Mounting(**truth["mounting"], hub_z_mm=truth["hub_z_mm"])


def test_true_wear_is_what_the_two_true_profiles_differ_by(archive):
    """Points of the first profile go through both mountings and are looked up in the second."""
    first, second = (read_capture(archive / name) for name in ("t1-00100", "t1-00400"))
    before = read_true_profile(first.folder / "truth/profile.npz")
    after = read_true_profile(second.folder / "truth/profile.npz")
    wear = read_true_wear(second.folder / "truth/wear.npz")
    assert np.array_equal(wear.theta, before.theta)
    assert np.array_equal(wear.z, before.z)
    one, two = mounting_of(first), mounting_of(second)
    theta, z = np.meshgrid(before.theta, before.z, indexing="ij")
    x = np.stack([before.r * np.cos(theta), before.r * np.sin(theta), z], axis=-1)
    body = (x - one.shift) @ one.rotation
    change = two.radius_change_mm - one.radius_change_mm
    radius = np.hypot(body[..., 0], body[..., 1])
    body[..., :2] *= ((radius + change) / radius)[..., None]
    there = body @ two.rotation.T + two.shift
    i = (np.arctan2(there[..., 1], there[..., 0]) - after.theta[0]) % (2 * np.pi)
    i = np.rint(i / np.diff(after.theta)[0])
    j = np.rint((there[..., 2] - after.z[0]) / np.diff(after.z)[0])
    ok = np.isfinite(i + j) & (i < len(after.theta)) & (j >= 0) & (j < len(after.z))
    flat = ok & (wear.r > 0.2) & (np.abs(z) < 75)
    loss = np.hypot(there[..., 0], there[..., 1])[flat]
    loss -= after.r[i[flat].astype(int), j[flat].astype(int)]
    assert flat.sum() > 2000
    assert np.nanmedian(loss - wear.r[flat]) == pytest.approx(0, abs=0.01)
    assert np.nanmedian(np.abs(loss - wear.r[flat])) < 0.05
    assert np.nanmedian(wear.r[flat]) == pytest.approx(0.36, rel=0.4)


def test_wear_is_nought_in_the_grooves(archive):
    profile = read_true_profile(archive / "t1-00100/truth/profile.npz")
    wear = read_true_wear(archive / "t1-00400/truth/wear.npz")
    floors = (profile.r < 349.0) & (np.abs(profile.z) < 70)
    assert floors.sum() > 1000
    assert np.nanmedian(np.abs(wear.r[floors])) < 1e-3


def test_whole_turn_is_covered_by_views_and_sections():
    settings = preset("demo", seed=11)
    measurement = plan.measurements(settings, Simulation(settings).sim)[1]
    views = np.sort(np.array(measurement.view_encoders_deg) % 360)
    gaps = np.diff(np.append(views, views[0] + 360))
    assert gaps.max() < 0.95 * plan.view_width_deg(settings)
    sections = np.array(measurement.section_encoders_deg)
    assert sections[-1] - sections[0] > 360
    assert len(sections) == settings.sections + 3
    grid = plan.true_grid(settings, measurement)
    assert grid.periodic


def test_two_tires_and_odd_mileages_have_ids_of_their_own():
    settings = preset("tiny", tires=2, mileages=(0.0, 250.5))
    ids = Simulation(settings).ids
    assert ids[1:] == ["t1-00000", "t1-00250.50", "t2-00000", "t2-00250.50"]
    assert len(set(ids)) == 5


@pytest.mark.parametrize(
    ("wrong", "names"),
    [
        ({"size_px": (20, 30)}, "size"),
        ({"sector_deg": 400.0}, "sector-deg"),
        ({"mileages": (200.0, 100.0)}, "mileages"),
        ({"sections": 0, "views": 0}, "sections"),
        ({"scan": "diagonal"}, "scan"),
        ({"tires": 0}, "tires"),
    ],
)
def test_wrong_settings_are_named(wrong, names):
    with pytest.raises(ConfigError, match=f"--{names} of simulate must be"):
        SimulationSettings(**wrong)


def test_command_says_what_is_there_already(archive, capsys):
    options = ["--preset", "tiny", "--leds", "2", "--views", "1", "--sections", "6"]
    options += ["--seed", "4", "--mileages", "100,400", "--threads", str(threads.cores())]
    assert main(["simulate", str(archive), *options]) == 0
    assert "there already" in capsys.readouterr().err
    assert json.loads((archive / "simulation.json").read_text())["captures"]


def test_command_renders_and_reports_wrong_options(tmp_path, capsys):
    options = [
        "--preset",
        "tiny",
        "--size",
        "96x144",
        "--leds",
        "1",
        "--views",
        "1",
        "--sections",
        "1",
    ]
    options += ["--mileages", "100", "--threads", str(threads.cores())]
    assert main(["simulate", str(tmp_path / "out"), *options]) == 0
    assert "rendering" in capsys.readouterr().err
    assert main(["simulate", str(tmp_path / "b"), "--size", "large"]) == 2
    assert "must look like 192x288" in capsys.readouterr().err
    assert "treadlight.simulate" in sys.modules
