import json
import os

import numpy as np
import pytest
import xarray as xr
import zarr

from treadlight import store
from treadlight.errors import StoreError


def dataset(shape=(7, 5), dtype=np.float32):
    values = np.arange(np.prod(shape), dtype=dtype).reshape(shape)
    return xr.Dataset({"r": store.variable(("theta", "z"), values, "mm", "radius")})


def write(path, data=None, **more):
    data = dataset() if data is None else data
    store.write_store(path, data, title="Title", source="t7-1", **more)


def test_a_store_comes_back_as_it_was_with_its_attributes(tmp_path):
    write(tmp_path / "a.zarr")
    found = store.open_store(tmp_path / "a.zarr")
    assert np.array_equal(found.r, dataset().r)
    assert found.r.dtype == np.float32
    assert found.r.attrs == {"units": "mm", "long_name": "radius"}
    assert found.attrs["title"] == "Title"
    assert found.attrs["source"] == "t7-1"
    assert found.attrs["Conventions"].startswith("CF-")
    assert len(found.attrs["content_digest"]) == 64


def test_a_store_is_zarr_3_without_consolidated_metadata(tmp_path):
    write(tmp_path / "a.zarr")
    root = json.loads((tmp_path / "a.zarr/zarr.json").read_text())
    assert root["zarr_format"] == 3
    assert not root.get("consolidated_metadata")


@pytest.mark.parametrize(
    "shape", [(1, 1), (255, 257), (1023, 40), (1025, 33), (2100, 1100), (1024, 1024)]
)
def test_sharded_arrays_of_odd_sizes_come_back_whole(tmp_path, rng, shape):
    values = rng.normal(size=shape).astype(np.float32)
    values[rng.uniform(size=shape) < 0.1] = np.nan
    data = xr.Dataset({"r": store.variable(("theta", "z"), values, "mm", "radius")})
    write(tmp_path / "a.zarr", data)
    assert np.array_equal(store.open_store(tmp_path / "a.zarr").r, values, equal_nan=True)
    array = zarr.open_array(tmp_path / "a.zarr/r", mode="r")
    assert all(s % c == 0 for s, c in zip(array.shards, array.chunks, strict=True))
    assert max(array.shards) <= 1024


def test_three_dimensions_and_texts_come_back(tmp_path, rng):
    values = rng.normal(size=(3, 300, 1030))
    names = np.array(["a", "longer"])
    data = xr.Dataset(
        {
            "normal": store.variable(("k", "theta", "z"), values, "1", "normal"),
            "label": store.variable(("capture",), names, "1", "label"),
        },
        coords={"capture": store.variable(("capture",), names, "1", "capture")},
    )
    write(tmp_path / "a.zarr", data)
    found = store.open_store(tmp_path / "a.zarr")
    assert np.array_equal(found.normal, values)
    assert found.label.values.tolist() == ["a", "longer"]
    assert found.capture.values.tolist() == ["a", "longer"]
    assert found.capture.attrs["long_name"] == "capture"


@pytest.mark.parametrize("rows", [[2, 3, 4], [5, 6, 0, 1], [0, 1, 2, 3, 4, 5, 6], []])
def test_neighbouring_rows_are_read_across_the_seam_too(tmp_path, rows):
    write(tmp_path / "a.zarr")
    rows = np.array(rows, int)
    found = store.load_rows(store.open_store(tmp_path / "a.zarr"), rows)
    np.testing.assert_array_equal(found.r, dataset().r.values[rows])


def test_a_store_is_the_same_from_any_number_of_threads(tmp_path, rng):
    data = dataset((1100, 300)) + rng.normal(size=(1100, 300)).astype(np.float32)
    data["r"].attrs = {"units": "mm", "long_name": "radius"}
    digests = set()
    # Of four threads the order of chunks in a shard would differ in half of the runs.
    for workers in (1, *[4] * 8):
        with zarr.config.set({"threading.max_workers": workers}):
            write(tmp_path / "a.zarr", data)
        digests.add(store.open_store(tmp_path / "a.zarr").content_digest)
    assert len(digests) == 1


def test_flags_are_bit_masks_in_cf(tmp_path):
    names = ["laser", "photometric", "step"]
    values = np.array([[0, 1, 2, 5]], np.uint8)
    flags = store.variable(("theta", "z"), values, "1", "quality", **store.flag_attrs(names))
    write(tmp_path / "a.zarr", xr.Dataset({"quality": flags}))
    found = store.open_store(tmp_path / "a.zarr").quality
    assert found.dtype == np.uint8
    assert list(found.attrs["flag_masks"]) == [1, 2, 4]
    assert found.attrs["flag_meanings"] == "laser photometric step"
    assert np.array_equal(found, values)


