"""The commands, on a capture that is written here."""

import cv2
import numpy as np
import pytest
import xarray as xr
import yaml

from treadlight import store
from treadlight.cli import main
from treadlight.photometric.observations import FLAGS

ENCODER_DEG = 30.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory, bench, analytic):
    """A capture, its calibration and its surface, as files."""
    root = tmp_path_factory.mktemp("photometric")
    images, _ = analytic.render(bench, np.radians(ENCODER_DEG))
    _write_capture(root / "capture", bench, np.nan_to_num(images, nan=0.0))
    store.write_json(root / "calibration.json", _calibration(bench))
    _write_illumination(root / "illumination.zarr", bench)
    coords = {
        "theta": store.variable(("theta",), bench.grid.theta, "rad", "angle"),
        "z": store.variable(("z",), bench.grid.z, "mm", "axial place"),
    }
    surface = {
        "r": store.variable(("theta", "z"), bench.r, "mm", "radius"),
        "r_std": store.variable(("theta", "z"), 0 * bench.r, "mm", "its uncertainty"),
    }
    dataset = xr.Dataset(surface, coords, {"nominal_radius_mm": 100.0})
    store.write_store(root / "surface.zarr", dataset, title="Surface", source="c1")
    return root


def _write_capture(folder, bench, images):
    folder.mkdir()
    scale = 60000 / images.max()
    rows = ["file,kind,pose,led,encoder_deg,exposure_s,sha256"]
    for k, image in enumerate(images):
        exposure = 0.5 + 0.02 * k
        counts = np.clip(image * scale * exposure / 0.8, 0, 65535).astype(np.uint16)
        cv2.imwrite(str(folder / f"{k:02d}.png"), counts)
        rows.append(f"{k:02d}.png,led,4,{k},{ENCODER_DEG},{exposure},")
    rows += [f"{k:02d}.png,led,5,{k},{ENCODER_DEG},," for k in range(3)]
    (folder / "frames.csv").write_text("\n".join(rows) + "\n")
    manifest = {
        "format": "tread-capture/1",
        "kind": "measurement",
        "capture": "c1",
        "captured_at": "2020-01-15T10:00:00Z",
        "rig": "bench",
        "camera": {
            "size_px": list(bench.camera.size_px),
            "encoding": "linear",
            "black_level": 0,
            "white_level": 65535,
        },
        "laser": {"scan": "rows", "channel": "red"},
        "leds": 16,
        "tire": {"id": "t", "size": "x", "nominal_radius_mm": 100.0, "tread_width_mm": 80.0},
        "mileage": {"value": 0, "unit": "km"},
    }
    (folder / "capture.yaml").write_text(yaml.safe_dump(manifest))


def _calibration(bench):
    plane = [*bench.plane.normal, bench.plane.offset]
    return {
        "camera": {
            "matrix": bench.camera.matrix,
            "distortion": bench.camera.distortion,
            "size_px": list(bench.camera.size_px),
        },
        "axis": {"direction": bench.axis.direction, "point": bench.axis.point},
        "reference_plane": {"coefficients": plane},
        "leds": [
            {"led": led.number, "position": led.position, "intensity": led.intensity}
            for led in bench.leds
        ],
    }


def _write_illumination(path, bench):
    v, u = np.arange(0, 49, 16), np.arange(0, 65, 16)
    maps = np.stack([np.full((4, 5), led.intensity * 4e4, np.float32) for led in bench.leds])
    dataset = xr.Dataset(
        {
            "radiant_intensity": store.variable(("led", "v", "u"), maps, "mm2", "intensity"),
            "vignetting": store.variable(("coefficient",), np.zeros(3), "1", "of the lens"),
        },
        {
            "led": store.variable(("led",), np.arange(16), "1", "LED"),
            "v": store.variable(("v",), v, "pixel", "row"),
            "u": store.variable(("u",), u, "pixel", "column"),
        },
    )
    store.write_store(path, dataset, title="Illumination", source="bench")


