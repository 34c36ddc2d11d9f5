"""Fixtures that all tests share."""

import json
import os
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from numba.core import event

from treadlight import store
from treadlight.cli import main
from treadlight.geometry import CylinderGrid

ROOT = Path(__file__).resolve().parents[1]
SHARED = ROOT.parent / "shared"


_BROWSERS = ("chromium", "chromium-browser", "google-chrome")
_LEFT_OUT = pytest.StashKey[list]()


def pytest_collection_modifyitems(config, items):
    """Tests that lack what they need are left out, and their number is said; never quietly."""
    # What takes longest starts first, so that no core waits for it at the end.
    items.sort(key=lambda item: item.path.parent.name != "workflow")
    config.stash[_LEFT_OUT] = []
    if not SHARED.is_dir():
        _leave_out(config, items, "shared", "on shared data", "there is no ../shared.")
    if browser() is None:
        remedy = "there is no Chromium (make browser installs it)."
        _leave_out(config, items, "browser", "of the pages", remedy)


def _leave_out(config, items, marker, what, why):
    marked = [item for item in items if item.get_closest_marker(marker)]
    if not marked:
        return
    if os.environ.get(f"REQUIRE_{marker.upper()}") == "1":
        raise pytest.UsageError(f"REQUIRE_{marker.upper()}=1, but {why}")
    items[:] = [item for item in items if item not in marked]
    config.hook.pytest_deselected(items=marked)
    config.stash[_LEFT_OUT].append(f"{len(marked)} tests {what} left out: {why}")


class _Untraced(event.Listener):
    """No coverage of the compiler: to trace it takes as long as to compile."""

    def __init__(self):
        self.depth, self.trace = 0, None

    def on_start(self, event):
        if self.depth == 0:
            self.trace = sys.gettrace()
            sys.settrace(None)
        self.depth += 1

    def on_end(self, event):
        self.depth -= 1
        if self.depth == 0:
            sys.settrace(self.trace)


event.register("numba:compile", _Untraced())


def browser() -> str | None:
    """The system's Chromium, if any."""
    return next(filter(None, map(shutil.which, _BROWSERS)), None)


def pytest_terminal_summary(terminalreporter, config):
    for line in config.stash.get(_LEFT_OUT, []):
        terminalreporter.write_line(line)


@pytest.fixture
def rng():
    return np.random.default_rng(20261122)


@pytest.fixture(scope="session")
def sample_archive() -> Path:
    return SHARED / "captures" / "sample"


@pytest.fixture(scope="session")
def shared_real() -> Path:
    return SHARED / "real"


@pytest.fixture(scope="session")
def worn_tire(tmp_path_factory) -> Path:
    """Results of a tire t at 100, 200 and again 200 mi as the stages write them, whole turn.

    Two grooves, three ribs with slots; the ribs lost 0.2, 0.3 and 0.4 mm. Profiles are analytic
    with noise; wear.zarr, trend.csv, report.html and index.html come from their commands.
    """
    root = tmp_path_factory.mktemp("worn") / "results"
    captures = {"a": (100.0, 0.0), "b": (200.0, 1.0), "c": (200.0, 1.0)}
    for number, (name, (mileage, worn)) in enumerate(captures.items()):
        _write_capture(root / "captures" / name, name, mileage, worn, number)
    _write_calibration(root / "calibrations" / "cal")
    state = {
        "tires": {"t": list(captures)},
        "calibration_of": dict.fromkeys(captures, "cal"),
        "calibrations": ["cal"],
        "refused": {},
        "warnings": {"a": "The <calibration> was taken later."},
    }
    store.write_json(root / "archive.json", state)
    tire = root / "tires" / "t"
    profiles = [root / "captures" / name / "profile.zarr" for name in captures]
    quality = [path.with_name("quality.json") for path in profiles]
    wear = ["wear", "t", *profiles, "--out", tire / "wear.zarr", "--trend", tire / "trend.csv"]
    report = ["report", "t", "--wear", tire / "wear.zarr", "--trend", tire / "trend.csv"]
    report += ["--profiles", *profiles, "--quality", *quality, "--out", tire / "report.html"]
    parts = [root / f"calibrations/cal/{part}.json" for part in ("camera", "laser_plane", "leds")]
    report += ["--calibrations", *["cal"] * 3, "--calibration-files", *parts]
    facts = {"size": "215/70R16", "rolling_direction": "+theta", "serial": "<b>7</b>"}
    report += ["--facts", json.dumps(facts)]
    index = ["index", "--results", root, "--archive-state", root / "archive.json"]
    index += ["--out", root / "index.html", "--products", root / "products.json"]
    for command in (wear, report, index):
        assert main([str(part) for part in command]) == 0
    return root


