"""One number is the same number everywhere: in wear.zarr, in trend.csv and on the page."""

import html
import re

import numpy as np
import pytest

from treadlight import store
from treadlight.commands.wear import surface_of
from treadlight.tread import TOP
from treadlight.wear import relief_from


@pytest.fixture(scope="module")
def trend(worn_tire):
    rows = store.read_csv(worn_tire / "tires/t/trend.csv")
    return {(row["capture"], row["region"]): row for row in rows}


@pytest.fixture(scope="module")
def page(worn_tire):
    return (worn_tire / "tires/t/report.html").read_text(encoding="utf-8")


def table_below(page, title):
    section = page.partition(f">{title}</h2>")[2].partition("<table>")[2].partition("</table>")[0]
    rows = re.findall("<tr>(.*?)</tr>", section)[1:]
    cells = [re.findall("<td[^>]*>(.*?)</td>", row) for row in rows]
    return [[html.unescape(cell).replace("\u2212", "-") for cell in row] for row in cells]


def test_wear_in_the_trend_is_that_of_the_map(worn_tire, trend):
    wear = store.open_store(worn_tire / "tires/t/wear.zarr")
    first = store.open_store(worn_tire / "captures/a/profile.zarr")
    regions = relief_from(surface_of(first)).regions.on_columns(first["z"].to_numpy())
    top = regions.classify(first["r"].to_numpy(), first["theta"].to_numpy()) == TOP
    for rib, truth in ((1, 0.2), (2, 0.3), (3, 0.4)):
        cells = wear["wear"].isel(capture=1).to_numpy()[top & (regions.rib_of_column == rib)]
        said = float(trend["b", f"rib-{rib}"]["wear_mm"])
        assert said == pytest.approx(np.nanmean(cells), abs=1e-3)
        assert said == pytest.approx(truth, abs=0.01)


def test_the_table_says_what_the_trend_says(trend, page):
    rows = {(row[0], row[1]): row for row in table_below(page, "Ribs and grooves")}
    for region in ("tread", "rib-1", "groove-1"):
        row, cells = trend["b", region], rows[region, "b"]
        depth, wear = float(row["depth_mm"]), 1000 * float(row["wear_mm"])
        assert cells[3].startswith(f"{depth:.3f} \u00b1")
        assert cells[4] == f"{float(row['depth_min_mm']):.2f}"
        assert cells[7].startswith(f"{wear:.1f} \u00b1")


def test_the_verdict_names_the_fastest_rib_and_the_tilted_wear(trend, page):
    verdict = page.partition('class="verdict">')[2].partition("</p>")[0]
    wear = 1000 * float(trend["c", "tread"]["wear_mm"])
    assert f"lost {wear:.0f} \u00b1" in verdict
    assert "fastest on rib-3" in verdict
    assert "one-sided wear" in verdict


def test_wear_that_differs_from_side_to_side_is_measured_as_such(page):
    rows = {(row[0], row[1]): row for row in table_below(page, "Irregular wear")}
    value, _, _ = rows["one-sided wear", "tread"][2].partition(" ")
    assert float(value) == pytest.approx(200, abs=15)
    assert "not detected" in rows["centre/shoulder wear", "tread"][2]
    assert "not detected" in rows["heel-and-toe", "rib-1"][2]
    assert rows["heel-and-toe", "rib-1"][-1] == "trailing less leading edge"


def test_repeats_at_one_mileage_are_compared(page):
    rows = {row[1]: row for row in table_below(page, "Repeatability")}
    assert rows["tread"][0] == "200 mi"
    assert rows["tread"][2] == "2"
    assert float(rows["tread"][3]) < 5


def test_runout_and_void_are_those_of_the_tire(page):
    rows = table_below(page, "Runout and void ratio")
    orders = [float(cell) for cell in rows[0][2:12]]
    assert orders[1] == pytest.approx(50, abs=3)
    assert max(orders[2:]) < 5


def test_what_a_capture_says_is_escaped_everywhere(worn_tire, page):
    assert "<b>7</b>" not in page
    assert "&lt;b&gt;7&lt;/b&gt;" in page
    assert "<calibration>" not in (worn_tire / "index.html").read_text(encoding="utf-8")


def test_the_page_stays_small(worn_tire):
    assert (worn_tire / "tires/t/report.html").stat().st_size < 25e6
