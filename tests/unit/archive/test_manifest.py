from datetime import UTC, datetime

import pytest

from treadlight.archive import read_capture
from treadlight.errors import CaptureError


def sentence(folder):
    with pytest.raises(CaptureError) as caught:
        read_capture(folder)
    text = str(caught.value)
    assert text.startswith(str(folder))
    assert text.endswith(".")
    assert "\n" not in text
    return text


def test_a_measurement_is_read_with_all_its_facts(make):
    capture = read_capture(make())
    assert (capture.id, capture.kind, capture.rig) == ("t7-00200", "measurement", "bench-1")
    assert capture.captured_at == datetime(2020, 1, 31, 10, tzinfo=UTC)
    assert capture.encoding.size_px == (512, 768)
    assert capture.tire.facts == {"position": "FL"}
    assert (capture.mileage, capture.mileage_unit) == (200.0, "mi")
    assert capture.views == (0,)
    assert [frame.led for frame in capture.view(0)] == [0, 1]
    assert capture.of_kind("laser")[0].encoder_deg == 1.5
    assert capture.board is None


def test_a_calibration_is_read_with_all_its_facts(make):
    capture = read_capture(make("calibration"))
    assert capture.board.inner_corners == (9, 6)
    assert capture.axis_board.square_mm == 18.0
    assert capture.balls.count == 15
    assert capture.card_albedo == 0.18
    assert capture.tire is None


def test_parts_without_frames_need_no_facts(make):
    folder = make(
        "calibration", {"axis_board": ..., "balls": ..., "card": ...}, ["a.png,board,0,,,,"]
    )
    capture = read_capture(folder)
    assert capture.axis_board is capture.balls is capture.card_albedo is None


@pytest.mark.parametrize(
    ("name", "value", "must"),
    [
        ("format", "tread-capture/2", "'tread-capture/1'"),
        ("kind", "sample", "one of measurement, calibration"),
        ("capture", "../x", "1 to 64 of the characters"),
        ("capture", ".hidden", "1 to 64 of the characters"),
        ("capture", "a" * 65, "1 to 64 of the characters"),
        ("capture", "name\n", "1 to 64 of the characters"),
        ("capture", 7, "1 to 64 of the characters"),
        ("rig", "  ", "a text"),
        ("captured_at", "yesterday", "a time such as"),
        ("captured_at", 2020, "a time such as"),
        ("camera.size_px", [512], "two whole numbers"),
        ("camera.size_px", [512, 0], "two whole numbers from 1"),
        ("camera.size_px", [512.0, 768], "two whole numbers"),
        ("camera.size_px", [True, 768], "two whole numbers"),
        ("camera.encoding", "gamma", "one of linear, srgb"),
        ("camera.black_level", -1, "a number from 0"),
        ("camera.white_level", "max", "a number from 1"),
        ("camera.white_level", float("nan"), "a number from 1"),
        ("laser.scan", "diagonal", "one of rows, columns"),
        ("laser.channel", "infrared", "one of red, green, blue, mono"),
        ("leds", -1, "a whole number from 0"),
        ("leds", True, "a whole number from 0"),
        ("leds", 4.0, "a whole number from 0"),
        ("tire", "t7", "a mapping"),
        ("tire.id", "t 7", "1 to 64 of the characters"),
        ("tire.size", 215, "a text"),
        ("tire.nominal_radius_mm", 0, "a number from 1"),
        ("tire.tread_width_mm", float("inf"), "a number from 1"),
        ("mileage.value", -5, "a number from 0"),
        ("mileage.value", True, "a number from 0"),
        ("mileage.value", 10**400, "a number from 0"),
        ("mileage.unit", "m", "one of mi, km"),
    ],
)
def test_a_bad_field_is_named_with_what_it_must_be(make, name, value, must):
    text = sentence(make(changes={name: value}))
    assert f"capture.yaml: '{name}'" in text
    assert must in text


