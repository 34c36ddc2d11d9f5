import csv
import warnings
from argparse import ArgumentParser

import numpy as np
import pytest
import xarray as xr

from treadlight import store
from treadlight.commands import wear as command
from treadlight.geometry import CylinderGrid


def publish(path, r, grid, capture, mileage, unit="mi", noise=0.02):
    dims = ("theta", "z")
    std = np.where(np.isfinite(r), noise, np.nan).astype(np.float32)
    dataset = xr.Dataset(
        {
            "r": store.variable(dims, r.astype(np.float32), "mm", "radius"),
            "r_std": store.variable(dims, std, "mm", "standard uncertainty"),
        },
        coords={
            "theta": store.variable(("theta",), grid.theta, "rad", "angle"),
            "z": store.variable(("z",), grid.z, "mm", "axial"),
        },
        attrs={
            "tire": "t",
            "mileage": mileage,
            "mileage_unit": unit,
            "captured_at": "2020-01-01T00:00:00+00:00",
            "nominal_radius_mm": grid.nominal_radius_mm,
        },
    )
    store.write_store(path, dataset, title="Profile", source=capture)
    return path


def run(tmp_path, profiles, *more):
    parser = ArgumentParser()
    command.add_arguments(parser)
    out, trend = tmp_path / "wear.zarr", tmp_path / "trend.csv"
    texts = ["t", *map(str, profiles), "--out", str(out), "--trend", str(trend), *more]
    args = parser.parse_args(texts)
    args.command = "wear"
    status = command.run(args)
    with trend.open() as file:
        return status, out, list(csv.DictReader(file))


@pytest.fixture
def mileages(tmp_path, tire, make_grid, make_remount, rng):
    grid, other = make_grid((0.0, 1.6)), make_grid((-1.2, 0.6), 0.6)
    one = tire.mileage(grid) + 0.02 * rng.standard_normal(grid.shape)
    two = tire.mileage(other, make_remount(1.2), 0.15) + 0.02 * rng.standard_normal(other.shape)
    return (
        publish(tmp_path / "1.zarr", one, grid, "c1", 100),
        publish(tmp_path / "2.zarr", two, other, "c2", 321.8688, "km"),
    )


def test_two_mileages_become_a_map_and_a_trend(tmp_path, mileages):
    """Another grid, another unit, another mounting."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        status, out, rows = run(tmp_path, mileages)
    assert status == 0
    wear = xr.open_zarr(out, consolidated=False)
    assert wear["wear"].dims == ("capture", "theta", "z")
    assert list(wear["capture"].values) == ["c1", "c2"]
    np.testing.assert_allclose(wear["mileage"], [100.0, 200.0])
    assert wear["mileage"].attrs["units"] == "mi"
    assert wear["alignment"].sel(capture="c1").values.tolist() == [0.0] * 7
    assert abs(float(wear["alignment"].sel(capture="c2", parameter="rotation_rad")) - 1.2) < 2e-3
    assert list(wear["parameter"].values)[-1] == "radial_mm"
    assert np.nanmax(np.abs(wear["wear"][0])) == 0.0
    by_region = {row["region"]: row for row in rows if row["capture"] == "c2"}
    assert abs(float(by_region["tread"]["wear_mm"]) - 0.15) < 0.02
    assert by_region["tread"]["status"] == "indicative"
    assert by_region["tread"]["unit"] == "mi"
    assert out.with_name("wear.zarr.provenance.json").is_file()


def test_a_single_capture_is_first_throughout(tmp_path, mileages):
    _, out, rows = run(tmp_path, mileages[:1])
    assert {row["status"] for row in rows} == {"first"}
    assert store.open_store(out).sizes["capture"] == 1


def test_another_sector_has_no_wear_and_a_warning(tmp_path, tire, make_grid, mileages, capsys):
    grid = make_grid((3.0, 4.5))
    path = publish(tmp_path / "3.zarr", tire.mileage(grid), grid, "c3", 300)
    _, out, rows = run(tmp_path, [*mileages, path])
    wear = store.open_store(out)
    assert np.isnan(wear["wear"].sel(capture="c3")).all()
    assert np.isfinite(wear["wear"].sel(capture="c2")).any()
    assert "c3: Its tread pattern matches" in wear.attrs["warnings"][0]
    assert "c3" in capsys.readouterr().err
    last = [row for row in rows if row["capture"] == "c3"]
    assert {row["status"] for row in last} == {"not_detected"}
    assert {row["wear_mm"] for row in last} == {""}


def test_a_refused_capture_leaves_the_others_their_wear(tmp_path, mileages):
    refused = tmp_path / "0.zarr"
    store.write_refused(refused, "No frame is readable.", title="Profile", source="c0")
    _, out, rows = run(tmp_path, [refused, *mileages])
    assert list(store.open_store(out)["capture"].values) == ["c1", "c2"]
    assert "refused" in store.open_store(out).attrs["warnings"][0]
    assert {row["capture"] for row in rows} == {"c1", "c2"}


def test_a_tire_of_refused_captures_is_refused(tmp_path):
    refused = tmp_path / "0.zarr"
    store.write_refused(refused, "No frame is readable.", title="Profile", source="c0")
    status, out, rows = run(tmp_path, [refused])
    assert status == 0
    assert store.refused_reason(out) == "No frame is readable."
    assert rows == []


def test_the_same_input_gives_the_same_bytes(tmp_path, mileages):
    digests = []
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        _, out, _ = run(tmp_path / folder, mileages)
        digests.append(store.content_digest(out))
    assert digests[0] == digests[1]


def test_a_profile_without_any_radius_is_no_crash(tmp_path, mileages, make_grid):
    grid = make_grid((0.0, 1.0))
    path = publish(tmp_path / "3.zarr", np.full(grid.shape, np.nan), grid, "c3", 300)
    for order in ([mileages[0], path], [path, mileages[0]]):
        _, out, _ = run(tmp_path, order)
        assert np.isnan(store.open_store(out)["wear"][1]).all()


@pytest.mark.shared
def test_the_samples_true_profiles_give_its_true_wear(tmp_path, sample_archive, rng):
    """Alignment and difference alone: mean within 5 um, 5 mm cells within 15 um."""
    paths = []
    for capture, mileage in (("t7-00100", 100), ("t7-00200", 200)):
        with np.load(sample_archive / capture / "truth" / "profile.npz") as data:
            # Every second cell keeps the test short.
            theta, z, r = data["theta"][::2], data["z"][::2], data["r"][::2, ::2]
        grid = CylinderGrid(theta, z, 355.0)
        noisy = r + 0.05 * rng.standard_normal(r.shape)
        paths.append(publish(tmp_path / f"{capture}.zarr", noisy, grid, capture, mileage))
    _, out, _ = run(tmp_path, paths)
    found = store.open_store(out)
    with np.load(sample_archive / "t7-00200" / "truth" / "wear.npz") as data:
        truth = data["wear"][::2, ::2]
    wear = found["wear"].values[1]
    worn = (truth > 0.02) & np.isfinite(wear)
    assert worn.sum() > 0.7 * (truth > 0.02).sum()
    assert abs(np.mean((wear - truth)[worn])) < 0.005
    rotation, axial, *_, radial = found["alignment"].values[1]
    assert abs(rotation - 1.57255) < 3e-4
    assert abs(axial - 2.2) < 0.05
    assert abs(radial + 0.14) < 0.02