def stereo(folder, out, view=4, calibration="calibration.json"):
    return main(
        [
            "photometric-stereo", str(folder / "capture"), "--view", str(view),
            "--calibration", str(folder / calibration),
            "--illumination", str(folder / "illumination.zarr" / "zarr.json"),
            "--surface", str(folder / "surface.zarr"), "--out", str(out / "zarr.json"),
            "--threads", "2",
        ]
    )  # fmt: skip


def test_a_view_becomes_the_store_of_the_contract(folder, tmp_path):
    out = tmp_path / "photometric.zarr" / "fov04"
    assert stereo(folder, out) == 0
    found = store.open_store(out)
    assert found["normal"].dims == ("v", "u", "component")
    assert found["normal"].shape == (48, 64, 3)
    assert list(found["component"].values) == ["r", "theta", "z"]
    assert found["normal_cov"].shape == (48, 64, 3)
    for name in ("k_d", "k_s", "alpha", "residual", "leds_used", "r", "theta", "z", "quality"):
        assert found[name].dims == ("v", "u")
    assert found["quality"].attrs["flag_meanings"] == " ".join(FLAGS)
    seen = np.isfinite(found["r"].values)
    assert seen.mean() > 0.5
    normal = found["normal"].values[seen]
    # Exposures differ by LED: undone wrongly they would tilt every normal by degrees.
    assert np.max(np.degrees(np.arccos(normal[:, 0]))) < 0.6
    assert np.median(found["k_s"].values[seen] / found["k_d"].values[seen]) == pytest.approx(
        20, rel=0.1
    )
    assert out.with_name("fov04.provenance.json").exists()


def test_what_is_noise_is_not_kept(folder, tmp_path):
    assert stereo(folder, tmp_path / "fov") == 0
    found = store.open_store(tmp_path / "fov").load()
    kept = {"normal": 13, "normal_cov": 8, "residual": 8, "r": 19, "theta": 20, "z": 18}
    for name, bits in (kept | dict.fromkeys(("k_d", "k_s", "alpha"), 10)).items():
        assert found[name].attrs["_QuantizeBitRoundNumberOfSignificantBits"] == bits
        mantissa = np.frexp(found[name].to_numpy().astype(float))[0] * 2.0 ** (bits + 1)
        mantissa = mantissa[np.isfinite(mantissa)]
        assert mantissa.size
        np.testing.assert_array_equal(mantissa, np.rint(mantissa))


def test_two_runs_write_the_same_bits(folder, tmp_path):
    for name in ("one", "two"):
        assert stereo(folder, tmp_path / name) == 0
    assert store.content_digest(tmp_path / "one") == store.content_digest(tmp_path / "two")


@pytest.mark.parametrize(
    ("part", "sentence"),
    [("axis", "rotation axis"), ("leds", "LED positions"), ("reference_plane", "reference plane")],
)
def test_a_calibration_without_a_part_is_refused(folder, tmp_path, bench, part, sentence):
    store.write_json(folder / "partial.json", {**_calibration(bench), part: None})
    assert stereo(folder, tmp_path / "fov", calibration="partial.json") == 0
    assert sentence in store.refused_reason(tmp_path / "fov")


def test_a_view_of_three_leds_is_refused_in_one_sentence(folder, tmp_path):
    assert stereo(folder, tmp_path / "fov", view=5) == 0
    assert "3 of its LED frames have a calibrated LED" in store.refused_reason(tmp_path / "fov")


def stack_file(path, analytic, **changes):
    y, x = np.mgrid[-0.2:0.2:48j, -0.2:0.2:40j]
    normals = np.stack([x, y, np.sqrt(1 - x**2 - y**2)], axis=-1)
    lights = analytic.two_rings()
    flat = normals.reshape(-1, 3)[:, [2, 0, 1]]
    images = analytic.blinn_phong(flat, lights, 0, 0.4, 30).reshape(16, 48, 40)
    stack = {
        "images": images.astype(np.float32),
        "light_directions": 2 * lights[:, [1, 2, 0]],
        "normals": normals,
    }
    stack.update(changes)
    np.savez(path, **{k: v for k, v in stack.items() if v is not None})
    return stack