@pytest.mark.parametrize(
    "name",
    [
        "format",
        "kind",
        "capture",
        "captured_at",
        "rig",
        "camera",
        "camera.white_level",
        "laser",
        "leds",
        "tire",
        "tire.id",
        "mileage",
        "mileage.unit",
    ],
)
def test_a_missing_field_is_said_to_be_missing(make, name):
    text = sentence(make(changes={name: ...}))
    assert f"'{name}" in text
    assert "is missing" in text


@pytest.mark.parametrize(
    ("name", "value", "must"),
    [
        ("board.inner_corners", [2, 6], "two whole numbers from 3"),
        ("board.square_mm", 0, "a number from 0.01"),
        ("axis_board", ..., "two whole numbers"),
        ("balls.count", 0, "a whole number from 1"),
        ("balls.diameter_mm", "12 mm", "a number from 0.1"),
        ("balls.centre_height_mm", None, "a number from -1000"),
        ("card.albedo", 1.5, "a number from 1e-06 to 1"),
    ],
)
def test_a_bad_calibration_field_is_named(make, name, value, must):
    assert must in sentence(make("calibration", {name: value}))


def test_a_white_level_at_the_black_level_is_refused(make):
    changes = {"camera.black_level": 640, "camera.white_level": 640}
    assert "It must be above black_level" in sentence(make(changes=changes))


@pytest.mark.parametrize("text", ["", "- a\n- b\n", "just words"])
def test_a_manifest_that_is_no_mapping_is_refused(make, text):
    folder = make()
    (folder / "capture.yaml").write_text(text)
    assert "must be a mapping" in sentence(folder)


@pytest.mark.parametrize(
    "data", [b"a: [1\nb: }", b"\xff\xfe\x00", b"a: &x [*x, !!python/object:x]"]
)
def test_a_manifest_that_is_no_yaml_is_refused(make, data):
    folder = make()
    (folder / "capture.yaml").write_bytes(data)
    sentence(folder)


def test_a_time_without_a_zone_counts_as_utc(make):
    capture = read_capture(make(changes={"captured_at": "2020-01-31T10:00:00"}))
    assert capture.captured_at == datetime(2020, 1, 31, 10, tzinfo=UTC)


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("a.png,laser,0,,,,", "row 2: encoder_deg is empty. A frame of kind 'laser' needs it"),
        ("a.png,laser,0,,n/a,,", "row 2: encoder_deg is 'n/a'"),
        ("a.png,laser,0,,inf,,", "row 2: encoder_deg is 'inf'"),
        ("a.png,laser,,,1,,", "row 2: pose is empty"),
        ("a.png,laser,-1,,1,,", "row 2: pose is '-1'. It must be a whole number from 0"),
        ("a.png,laser,1.5,,1,,", "row 2: pose is '1.5'"),
        ("a.png,led,0,,1,,", "row 2: led is empty"),
        ("a.png,led,0,4,1,,", "row 2: led is 4. capture.yaml says leds: 4, counted from 0"),
        ("a.png,board,0,,,,", "row 2: kind is 'board'. It must be one of laser, led, dark"),
        ("a.png,,0,,,,", "row 2: kind is ''"),
        ("a.png,laser,0,,1,0,", "row 2: exposure_s is 0.0. It must be above 0"),
        ("a.png,laser,0,,1,x,", "row 2: exposure_s is 'x'"),
        ("a.png,laser,0,,1,,abc", "row 2: sha256 is 'abc'. It must be 64 hex digits"),
        ("z.png,laser,0,,1,,", "row 2: file is 'z.png', which is not there"),
        (",laser,0,,1,,", "row 2: file is ''"),
        ("x" * 300 + ".png,laser,0,,1,,", "which is not there"),
        ("/etc/hostname,laser,0,,1,,", "It must be a path below the capture's folder"),
        ("../capture/a.png,laser,0,,1,,", "It must be a path below the capture's folder"),
        (r"sub\a.png,laser,0,,1,,", "It must be a path below the capture's folder"),
    ],
)
def test_a_bad_row_is_named_with_its_field(make, row, said):
    text = sentence(make(rows=[row]))
    assert "frames.csv" in text
    assert said in text