def test_a_variable_without_units_is_a_defect_of_the_caller(tmp_path):
    data = xr.Dataset({"r": (("theta",), np.zeros(3), {"long_name": "radius"})})
    with pytest.raises(ValueError, match="'r' lacks \\['units'\\]"):
        write(tmp_path / "a.zarr", data)
    assert not (tmp_path / "a.zarr").exists()


def test_writing_twice_gives_the_same_bytes(tmp_path, rng):
    data = dataset((1500, 700))
    for name in "ab":
        write(tmp_path / f"{name}.zarr", data)
    files = sorted(p.relative_to(tmp_path / "a.zarr") for p in (tmp_path / "a.zarr").rglob("*"))
    assert files == sorted(
        p.relative_to(tmp_path / "b.zarr") for p in (tmp_path / "b.zarr").rglob("*")
    )
    for file in files:
        if (tmp_path / "a.zarr" / file).is_file():
            assert (tmp_path / "a.zarr" / file).read_bytes() == (
                tmp_path / "b.zarr" / file
            ).read_bytes()


def test_publishing_replaces_the_old_store_and_leaves_nothing_beside(tmp_path):
    write(tmp_path / "a.zarr", dataset((2000, 30)))
    write(tmp_path / "a.zarr", dataset((7, 5)))
    assert store.open_store(tmp_path / "a.zarr").r.shape == (7, 5)
    assert os.listdir(tmp_path) == ["a.zarr"]


def test_leftovers_of_a_broken_run_do_no_harm(tmp_path):
    for name in (".a.zarr.writing", ".a.zarr.old"):
        (tmp_path / name / "r").mkdir(parents=True)
        (tmp_path / name / "r" / "junk").write_text("x")
    write(tmp_path / "a.zarr")
    assert store.open_store(tmp_path / "a.zarr").r.shape == (7, 5)
    assert os.listdir(tmp_path) == ["a.zarr"]


def test_a_writer_that_fails_leaves_the_old_store(tmp_path, monkeypatch):
    write(tmp_path / "a.zarr")

    def fail(path):
        raise OSError("disk full")

    monkeypatch.setattr(store, "content_digest", fail)
    with pytest.raises(OSError, match="disk full"):
        write(tmp_path / "a.zarr", dataset((3, 3)))
    monkeypatch.undo()
    assert store.open_store(tmp_path / "a.zarr").r.shape == (7, 5)


def test_a_store_whose_root_metadata_was_removed_can_be_published_again(tmp_path):
    """Snakemake removes the declared output, the root metadata, before it reruns a job."""
    write(tmp_path / "a.zarr", dataset((2000, 30)))
    (tmp_path / "a.zarr/zarr.json").unlink()
    with pytest.raises(StoreError, match="there is no such product"):
        store.open_store(tmp_path / "a.zarr")
    write(tmp_path / "a.zarr")
    assert store.open_store(tmp_path / "a.zarr").r.shape == (7, 5)


def shard(path):
    return next(p for p in (path / "r" / "c").rglob("*") if p.is_file())


