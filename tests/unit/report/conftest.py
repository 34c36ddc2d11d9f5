"""A small results folder: two captures of one tire, as the stages would have written it."""

import json
import shutil

import numpy as np
import pytest
import xarray as xr

from treadlight import store
from treadlight.store import variable

TREND = (
    "tire,capture,mileage,unit,region,depth_mm,depth_std_mm,wear_mm,wear_std_mm,"
    "rate_mm_per_1000km,status\n"
    "t7,a,100,mi,tread,8.0,0.02,0,0,,first\n"
    "t7,a,100,mi,rib-1,8.0,0.02,0,0,,first\n"
    "t7,b,200,mi,tread,7.9,0.02,0.1,0.02,0.6,indicative\n"
    "t7,b,200,mi,rib-1,7.9,0.02,0.1,0.02,0.6,indicative\n"
)


def profile(rng, name, mileage):
    theta, z = np.linspace(0, 0.3, 40), np.linspace(-10, 10, 30)
    height = 8 + rng.normal(0, 0.05, (40, 30))
    height[:5] = np.nan
    maps = {"height": height, "r": 347 + height, "r_std": np.full((40, 30), 0.05)}
    return xr.Dataset(
        {name: variable(("theta", "z"), values, "mm", name) for name, values in maps.items()},
        coords={
            "theta": variable(("theta",), theta, "rad", "angle"),
            "z": variable(("z",), z, "mm", "position along the axis"),
        },
        attrs={
            "tire": "t7",
            "mileage": mileage,
            "mileage_unit": "mi",
            "captured_at": "2020-01-15T10:00:00+00:00",
            "nominal_radius_mm": 355.0,
            "rig": "bench",
        },
    )


@pytest.fixture
def results(tmp_path, pristine):
    return shutil.copytree(pristine, tmp_path / "results")


@pytest.fixture(scope="session")
def pristine(tmp_path_factory):
    root = tmp_path_factory.mktemp("pristine")
    rng = np.random.default_rng(7)
    profiles = [profile(rng, "a", 100.0), profile(rng, "b", 200.0)]
    for name, data in zip("ab", profiles, strict=True):
        folder = root / "captures" / name
        store.write_store(folder / "profile.zarr", data, title="Profile", source=name)
        store.write_store(folder / "laser.zarr", data, title="Laser", source=name)
        store.write_store(
            folder / "photometric.zarr" / "fov00", data, title="Photometry", source=name
        )
        quality = {"coverage": {"tread": 0.9}, "held_out_laser_mm": {"rms": 0.2}}
        store.write_json(folder / "quality.json", {**quality, "warnings": [f"Odd {name}."]})
        mileage = {"value": 100.0, "unit": "mi"}
        store.write_json(folder / "inventory.json", {"mileage": mileage, "views": [{"view": 0}]})
    wear = np.stack([np.zeros((40, 30)), np.full((40, 30), 0.1)])
    data = (
        profiles[0]
        .drop_vars("height")
        .drop_vars(["r", "r_std"])
        .assign(
            wear=variable(("capture", "theta", "z"), wear, "mm", "wear"),
            wear_std=variable(("capture", "theta", "z"), 0 * wear + 0.02, "mm", "wear_std"),
            r=variable(("capture", "theta", "z"), profiles[0]["r"].values - wear, "mm", "r"),
        )
    )
    data = data.assign_coords(
        capture=variable(("capture",), np.array(["a", "b"]), "1", "capture"),
        mileage=variable(("capture",), np.array([100.0, 200.0]), "mi", "mileage"),
    )
    tire = root / "tires" / "t7"
    store.write_store(tire / "wear.zarr", data, title="Wear", source="t7")
    store.write_text(tire / "trend.csv", TREND)
    store.write_text(tire / "report.html", "<html></html>")
    calibration = root / "calibrations" / "cal"
    content = {"camera": {"reprojection_rms_px": 0.02}, "laser_plane": None, "axis": None}
    store.write_json(calibration / "calibration.json", {**content, "leds": []})
    store.write_store(calibration / "illumination.zarr", profiles[0], title="I", source="cal")
    state = {
        "tires": {"t7": ["a", "b"]},
        "calibration_of": {"a": "cal", "b": "cal"},
        "calibrations": ["cal"],
        "refused": {},
        "warnings": {"a": "Late calibration."},
    }
    (root / "archive.json").write_text(json.dumps(state), encoding="utf-8")
    return root


@pytest.fixture
def refuse(results):
    """Turns products of the small results folder into refused ones."""

    def turn(*products, reason="led/3.png: cannot be decoded."):
        for product in products:
            store.write_refused(results / product, reason, title="x", source=product.split("/")[1])

    return turn