def _write_capture(folder: Path, name: str, mileage: float, worn: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    radius = 100.0
    grid = CylinderGrid.whole_turn((-45.0, 45.0), 0.8, radius)
    theta, z = np.meshgrid(grid.theta, grid.z, indexing="ij")
    loss = worn * np.select([z < -18, z < 18], [0.2, 0.3], 0.4)
    # Pitches of uneven length, or a turned tire could not be told.
    slot = np.mod(theta * radius + 6 * np.cos(theta) + 0.2 * np.abs(z), 20.0) < 3.0
    height = np.where(slot, 1.0, 8.0 - loss)
    height[np.abs(np.abs(z) - 18) < 4] = 0.0
    noise = rng.normal(0, 0.01, theta.shape)
    r = radius - 8 + height + 0.05 * np.cos(2 * theta) + noise
    r[:4, :3] = height[:4, :3] = np.nan
    dims = ("theta", "z")
    maps = {"r": r, "r_std": np.full_like(r, 0.01), "height": height + noise, "laser_r": r}
    data = xr.Dataset(
        {key: store.variable(dims, values, "mm", key) for key, values in maps.items()},
        coords={
            "theta": store.variable(("theta",), grid.theta, "rad", "angle"),
            "z": store.variable(("z",), grid.z, "mm", "position along the axis"),
        },
        attrs={
            "tire": "t",
            "mileage": mileage,
            "mileage_unit": "mi",
            "captured_at": "2020-01-15T10:00:00+00:00",
            "nominal_radius_mm": radius,
            "rig": "bench",
        },
    )
    store.write_store(folder / "profile.zarr", data, title="Profile", source=name)
    quality = {
        "coverage": {"tread": 0.98, "rib": 0.99, "groove": 0.97},
        "held_out_laser_mm": {"n": 700, "bias": 0.002, "rms": 0.08},
        "flags": {"laser": 0.05, "photometric": 0.6},
        "warnings": [],
    }
    store.write_json(folder / "quality.json", quality)
    store.write_json(
        folder / "inventory.json", {"mileage": {"value": mileage, "unit": "mi"}, "views": []}
    )


def _write_calibration(folder: Path) -> None:
    rng = np.random.default_rng(3)
    distances = np.abs(rng.normal(0, 0.05, 500))
    counts, edges = np.histogram(distances, 40)
    camera = {"reprojection_rms_px": 0.02, "poses": 30}
    residual = {"mean": 0.04, "rms": 0.05, "p95": 0.1}
    plane = {"residual_mm": residual, "poses": 20, "points": 500}
    rays = [
        {"led": led, "distance_mm": float(abs(rng.normal(0.2, 0.1))), "used": ball < 14}
        for led in range(16)
        for ball in range(15)
    ]
    parts = {
        "camera": {"camera": camera, "residuals_px": rng.normal(0, 0.02, (300, 2))},
        "laser_plane": {
            "laser_plane": plane,
            "histogram_mm": {"edges": edges, "counts": counts},
        },
        "leds": {"leds": [{"led": led} for led in range(16)], "rays": rays},
        "calibration": {"camera": camera, "laser_plane": plane, "axis": None, "leds": []},
    }
    for name, content in parts.items():
        store.write_json(folder / f"{name}.json", content)
