"""A whole view of a smooth cylinder: points, light, shadows, normals in {T}'s local basis."""

import dataclasses

import numpy as np
import pytest

from treadlight.geometry import Camera, CylinderGrid
from treadlight.photometric import PhotometrySettings, View, solve_view, view_kernels
from treadlight.photometric import view as view_module
from treadlight.photometric.observations import OUTSIDE, POOR_FIT, SATURATED, SHADOWED
from treadlight.photometric.view import needed_rows

ENCODER = 2.5
SETTINGS = PhotometrySettings()


@pytest.fixture(scope="module")
def view(bench, analytic):
    images, _ = analytic.render(bench, ENCODER)
    return View(
        intensity=np.nan_to_num(images, nan=0.0),
        noise=np.full(16, 1e-6),
        leds=tuple(range(16)),
        light=bench,
        camera=bench.camera,
        axis=bench.axis,
        encoder=ENCODER,
    )


def solve(view, bench, r=None, r_std=0.0, settings=SETTINGS):
    r = bench.r if r is None else r
    return solve_view(view, bench.grid, r, np.full(r.shape, r_std), settings)


@pytest.mark.parametrize("method", ["map", "sps"])
def test_a_cylinder_looks_outward_everywhere(view, bench, analytic, method):
    """Normals within 0.5 degree of e_r, and unbiased: five refinements leave that much of k_d."""
    found = solve(view, bench, settings=PhotometrySettings(method))
    seen = (found.quality & OUTSIDE) == 0
    assert seen.mean() > 0.5
    error = analytic.degrees_between(found.normal[seen], np.array([1.0, 0, 0]))
    assert np.max(error) < 0.5
    assert np.max(np.abs(np.mean(found.normal[seen][:, 1:], axis=0))) < 1e-3
    assert np.median(found.k_s[seen]) == pytest.approx(0.4, rel=0.05)
    assert np.median(found.alpha[seen]) == pytest.approx(20, rel=0.05)
    assert (found.leds_used[seen] == 16).all()


def test_scene_points_are_where_the_pixels_look(view, bench, analytic):
    _, points = analytic.render(bench, ENCODER)
    theta, z, r = bench.axis.to_tire(points, ENCODER)
    found = solve(view, bench)
    seen = (found.quality & OUTSIDE) == 0
    assert not seen[np.isnan(r)].any()
    np.testing.assert_allclose(found.theta[seen], theta[seen], atol=2e-5)
    np.testing.assert_allclose(found.z[seen], z[seen], atol=2e-3)
    np.testing.assert_allclose(found.r[seen], 100.0, atol=1e-3)
    assert np.isnan(found.r[~seen]).all()
    assert np.isnan(found.normal[~seen]).all()


def test_what_the_camera_sees_beside_the_surface_is_outside(view, bench):
    r = np.where(np.abs(bench.grid.z) < 10, bench.r, np.nan)
    found = solve(view, bench, r)
    outside = (found.quality & OUTSIDE) > 0
    assert outside.mean() > 0.3
    assert np.max(np.abs(found.z[~outside])) < 10
    assert (found.quality[outside] == OUTSIDE).all()
    assert (found.leds_used[outside] == 0).all()


@pytest.mark.parametrize("encoder", [0.3, 2.9, -3.1])
def test_the_needed_rows_of_a_surface_are_enough(view, bench, analytic, encoder):
    """They give what the whole turn gives, across its seam too."""
    images, _ = analytic.render(bench, encoder)
    turned = dataclasses.replace(view, intensity=np.nan_to_num(images, nan=0.0), encoder=encoder)
    r = bench.r + 2.0 * np.cos(8 * bench.grid.theta)[:, None]
    rows = needed_rows(turned, bench.grid)
    assert len(rows) < len(bench.grid.theta)
    part = bench.grid.part(rows)
    every = solve(turned, bench, r)
    some = solve_view(turned, part, r[rows], 0 * r[rows], SETTINGS)
    np.testing.assert_allclose(some.theta, every.theta, atol=1e-6)
    np.testing.assert_allclose(some.r, every.r, atol=1e-4)
    np.testing.assert_array_equal(some.quality & OUTSIDE, every.quality & OUTSIDE)


