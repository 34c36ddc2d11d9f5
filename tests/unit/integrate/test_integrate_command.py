import json

import numpy as np
import pytest
import xarray as xr

from treadlight import store
from treadlight.cli import main
from treadlight.commands.integrate import StoredView, read_ahead
from treadlight.geometry import CylinderGrid

CAPTURE = """\
format: tread-capture/1
kind: measurement
capture: t1-0
tire: {id: t1, size: "1", nominal_radius_mm: 100.0, tread_width_mm: 20.0}
mileage: {value: 0, unit: km}
captured_at: 2020-01-31T10:00:00Z
rig: bench
camera: {size_px: [8, 8], encoding: linear, black_level: 0, white_level: 65535}
laser: {scan: rows, channel: red}
leds: 0
"""

# Of a normal's components, rad^2.
COVARIANCE = 1e-4


@pytest.fixture
def products(tmp_path, rng):
    (tmp_path / "t1").mkdir()
    (tmp_path / "t1/capture.yaml").write_text(CAPTURE)
    (tmp_path / "t1/a.png").write_bytes(b"")
    (tmp_path / "t1/frames.csv").write_text(
        "file,kind,pose,led,encoder_deg,exposure_s,sha256\na.png,laser,0,,0,,\n"
    )
    camera = {"matrix": np.eye(3), "distortion": np.zeros(5), "size_px": [8, 8]}
    store.write_json(tmp_path / "calibration.json", {"camera": camera})
    grid = CylinderGrid.sector((0.0, 0.3), (-10.0, 10.0), 0.5, 100.0)
    field, dims = store.variable, ("theta", "z")
    r = np.full(grid.shape, 100.0)
    surface = xr.Dataset(
        {
            "r": field(dims, r, "mm", "r"),
            "r_std": field(dims, r * 0 + 0.1, "mm", "r"),
            "laser_r": field(dims, r * np.nan, "mm", "r"),
        },
        coords={
            "theta": field(("theta",), grid.theta, "rad", "t"),
            "z": field(("z",), grid.z, "mm", "z"),
        },
        attrs={"nominal_radius_mm": 100.0, "tire": "t1"},
    )
    store.write_store(tmp_path / "surface.zarr", surface, title="s", source="t1-0")
    theta = np.linspace(0.02, 0.28, 16)[:, None] + 0 * grid.z
    values = {
        "r": 100 + rng.normal(0, 0.1, theta.shape),
        "theta": theta,
        "z": theta * 0 + grid.z,
        "r_std": theta * 0 + 0.1,
    }
    line = ("section", "line")
    laser = xr.Dataset(
        {name: field(line, v, "1", name) for name, v in values.items()}
        | {"encoder": field(("section",), -theta[:, 0], "rad", "e")},
        attrs={"closure_mm": 0.02, "shared_rows": 1.0},
    )
    store.write_store(tmp_path / "laser.zarr", laser, title="l", source="t1-0")
    return tmp_path


def integrate(folder, *more):
    options = {
        "--calibration": "calibration.json",
        "--surface": "surface.zarr/zarr.json",
        "--laser": "laser.zarr",
        "--out": "profile.zarr",
        "--quality": "quality.json",
    }
    words = [word for option, name in options.items() for word in (option, str(folder / name))]
    return main(["integrate", str(folder / "t1"), "--threads", "1", *words, *more])


def test_laser_only_capture_gets_a_profile_as_the_contract_says(products):
    store.write_refused(products / "fov00", "All dark.", title="n", source="t1-0")
    views = ["--views", str(products / "fov00"), "--warning", "Mind this."]
    assert integrate(products, *views) == 0
    profile = store.open_store(products / "profile.zarr")
    names = {"r", "r_std", "laser_r", "normal", "k_d", "k_s", "alpha", "height", "quality"}
    assert names <= set(profile.variables)
    assert profile.attrs["tire"] == "t1"
    assert profile.quality.attrs["flag_meanings"].split()[:2] == ["laser", "photometric"]
    assert np.abs(profile.r - 100).max() < 0.5
    report = json.loads((products / "quality.json").read_text())
    assert report["closure_mm"] == 0.02
    assert report["coverage"]["tread"] == 1
    assert report["held_out_laser_mm"]["n"] == 0
    assert report["frame_std"]["radial_mm"] is None
    assert report["warnings"][0] == "Mind this."
    assert any("All dark." in warning for warning in report["warnings"])


