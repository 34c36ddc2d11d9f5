"""The command on a rendered capture of a few facts and the products of a perfect pipeline."""

import json

import cv2
import numpy as np
import pytest
import xarray as xr
import yaml

from treadlight import store
from treadlight.cli import main
from treadlight.evaluate.surface import true_normals
from treadlight.store import variable

RIG = {
    "camera": {
        "matrix": [[2580.0, 0, 8], [0, 2580.0, 6], [0, 0, 1]],
        "distortion": [0, 0, 0, 0, 0],
        "size_px": [16, 12],
    },
    "laser_plane": {"coefficients": [0.96, 0.0, 0.28, -208.0]},
    "axis": {"direction": [0.0, 1.0, 0.0], "point": [0.0, 0.0, 1156.0]},
    "reference_plane": {"coefficients": [0.0, 0.0, -1.0, 801.0]},
    "leds": [{"led": k, "position": [100.0 * k, 0, 470], "intensity": 1.0} for k in range(4)],
    "hub_z_mm": -16.0,
}


def mounting(rotation):
    return {
        "rotation_deg": rotation,
        "axial_mm": 0.0,
        "tilt_deg": [0.0, 0.0],
        "ecc_mm": [0.0, 0.0],
        "radius_change_mm": 0.0,
    }


def capture_yaml(name, kind, day):
    facts = {
        "format": "tread-capture/1",
        "kind": kind,
        "capture": name,
        "captured_at": f"2020-01-{day:02d}T10:00:00Z",
        "rig": "bench",
        "camera": {"size_px": [16, 12], "encoding": "linear", "black_level": 0, "white_level": 255},
        "laser": {"scan": "rows", "channel": "mono"},
        "leds": 4,
    }
    if kind == "measurement":
        facts["tire"] = {
            "id": "t7",
            "size": "215/70R16",
            "nominal_radius_mm": 355.0,
            "tread_width_mm": 60.0,
        }
        facts["mileage"] = {"value": day * 10, "unit": "mi"}
    return facts


def write_capture(root, name, kind, day, rows):
    folder = root / name
    (folder / "truth").mkdir(parents=True)
    (folder / "capture.yaml").write_text(yaml.safe_dump(capture_yaml(name, kind, day)))
    cv2.imwrite(str(folder / "0.png"), np.zeros((12, 16), np.uint8))
    lines = ["file,kind,pose,led,encoder_deg", *rows]
    (folder / "frames.csv").write_text("\n".join(lines) + "\n")
    return folder / "truth"


@pytest.fixture
def archive(tmp_path, truth):
    root = tmp_path / "archive"
    write_capture(root, "cal", "calibration", 1, ["0.png,dark,,,"])
    frames = ["0.png,led,0,0,2.0", "0.png,led,1,0,-2.0", "0.png,laser,0,,0"]
    for day, name in ((10, "a"), (20, "b")):
        folder = write_capture(root, name, "measurement", day, frames)
        np.savez(folder / "profile.npz", theta=truth.theta, z=truth.z, r=truth.r)
        text = yaml.safe_dump({**RIG, "mounting": mounting(day)})
        (folder / "rig.yaml").write_text(text)
    (root / "cal" / "truth" / "rig.yaml").write_text(yaml.safe_dump(RIG))
    wear = np.where(truth.r < 350, 0.0, 0.1 + 0.02 * np.sin(truth.z / 5))
    np.savez(root / "b" / "truth" / "wear.npz", theta=truth.theta, z=truth.z, wear=wear)
    return root