def test_a_view_that_sees_nothing_of_a_sector_is_empty(view, bench):
    grid = CylinderGrid.sector((0.0, 0.6), (-40, 40), 0.5, 100.0)
    turned = dataclasses.replace(view, encoder=np.pi)
    rows = needed_rows(turned, grid)
    part = np.full((len(rows), len(grid.z)), 100.0)
    found = solve_view(turned, grid.part(rows), part, 0 * part, SETTINGS)
    assert (found.quality == OUTSIDE).all()


def test_a_saturated_led_is_flagged_and_left_out(view, bench):
    intensity = view.intensity.copy()
    intensity[3, 20:25, 30:35] = np.nan
    found = solve(dataclasses.replace(view, intensity=intensity), bench)
    patch = (slice(20, 25), slice(30, 35))
    assert (found.quality[patch] & SATURATED).all()
    assert (found.leds_used[patch] == 15).all()
    assert np.isfinite(found.normal[patch]).all()
    inside = (found.quality & OUTSIDE) == 0
    assert (((found.quality & SATURATED) > 0) & inside).sum() == 25


def test_a_wall_shadows_some_leds_beside_it(view, bench):
    """A 10 mm ring at z > 15: LEDs of that side do not reach the foot of its wall."""
    r = bench.r + 10.0 * (bench.grid.z > 15)
    found = solve(view, bench, r)
    shadowed = (found.quality & SHADOWED) > 0
    foot = (found.z > 11) & (found.z < 14.5) & (found.r < 101)
    away = (found.z < 0) & (found.r < 101)
    assert shadowed[foot].mean() > 0.95
    assert not shadowed[away].any()
    assert (found.leds_used[foot] < 16).mean() > 0.95


@pytest.mark.parametrize("sample_px", [300, 1_000_000])
def test_a_stain_fits_poorly(view, bench, monkeypatch, sample_px):
    """Light that comes from elsewhere at single LEDs shows in the residual.

    Whatever part of a view's pixels, from all over it, says how large residuals are.
    """
    monkeypatch.setattr(view_module, "_SPREAD_PX", sample_px)
    intensity = view.intensity.copy()
    intensity[::3, 10:14, 30:34] *= 3
    intensity[::3, :6] *= 3
    found = solve(dataclasses.replace(view, intensity=intensity), bench)
    poor = (found.quality & POOR_FIT) > 0
    assert poor[10:14, 30:34].all()


def test_a_surface_that_is_not_there_leaves_an_empty_view(view, bench):
    found = solve(view, bench, np.full(bench.grid.shape, np.nan))
    assert (found.quality == OUTSIDE).all()
    assert np.isnan(found.normal).all()


@pytest.mark.shared
def test_block_tops_of_the_rendered_tire_are_near_their_truth(sample_archive):
    """True rig and true surface, the middle of one view, cells facing the camera: median below
    1.6 degrees on tops (the plainest Lambertian fit: more than 10), and no common tilt."""
    sample = _Sample(sample_archive / "t7-00100")
    found = sample.solve()
    error = sample.angles(found)
    assert np.median(error) < 1.6
    bias = np.median((found.normal - sample.normals(found))[sample.tops(found)], axis=0)
    assert np.max(np.abs(bias[1:])) < np.radians(0.3)