def normals(path, out, *options):
    return main(["normals", str(path), "--out", str(out), "--threads", "2", *options])


def test_normals_of_a_stack_are_found_and_held_against_truth(analytic, tmp_path, capsys):
    stack = stack_file(tmp_path / "s.npz", analytic, mask=np.arange(40) < 30 + np.zeros((48, 1)))
    assert normals(tmp_path / "s.npz", tmp_path / "o.npz") == 0
    said = capsys.readouterr().out
    assert "map: normals at 100.0% of 1440 pixels" in said
    assert "angular error: mean 0.00" in said
    with np.load(tmp_path / "o.npz") as found:
        error = analytic.degrees_between(found["normals"][:, :30], stack["normals"][:, :30])
        assert np.max(error) < 0.02
        assert np.isnan(found["normals"][:, 30:]).all()
        assert found["alpha"].shape == found["flags"].shape == (48, 40)


def test_near_lights_and_colours_are_undone(analytic, rng, tmp_path):
    """Positions instead of directions, the inverse square, and RGB divided by its intensities."""
    points = np.zeros((48, 40, 3))
    points[..., :2] = np.moveaxis(np.mgrid[:48, :40], 0, -1) - 20.0
    positions = 300 * analytic.two_rings()[:, [1, 2, 0]]
    truth = np.array([0.1, -0.05, np.sqrt(1 - 0.0125)])
    vectors = positions[:, None, None] - points
    squared = np.sum(vectors**2, -1)
    shading = np.maximum(vectors @ truth, 0) / squared**1.5 * 300**2
    strength = rng.uniform(0.5, 2, (16, 3))
    images = (2000 * shading[..., None] * strength[:, None, None]).astype(np.uint16)
    stack_file(
        tmp_path / "s.npz", analytic, images=images, light_directions=None, normals=None,
        light_positions=positions, points=points, light_intensities=strength,
        view=np.broadcast_to([0, 0, 2.0], (48, 40, 3)),
    )  # fmt: skip
    assert normals(tmp_path / "s.npz", tmp_path / "o.npz", "--method", "dps") == 0
    with np.load(tmp_path / "o.npz") as found:
        assert np.median(analytic.degrees_between(found["normals"], truth)) < 0.05


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"images": None}, "'images' must be"),
        ({"light_directions": None}, "'light_directions' is missing"),
        ({"mask": np.ones((3, 3))}, "'mask' is (3, 3). It must be (48, 40)"),
    ],
)
def test_a_stack_that_is_wrong_is_said_in_one_sentence(
    analytic, tmp_path, capsys, changes, sentence
):
    stack_file(tmp_path / "s.npz", analytic, **changes)
    assert normals(tmp_path / "s.npz", tmp_path / "o.npz") == 2
    assert sentence in capsys.readouterr().err


def test_a_file_that_is_no_stack_is_said_in_one_sentence(tmp_path, capsys):
    (tmp_path / "s.npz").write_text("nothing")
    assert normals(tmp_path / "s.npz", tmp_path / "o.npz") == 2
    assert "is no readable .npz file" in capsys.readouterr().err


@pytest.mark.shared
@pytest.mark.parametrize(
    ("name", "mean"), [("diligent-cat16/cat16.npz", 8.69), ("glossy-bunny16/bunny16.npz", 16.46)]
)
def test_least_squares_on_real_stacks_gives_the_published_error(
    shared_real, tmp_path, capsys, name, mean
):
    assert normals(shared_real / name, tmp_path / "o.npz", "--method", "dps") == 0
    said = capsys.readouterr().out
    assert float(said.split("mean ")[1].split(",")[0]) == pytest.approx(mean, abs=0.05)


def test_a_method_that_is_none_is_said_with_those_there_are(analytic, tmp_path, capsys):
    stack_file(tmp_path / "s.npz", analytic)
    assert normals(tmp_path / "s.npz", tmp_path / "o.npz", "--method", "magic") == 2
    said = capsys.readouterr().err
    assert "No method 'magic'" in said
    assert "sps-2" in said
    assert "nips" in said
