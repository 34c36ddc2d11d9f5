"""Neighbouring pixels brought together for cells that are several pixels wide."""

import numpy as np
import pytest

from treadlight.geometry import CylinderGrid
from treadlight.integrate import ViewNormals, views_for_cells
from treadlight.spool import Spool

RADIUS = 300.0
STEP = 0.031
WIDTH = 10
SIDE = 3


def cells(width=WIDTH):
    return CylinderGrid.sector((-0.1, 0.1), (-10.0, 10.0), STEP * width, RADIUS)


def view_of(shape, theta_0=0.0, slope=(0.2, -0.1), variance=1e-4):
    """A view of a surface with constant slopes, one pixel per `STEP`; rows lie along z."""
    v, u = np.indices(shape)
    theta = (theta_0 + u * STEP / RADIUS + np.pi) % (2 * np.pi) - np.pi
    normal = np.array([1.0, -slope[0], -slope[1]]) / np.sqrt(1 + slope[0] ** 2 + slope[1] ** 2)
    no = np.zeros(shape, bool)
    return ViewNormals(
        np.broadcast_to(normal.astype(np.float32), (*shape, 3)).copy(),
        np.full((*shape, 3), variance, np.float32),
        np.full(shape, RADIUS, np.float32),
        theta.astype(np.float32),
        (v * STEP).astype(np.float32),
        np.broadcast_to(np.float32([0.05, 0.4, 20.0]), (*shape, 3)).copy(),
        no,
        no.copy(),
        no.copy(),
        np.array([600.0, 0.0, 0.0]),
    )


def binned(view):
    (found,) = views_for_cells([view], cells())
    (block,) = found.blocks(cells())
    return block


def test_bins_have_the_slopes_and_all_the_information_of_their_pixels():
    view = view_of((9, 12))
    found = binned(view)
    assert found.theta.shape == (3, 4)
    np.testing.assert_allclose(found.normal, view.normal[:3, :4], atol=1e-4)
    np.testing.assert_allclose(found.covariance[..., [0, 2]], 1e-4 / SIDE**2, rtol=1e-3)
    np.testing.assert_allclose(found.material, view.material[:3, :4], rtol=1e-6)


def test_a_bin_lies_where_its_middle_pixel_does_or_its_first_known_one():
    view = view_of((9, 12))
    view.theta[4, 4] = np.nan
    found = binned(view)
    middle = view.theta[1::SIDE, 1::SIDE].copy()
    middle[1, 1] = view.theta[3, 3]
    np.testing.assert_array_equal(found.theta, middle)
    assert found.z[0, 0] == view.z[1, 1]
    assert found.z[1, 1] == view.z[3, 3]
    np.testing.assert_array_equal(found.r, np.float32(RADIUS))


def test_what_is_left_over_at_the_rim_is_a_bin_of_fewer_pixels():
    found = binned(view_of((7, 11)))
    assert found.theta.shape == (3, 4)
    assert found.covariance[2, 3, 0] == pytest.approx(1e-4 / 2, rel=1e-3)


def test_pixels_count_by_their_information():
    view = view_of((3, 3), slope=(0.0, 0.0))
    view.normal[0, 0] = np.array([1.0, -0.1, 0.0]) / np.sqrt(1.01)
    view.covariance[0, 0] = 1e-4 / 100
    found = binned(view)
    p = -found.normal[0, 0, 1] / found.normal[0, 0, 0]
    # A slope's variance grows as (1 + p^2)^3.
    weight = 100 / 1.01**3
    # The pixel lies 0.1 mrad before the bin's middle, to whose basis its slope is turned.
    assert p == pytest.approx((0.1 + STEP / RADIUS) * weight / (weight + 8), rel=1e-4)


def test_a_flat_face_has_one_normal_across_the_turns_end():
    """Its normals differ in the local bases of their pixels, where theta jumps by a turn."""
    view = view_of((3, 3), theta_0=np.pi - STEP / RADIUS)
    fixed = np.pi - 0.1
    away = fixed - view.theta
    view.normal[..., 0], view.normal[..., 1] = np.cos(away), np.sin(away)
    view.normal[..., 2] = 0
    found = binned(view)
    np.testing.assert_allclose(found.normal[0, 0], view.normal[1, 1], atol=1e-5)


def test_flags_are_shares_and_pixels_without_a_normal_tell_nothing_else():
    view = view_of((3, 3))
    view.shadowed[0] = True
    view.poor_fit[0, 0] = True
    view.normal[0] = np.nan
    view.material[0] = 1e6
    found = binned(view)
    assert found.shadowed[0, 0] == pytest.approx(1 / 3)
    assert found.poor_fit[0, 0] == pytest.approx(1 / 9)
    assert found.saturated[0, 0] == 0
    np.testing.assert_allclose(found.material[0, 0], [0.05, 0.4, 20.0], rtol=1e-6)
    assert found.covariance[0, 0, 0] == pytest.approx(1e-4 / 6, rel=1e-3)


def test_pixels_that_lie_nowhere_count_for_no_flag():
    view = view_of((3, 6))
    view.shadowed[0, 0] = view.poor_fit[2, 2] = True
    view.theta[:, :3][~view.shadowed[:, :3]] = np.nan
    found = binned(view)
    assert found.shadowed[0, 0] == 1
    assert found.poor_fit[0, 0] == 0


def test_a_bin_without_a_normal_has_none():
    view = view_of((3, 6))
    view.normal[:, :3] = np.nan
    found = binned(view)
    assert np.isnan(found.normal[0, 0]).all()
    assert np.isnan(found.material[0, 0]).all()
    assert np.isfinite(found.normal[0, 1]).all()


def test_pixels_that_cells_tell_apart_stay_as_they_are():
    view = view_of((9, 12))
    assert views_for_cells([view], cells(1.9 * SIDE)) == [view]


def test_bins_follow_the_pixels_and_not_the_grid():
    """A grid may be finer, or coarser, than the camera."""
    (found,) = views_for_cells([view_of((60, 60))], cells(2 * WIDTH))
    assert next(found.blocks(cells())).theta.shape == (10, 10)


def test_bins_in_files_are_those_in_memory(tmp_path):
    views = [view_of((9, 12)), view_of((30, 31), slope=(-0.3, 0.4))]
    held = views_for_cells(views, cells())
    filed = views_for_cells(views, cells(), Spool(tmp_path))
    for one, other in zip(held, filed, strict=True):
        for a, b in zip(one.blocks(cells()), other.blocks(cells()), strict=True):
            for name in ("normal", "covariance", "r", "theta", "z", "material", "shadowed"):
                np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