class _Sample:
    """A crop of the sample's first view, its beam shapes, and what is true there."""

    rows, columns = slice(300, 420), slice(180, 340)

    def __init__(self, folder):
        import yaml

        from treadlight.archive import read_capture
        from treadlight.commands.photometric_stereo import read_frames
        from treadlight.evaluate.truth import read_true_profile, read_true_rig
        from treadlight.geometry import CylinderGrid
        from treadlight.photometric.noise import dark_noise
        from treadlight.spool import Memory

        capture = read_capture(folder)
        self.rig = read_true_rig(folder / "truth" / "rig.yaml")
        self.leds = self.rig.leds
        text = (folder / "truth" / "rig.yaml").read_text(encoding="utf-8")
        self.beams = yaml.load(text, yaml.CSafeLoader)["leds"]
        profile = read_true_profile(folder / "truth" / "profile.npz")
        self.grid = CylinderGrid(profile.theta, profile.z, capture.tire.nominal_radius_mm)
        self.r = profile.r
        frames = list(capture.view(0))
        frames, intensity, left_out = read_frames(capture, frames, Memory())
        assert not left_out
        noise = np.array([dark_noise(frame) for frame in intensity])
        self.view = View(
            np.ascontiguousarray(intensity[:, self.rows, self.columns]), noise,
            tuple(range(16)), self, self._camera(), self.rig.axis,
            np.radians(frames[0].encoder_deg),
        )  # fmt: skip

    def _camera(self):
        matrix = self.rig.camera.matrix.copy()
        matrix[0, 2] -= self.columns.start
        matrix[1, 2] -= self.rows.start
        size = (self.columns.stop - self.columns.start, self.rows.stop - self.rows.start)
        return Camera(matrix, self.rig.camera.distortion, size)

    def irradiance(self, k, points):
        ray = points - self.leds[k].position
        squared = np.sum(ray**2, axis=-1)
        cosine = ray @ np.array(self.beams[k]["beam_direction"]) / np.sqrt(squared)
        return self.leds[k].intensity * cosine ** self.beams[k]["beam_cos_power"] / squared

    def solve(self):
        return solve_view(self.view, self.grid, self.r, np.full(self.r.shape, 0.02), SETTINGS)

    def normals(self, found):
        from scipy.ndimage import gaussian_filter, map_coordinates

        smooth = gaussian_filter(self.r, 0.7)
        along = np.gradient(smooth, self.grid.step_theta, axis=0) / smooth
        axial = np.gradient(smooth, self.grid.step_z, axis=1)
        at = self.grid.index(found.theta, found.z)
        slopes = [map_coordinates(slope, at, order=1) for slope in (along, axial)]
        normal = np.stack([np.ones(found.r.shape), -slopes[0], -slopes[1]], axis=-1)
        return normal / np.linalg.norm(normal, axis=-1, keepdims=True)

    def tops(self, found):
        """Within 1.2 mm of the crown, and with a slope that no wall has."""
        high = found.r > np.percentile(found.r, 99) - 1.2
        return high & (self.normals(found)[..., 0] > 0.98)

    def angles(self, found):
        difference = np.linalg.norm(found.normal - self.normals(found), axis=-1)
        return np.degrees(2 * np.arcsin(difference / 2))[self.tops(found)]


@pytest.mark.parametrize("skew", [0.0, 0.5])
def test_rays_are_those_that_the_camera_projects(bench, skew):
    """Of a lens far worse than any rig's, and of pixels in any order."""
    matrix = np.array([[900.0, skew, 330.2], [0.0, 880.0, 245.7], [0.0, 0.0, 1.0]])
    lens = np.array([-0.25, 0.1, 2e-3, -1e-3, -0.02])
    camera = Camera(matrix, lens, (640, 480))
    pixels = np.random.default_rng(3).permutation(640 * 480)[:3001]
    found = np.empty((len(pixels), 3))
    view_kernels.directions(
        0, len(pixels), pixels, 640, camera.intrinsics, tuple(lens.tolist()),
        np.ascontiguousarray(bench.axis.basis), found,
    )  # fmt: skip
    there = np.column_stack([pixels % 640, pixels // 640])
    np.testing.assert_allclose(camera.project(found @ bench.axis.basis), there, atol=1e-7)


def test_points_go_to_the_camera_as_the_axis_says(bench):
    rng = np.random.default_rng(4)
    points = np.column_stack(
        [rng.uniform(-0.9, 0.9, 500), rng.uniform(-50, 50, 500), rng.uniform(90, 110, 500)]
    )
    points[7] = np.nan
    found = np.empty(points.shape)
    view_kernels.to_camera(
        0, 500, points, np.ascontiguousarray(bench.axis.basis), bench.axis.point, found
    )
    phi, z, r = points.T
    expected = bench.axis.to_camera(phi - ENCODER, z, r, ENCODER)
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_a_view_in_many_chunks_is_the_view_in_one(view, bench, monkeypatch):
    """Chunks end within the image both ways, the last ones before their size."""
    whole = solve(view, bench)
    height, width = whole.r.shape
    rows, columns = height // 3 + 1, width // 3 + 1
    assert height % rows
    assert width % columns
    monkeypatch.setattr(view_module, "_CHUNK_ROWS", rows)
    monkeypatch.setattr(view_module, "_CHUNK_COLUMNS", columns)
    parts = solve(view, bench)
    for name in ("r", "theta", "z", "leds_used"):
        np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))
    # Without noise a poor fit is a matter of rounding.
    np.testing.assert_array_equal(parts.quality & ~POOR_FIT, whole.quality & ~POOR_FIT)
    # Pixels below a chunk's first row begin elsewhere: they end at the same minimum, nearly.
    np.testing.assert_allclose(parts.normal, whole.normal, atol=1e-3)
