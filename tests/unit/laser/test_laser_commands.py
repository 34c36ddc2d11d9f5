"""The three laser stages, from images on disk to laser.zarr and surface.zarr."""

import csv
import math

import cv2
import numpy as np
import pytest
import yaml

from treadlight import cli, store
from treadlight.geometry import Axis, Camera, Plane

NOMINAL, WIDTH, HEIGHT = 300.0, 128, 192
CAMERA = Camera(
    np.array([[700.0, 0, 62.0], [0, 700.0, 96.0], [0, 0, 1]]), np.zeros(5), (WIDTH, HEIGHT)
)
NORMAL = np.array([0.966, -0.01, 0.258]) / np.linalg.norm([0.966, -0.01, 0.258])
PLANE = Plane(NORMAL, -207.0)
AXIS = Axis.through([0.01, 1, -0.02], [3, 20, 1100])
ENCODER_DEG = [-6.0, -4.0, -2.0, 0.0, 2.0, 4.0]


def true_radius(theta, z):
    return np.where(np.abs(z - 10) < 6, NOMINAL - 8.0, NOMINAL) + 0.5 * np.sin(8 * theta)


def line_columns(encoder):
    """Where the laser line crosses each row: the root of r - true r along the laser plane."""
    u = np.arange(20, 110, 0.05)
    found = np.full(HEIGHT, np.nan)
    for v in range(HEIGHT):
        rays = CAMERA.rays(np.column_stack([u, np.full_like(u, v)]))
        theta, z, r = AXIS.to_tire(PLANE.intersect(rays), encoder)
        miss = r - true_radius(theta, z)
        change = np.flatnonzero(np.diff(np.sign(miss)))
        if len(change):
            k = change[0] if miss[0] > 0 else change[-1]
            found[v] = u[k] - miss[k] * 0.05 / (miss[k + 1] - miss[k])
    return found


def draw(encoder, rng):
    u = line_columns(encoder)
    light = 0.6 * np.exp(-0.5 * ((np.arange(WIDTH) - u[:, None]) / 1.8) ** 2)
    light = np.nan_to_num(light) * (1 + 0.1 * rng.standard_normal(light.shape))
    light += 0.02 + 1e-3 * rng.standard_normal(light.shape)
    return np.clip(np.round(light * 65535), 0, 65535).astype(np.uint16)


@pytest.fixture(scope="module")
def images():
    rng = np.random.default_rng(7)
    return [draw(math.radians(angle), rng) for angle in ENCODER_DEG]


@pytest.fixture
def make_capture(tmp_path, images):
    """Write a capture; returns its folder."""

    def make(name="t1-00000", *, scan="rows", laser=True, views=(), mono=True):
        folder = tmp_path / name
        folder.mkdir()
        turn = (lambda image: image.T) if scan == "columns" else (lambda image: image)
        size = [HEIGHT, WIDTH] if scan == "columns" else [WIDTH, HEIGHT]
        facts = {
            "format": "tread-capture/1",
            "kind": "measurement",
            "capture": name,
            "tire": {"id": "t1", "size": "x", "nominal_radius_mm": NOMINAL, "tread_width_mm": 70.0},
            "mileage": {"value": 0, "unit": "mi"},
            "captured_at": "2020-01-31T10:00:00Z",
            "rig": "bench",
            "camera": {
                "size_px": size,
                "encoding": "linear",
                "black_level": 1311,
                "white_level": 65535,
            },
            "laser": {"scan": scan, "channel": "mono"},
            "leds": 1,
        }
        (folder / "capture.yaml").write_text(yaml.safe_dump(facts))
        rows = [["file", "kind", "pose", "led", "encoder_deg", "exposure_s", "sha256"]]
        if laser:
            # Written out of order: sections are put in order of encoder.
            for k in (3, 0, 5, 1, 2, 4):
                cv2.imwrite(str(folder / f"{k}.png"), turn(images[k]))
                rows.append([f"{k}.png", "laser", k, "", ENCODER_DEG[k], "", ""])
        for k, angle in enumerate(views):
            cv2.imwrite(str(folder / f"led{k}.png"), turn(images[0]))
            rows.append([f"led{k}.png", "led", k, 0, angle, "", ""])
        with (folder / "frames.csv").open("w", newline="") as stream:
            csv.writer(stream).writerows(rows)
        return folder

    return make


def plane_json(plane):
    return {"coefficients": [*plane.normal, plane.offset]}