def test_rows_are_counted_as_an_editor_counts_lines(make):
    folder = make(rows=["a.png,laser,0,,1,,", "b.png,laser,1,,2,,", "c.png,laser,2,,x,,"])
    assert "row 4: encoder_deg" in sentence(folder)


def test_a_link_that_leaves_the_folder_is_refused(make, tmp_path):
    folder = make(rows=["link.png,laser,0,,1,,"])
    (tmp_path / "outside.png").write_bytes(b"x")
    (folder / "link.png").symlink_to(tmp_path / "outside.png")
    assert "a link that leaves the capture's folder" in sentence(folder)


def test_a_link_inside_the_folder_is_followed(make):
    folder = make(rows=["link.png,laser,0,,1,,"])
    (folder / "link.png").symlink_to(folder / "a.png")
    assert read_capture(folder).frames[0].file == "link.png"


def test_a_folder_linked_as_a_whole_is_read(make, tmp_path):
    make()
    (tmp_path / "linked").symlink_to(tmp_path / "capture")
    assert read_capture(tmp_path / "linked").id == "t7-00200"


@pytest.mark.parametrize(
    "rows",
    [
        ["a.png,laser,0,,1,,", "b.png,laser,0,,2,,"],
        ["a.png,led,0,1,1,,", "b.png,led,0,1,1,,"],
    ],
)
def test_a_repeated_frame_is_refused(make, rows):
    assert "row 3: repeats row 2" in sentence(make(rows=rows))


def test_a_repeated_calibration_frame_is_refused(make):
    rows = ["a.png,balls,,1,,,", "b.png,balls,,1,,,"]
    assert "row 3: repeats row 2" in sentence(make("calibration", rows=rows))


def test_several_dark_frames_are_welcome(make):
    rows = ["a.png,laser,0,,1,,", "b.png,dark,,,,,", "c.png,dark,,,,,"]
    assert len(read_capture(make(rows=rows)).of_kind("dark")) == 2


def test_led_frames_of_a_view_share_one_angle(make):
    rows = ["a.png,led,0,0,1,,", "b.png,led,0,1,1.5,,"]
    text = sentence(make(rows=rows))
    assert "row 3: encoder_deg is 1.5, but row 2" in text
    assert "share one angle" in text


def test_a_table_without_rows_or_columns_is_refused(make):
    assert "lists no frame" in sentence(make(rows=[]))
    assert "has no column 'kind'" in sentence(make(header="file,what,pose"))


def test_a_missing_table_is_refused(make):
    folder = make()
    (folder / "frames.csv").unlink()
    assert "frames.csv: cannot be read" in sentence(folder)


def test_optional_columns_may_be_absent_and_others_are_ignored(make):
    folder = make(header="kind,file,pose,encoder_deg,note", rows=["laser,a.png,3,4.5,hello"])
    frame = read_capture(folder).frames[0]
    assert (frame.pose, frame.encoder_deg, frame.sha256, frame.led) == (3, 4.5, None, None)


def test_a_byte_order_mark_and_windows_line_ends_are_read(make):
    folder = make()
    text = (folder / "frames.csv").read_text()
    (folder / "frames.csv").write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode())
    assert len(read_capture(folder).frames) == 4


def test_digests_are_compared_in_lower_case(make):
    digest = "AB" * 32
    assert read_capture(make(rows=[f"a.png,laser,0,,1,,{digest}"])).frames[0].sha256 == "ab" * 32


@pytest.mark.shared
def test_the_sample_archive_is_healthy(sample_archive):
    for name in ("bench-1-2020-01", "t7-00100", "t7-00200"):
        assert read_capture(sample_archive / name).id == name
