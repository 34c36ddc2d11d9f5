import io

import numpy as np
import pytest
from PIL import Image

from treadlight.report import (
    Map,
    box_figure,
    figures,
    map_figure,
    section_figure,
    thumbnail,
    trend_figure,
)


@pytest.fixture
def maps(rng):
    values = rng.normal(5, 1, (60, 20))
    values[10:20] = np.nan
    return [Map("a", values, (-10, 50), (-5, 5)), Map("b", values + 10, (20, 80), (-5, 5))]


def pixels(png):
    return np.asarray(Image.open(io.BytesIO(png)))


def test_figures_are_the_same_bytes_each_time_and_name_no_software(maps):
    z = np.linspace(-5, 5, 20)
    draw = [
        lambda: map_figure(maps, "mm", 355.0, "viridis"),
        lambda: section_figure([("a", z, z**2)], "mm", "title"),
        lambda: trend_figure([("rib-1", z[:3], z[:3], z[:3] * 0 + 0.1, -0.1)], "mi", "mm", "t"),
        lambda: box_figure([("0", z**2, z[-2:] ** 3)], "LED", "mm", "t"),
        lambda: thumbnail(maps[0]),
    ]
    for one in draw:
        png = one()
        assert png == one()
        assert png.startswith(b"\x89PNG")
        assert b"matplotlib" not in png


def test_all_maps_share_one_colour_scale(maps):
    low, high = figures.colour_limits(maps)
    assert low == pytest.approx(np.nanpercentile(maps[0].values, 2), abs=0.3)
    assert high > 14
    empty = Map("e", np.full((3, 3), np.nan), (0, 1), (0, 1))
    assert figures.colour_limits([empty]) == (0.0, 1.0)


def test_rejected_values_are_red_and_do_not_stretch_the_boxes():
    """Far outliers stay at the border: the boxes are as tall as without them."""
    values, none = np.linspace(0.1, 0.5, 9), np.empty(0)

    def drawn(rejected):
        return pixels(box_figure([("0", values, rejected)], "LED", "mm", "t")).astype(int)

    def red(picture):
        return (picture[..., 0] > picture[..., 1] + 60) & (picture[..., 0] > picture[..., 2] + 60)

    alone, near, far = (drawn(np.array(r)) for r in (none, [0.3], [40.0]))
    assert not red(alone).any()
    assert red(near).any()
    rows = np.nonzero(red(far))[0].mean(), np.nonzero(red(near))[0].mean()
    assert rows[0] < rows[1]
    assert (far == alone)[~red(far)].mean() > 0.999


def test_a_constant_map_still_has_a_scale():
    flat = Map("f", np.full((3, 3), 2.0), (0, 1), (0, 1))
    assert figures.colour_limits([flat]) == (2.0, 3.0)


def test_missing_data_is_grey_in_a_thumbnail_and_z_points_up():
    values = np.tile(np.arange(10.0), (30, 1))
    values[5] = np.nan
    picture = pixels(thumbnail(Map("t", values, (0, 1), (0, 1))))
    assert picture.shape == (10, 30, 3)
    assert (picture[:, 5] == 0xD9).all()
    # viridis grows brighter: the largest z is on top.
    assert picture[0, 0].sum() > picture[-1, 0].sum()


def test_a_whole_turn_and_a_sector_keep_a_readable_height():
    turn = Map("t", np.zeros((4, 4)), (-180, 180), (-100, 100))
    sector = Map("s", np.zeros((4, 4)), (0, 5), (-100, 100))
    assert figures._panel_height(turn, 355.0) == pytest.approx(1.6)
    assert figures._panel_height(sector, 355.0) == pytest.approx(4.5)