def damage(path, kind):
    file = shard(path)
    if kind == "missing":
        file.unlink()
    elif kind == "truncated":
        file.write_bytes(file.read_bytes()[:-3])
    elif kind == "flipped":
        data = bytearray(file.read_bytes())
        data[len(data) // 2] ^= 1
        file.write_bytes(bytes(data))
    elif kind == "added":
        (file.parent / "99").write_bytes(b"x")
    elif kind == "renamed":
        file.rename(file.parent / "7")
    else:
        root = json.loads((path / "zarr.json").read_text())
        root["attributes"]["title"] = "Other"
        (path / "zarr.json").write_text(json.dumps(root))


@pytest.mark.parametrize(
    "kind", ["missing", "truncated", "flipped", "added", "renamed", "attribute"]
)
def test_the_digest_catches_damage(tmp_path, kind):
    write(tmp_path / "a.zarr")
    damage(tmp_path / "a.zarr", kind)
    with pytest.raises(StoreError, match=r"does not match its digest\. Delete it and run again"):
        store.open_store(tmp_path / "a.zarr")


@pytest.mark.filterwarnings("ignore:Object at .snakemake_timestamp")
def test_snakemakes_timestamp_is_no_content(tmp_path):
    write(tmp_path / "a.zarr")
    (tmp_path / "a.zarr/.snakemake_timestamp").touch()
    assert store.open_store(tmp_path / "a.zarr").r.shape == (7, 5)


@pytest.mark.parametrize("text", ["", "{", "[]", '{"attributes": 3}', "\udcff"])
def test_a_broken_root_is_a_damaged_store(tmp_path, text):
    write(tmp_path / "a.zarr")
    (tmp_path / "a.zarr/zarr.json").write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(StoreError):
        store.open_store(tmp_path / "a.zarr")
    with pytest.raises(StoreError):
        store.refused_reason(tmp_path / "a.zarr")


def test_a_store_is_named_by_its_folder_or_its_root(tmp_path):
    write(tmp_path / "a.zarr")
    assert store.open_store(tmp_path / "a.zarr/zarr.json").r.shape == (7, 5)
    assert store.store_folder(tmp_path / "a.zarr/zarr.json") == tmp_path / "a.zarr"


@pytest.mark.parametrize("name", ["a.zarr", "a.zarr/zarr.json", "a.json", "photometric.zarr/fov03"])
def test_a_refused_product_says_why_and_is_valid(tmp_path, name):
    path = tmp_path / name
    store.write_refused(path, "led/3.png: cannot be decoded.", title="T", source="s")
    assert store.refused_reason(path) == "led/3.png: cannot be decoded."
    if "json" not in name:
        assert store.open_store(path).attrs["refused"] == "led/3.png: cannot be decoded."
        assert not store.open_store(path).data_vars


def test_what_is_not_refused_has_no_reason(tmp_path):
    write(tmp_path / "a.zarr")
    store.write_json(tmp_path / "a.json", {"x": 1})
    store.write_text(tmp_path / "a.csv", "refused\nno\n")
    for name in ("a.zarr", "a.json", "a.csv"):
        assert store.refused_reason(tmp_path / name) is None


def test_a_missing_product_is_a_store_error(tmp_path):
    for read in (store.refused_reason, store.open_store, store.read_csv, store.read_json):
        with pytest.raises(StoreError):
            read(tmp_path / "none.zarr")


def test_json_writes_plain_numbers_and_null_for_nan(tmp_path):
    content = {
        "b": np.float64(np.nan),
        "a": [np.int64(3), np.inf, np.float32(0.5), (True, None)],
        3: np.array([[1.0, np.nan]]),
        "text": "µm",
    }
    store.write_json(tmp_path / "x" / "a.json", content)
    text = (tmp_path / "x" / "a.json").read_text(encoding="utf-8")
    assert json.loads(text) == {
        "b": None,
        "a": [3, None, 0.5, [True, None]],
        "3": [[1.0, None]],
        "text": "µm",
    }
    assert list(json.loads(text)) == ["b", "a", "3", "text"]
    assert os.listdir(tmp_path / "x") == ["a.json"]


def test_damaged_json_and_csv_are_store_errors(tmp_path):
    (tmp_path / "a.json").write_text('{"a": ')
    with pytest.raises(StoreError, match="Delete it and run again"):
        store.read_json(tmp_path / "a.json")
    (tmp_path / "a.csv").write_bytes(b"\xff\xfe\n")
    with pytest.raises(StoreError, match="Delete it and run again"):
        store.read_csv(tmp_path / "a.csv")


def test_csv_rows_come_back_as_texts(tmp_path):
    store.write_text(tmp_path / "a.csv", "a,b\n1,\n")
    assert store.read_csv(tmp_path / "a.csv") == [{"a": "1", "b": ""}]


def test_a_rig_is_read_with_the_parts_that_are_there(tmp_path):
    content = {
        "camera": {
            "matrix": [[2580, 0, 8], [0, 2580, 6], [0, 0, 1]],
            "distortion": [-0.06, 0.03, 0, 0, 0],
            "size_px": [512, 768],
        },
        "laser_plane": {"coefficients": [0.6, 0.0, 0.8, -200.0]},
        "axis": {"direction": [0, 1, 0], "point": [1, 0, 1150]},
        "reference_plane": None,
        "leds": [{"led": 3, "position": [1, 2, 3], "intensity": 0.9}],
        "covariance": {"order": ["camera.fx"], "matrix": [[0.25]]},
    }
    store.write_json(tmp_path / "calibration.json", content)
    rig = store.read_rig(tmp_path / "calibration.json")
    assert rig.camera.size_px == (512, 768)
    assert rig.laser_plane.offset == -200.0
    assert rig.axis.point.tolist() == [1, 0, 1150]
    assert rig.reference_plane is None
    assert rig.leds[0].number == 3
    assert rig.covariance.tolist() == [[0.25]]
    store.write_json(tmp_path / "bare.json", {"camera": content["camera"]})
    bare = store.read_rig(tmp_path / "bare.json")
    assert bare.axis is bare.laser_plane is bare.covariance is None
    assert bare.leds == ()
