import numpy as np
import pytest

from treadlight.evaluate import metrics, surface
from treadlight.evaluate.truth import Profile
from treadlight.geometry import CylinderGrid


def evaluate(truth, r, **more):
    return metrics.evaluate_profile(truth, truth.theta, truth.z, r, **more)


def test_truth_as_the_result_has_no_error_anywhere(truth):
    found = evaluate(truth, truth.r)
    for kind in ("absolute", "shape"):
        for figures in found[kind].values():
            assert figures["cells"] > 0
            assert figures["coverage"] == 1.0
            assert figures["p95_mm"] < 1e-9
    assert found["detail"]["correlation"] == pytest.approx(1.0)
    assert found["edges"]["found"] == 1.0
    assert found["edges"]["edges"] > 1000


def test_an_offset_is_the_absolute_bias_and_no_shape_error(truth):
    found = evaluate(truth, truth.r + 0.25)
    assert found["absolute"]["top"]["bias_mm"] == pytest.approx(0.25)
    assert found["absolute"]["floor"]["rms_mm"] == pytest.approx(0.25)
    assert found["shape"]["top"]["rms_mm"] < 1e-6


def test_every_motion_of_the_frame_is_taken_out_of_the_shape(truth):
    c, s, z = np.cos(truth.theta)[:, None], np.sin(truth.theta)[:, None], truth.z
    moved = truth.r + 0.1 * c - 0.2 * s + 0.004 * z + 0.003 * z * c - 0.002 * z * s
    found = evaluate(truth, moved)
    assert found["absolute"]["top"]["rms_mm"] > 0.05
    for name in ("top", "floor", "slot", "wall"):
        assert found["shape"][name]["p95_mm"] < 1e-6


def test_a_bump_stays_in_the_shape_error(truth, rng):
    found = evaluate(truth, truth.r + rng.normal(0, 0.1, truth.r.shape))
    assert found["shape"]["top"]["rms_mm"] == pytest.approx(0.1, rel=0.03)
    assert found["shape"]["top"]["median_abs_mm"] == pytest.approx(0.0674, rel=0.04)
    assert abs(found["shape"]["top"]["bias_mm"]) < 0.005


def test_gross_errors_do_not_move_the_shape_fit(truth):
    broken = truth.r + 0.1
    broken[:80] += 5.0
    found = evaluate(truth, broken)
    assert found["shape_fit"]["one"] + found["shape_fit"]["cos"] == pytest.approx(0.1, abs=0.01)
    assert found["shape"]["top"]["p95_mm"] == pytest.approx(5.0, abs=0.05)


def test_coverage_counts_missing_cells_of_each_class(truth):
    r = truth.r.copy()
    r[::4] = np.nan
    found = evaluate(truth, r)
    assert found["shape"]["top"]["coverage"] == pytest.approx(0.75, abs=0.01)
    nothing = evaluate(truth, np.full_like(truth.r, np.nan))
    assert nothing["shape"]["top"]["coverage"] == 0.0
    assert nothing["shape"]["top"]["rms_mm"] is None
    assert nothing["detail"]["correlation"] is None
    assert nothing["edges"]["found"] == 0.0


def test_a_result_beside_the_truth_gives_no_figures(truth):
    found = metrics.evaluate_profile(truth, truth.theta + 2.0, truth.z, truth.r)
    assert found["absolute"]["all"]["cells"] == 0
    assert found["absolute"]["all"]["coverage"] is None
    assert found["edges"] == {"found": None, "edges": 0}
    assert found["extent"]["top"] == 0.0


def test_a_coarser_shifted_grid_is_held_against_interpolated_truth(truth):
    theta = truth.theta[:-1:2] + 0.3e-3
    z = truth.z[:-1:2] + 0.13
    found = metrics.evaluate_profile(
        truth, theta, z, surface.interpolate(truth, truth.r, theta, z) + 0.05
    )
    assert found["absolute"]["top"]["bias_mm"] == pytest.approx(0.05)
    assert found["absolute"]["all"]["rms_mm"] == pytest.approx(0.05)


def test_detail_sees_texture_and_not_slow_errors(truth):
    slow = 0.3 * np.sin(truth.theta * 355 / 30)[:, None]
    found = evaluate(truth, truth.r + slow)["detail"]
    assert found["correlation"] > 0.9
    assert found["rms_mm"] < 0.01


def test_another_texture_does_not_correlate(truth, rng):
    flat = Profile(truth.theta, truth.z, 355.0 + rng.normal(0, 0.02, truth.r.shape))
    found = evaluate(flat, 355.0 + rng.normal(0, 0.02, truth.r.shape))["detail"]
    assert abs(found["correlation"]) < 0.05
    assert found["rms_mm"] == pytest.approx(0.02 * np.sqrt(2), rel=0.05)


@pytest.mark.parametrize(("shift", "least", "most"), [(1, 0.95, 1.0), (3, 0.0, 0.25)])
def test_edges_count_within_one_and_a_half_cells(truth, shift, least, most):
    found = evaluate(truth, np.roll(truth.r, shift, axis=1))["edges"]
    assert least <= found["found"] <= most


def test_edges_smeared_shut_are_not_found(truth):
    filled = np.broadcast_to(surface.outer_envelope(truth), truth.r.shape)
    assert evaluate(truth, filled)["edges"]["found"] == 0.0


