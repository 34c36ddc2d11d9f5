"""Frame digests follow content, not times; wrong headers are refused."""

import os
import shutil

import cv2
import numpy as np
import pytest
import yaml

from treadlight.archive import read_capture
from treadlight.errors import CaptureError
from treadlight.planning.frames import FrameDigests, facts_digest

FACTS = {
    "format": "tread-capture/1",
    "kind": "measurement",
    "capture": "t1-100",
    "tire": {"id": "t1", "size": "215/70R16", "nominal_radius_mm": 355.0, "tread_width_mm": 200.0},
    "mileage": {"value": 100, "unit": "mi"},
    "captured_at": "2020-01-31T10:00:00Z",
    "rig": "bench-1",
    "camera": {"size_px": [8, 6], "encoding": "linear", "black_level": 0, "white_level": 65535},
    "laser": {"scan": "rows", "channel": "red"},
    "leds": 1,
}


@pytest.fixture
def folder(tmp_path):
    folder = tmp_path / "t1-100"
    folder.mkdir()
    (folder / "capture.yaml").write_text(yaml.safe_dump(FACTS))
    rows = ["file,kind,pose,led,encoder_deg,exposure_s,sha256"]
    for k in range(3):
        cv2.imwrite(str(folder / f"{k}.png"), np.full((6, 8), k, np.uint16))
        rows.append(f"{k}.png,laser,{k},,{k * 1.8},0.1,")
    (folder / "frames.csv").write_text("\n".join(rows))
    return folder


def digest_of(folder, memory):
    capture = read_capture(folder)
    digests = FrameDigests(memory)
    digests.check(capture)
    return digests.of_frames(capture, capture.frames)


def test_a_touched_image_keeps_its_digest(folder, tmp_path):
    before = digest_of(folder, tmp_path / "memory")
    os.utime(folder / "1.png", (1, 1))
    assert digest_of(folder, tmp_path / "memory") == before


def test_a_changed_image_changes_the_digest(folder, tmp_path):
    before = digest_of(folder, tmp_path / "memory")
    cv2.imwrite(str(folder / "1.png"), np.full((6, 8), 9, np.uint16))
    assert digest_of(folder, tmp_path / "memory") != before


def test_a_changed_angle_changes_the_digest(folder, tmp_path):
    before = digest_of(folder, tmp_path / "memory")
    frames = folder / "frames.csv"
    frames.write_text(frames.read_text().replace("1.8", "1.9"))
    assert digest_of(folder, tmp_path / "memory") != before


def test_the_place_of_the_capture_does_not_count(folder, tmp_path):
    before = digest_of(folder, tmp_path / "memory")
    moved = shutil.copytree(folder, tmp_path / "moved")
    assert digest_of(moved, tmp_path / "memory") == before


def test_a_damaged_memory_is_made_anew(folder, tmp_path):
    before = digest_of(folder, tmp_path / "memory")
    (tmp_path / "memory" / "t1-100.json").write_text("{")
    assert digest_of(folder, tmp_path / "memory") == before


def test_an_image_of_another_size_is_refused(folder, tmp_path):
    cv2.imwrite(str(folder / "2.png"), np.zeros((6, 9), np.uint16))
    with pytest.raises(CaptureError, match=r"2\.png: is 9x6\..*size_px: \[8, 6\]"):
        digest_of(folder, tmp_path / "memory")


def test_a_file_that_is_no_image_is_refused(folder, tmp_path):
    (folder / "2.png").write_text("no image")
    with pytest.raises(CaptureError, match=r"2\.png: is no readable PNG, TIFF or JPEG"):
        digest_of(folder, tmp_path / "memory")


def test_facts_do_not_change_with_a_comment_but_with_a_value(folder):
    before = facts_digest(read_capture(folder))
    path = folder / "capture.yaml"
    path.write_text("# A remark.\n" + path.read_text())
    assert facts_digest(read_capture(folder)) == before
    path.write_text(path.read_text().replace("value: 100", "value: 101"))
    assert facts_digest(read_capture(folder)) != before