@pytest.fixture
def make_calibration(tmp_path):
    def make(name="calibration.json", *, scan="rows", plane=True, axis=True):
        swap = [1, 0, 2] if scan == "columns" else [0, 1, 2]
        # Swapping the image's axes mirrors space, where a right-handed turn is a left-handed one.
        sign = -1 if scan == "columns" else 1
        matrix = CAMERA.matrix[np.ix_(swap, swap)]
        content = {
            "camera": {
                "matrix": matrix,
                "distortion": [0.0] * 5,
                "size_px": [HEIGHT, WIDTH] if scan == "columns" else [WIDTH, HEIGHT],
            },
            "laser_plane": plane_json(Plane(PLANE.normal[swap], PLANE.offset)) if plane else None,
            "axis": {"direction": sign * AXIS.direction[swap], "point": AXIS.point[swap]}
            if axis
            else None,
        }
        path = tmp_path / name
        store.write_json(path, content)
        return path

    return make


def run_stages(folder, calibration, out, threads=1, settings="{}"):
    pixels, points = out / "laser_pixels.zarr", out / "laser_points.zarr"
    laser, surface = out / "laser.zarr", out / "surface.zarr"
    common = ["--capture", str(folder), "--calibration", str(calibration)]
    steps = [
        ["detect-laser-pixels", str(folder), "--out", str(pixels), "--threads", str(threads)],
        ["triangulate", str(pixels / "zarr.json"), *common, "--out", str(points / "zarr.json")],
        ["register-to-cylinder", str(points), *common, "--settings", settings],
    ]
    steps[2] += ["--out", str(laser), "--surface", str(surface)]
    for step in steps:
        assert cli.main(step) == 0
    return laser, surface


def test_sections_and_surface_follow_the_tire(make_capture, make_calibration, tmp_path):
    laser, surface = run_stages(make_capture(), make_calibration(), tmp_path / "out")
    sections = store.open_store(laser)
    assert np.allclose(sections.encoder, np.radians(ENCODER_DEG))
    theta, z = sections.theta.values, sections.z.values
    error = sections.r.values - true_radius(theta, z)
    calm = np.isfinite(error) & (np.abs(np.abs(z - 10) - 6) > 1.5)
    assert calm.mean() > 0.85
    assert abs(np.median(error[calm])) < 0.02
    assert np.percentile(np.abs(error[calm]), 95) < 0.3
    share = np.abs(error[calm]) / sections.r_std.values[calm]
    assert 0.5 < np.mean(share < 1) < 0.85
    assert set(sections.data_vars) >= {"u", "u_std", "width", "strength", "r_std", "quality"}

    grid = store.open_store(surface)
    error = grid.r.values - true_radius(grid.theta.values[:, None], grid.z.values)
    calm = np.abs(np.abs(grid.z.values - 10) - 6) > 1.5
    assert np.isfinite(error).all()
    assert np.median(np.abs(error[:, calm])) < 0.15
    assert grid.attrs["tire"] == "t1"
    assert grid.attrs["nominal_radius_mm"] == NOMINAL


def test_result_does_not_depend_on_the_number_of_threads(make_capture, make_calibration, tmp_path):
    folder, calibration = make_capture(), make_calibration()
    digests = []
    for threads in (1, 3):
        out = run_stages(folder, calibration, tmp_path / str(threads), threads)
        digests.append([store.content_digest(path) for path in out])
    assert digests[0] == digests[1]


def test_columns_scan_equals_the_transposed_rows_scan(make_capture, make_calibration, tmp_path):
    rows, _ = run_stages(make_capture("a"), make_calibration("a.json"), tmp_path / "rows")
    columns, _ = run_stages(
        make_capture("b", scan="columns"),
        make_calibration("b.json", scan="columns"),
        tmp_path / "columns",
    )
    a, b = store.open_store(rows), store.open_store(columns)
    np.testing.assert_array_equal(a.u, b.u)
    np.testing.assert_allclose(a.r, b.r, atol=1e-6)
    np.testing.assert_allclose(a.theta, b.theta, atol=1e-8)
    np.testing.assert_allclose(a.z, -b.z, atol=1e-6)


def test_capture_without_laser_gets_the_nominal_cylinder(make_capture, make_calibration, tmp_path):
    folder = make_capture(laser=False, views=(0.0, 15.0))
    calibration = make_calibration(plane=False)
    laser, surface = run_stages(folder, calibration, tmp_path / "out")
    assert store.open_store(laser).sizes["section"] == 0
    grid = store.open_store(surface)
    assert np.all(grid.r == NOMINAL)
    assert np.all(grid.r_std == 8)
    assert float(grid.theta[0]) < math.radians(-15) < 0 < float(grid.theta[-1])