def test_honest_sigmas_hold_their_share(truth, rng):
    noisy = truth.r + rng.normal(0, 0.1, truth.r.shape)
    std = np.full(truth.r.shape, 0.1)
    found = evaluate(truth, noisy, r_std=std)["r_std"]
    for name in ("top", "floor"):
        assert found[name]["inside_1"] == pytest.approx(0.683, abs=0.015)
        assert found[name]["inside_2"] == pytest.approx(0.954, abs=0.01)
        assert found[name]["median_std_mm"] == 0.1
    assert evaluate(truth, noisy, r_std=std * np.nan)["r_std"]["top"]["inside_1"] is None


def test_a_step_where_the_view_changes_is_seen_as_a_seam(truth):
    middle = len(truth.theta) // 2
    stepped = truth.r.copy()
    stepped[middle:] += 0.2
    seam = np.array([truth.theta[middle - 1 : middle + 1].mean() + 4 * np.pi])
    found = evaluate(truth, stepped, seams=seam)["seams"]
    assert found["at_seams_mm"] > 0.1
    assert found["elsewhere_mm"] < 1e-9
    assert "seams" not in evaluate(truth, stepped, seams=np.empty(0))


def test_views_change_midway_between_neighbours():
    found = metrics.view_changes(np.radians([10.0, -20.0, 40.0]))
    assert np.degrees(np.sort(found)) == pytest.approx([-25.0, 5.0])


def test_views_of_a_whole_turn_change_as_often_as_there_are_views():
    encoders = np.radians(np.arange(0, 360, 30.0))
    found = np.degrees(metrics.view_changes(encoders))
    assert len(found) == 12
    assert np.sort(found % 30) == pytest.approx(15.0)


def test_a_single_view_has_no_change():
    assert len(metrics.view_changes(np.array([0.3]))) == 0


def test_the_camera_stands_opposite_the_encoder_angle():
    facing = metrics.towards_camera(np.array([-0.4]), np.array([0.0]), np.array([300.0]), 0.4, 1e3)
    assert facing[0] == pytest.approx([1, 0, 0])
    aside = metrics.towards_camera(np.array([-0.6]), np.array([10.0]), np.array([300.0]), 0.4, 1e3)
    assert aside[0, 1] > 0
    assert aside[0, 2] < 0
    assert np.linalg.norm(aside) == pytest.approx(1.0)


def test_cells_are_seen_by_the_view_that_looks_most_squarely():
    encoders = np.array([0.0, -1.0, 3.0])
    found = metrics.nearest_view(np.array([0.1, 0.9, -2.9, 3.3]), encoders)
    assert found.tolist() == [0.0, -1.0, 3.0, 3.0]
    assert metrics.nearest_view(np.array([0.2]), np.empty(0)).tolist() == [-0.2]


def test_a_tilted_normal_is_off_by_its_tilt(truth):
    theta, z = np.meshgrid(truth.theta[5:-5], truth.z[5:-5], indexing="ij")
    true = surface.true_normals(truth, 0.7 * 0.4)[5:-5, 5:-5]
    view = np.broadcast_to([1.0, 0, 0], true.shape)
    tops = surface.classify(truth, surface.outer_envelope(truth))["top"][5:-5, 5:-5, None]
    exact = metrics.normal_figures(truth, theta, z, true, view, 0.4)
    assert exact["p95_deg"] < 1e-4
    assert exact["coverage"] == 1.0
    a = np.radians(5.0)
    along_z = np.cross(np.cross(true, [0, 0, 1.0]), true)
    along_z /= np.linalg.norm(along_z, axis=-1, keepdims=True)
    tilted = np.cos(a) * true + np.sin(a) * along_z
    tilted[::2] = np.nan
    found = metrics.normal_figures(truth, theta, z, tilted, view, 0.4)
    assert found["median_deg"] == pytest.approx(5.0, abs=1e-4)
    assert found["rms_deg"] == pytest.approx(5.0, abs=1e-4)
    assert found["mean_deg"] == pytest.approx(5.0, abs=1e-4)
    mixed = metrics.normal_figures(truth, theta, z, np.where(tops, true, tilted), view, 0.4)
    assert mixed["top_median_deg"] < 1e-4
    assert found["coverage"] == pytest.approx(0.5, abs=0.02)


def test_only_cells_that_face_the_camera_count(truth):
    theta, z = np.meshgrid(truth.theta, truth.z, indexing="ij")
    normal = surface.true_normals(truth, 0.3)
    away = np.broadcast_to([-1.0, 0.0, 0.0], normal.shape)
    assert metrics.normal_figures(truth, theta, z, normal, away, 0.4)["median_deg"] is None


def test_shape_fit_of_a_short_sector_is_the_smallest_that_fits(rng):
    theta, z = np.linspace(0, 0.01, 30), np.linspace(-50, 50, 40)
    error = np.full((30, 40), 0.3)
    fit = metrics.fit_shape(error, theta, z, np.ones_like(error, bool))
    assert metrics.evaluate_shape(fit, theta, z) == pytest.approx(error, abs=1e-9)
    assert np.abs(fit).max() < 1.0
    assert not metrics.fit_shape(error, theta, z, np.zeros_like(error, bool)).any()


def test_seams_of_a_whole_turn_are_found_by_angle():
    n = 360
    grid = CylinderGrid(-np.pi + np.arange(n) * 2 * np.pi / n, np.array([0.0, 1.0]), 300.0)
    error = np.zeros((n, 2))
    error[180:] = 1.0
    found = metrics.seam_steps(error, grid, np.array([-0.5 * 2 * np.pi / n]))
    assert found["at_seams_mm"] > 0.5
    assert found["elsewhere_mm"] == 0.0
