import base64
import io
import json

import numpy as np
import pytest
from PIL import Image

from treadlight.report import (
    Layer,
    Projection,
    RegionTrend,
    box_chart,
    histogram_chart,
    polar_chart,
    projection_chart,
    residual_chart,
    share_chart,
    thumbnail,
    trend_chart,
)
from treadlight.report.charts import line_style, numbers
from treadlight.report.layers import colour_scale, layer_data, pack, upper_limit

MILES = np.array([100.0, 200.0, 300.0])


def trend(name="tread", detected=(True, True, True), line=True):
    wear = np.array([0.0, 0.1, 0.2])
    band = (MILES, wear, np.full(3, 0.05)) if line else None
    return RegionTrend(name, MILES, wear, np.full(3, 0.02), np.array(detected), band)


def traces(chart, **wanted):
    return [t for t in chart.data if all(t.get(k) == v for k, v in wanted.items())]


def test_packed_maps_come_back_to_half_a_micrometre(rng):
    values = rng.uniform(-30, 30, (20, 7))
    values[3, 2] = np.nan
    back = np.frombuffer(base64.b64decode(pack(values)), "<i2").reshape(20, 7)
    assert back[3, 2] == -32768
    known = np.isfinite(values)
    assert np.abs(back[known] / 1000 - values[known]).max() <= 0.5e-3 + 1e-12


def test_what_does_not_fit_is_clipped_and_not_lost():
    assert list(np.frombuffer(base64.b64decode(pack(np.array([99.0, -99.0]))), "<i2")) == [
        32767,
        -32767,
    ]


def test_a_layer_says_where_its_cells_are():
    layer = Layer("a", np.zeros((4, 3)), None, None, (-2.0, 0.5), (1.0, 0.25), np.zeros(3), False)
    data = layer_data(layer)
    assert data["theta_deg"] == {"first": -2.0, "step": 0.5, "count": 4}
    assert data["z_mm"] == {"first": 1.0, "step": 0.25, "count": 3}
    assert data["wear"] is None


def test_all_maps_share_one_scale_from_nil_to_a_percentile(rng):
    maps = [rng.uniform(0, 1, (50, 50)), rng.uniform(0, 3, (50, 50))]
    scale = colour_scale(maps, "viridis", 98)
    assert scale["low"] == 0
    assert scale["high"] == pytest.approx(np.percentile(np.concatenate(maps), 98), abs=1e-3)
    assert scale["colours"][0] == [0.0, "#440154"]
    assert upper_limit([np.full((2, 2), np.nan)], 98) == 1.0


def test_numbers_are_short_and_what_is_missing_is_none():
    assert numbers([1 / 3, np.nan, 12345678.0]) == [0.333333, None, 12345700.0]


def test_sixteen_curves_differ_in_colour_or_dash():
    styles = {tuple(line_style(k).items()) for k in range(16)}
    assert len(styles) == 16


def test_undetected_wear_is_an_upper_limit_and_never_a_point():
    chart = trend_chart([trend(detected=(True, False, True))], "mi")
    (points,) = traces(chart, name="tread", mode="markers")
    assert points["x"] == [100.0, 300.0]
    (limit,) = [t for t in chart.data if t["name"].startswith("not detected")]
    assert (limit["x"], limit["y"]) == ([200.0], [0.04])
    assert limit["marker"]["symbol"] == "triangle-down-open"


def test_the_prediction_band_surrounds_the_line():
    chart = trend_chart([trend(), trend("rib-1", line=False)], "km")
    (band,) = traces(chart, fill="toself")
    assert band["y"][:3] == [0.05, 0.15, 0.25]
    assert band["y"][3:] == [0.15, 0.05, -0.05]
    assert len(traces(chart, mode="lines")) == 2
    assert chart.layout["xaxis"]["title"]["text"] == "mileage (km)"


def test_a_projection_runs_from_the_last_depth_to_the_limit():
    region = Projection(
        "x", MILES, np.array([8, 7.9, 7.8]), np.full(3, 0.1), 5000.0, 4000.0, 7000.0
    )
    chart = projection_chart([region], 1.6, "mi")
    (line,) = traces(chart, mode="lines+markers")
    assert line["x"] == [300.0, 5000.0]
    assert line["y"] == [7.8, 1.6]
    assert line["error_x"]["array"] == [0.0, 2000.0]
    assert line["error_x"]["arrayminus"] == [0.0, 1000.0]
    assert chart.layout["shapes"][0]["y0"] == 1.6


def test_a_projection_without_a_latest_end_has_no_bar_to_the_right():
    region = Projection("x", MILES, np.array([8, 7.9, 7.8]), np.zeros(3), 5000.0, 4000.0, np.nan)
    (line,) = traces(projection_chart([region], 1.6, "mi"), mode="lines+markers")
    assert line["error_x"]["array"] == [0.0, 0.0]


def test_the_polar_plot_leaves_gaps_where_nothing_is_detected():
    wear, sure = np.array([0.1, 0.2, 0.3]), np.array([True, False, True])
    chart = polar_chart([("a", np.array([0.0, 2, 4]), {"rib-1": (wear, sure)})])
    assert chart.data[0]["r"] == [0.1, None, 0.3]
    assert chart.choices == ("a",)


def test_rejected_rays_stand_at_the_border_and_do_not_stretch_the_boxes():
    values = np.linspace(0.1, 0.5, 9)
    alone, far = (box_chart([("0", values, np.array(r))], "t", "c") for r in ([], [40.0]))
    assert alone.layout["yaxis"]["range"] == far.layout["yaxis"]["range"]
    (crosses,) = traces(far, name="rejected")
    assert crosses["y"] == [0.55]
    assert crosses["customdata"] == [40.0]


def test_every_axis_has_a_name_and_a_unit_and_the_chart_is_json():
    charts = [
        trend_chart([trend()], "mi"),
        histogram_chart(np.array([0.0, 1, 2]), np.array([3, 4]), "distance (mm)", "t", "c"),
        residual_chart(np.zeros((3, 2)), "t", "c"),
        share_chart([("a", {"laser": 0.1}), ("b", {"step": 0.2})]),
    ]
    for chart in charts:
        for axis in ("xaxis", "yaxis"):
            assert len(chart.layout[axis]["title"]["text"]) > 3
        assert json.dumps([chart.data, chart.layout], allow_nan=False)


def test_missing_data_is_grey_in_a_thumbnail_and_z_points_up():
    values = np.tile(np.arange(10.0), (30, 1))
    values[5] = np.nan
    png = thumbnail(values)
    assert png == thumbnail(values)
    assert b"matplotlib" not in png
    picture = np.asarray(Image.open(io.BytesIO(png)))
    assert picture.shape == (10, 30, 3)
    assert (picture[:, 5] == 0xD9).all()
    # viridis grows brighter: the largest z is on top.
    assert picture[0, 0].sum() > picture[-1, 0].sum()
