"""The README's table of what reruns when: a dry run plans just those jobs."""

import os
import shutil
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import cv2
import pytest
import yaml


@contextmanager
def changed(path: Path):
    """Give back the file as it was, times included."""
    content, stat = path.read_bytes(), path.stat()
    try:
        yield path
    finally:
        path.write_bytes(content)
        os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))


@contextmanager
def moved(path: Path, to: Path):
    path.rename(to)
    try:
        yield
    finally:
        to.rename(path)


@contextmanager
def added(source: Path, target: Path, **facts):
    """A copy of a capture with other facts."""
    shutil.copytree(source, target)
    manifest = target / "capture.yaml"
    content = yaml.safe_load(manifest.read_text()) | {"capture": target.name} | facts
    manifest.write_text(yaml.safe_dump(content))
    try:
        yield
    finally:
        shutil.rmtree(target)


@pytest.fixture(scope="module")
def changeable(processed):
    """The project with a copy of the package."""
    package = processed.folder / "package"
    ignore = shutil.ignore_patterns("__pycache__", "*.egg-info")
    shutil.copytree(processed.package, package, ignore=ignore)
    return replace(processed, package=package)


@pytest.fixture(scope="module")
def captures(processed):
    """Folders of the measurements, in order of mileage, and of the calibration."""
    facts = {
        path.parent: yaml.safe_load(path.read_text())
        for path in processed.archive.glob("**/capture.yaml")
    }
    measured = [folder for folder in facts if facts[folder]["kind"] == "measurement"]
    measured.sort(key=lambda folder: facts[folder]["mileage"]["value"])
    calibration = next(folder for folder in facts if facts[folder]["kind"] == "calibration")
    return measured, calibration


def views(folder: Path) -> int:
    rows = (folder / "frames.csv").read_text().splitlines()
    return len({row.split(",")[2] for row in rows if row.split(",")[1] == "led"})


def image_of(folder: Path, kind: str) -> Path:
    rows = (folder / "frames.csv").read_text().splitlines()
    return folder / next(row.split(",")[0] for row in rows if row.split(",")[1] == kind)


def alter(image: Path) -> None:
    """Change one count of an image; its digest in the manifest is taken out, as a user would."""
    manifest = image
    while not (manifest / "frames.csv").exists():
        manifest = manifest.parent
    pixels = cv2.imread(str(image), cv2.IMREAD_UNCHANGED)
    pixels[0, 0] += 16
    cv2.imwrite(str(image), pixels)


TIRE = {"wear": 1, "report": 1, "index": 1}


def test_nothing_changed_plans_nothing(processed):
    assert processed.planned() == {}


def test_a_config_key_reruns_its_stage_and_what_follows(processed, captures):
    with changed(processed.folder / "config/config.yaml") as config:
        config.write_text(config.read_text() + "integrate: {held_out_every: 4}\n")
        assert processed.planned() == {"integrate": len(captures[0]), **TIRE}


def test_a_comment_in_the_config_plans_nothing(processed):
    with changed(processed.folder / "config/config.yaml") as config:
        config.write_text("# A remark.\n" + config.read_text())
        assert processed.planned() == {}


def test_a_laser_image_reruns_its_capture(processed, captures):
    folder = captures[0][0]
    with changed(image_of(folder, "laser")) as image:
        alter(image)
        assert processed.planned() == {
            "inspect_capture": 1,
            "detect_laser_pixels": 1,
            "triangulate": 1,
            "register_to_cylinder": 1,
            "photometric_stereo": views(folder),
            "integrate": 1,
            **TIRE,
        }


def test_an_led_image_reruns_its_view_alone(processed, captures):
    with changed(image_of(captures[0][0], "led")) as image:
        alter(image)
        assert processed.planned() == {
            "inspect_capture": 1,
            "photometric_stereo": 1,
            "integrate": 1,
            **TIRE,
        }


def test_a_card_image_reruns_the_leds_whose_light_it_shows(processed, captures):
    with changed(image_of(captures[1], "card")) as image:
        alter(image)
        counts = processed.planned()
    assert counts["calibrate_leds"] == counts["calibrate_illumination"] == 1
    assert {"calibrate_camera", "calibrate_axis", "detect_laser_pixels"}.isdisjoint(counts)


def test_an_image_touched_but_not_changed_plans_nothing(processed, captures):
    with changed(image_of(captures[0][0], "laser")) as image:
        os.utime(image)
        assert processed.planned() == {}


def test_a_module_reruns_its_stage_and_what_follows(changeable):
    with changed(changeable.package / "treadlight/commands/wear.py") as module:
        module.write_text(module.read_text() + "\nEXTRA = 1\n")
        assert changeable.planned() == TIRE


def test_a_comment_in_a_module_plans_nothing(changeable):
    with changed(changeable.package / "treadlight/geometry/axis.py") as module:
        module.write_text(module.read_text() + "\n# A remark.\n")
        assert changeable.planned() == {}


def test_a_new_mileage_runs_alone_and_renews_its_tire(processed, captures):
    last = captures[0][-1]
    more = {"mileage": {"value": 9999, "unit": "mi"}}
    with added(last, last.with_name("t-new"), **more):
        assert processed.planned() == {
            "inspect_capture": 1,
            "detect_laser_pixels": 1,
            "triangulate": 1,
            "register_to_cylinder": 1,
            "photometric_stereo": views(last),
            "integrate": 1,
            "list_archive": 1,
            **TIRE,
        }


def test_a_capture_taken_out_renews_its_tire(processed, captures):
    last = captures[0][-1]
    with moved(last, processed.folder / "taken-out"):
        assert processed.planned() == {"list_archive": 1, **TIRE}


def test_a_newer_calibration_renews_the_captures_after_it(processed, captures):
    measured, calibration = captures
    times = [yaml.safe_load((f / "capture.yaml").read_text())["captured_at"] for f in measured]
    with added(calibration, calibration.with_name("zz-newer"), captured_at=max(times)):
        counts = processed.planned()
    later = [f for f, time in zip(measured, times, strict=True) if time == max(times)]
    assert counts["calibrate"] == 1
    assert counts["triangulate"] == counts["integrate"] == len(later) < len(measured)
    assert counts["photometric_stereo"] == sum(views(folder) for folder in later)
    assert "detect_laser_pixels" not in counts


def test_an_excluded_capture_renews_its_tire(processed, captures):
    name = yaml.safe_load((captures[0][-1] / "capture.yaml").read_text())["capture"]
    with changed(processed.folder / "config/config.yaml") as config:
        config.write_text(config.read_text() + f"exclude: [{name}]\n")
        assert processed.planned() == {"list_archive": 1, **TIRE}
