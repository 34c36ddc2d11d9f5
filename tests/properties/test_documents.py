"""Whatever stands in a document that people write, it is read or refused in one plain sentence."""

import string
from pathlib import Path

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from treadlight.archive import read_capture
from treadlight.errors import CaptureError, ConfigError
from treadlight.planning.config import complete_config, load_schema

ROOT = Path(__file__).resolve().parents[2]
SCHEMA = load_schema(ROOT / "schemas/config.schema.yaml")
FACTS = {
    "format": "tread-capture/1",
    "kind": "measurement",
    "capture": "t7-00200",
    "captured_at": "2020-01-31T10:00:00Z",
    "rig": "bench-1",
    "camera": {"size_px": [512, 768], "encoding": "linear", "black_level": 0, "white_level": 65535},
    "laser": {"scan": "rows", "channel": "red"},
    "leds": 4,
    "tire": {"id": "t7", "size": "1", "nominal_radius_mm": 355.0, "tread_width_mm": 215.0},
    "mileage": {"value": 200, "unit": "mi"},
}
ROWS = "file,kind,pose,led,encoder_deg,exposure_s,sha256\na.png,laser,0,,1.5,0.2,\n"
FUZZ = settings(
    max_examples=150, deadline=2000, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
texts = st.text(max_size=12) | st.sampled_from(
    ["&a", "*a", "<<", "!!set", "!!binary", "0x", "1e999"]
)
values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | texts | st.datetimes(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(texts, inner, max_size=3),
    max_leaves=8,
)


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "a.png").write_bytes(b"x")
    (tmp_path / "capture.yaml").write_text(yaml.safe_dump(FACTS))
    (tmp_path / "frames.csv").write_text(ROWS)
    return tmp_path


def read_or_refused(folder):
    """The capture, or None after one plain sentence that names a file of it."""
    try:
        return read_capture(folder)
    except CaptureError as error:
        said = str(error)
        assert said.isprintable()
        assert said.startswith(str(folder))
        assert said.endswith(".")
        return None


@FUZZ
@given(data=st.binary(max_size=200))
def test_any_bytes_as_capture_yaml(folder, data):
    (folder / "capture.yaml").write_bytes(data)
    assert read_or_refused(folder) is None


@FUZZ
@given(text=st.text(alphabet=string.printable, max_size=200))
def test_any_text_as_capture_yaml(folder, text):
    (folder / "capture.yaml").write_text(text)
    assert read_or_refused(folder) is None


@FUZZ
@given(name=st.sampled_from(sorted(FACTS)), value=values)
def test_any_value_of_any_fact(folder, name, value):
    (folder / "capture.yaml").write_text(yaml.safe_dump(FACTS | {name: value}))
    capture = read_or_refused(folder)
    assert capture is None or 0 < capture.encoding.size_px[0] <= 65_535


@FUZZ
@given(data=st.data())
def test_capture_yaml_with_bytes_changed(folder, data):
    whole = yaml.safe_dump(FACTS).encode()
    start = data.draw(st.integers(0, len(whole)))
    stop = data.draw(st.integers(start, len(whole)))
    (folder / "capture.yaml").write_bytes(
        whole[:start] + data.draw(st.binary(max_size=8)) + whole[stop:]
    )
    read_or_refused(folder)


@FUZZ
@given(data=st.binary(max_size=200))
def test_any_bytes_as_frames_csv(folder, data):
    (folder / "frames.csv").write_bytes(data)
    assert read_or_refused(folder) is None


@FUZZ
@given(cells=st.lists(texts | st.floats().map(str), min_size=1, max_size=9))
def test_any_cells_in_a_row(folder, cells):
    (folder / "frames.csv").write_text(ROWS + ",".join(cells) + "\n", errors="surrogateescape")
    capture = read_or_refused(folder)
    assert capture is None or all(
        abs(frame.encoder_deg) <= 36_000 for frame in capture.of_kind("laser")
    )


@FUZZ
@given(data=st.data())
def test_frames_csv_with_bytes_changed(folder, data):
    whole = ROWS.encode()
    start = data.draw(st.integers(0, len(whole)))
    stop = data.draw(st.integers(start, len(whole)))
    (folder / "frames.csv").write_bytes(
        whole[:start] + data.draw(st.binary(max_size=8)) + whole[stop:]
    )
    read_or_refused(folder)


@FUZZ
@given(key=st.sampled_from([*SCHEMA["properties"], "other"]) | texts, value=values)
def test_any_value_of_any_config_key(tmp_path, key, value):
    config = {"archive": str(tmp_path), "results": str(tmp_path.parent / "results"), key: value}
    said = []
    try:
        complete_config(config, SCHEMA, "config.yaml")
    except ConfigError as error:
        said.append(str(error))
    assert all(text.isprintable() and text.startswith("config.yaml: ") for text in said)
