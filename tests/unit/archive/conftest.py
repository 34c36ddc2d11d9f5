"""Captures on disk, good ones, for tests that break one thing each."""

import copy

import pytest
import yaml

MEASUREMENT = {
    "format": "tread-capture/1",
    "kind": "measurement",
    "capture": "t7-00200",
    "captured_at": "2020-01-31T10:00:00Z",
    "rig": "bench-1",
    "camera": {
        "size_px": [512, 768],
        "encoding": "linear",
        "black_level": 0,
        "white_level": 65535,
    },
    "laser": {"scan": "rows", "channel": "red"},
    "leds": 4,
    "tire": {
        "id": "t7",
        "size": "215/70R16",
        "nominal_radius_mm": 355.0,
        "tread_width_mm": 215.0,
        "position": "FL",
    },
    "mileage": {"value": 200, "unit": "mi"},
}
CALIBRATION = {
    **{k: v for k, v in MEASUREMENT.items() if k not in ("tire", "mileage")},
    "kind": "calibration",
    "capture": "bench-1-2020-01",
    "captured_at": "2020-01-30T08:00:00Z",
    "board": {"inner_corners": [9, 6], "square_mm": 15.0},
    "axis_board": {"inner_corners": [9, 6], "square_mm": 18.0},
    "balls": {"count": 15, "diameter_mm": 12.7, "centre_height_mm": 0.0},
    "card": {"albedo": 0.18},
}
HEADER = "file,kind,pose,led,encoder_deg,exposure_s,sha256"
MEASUREMENT_ROWS = (
    "a.png,laser,0,,1.5,0.2,",
    "b.png,led,0,0,3.0,0.3,",
    "c.png,led,0,1,3.0,0.3,",
    "d.png,dark,,,,,",
)
CALIBRATION_ROWS = (
    "a.png,board,0,,,,",
    "b.png,board_laser,0,,,,",
    "c.png,axis_board,0,,10,,",
    "d.png,reference_board,,,,,",
    "e.png,balls,,0,,,",
    "f.png,card,,0,,,",
)


def changed(facts, changes):
    """A copy with dotted names set, or left out where the value is `...`."""
    facts = copy.deepcopy(facts)
    for name, value in changes.items():
        *path, last = name.split(".")
        node = facts
        for part in path:
            node = node[part]
        if value is ...:
            del node[last]
        else:
            node[last] = value
    return facts


@pytest.fixture
def make(tmp_path):
    """Writes a capture's folder: facts changed by dotted name, rows of frames.csv."""

    def write(kind="measurement", changes=None, rows=None, name="capture", header=HEADER):
        facts, default = (
            (MEASUREMENT, MEASUREMENT_ROWS)
            if kind == "measurement"
            else (CALIBRATION, CALIBRATION_ROWS)
        )
        folder = tmp_path / name
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "capture.yaml").write_text(yaml.safe_dump(changed(facts, changes or {})))
        rows = default if rows is None else rows
        (folder / "frames.csv").write_text("\n".join([header, *rows]) + "\n")
        for letter in "abcdef":
            (folder / f"{letter}.png").write_bytes(b"image " + letter.encode())
        return folder

    return write
