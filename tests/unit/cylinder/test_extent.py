import numpy as np
import pytest

from treadlight.cylinder import Extent, choose_grid, pixel_size_mm, view_extent
from treadlight.cylinder.extent import widest_gap
from treadlight.errors import CaptureError

NOMINAL = 300.0


def grid_of(sections, views=(), step=1.0):
    return choose_grid(sections, views, step, NOMINAL, 100.0)


def test_pixel_size_is_depth_over_focal_length(rig):
    depth = np.linalg.norm(rig.axis.point) - NOMINAL
    assert pixel_size_mm(rig, NOMINAL) == pytest.approx(depth / 900.0)


def test_view_looks_at_minus_its_encoder_angle(rig):
    view = view_extent(rig, 0.7, NOMINAL)
    assert view.start < -0.7 < view.start + view.length
    # The border of the image projects back onto the border.
    theta = np.array([view.start, view.start + view.length])
    uv = rig.camera.project(rig.axis.to_camera(theta, np.zeros(2), np.full(2, NOMINAL), 0.7))
    assert np.abs(np.sort(uv[:, 0]) - [0, 191]).max() < 6
    assert view.z_high - view.z_low == pytest.approx(255 * pixel_size_mm(rig, NOMINAL), rel=0.05)


def test_view_that_misses_the_tire_is_refused_with_a_sentence(rig):
    with pytest.raises(CaptureError, match="does not see the tire"):
        view_extent(rig, 0.0, 1e-3)


def test_sections_all_round_give_a_whole_turn_and_one_gap_a_sector(sections_of, grooved):
    encoder = np.radians(np.arange(0, 360, 2.0))
    whole = grid_of(sections_of(grooved, encoder))
    assert whole.periodic
    # Two missing in a row are bridged, ten are not.
    assert grid_of(sections_of(grooved, np.delete(encoder, [50, 51]))).periodic
    sector = grid_of(sections_of(grooved, np.delete(encoder, np.arange(50, 60))))
    assert not sector.periodic
    length = sector.theta[-1] - sector.theta[0]
    assert length == pytest.approx(2 * np.pi - np.radians(22), abs=0.02)


def test_overlapping_sections_still_give_one_turn(sections_of, grooved):
    grid = grid_of(sections_of(grooved, np.radians(np.arange(0, 372, 2.0))))
    assert grid.periodic
    assert len(grid.theta) == round(2 * np.pi * NOMINAL)


def test_sector_may_pass_pi_and_holds_sections_and_views(sections_of, grooved):
    encoder = -np.radians(np.arange(150, 200, 2.0))
    views = [Extent(np.radians(195), np.radians(20), -30, 30)]
    grid = grid_of(sections_of(grooved, encoder), views)
    assert not grid.periodic
    assert np.degrees(grid.theta[0]) == pytest.approx(150, abs=1)
    assert np.degrees(grid.theta[-1]) == pytest.approx(215, abs=1)


def test_views_all_round_give_a_whole_turn_without_a_laser(sections_of, grooved):
    none = sections_of(grooved, [])
    views = [Extent(np.radians(21.0 * k), np.radians(25), -60.0, 58.0) for k in range(18)]
    grid = grid_of(none, views)
    assert grid.periodic
    # The camera saw more than the tread's width with its shoulders.
    assert grid.z[0] == pytest.approx(-60)
    assert grid.z[-1] == pytest.approx(58, abs=1)
    assert not grid_of(none, views[:9]).periodic


def test_z_range_is_that_of_lines_which_a_tenth_of_the_sections_sees(sections_of, grooved):
    found = sections_of(grooved, np.radians(np.arange(0, 60, 2.0)))
    found.z[:, :20] = np.nan
    found.z[0, :20] = -40.0
    grid = grid_of(found)
    assert grid.z[0] == pytest.approx(-35.0, abs=0.01)
    assert grid.z[-1] == pytest.approx(44.5, abs=1)


def test_nothing_at_all_is_refused_with_a_sentence(sections_of, grooved):
    with pytest.raises(CaptureError, match="Neither laser nor LED"):
        grid_of(sections_of(grooved, []))


@pytest.mark.parametrize(
    ("arcs", "gap"),
    [
        ([(0, 1)], (1, 2 * np.pi - 1)),
        ([(0, 1), (2, 1)], (3, 2 * np.pi - 3)),
        ([(6, 1), (3, 1)], (7 - 2 * np.pi, 3 - 7 + 2 * np.pi)),
        ([(0, 5), (1, 1)], (5, 2 * np.pi - 5)),
    ],
)
def test_widest_gap_is_found_over_zero_too(arcs, gap):
    start, length = widest_gap(arcs)
    assert length == pytest.approx(gap[1])
    assert (start - gap[0]) % (2 * np.pi) == pytest.approx(0, abs=1e-9)


def test_arcs_that_cover_the_turn_leave_no_gap():
    assert widest_gap([(0, 4), (3, 4)])[1] <= 0
