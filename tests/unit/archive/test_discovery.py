import pytest

from treadlight.archive import choose_calibration, find_archive, read_capture
from treadlight.errors import CaptureError


@pytest.fixture
def archive(make, tmp_path):
    """Three measurements and three calibrations of two rigs."""

    def measurement(name, day, value=100, unit="mi", **changes):
        facts = {"capture": name, "captured_at": f"2020-02-{day:02d}T00:00:00Z"}
        facts |= {"mileage.value": value, "mileage.unit": unit, **changes}
        make(changes=facts, name=f"in/{name}")

    def calibration(name, day, rig="bench-1"):
        facts = {"capture": name, "captured_at": f"2020-02-{day:02d}T00:00:00Z", "rig": rig}
        make("calibration", facts, name=f"in/cal/{name}")

    calibration("cal-05", 5)
    calibration("cal-15", 15)
    calibration("other", 10, "bench-2")
    measurement("m-10", 10, 300)
    measurement("m-20", 20, 200)
    measurement("m-01", 1, 100)
    return tmp_path / "in", measurement, calibration


def test_each_measurement_takes_the_latest_calibration_before_it(archive):
    found = find_archive(archive[0])
    assert found.calibration_of == {"m-01": "cal-05", "m-10": "cal-05", "m-20": "cal-15"}
    assert list(found.warnings) == ["m-01"]
    assert "was taken after this capture" in found.warnings["m-01"]
    assert found.refused == {}


def test_ties_in_time_go_by_id(archive):
    root, _, calibration = archive
    calibration("cal-00", 15)
    calibration("cal-99", 15)
    assert find_archive(root).calibration_of["m-20"] == "cal-00"


def test_a_calibration_taken_at_the_same_moment_counts_as_before(archive):
    root, measurement, _ = archive
    measurement("m-15", 15)
    found = find_archive(root)
    assert found.calibration_of["m-15"] == "cal-15"
    assert "m-15" not in found.warnings


def test_a_named_calibration_wins_whatever_its_rig_and_time(archive):
    found = find_archive(archive[0], named_calibrations={"m-01": "other"})
    assert found.calibration_of["m-01"] == "other"
    assert "m-01" not in found.warnings


def test_a_named_calibration_that_is_not_there_refuses_the_capture(archive):
    found = find_archive(archive[0], named_calibrations={"m-01": "cal-77"})
    assert "no usable calibration 'cal-77'" in found.refused["m-01"]
    assert "cal-05 of rig bench-1" in found.refused["m-01"]
    assert "m-01" not in found.measurements


def test_a_rig_without_calibration_refuses_its_captures_only(archive):
    root, measurement, _ = archive
    measurement("m-lost", 20, rig="bench-9")
    found = find_archive(root)
    assert list(found.refused) == ["m-lost"]
    assert "no calibration of rig 'bench-9'" in found.refused["m-lost"]
    assert len(found.measurements) == 3


def test_an_archive_without_calibration_says_none(make):
    capture = read_capture(make())
    with pytest.raises(CaptureError, match="Found: none"):
        choose_calibration(capture, {})


def test_tires_order_captures_by_mileage_then_date(archive):
    root, measurement, _ = archive
    measurement("m-late", 25, 200)
    measurement("m-km", 26, 161, "km")
    found = find_archive(root)
    assert found.tires == {"t7": ["m-01", "m-km", "m-20", "m-late", "m-10"]}


def test_a_bad_capture_is_refused_and_the_others_are_found(archive):
    root, _, _ = archive
    (root / "m-10" / "capture.yaml").write_text("kind: [")
    found = find_archive(root)
    assert list(found.refused) == ["m-10"]
    assert sorted(found.measurements) == ["m-01", "m-20"]


def test_a_bad_calibration_is_not_chosen(archive):
    root, _, _ = archive
    (root / "cal/cal-15/frames.csv").unlink()
    found = find_archive(root)
    assert found.calibration_of["m-20"] == "cal-05"
    assert list(found.refused) == ["cal-15"]


def test_two_captures_of_one_id_leave_the_first(archive, make):
    make(changes={"capture": "m-10"}, name="in/zz-copy")
    found = find_archive(archive[0])
    assert "m-10" in found.measurements
    assert "Two captures cannot share an id" in found.refused["zz-copy"]
    assert str(archive[0] / "m-10") in found.refused["zz-copy"]


def test_copies_in_folders_of_one_name_are_both_accounted_for(archive, make):
    make(changes={"capture": "m-10"}, name="in/zz/m-10")
    found = find_archive(archive[0])
    assert "m-10" in found.measurements
    assert list(found.refused) == ["zz/m-10"]


def test_bad_captures_in_folders_of_one_name_are_all_listed(archive, make):
    for place in ("x", "y"):
        make(changes={"kind": "odd", "capture": "scan"}, name=f"in/{place}/scan")
    assert len(find_archive(archive[0]).refused) == 2


def test_a_bad_capture_never_takes_the_name_of_a_good_one(archive, make):
    make(changes={"kind": "odd"}, name="in/aa/m-10")
    found = find_archive(archive[0])
    assert "m-10" in found.measurements
    assert list(found.refused) == ["aa/m-10"]


def test_patterns_choose_captures(archive):
    root = archive[0]
    assert list(find_archive(root, include=["m-1*", "cal*"]).measurements) == ["m-10"]
    assert "m-10" not in find_archive(root, exclude=["m-1*"]).measurements
    assert find_archive(root, exclude=["other"]).calibrations.keys() == {"cal-05", "cal-15"}


def test_an_excluded_bad_capture_is_no_trouble(archive):
    root = archive[0]
    (root / "m-10" / "capture.yaml").write_text("kind: [")
    assert find_archive(root, exclude=["m-10"]).refused == {}


def test_a_check_may_refuse_a_capture(archive):
    def check(capture):
        if capture.id == "m-20":
            raise CaptureError("a.png: is 3x3.")

    found = find_archive(archive[0], check=check)
    assert found.refused == {"m-20": "a.png: is 3x3."}


def test_a_capture_may_be_the_archive_itself(make):
    assert list(find_archive(make("calibration")).calibrations) == ["bench-1-2020-01"]


def test_an_empty_folder_holds_nothing(tmp_path):
    found = find_archive(tmp_path)
    assert not found.measurements
    assert not found.refused
    assert found.tires == {}