@pytest.fixture
def results(tmp_path, truth):
    root = tmp_path / "results"
    coordinates = {
        "theta": variable(("theta",), truth.theta, "rad", "angle"),
        "z": variable(("z",), truth.z, "mm", "position"),
    }
    cells = ("theta", "z")
    normal = variable((*cells, "component"), true_normals(truth, 0.7 * 0.4), "1", "normal")
    std = variable(cells, np.full(truth.r.shape, 0.1), "mm", "uncertainty")
    data = xr.Dataset(
        {"r": variable(cells, truth.r, "mm", "radius"), "r_std": std, "normal": normal},
        coords=coordinates,
    )
    for name in "ab":
        folder = root / "captures" / name
        store.write_store(folder / "profile.zarr", data, title="Profile", source=name)
    around, along = np.meshgrid(truth.theta[:120], truth.z, indexing="ij")
    image = ("v", "u")
    view = xr.Dataset(
        {
            "theta": variable(image, around.T, "rad", "angle"),
            "z": variable(image, along.T, "mm", "position"),
            "r": variable(image, truth.r[:120].T, "mm", "radius"),
            "normal": variable(
                (*image, "component"), normal.values[:120].transpose(1, 0, 2), "1", "normal"
            ),
        }
    )
    store.write_store(root / "captures/a/photometric.zarr/fov00", view, title="P", source="a")
    wear = np.where(truth.r < 350, 0.0, 0.1 + 0.02 * np.sin(truth.z / 5))
    turn = np.radians(10.0 - 20.0)
    data = xr.Dataset(
        {
            "wear": variable(("capture", *cells), np.stack([0 * wear, wear]), "mm", "wear"),
            "wear_std": variable(
                ("capture", *cells), np.full((2, *wear.shape), 0.05), "mm", "uncertainty"
            ),
            "alignment": variable(
                ("capture", "parameter"), np.array([[0.0] * 7, [turn, *[0.0] * 6]]), "1", "motion"
            ),
        },
        coords={
            **coordinates,
            "capture": variable(("capture",), np.array(["a", "b"]), "1", "capture"),
        },
    )
    store.write_store(root / "tires/t7/wear.zarr", data, title="Wear", source="t7")
    store.write_json(root / "calibrations/cal/calibration.json", RIG)
    return root