def test_views_widen_the_grid_beyond_the_sections(make_capture, make_calibration, tmp_path):
    folder = make_capture(views=(40.0,))
    _, surface = run_stages(folder, make_calibration(), tmp_path / "out")
    grid = store.open_store(surface)
    assert float(grid.theta[0]) < math.radians(-40)
    near_view = np.abs(grid.theta.values + math.radians(40)) < 0.05
    assert np.isfinite(grid.r.values[near_view]).all()


def test_step_of_the_grid_can_be_set(make_capture, make_calibration, tmp_path):
    _, surface = run_stages(
        make_capture(), make_calibration(), tmp_path / "out", settings='{"step_mm": 3.0}'
    )
    z = store.open_store(surface).z.values
    np.testing.assert_allclose(np.diff(z), 3.0)


@pytest.mark.parametrize(
    ("missing", "sentence"), [("plane", "no laser plane"), ("axis", "no rotation axis")]
)
def test_calibration_without_a_needed_part_is_refused_in_a_sentence(
    make_capture, make_calibration, tmp_path, missing, sentence
):
    calibration = make_calibration(**{missing: False})
    laser, surface = run_stages(make_capture(), calibration, tmp_path / "out")
    assert sentence in store.refused_reason(laser)
    assert sentence in store.refused_reason(surface)


def test_damaged_laser_frame_refuses_the_capture_in_a_sentence(
    make_capture, make_calibration, tmp_path
):
    folder = make_capture()
    (folder / "3.png").write_bytes(b"no image")
    laser, _ = run_stages(folder, make_calibration(), tmp_path / "out")
    assert "3.png: cannot be decoded" in store.refused_reason(laser)


@pytest.mark.shared
def test_sample_sections_are_within_a_tenth_of_a_millimetre(sample_archive, tmp_path):
    """With the true rig: medians of |error| measured 70 (tops) and 85 um (floors), bound + 20 %."""
    from scipy.ndimage import map_coordinates

    from treadlight.evaluate import surface as classes
    from treadlight.evaluate.truth import read_true_profile, read_true_rig

    folder = sample_archive / "t7-00100"
    rig = read_true_rig(folder / "truth" / "rig.yaml")
    calibration = tmp_path / "calibration.json"
    store.write_json(
        calibration,
        {
            "camera": {
                "matrix": rig.camera.matrix,
                "distortion": rig.camera.distortion,
                "size_px": list(rig.camera.size_px),
            },
            "laser_plane": plane_json(rig.laser_plane),
            "axis": {"direction": rig.axis.direction, "point": rig.axis.point},
        },
    )
    laser, surface = run_stages(folder, calibration, tmp_path / "out", threads=2)
    sections = store.open_store(laser)
    assert float(np.isfinite(sections.r).mean()) > 0.9
    truth = read_true_profile(folder / "truth" / "profile.npz")
    found = classes.classify(truth, classes.outer_envelope(truth))
    row, column = classes.truth_grid(truth).index(sections.theta.values, sections.z.values)
    inside = (row > 0) & (row < len(truth.theta) - 1) & (column > 0) & (column < len(truth.z) - 1)
    row, column = row[inside], column[inside]
    error = sections.r.values[inside] - map_coordinates(
        truth.r, [row, column], order=1, prefilter=False
    )
    cell = np.rint(row).astype(int), np.rint(column).astype(int)
    for name, median, p95 in (("top", 0.084, 0.25), ("floor", 0.102, 0.30)):
        here = error[found[name][cell] & np.isfinite(error)]
        assert abs(np.median(here)) < 0.03
        assert np.median(np.abs(here)) < median
        assert np.percentile(np.abs(here), 95) < p95
    grid = store.open_store(surface)
    cells = classes.look_up(truth, grid.theta.values, grid.z.values)
    error = grid.r.values - cells.r
    for name, median in (("top", 0.078), ("floor", 0.066)):
        here = error[cells.classes[name]]
        assert np.isfinite(here).mean() > 0.97
        assert np.nanmedian(np.abs(here)) < median
        share = np.abs(here) / grid.r_std.values[cells.classes[name]]
        assert 0.6 < np.nanmean(share < 1) < 0.9