def test_a_refused_surface_is_passed_on(products):
    store.write_refused(products / "surface.zarr", "No section.", title="s", source="t1-0")
    assert integrate(products) == 0
    assert store.refused_reason(products / "profile.zarr") == "No section."
    assert store.refused_reason(products / "quality.json") == "No section."


def write_view(folder, number, first, last, rng):
    """Flat tread, 140 by 44 pixels, seen between two angles, rad."""
    theta, z = np.meshgrid(np.linspace(first, last, 140), np.linspace(-9.9, 9.9, 44), indexing="ij")
    flat = np.zeros((*theta.shape, 3))
    flat[..., 0] = 1
    values = {"r": theta * 0 + 100, "theta": theta, "z": z, "residual": theta * 0 + 0.02}
    values |= dict.fromkeys(("k_d", "k_s", "alpha"), theta * 0 + 0.3)
    pixel, field = ("v", "u"), store.variable
    variables = {name: field(pixel, v.astype(np.float32), "1", name) for name, v in values.items()}
    variables["normal"] = field((*pixel, "component"), flat, "1", "normal")
    covariance = np.full(flat.shape, COVARIANCE) * [1, 0, 1]
    variables["normal_cov"] = field((*pixel, "tilt"), covariance, "rad2", "covariance")
    names = ("outside", "shadowed", "saturated", "poor_fit")
    none = np.zeros(theta.shape, np.uint8)
    variables["quality"] = field(pixel, none, "1", "flags", **store.flag_attrs(names))
    pattern = rng.normal(0, 1, (4, 8, 8))
    variables["light_pattern"] = field(("led", "row", "column"), pattern, "1", "light")
    view = xr.Dataset(variables, {"led": field(("led",), np.arange(4), "1", "LED")})
    path = folder / f"fov{number:02d}"
    store.write_store(path, view, title="n", source="t1-0")
    return str(path)


def in_pixels_and_in_bands(products, rng):
    """The profile solved at the pixels, and in wide cells with their pixels in bands."""
    views = [
        write_view(products, k, first, first + 0.12, rng)
        for k, first in enumerate((0.0, 0.09, 0.18))
    ]
    found = []
    for cells in (16_000_000, 600):
        settings = json.dumps({"held_out_every": 0, "most_cells": cells})
        assert integrate(products, "--views", *views, "--settings", settings) == 0
        found.append(store.open_store(products / "profile.zarr").load())
    return found


def test_wider_cells_and_bands_give_nearly_the_profile_of_pixels(products, rng):
    whole, bands = in_pixels_and_in_bands(products, rng)
    assert set(whole.variables) == set(bands.variables)
    assert 0 < np.abs(bands.r - whole.r).max() < 0.03
    np.testing.assert_allclose(bands.k_d, whole.k_d, rtol=1e-5)
    laser = 1 << whole.quality.attrs["flag_meanings"].split().index("laser")
    np.testing.assert_array_equal(bands.quality & laser, whole.quality & laser)
    # Two standard deviations of one pixel's normal: slopes of pixels bend to the sections' noise,
    # those of wide cells, which hold more of them, do not.
    np.testing.assert_allclose(bands.normal, whole.normal, atol=2 * np.sqrt(COVARIANCE))


@pytest.mark.parametrize("share", [0.0, 0.01])
def test_where_sections_have_hardly_any_noise_both_are_the_flat_tread(products, rng, share):
    laser = store.open_store(products / "laser.zarr").load()
    laser["r"][:] = 100.0 + share * (laser["r"] - 100.0)
    store.write_store(products / "laser.zarr", laser, title="l", source="t1-0")
    for found in in_pixels_and_in_bands(products, rng):
        np.testing.assert_allclose(found.r, 100.0, rtol=0, atol=1e-3)
        np.testing.assert_allclose(found.normal - [1.0, 0.0, 0.0], 0, atol=1e-3)


