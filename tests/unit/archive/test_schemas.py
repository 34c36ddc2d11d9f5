"""The published schemas and the reader of manifests agree on what is right and what is wrong."""

import copy
import csv
from pathlib import Path

import jsonschema
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from treadlight.archive import read_capture
from treadlight.errors import CaptureError

ROOT = Path(__file__).resolve().parents[3]
SCHEMA = yaml.safe_load((ROOT / "schemas/capture.schema.yaml").read_text())
ROW_SCHEMA = yaml.safe_load((ROOT / "schemas/frames.schema.yaml").read_text())
GOOD = {
    "format": "tread-capture/1",
    "kind": "measurement",
    "capture": "t1-100",
    "tire": {"id": "t1", "size": "215/70R16", "nominal_radius_mm": 355.0, "tread_width_mm": 200.0},
    "mileage": {"value": 100, "unit": "mi"},
    "captured_at": "2020-01-31T10:00:00Z",
    "rig": "bench-1",
    "camera": {"size_px": [8, 6], "encoding": "linear", "black_level": 0, "white_level": 65535},
    "laser": {"scan": "rows", "channel": "red"},
    "leds": 16,
}
LEAVES = [
    ("format",), ("kind",), ("capture",), ("rig",), ("leds",), ("tire", "id"), ("tire", "size"),
    ("tire", "nominal_radius_mm"), ("tire", "tread_width_mm"), ("mileage", "value"),
    ("mileage", "unit"), ("camera", "size_px"), ("camera", "encoding"), ("camera", "black_level"),
    ("camera", "white_level"), ("laser", "scan"), ("laser", "channel"),
]  # fmt: skip
VALUES = st.one_of(
    st.none(),
    st.integers(-3, 100_000),
    st.sampled_from(["red", "rows", "mi", "linear", "", ".x", "a/b", "x" * 65, "t1", 0.5, -2.5]),
    st.lists(st.integers(-1, 9), max_size=3),
)


def write(folder: Path, facts) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "capture.yaml").write_text(yaml.safe_dump(facts))
    (folder / "0.png").touch()
    (folder / "frames.csv").write_text("file,kind,pose,led,encoder_deg\n0.png,laser,0,,1.8\n")
    return folder


def accepted_by_schema(facts) -> bool:
    return jsonschema.Draft202012Validator(SCHEMA).is_valid(facts)


def accepted_by_reader(folder: Path) -> bool:
    try:
        read_capture(folder)
    except CaptureError:
        return False
    return True


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(leaf=st.sampled_from(LEAVES), value=VALUES)
def test_schema_and_reader_judge_every_field_alike(tmp_path, leaf, value):
    facts = copy.deepcopy(GOOD)
    node = facts
    for name in leaf[:-1]:
        node = node[name]
    node[leaf[-1]] = value
    levels = facts["camera"]["black_level"], facts["camera"]["white_level"]
    ordered = all(isinstance(v, int | float) for v in levels) and levels[0] < levels[1]
    # What a schema cannot say: the order of the two levels, and what a kind needs.
    if not ordered or facts["kind"] == "calibration":
        return
    assert accepted_by_schema(facts) == accepted_by_reader(write(tmp_path / "c", facts))


@pytest.mark.shared
def test_the_sample_archive_satisfies_the_schemas(sample_archive):
    captures = sorted(sample_archive.glob("*/capture.yaml"))
    assert len(captures) == 3
    for path in captures:
        jsonschema.validate(yaml.safe_load(path.read_text()), SCHEMA)
        with (path.parent / "frames.csv").open() as stream:
            for row in csv.DictReader(stream):
                jsonschema.validate(row, ROW_SCHEMA)
