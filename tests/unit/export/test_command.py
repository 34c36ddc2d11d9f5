"""Every export is read back by somebody else's reader and holds the profile's numbers."""

import csv
import hashlib

import numpy as np
import open3d
import pytest
import SurfaceTopography
import xarray as xr
from PIL import Image

from treadlight import store
from treadlight.cli import main

FORMATS = {
    "mesh": "m.ply",
    "points": "p.ply",
    "x3p": "h.x3p",
    "gwy": "h.gwy",
    "netcdf": "p.nc",
    "png": "h.png",
    "areal": "a.csv",
}


@pytest.fixture
def profile(worn_tire):
    return worn_tire / "captures/b/profile.zarr"


@pytest.fixture
def data(profile):
    return store.open_store(profile)


def export(name, profile, tmp_path, *more):
    out = tmp_path / FORMATS[name]
    assert main(["export", name, str(profile), str(out), *more]) == 0
    return out


def place_of(data):
    r = data["r"].to_numpy()
    theta, z = np.broadcast_arrays(data["theta"].to_numpy()[:, None], data["z"].to_numpy())
    known = np.isfinite(r)
    return np.stack([r * np.cos(theta), r * np.sin(theta), z], 2)[known]


def test_the_mesh_has_a_vertex_at_every_known_cell(profile, data, tmp_path):
    mesh = open3d.io.read_triangle_mesh(export("mesh", profile, tmp_path))
    np.testing.assert_allclose(np.asarray(mesh.vertices), place_of(data), atol=1e-5)
    assert mesh.has_triangles()
    assert mesh.is_orientable()


def test_the_points_have_outward_normals(profile, data, tmp_path):
    cloud = open3d.io.read_point_cloud(export("points", profile, tmp_path))
    points, normals = np.asarray(cloud.points), np.asarray(cloud.normals)
    np.testing.assert_allclose(points, place_of(data), atol=1e-5)
    outward = np.einsum("ij,ij->i", points[:, :2], normals[:, :2])
    assert (outward > 0).mean() > 0.99


@pytest.mark.parametrize("name", ["x3p", "gwy"])
def test_surface_files_are_read_by_surface_topography(profile, data, tmp_path, name):
    reader = SurfaceTopography.open_topography(export(name, profile, tmp_path))
    topography = reader.topography()
    unit = {"m": 1.0, "mm": 1e-3, "\u00b5m": 1e-6, "nm": 1e-9}[topography.unit]
    height = data["height"].to_numpy()
    back = np.ma.filled(topography.heights(), np.nan) * unit * 1e3
    # Its first axis is x. Rows of a Gwyddion field run downwards, and are read as they come.
    expected = height[:, ::-1] if name == "gwy" else height
    np.testing.assert_allclose(back, expected, atol=1e-9)
    size = [step * count for step, count in zip(steps(data), height.shape, strict=True)]
    np.testing.assert_allclose(np.array(topography.physical_sizes) * unit * 1e3, size, rtol=1e-3)


def steps(data):
    theta, z = data["theta"].to_numpy(), data["z"].to_numpy()
    return (theta[1] - theta[0]) * float(data.attrs["nominal_radius_mm"]), z[1] - z[0]


def test_netcdf_holds_every_variable_exactly(profile, data, tmp_path):
    with xr.open_dataset(export("netcdf", profile, tmp_path), engine="netcdf4") as back:
        assert set(back.variables) == set(data.variables)
        for name in data.data_vars:
            np.testing.assert_array_equal(back[name].to_numpy(), data[name].to_numpy())
            assert back[name].attrs["units"] == data[name].attrs["units"]
        assert back.attrs["source"] == "b"


def test_the_picture_says_how_grey_becomes_height(profile, data, tmp_path):
    with Image.open(export("png", profile, tmp_path)) as image:
        grey, text = np.asarray(image).astype(float), image.text["height_mm"]
    low, _, rest = text.partition(" + (value - 1) * ")
    back = np.where(grey == 0, np.nan, float(low) + (grey - 1) * float(rest.partition(";")[0]))
    height = data["height"].to_numpy()
    np.testing.assert_allclose(back[::-1].T, height, atol=1e-3)


def test_areal_parameters_are_those_of_the_noise_on_the_ribs(profile, tmp_path):
    settings = '{"s_filter_mm": 0.5, "l_filter_mm": 5.0}'
    with export("areal", profile, tmp_path, "--settings", settings).open() as file:
        rows = list(csv.DictReader(file))
    assert {row["rib"] for row in rows} == {"rib-1", "rib-2", "rib-3"}
    assert {row["s_filter_mm"] for row in rows} == {"0.5"}
    # Noise of 14 um (the height's and the radius's), of which the filters leave the most.
    sq = [float(row["sq_um"]) for row in rows]
    assert 8 < np.median(sq) < 15
    assert all(0 < float(row["sa_um"]) < float(row["sq_um"]) < float(row["sz_um"]) for row in rows)


@pytest.mark.parametrize("name", FORMATS)
def test_the_same_profile_gives_the_same_file(profile, tmp_path, name):
    digests = set()
    for folder in ("one", "two"):
        out = export(name, profile, tmp_path / folder, "--step-mm", "2")
        digests.add(hashlib.sha256(out.read_bytes()).hexdigest())
    assert len(digests) == 1


def test_a_coarser_export_has_fewer_cells(profile, data, tmp_path):
    with Image.open(export("png", profile, tmp_path, "--step-mm", "1.5")) as image:
        assert image.size[0] == data.sizes["theta"] // 2


def test_a_refused_profile_is_not_exported(tmp_path, capsys):
    path = tmp_path / "profile.zarr"
    store.write_refused(path, "No laser line was found.", title="Profile", source="b")
    out = tmp_path / "h.x3p"
    assert main(["export", "x3p", str(path), str(out)]) == 1
    assert "No laser line was found." in capsys.readouterr().err
    assert not out.exists()


def test_filters_in_the_wrong_order_are_named(profile, tmp_path, capsys):
    settings = '{"s_filter_mm": 9}'
    out = tmp_path / "a.csv"
    assert main(["export", "areal", str(profile), str(out), "--settings", settings]) == 2
    assert "export.s_filter_mm must be above 0 and below" in capsys.readouterr().err
    assert not list(tmp_path.glob(".writing*"))


def test_a_large_profile_is_read_in_slabs_to_the_same_file(profile, tmp_path, monkeypatch):
    whole = export("png", profile, tmp_path / "whole", "--step-mm", "2")
    monkeypatch.setattr("treadlight.commands.export._CELLS_AT_ONCE", 2000)
    slabs = export("png", profile, tmp_path / "slabs", "--step-mm", "2")
    assert whole.read_bytes() == slabs.read_bytes()


def test_more_cells_than_others_can_open_name_the_remedy(profile, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("treadlight.commands.export._MOST_CELLS", 1000)
    assert main(["export", "mesh", str(profile), str(tmp_path / "m.ply")]) == 2
    assert "Set export.step_mm or --step-mm" in capsys.readouterr().err