def test_what_is_noise_is_not_kept(products, rng):
    assert integrate(products, "--views", write_view(products, 0, 0.0, 0.3, rng)) == 0
    profile = store.open_store(products / "profile.zarr").load()
    # A flat tread has no height over its grooves.
    kept = {"r": 24, "r_std": 8, "normal": 13, "k_d": 10, "k_s": 10, "alpha": 10}
    for name, bits in kept.items():
        assert profile[name].attrs["_QuantizeBitRoundNumberOfSignificantBits"] == bits
        mantissa = np.frexp(profile[name].to_numpy().astype(float))[0] * 2.0 ** (bits + 1)
        mantissa = mantissa[np.isfinite(mantissa)]
        assert mantissa.size
        np.testing.assert_array_equal(mantissa, np.rint(mantissa))


@pytest.mark.parametrize("turned", [0.0, 3.0])
@pytest.mark.parametrize(
    ("first", "last", "seen"),
    [(0.1, 0.3, 1.0), (0.0, 0.05, 0.0), (0.25, 0.4, 1.0), (0.35, 0.5, 0.0), (-3.0, 0.12, 1.0)],
)
def test_a_band_takes_the_parts_of_views_that_reach_into_it(
    products, rng, monkeypatch, turned, first, last, seen
):
    monkeypatch.setattr(store, "CHUNK", 16)
    write_view(products, 0, turned + 0.1, turned + 0.3, rng)
    view = StoredView(store.open_store(products / "fov00"), None)
    grid = CylinderGrid(np.linspace(first, last, 50) + turned, np.arange(5.0), 100.0)
    theta = [block.theta for block in view.blocks(grid)]
    rows = np.concatenate([part[:, 0] for part in theta]) - turned if theta else np.empty(0)
    every = np.linspace(0.1, 0.3, 140)
    inside, read = ((x > first - 1e-4) & (x < last + 1e-4) for x in (every, rows))
    assert np.count_nonzero(read) == np.count_nonzero(inside)
    # No more than a chunk and what is seen obliquely beyond either end.
    assert bool(len(rows)) == bool(seen)
    assert ((rows > first - 0.06) & (rows < last + 0.06)).all()


def test_parts_are_read_ahead_in_their_order_and_say_what_is_wrong():
    loaded = []

    class Part:
        def __init__(self, number):
            self.number = number

        def load(self):
            if self.number == 3:
                raise OSError("no part 3")
            loaded.append(self.number)
            return self.number

    assert list(read_ahead(map(Part, range(3)))) == [0, 1, 2]
    assert list(read_ahead([])) == []
    parts = read_ahead(map(Part, range(9)))
    assert [next(parts) for _ in range(3)] == [0, 1, 2]
    with pytest.raises(OSError, match="no part 3"):
        next(parts)
    assert max(loaded) <= 4


def test_cells_of_which_nothing_is_known_are_empty(products):
    surface = store.open_store(products / "surface.zarr").load()
    for name in ("r", "r_std"):
        surface[name][30:] = np.nan
    store.write_store(products / "surface.zarr", surface, title="s", source="t1-0")
    laser = store.open_store(products / "laser.zarr").load()
    laser["r"][7:] = np.nan
    store.write_store(products / "laser.zarr", laser, title="l", source="t1-0")
    settings = json.dumps({"held_out_every": 0, "most_cells": 600})
    assert integrate(products, "--settings", settings) == 0
    profile = store.open_store(products / "profile.zarr").load()
    assert np.isfinite(profile.r[:25]).all()
    assert np.isnan(profile.r[45:]).all()
    assert np.isnan(profile.k_d[45:]).all()
    refused = 1 << profile.quality.attrs["flag_meanings"].split().index("refused")
    assert (profile.quality[45:] & refused).all()
    assert not (profile.quality[:25] & refused).any()


@pytest.mark.parametrize("cells", [16_000_000, 600])
def test_normals_without_sections_still_tell_how_well_they_are_met(products, rng, cells):
    laser = store.open_store(products / "laser.zarr").load()
    laser["r"][:] = np.nan
    store.write_store(products / "laser.zarr", laser, title="l", source="t1-0")
    view = write_view(products, 0, 0.0, 0.3, rng)
    settings = json.dumps({"held_out_every": 0, "most_cells": cells})
    assert integrate(products, "--views", view, "--settings", settings) == 0
    report = json.loads((products / "quality.json").read_text())
    assert report["laser_points"] == 0
    assert 0 <= report["normal_residual"]["median"] < 0.01