def evaluate(results, archive, capsys):
    assert main(["evaluate", str(results), str(archive), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_perfect_products_have_no_error(results, archive, capsys):
    found = evaluate(results, archive, capsys)
    assert found["calibrations"]["cal"]["camera"]["fx_percent"] == 0
    assert found["calibrations"]["cal"]["axis"]["line_mm"] == 0
    for name in "ab":
        assert found["captures"][name]["shape"]["top"]["p95_mm"] < 1e-6
        assert found["captures"][name]["normals"]["profile"]["p95_deg"] < 1e-3
    assert found["captures"]["a"]["normals"]["fov00"]["p95_deg"] < 1e-3
    assert "fov00" not in found["captures"]["b"]["normals"]
    assert found["captures"]["a"]["seams"]["seams"] == 3
    assert found["captures"]["b"]["seams"]["seams"] == 1
    wear = found["wear"]["t7"]["b"]
    assert abs(wear["mean_error_mm"]) < 1e-6
    assert wear["blocks"]["correlation"] == pytest.approx(1.0)
    assert abs(wear["alignment"]["rotation_arc_mm"]) < 1e-9


@pytest.mark.parametrize("scan", ["rows", "columns"])
def test_the_limits_of_a_view_are_where_nearly_all_lines_end(scan):
    from treadlight.commands.evaluate import _limits

    theta = np.pi + np.tile(np.linspace(-0.1, 0.2, 31), (20, 1))
    theta[3] += 0.01
    known = np.ones((20, 31))
    known[:, :4] = np.nan
    known[5] = np.nan
    if scan == "columns":
        theta, known = theta.T, known.T
    image = ("v", "u")
    normal = np.repeat(known[..., None], 3, axis=2)
    view = xr.Dataset({"theta": (image, theta), "normal": ((*image, "component"), normal)})
    found = _limits(view)
    assert found - np.pi == pytest.approx([-0.06, 0.2], abs=1e-9)
    assert len(_limits(view.where(False))) == 0


def test_people_get_tables(results, archive, capsys):
    assert main(["evaluate", str(results), str(archive)]) == 0
    said = capsys.readouterr().out
    for text in ("Calibration cal", "Capture a", "r shape", "floor", "edges found", "100.0 %"):
        assert text in said
    assert "Wear of tire t7 at b" in said
    assert "alignment error" in said


def test_refused_and_missing_products_are_said(results, archive, capsys):
    reason = "led/3.png: cannot be decoded."
    store.write_refused(results / "captures/a/profile.zarr", reason, title="x", source="a")
    store.write_refused(
        results / "calibrations/cal/calibration.json", reason, title="x", source="c"
    )
    (results / "captures/b/profile.zarr/zarr.json").unlink()
    found = evaluate(results, archive, capsys)
    assert found["captures"]["a"] == {"missing": f"Refused: {reason}"}
    assert found["calibrations"]["cal"] == {"missing": f"Refused: {reason}"}
    assert "there is no such product" in found["captures"]["b"]["missing"]
    assert main(["evaluate", str(results), str(archive)]) == 0
    assert f"Refused: {reason}" in capsys.readouterr().out


def test_a_damaged_store_is_said_to_be(results, archive, capsys):
    chunk = next((results / "tires/t7/wear.zarr/wear").rglob("c/*/*/*"))
    chunk.write_bytes(b"damaged")
    found = evaluate(results, archive, capsys)
    assert "does not match its digest" in found["wear"]["t7"]["b"]["missing"]


def test_wear_of_another_capture_is_not_compared(results, archive, capsys):
    data = store.open_store(results / "tires/t7/wear.zarr").load()
    data = data.assign_coords(capture=("capture", np.array(["a", "c"]), data.capture.attrs))
    store.write_store(results / "tires/t7/wear.zarr", data, title="Wear", source="t7")
    found = evaluate(results, archive, capsys)
    assert "does not hold b against a" in found["wear"]["t7"]["b"]["missing"]


def test_captures_without_truth_are_left_out(results, archive, capsys):
    for name in "ab":
        for file in (archive / name / "truth").iterdir():
            file.unlink()
    (archive / "cal/truth/rig.yaml").unlink()
    assert main(["evaluate", str(results), str(archive)]) == 0
    assert "No capture of the archive carries a truth/ folder" in capsys.readouterr().out


def test_a_folder_that_is_not_there_is_named(tmp_path, capsys):
    assert main(["evaluate", str(tmp_path / "none"), str(tmp_path)]) == 2
    assert "is no folder" in capsys.readouterr().err


@pytest.mark.shared
def test_truth_of_the_sample_agrees_with_itself(sample_archive):
    """The mounting, the wear map and both profiles of the sample tell one story."""
    from treadlight.evaluate.remount import read_mounting, true_alignment
    from treadlight.evaluate.surface import interpolate_at
    from treadlight.evaluate.truth import read_true_profile, read_true_wear

    first, later = sample_archive / "t7-00100/truth", sample_archive / "t7-00200/truth"
    mountings = [
        read_mounting(yaml.safe_load((f / "rig.yaml").read_text())) for f in (first, later)
    ]
    rotation, axial, tilt_x, tilt_y, off_x, off_y, radial = true_alignment(*mountings)
    worn = read_true_profile(later / "profile.npz")
    theta, z = np.meshgrid(worn.theta[::9], worn.z[::9], indexing="ij")
    r = worn.r[::9, ::9]
    points = np.stack([r * np.cos(theta), r * np.sin(theta), z], axis=-1)
    turn = mountings[0].rotation @ mountings[1].rotation.T
    x, y, z = np.moveaxis(points @ turn.T + [off_x, off_y, axial], -1, 0)
    theta, r = np.arctan2(y, x), np.hypot(x, y) + radial
    new, wear = read_true_profile(first / "profile.npz"), read_true_wear(later / "wear.npz")
    error = interpolate_at(new, new.r, theta, z) - r - interpolate_at(wear, wear.r, theta, z)
    assert abs(np.nanmedian(error)) < 0.002
    assert np.nanmedian(np.abs(error)) < 0.02
    assert abs(rotation - np.radians(90.1)) < 0.01
    assert max(abs(tilt_x), abs(tilt_y)) < 0.01
