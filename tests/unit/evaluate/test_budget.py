"""What the sources of error are replaced by, and the table that comes of it."""

import numpy as np
import pytest

from treadlight.evaluate.budget import (
    SOURCES,
    budget_row,
    smooth_normals,
    true_points,
    without_error,
)
from treadlight.evaluate.surface import classify, outer_envelope, true_normals
from treadlight.evaluate.text import render_budget


def test_points_without_error_lie_on_the_truth(truth):
    theta, z = np.meshgrid(truth.theta[10:13], truth.z[20:24], indexing="ij")
    r = truth.r[10:13, 20:24] + 0.3
    r[1, 1] = np.nan
    found = true_points(truth, r, theta, z)
    np.testing.assert_allclose(found[0], truth.r[10, 20:24], atol=1e-9)
    assert np.isnan(found[1, 1])


def test_points_beyond_the_truth_stay_as_they_were(truth):
    outside = np.full((1, 2), truth.z[-1] + 5.0)
    r = np.array([[350.0, 351.0]])
    np.testing.assert_array_equal(true_points(truth, r, np.zeros((1, 2)), outside), r)


def test_normals_on_tops_and_floors_are_the_truths_where_there_were_any(truth):
    theta, z = np.meshgrid(truth.theta, truth.z, indexing="ij")
    measured = np.broadcast_to([1.0, 0, 0], (*theta.shape, 3)).copy()
    measured[3, 4] = np.nan
    found = without_error(truth, smooth_normals(truth, 0.4), measured, theta, z)
    assert np.isnan(found[3, 4]).all()
    classes = classify(truth, outer_envelope(truth))
    clear = classes["top"] | classes["floor"]
    clear[3, 4] = False
    assert 0.2 < clear.mean() < 0.9
    np.testing.assert_allclose(found[clear], true_normals(truth, 0.7 * 0.4)[clear], atol=1e-5)
    np.testing.assert_array_equal(found[classes["wall"]], measured[classes["wall"]])


def test_rows_that_no_view_sees_are_told_apart(truth, rng):
    r = truth.r + rng.normal(0, 0.02, truth.r.shape)
    seen = np.arange(len(truth.theta)) < len(truth.theta) // 2
    r[~seen] += rng.normal(0, 0.2, r[~seen].shape)
    row = budget_row(truth, truth.theta, truth.z, r, seen)
    assert row["seen"]["top"]["rms_mm"] == pytest.approx(0.02, rel=0.1)
    assert row["all"]["top"]["rms_mm"] == pytest.approx(np.hypot(0.02, 0.2) / 2**0.5, rel=0.1)
    assert row["edges"] == pytest.approx(1.0, abs=0.01)


def test_the_table_has_a_line_for_every_source(truth):
    row = budget_row(truth, truth.theta, truth.z, truth.r, np.ones(len(truth.theta), bool))
    wear = {source: {"mean_error_mm": 0.0123, "block_rms_mm": None} for source in SOURCES}
    report = {"captures": {"a": dict.fromkeys(SOURCES, row)}, "wear": {"t": {"b": wear}}}
    text = render_budget(report)
    for name in SOURCES.values():
        assert text.count(name + " ") >= 2
    assert "12.3" in text
    assert "nothing to take apart" in render_budget({"captures": {}, "wear": {}})
