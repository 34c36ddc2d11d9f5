import dataclasses
import re

import numpy as np
import pytest

from treadlight.report import (
    ArchivePage,
    CaptureFacts,
    CaptureLine,
    IrregularWear,
    Layer,
    TireCard,
    TirePage,
    Verdict,
    archive_page,
    tire_page,
    verdict,
)
from treadlight.report.tables import irregular_table

ROW = {
    "tire": "t7",
    "capture": "t7-2",
    "mileage": "200",
    "unit": "mi",
    "region": "rib-1",
    "depth_mm": "7.812",
    "depth_std_mm": "0.02",
    "depth_p05_mm": "7.5",
    "depth_p95_mm": "8.1",
    "wear_mm": "0.115",
    "wear_std_mm": "0.02",
    "wear_p05_mm": "",
    "wear_p95_mm": "",
    "rate_mm_per_1000km": "0.7",
    "rate_mils_per_1000mi": "44.4",
    "rate_r2": "",
    "projected_mileage": "5400",
    "projected_low": "5000",
    "projected_high": "6000",
    "status": "not_detected",
    "later_column": "ignored",
}
QUALITY = {
    "coverage": {"tread": 0.975, "rib": 0.99, "groove": None},
    "laser_points": 31000,
    "held_out_laser_mm": {"n": 3000, "bias": -0.003, "rms": 0.21},
    "closure_mm": None,
    "flags": {"shadowed": 0.05},
    "warnings": ["The <calibration> was taken after this capture."],
}


@pytest.fixture
def capture():
    return CaptureFacts("t7-1", "100 mi", "2020-01-15", "bench", "cal-1", QUALITY, None)


@pytest.fixture
def page(capture):
    refused = CaptureFacts("t7-2", "", "", "", "cal-1", {}, "led.png: cannot be decoded.")
    facts = [("Size", "215/70R16"), ("Nominal radius", "355.0 mm")]
    return TirePage("t7", facts, "It wears.", [capture, refused], None, ["Odd."], trend=[ROW])


def test_warnings_come_before_any_table(page):
    text = tire_page(page)
    for sentence in (
        "It wears.",
        "led.png: cannot be decoded.",
        "Odd.",
        "The &lt;calibration&gt; was taken",
    ):
        assert text.index(sentence) < text.index("<table")


def test_the_head_names_tire_size_mileage_and_calibration(page):
    head = tire_page(page).split("<h2")[0]
    for fact in ("Tire t7", "215/70R16", "100 mi", "cal-1", "355.0"):
        assert fact in head


def test_a_rib_row_shows_depth_wear_and_status(page):
    text = tire_page(page)
    for cell in ("7.812 \u00b1 0.020", "115.0 \u00b1 20.0", "5400 (5000 to 6000)", "not detected"):
        assert cell in text
    assert "ignored" not in text


def test_quality_shows_measured_captures_only(page):
    quality = tire_page(page).split(">Quality</h2>")[1]
    assert "t7-1" in quality
    assert "t7-2" not in quality
    assert "97.5\u202f%" in quality
    assert "\u22120.003" in quality
    assert "Cells: shadowed" in quality


def test_a_tire_of_refused_captures_only_says_why_and_nothing_else(page):
    bare = dataclasses.replace(page, captures=page.captures[1:], trend=[], facts=[], verdict="")
    text = tire_page(bare)
    assert "t7-2 was refused: led.png: cannot be decoded." in text
    assert "Quality" not in text
    assert "<script" not in text


def test_a_page_with_figures_carries_its_scripts_and_data(page):
    layer = Layer("a", np.ones((4, 3)), None, None, (0.0, 1.0), (0.0, 1.0), np.ones(3), False)
    worn = dataclasses.replace(layer, wear=np.ones((4, 3)), wear_std=np.ones((4, 3)))
    text = tire_page(dataclasses.replace(page, layers=[layer, worn], radius_mm=355.0))
    assert text.count("<script>") == 2
    assert text.count('data-map="height"') == 2
    assert text.count('data-layer="1" data-map="wear"') == 1
    assert re.findall(r'(?:src|href)="(?!#)', text.partition("<script>")[0]) == []


def test_irregular_wear_has_a_word_in_every_capture():
    row = IrregularWear(
        "cupping", "rib-1", "why", [("a", 0.2, 0.01, "slight"), ("b", np.nan, np.nan, "not known")]
    )
    text = irregular_table([row])
    assert "200 \u00b1 10: slight" in text
    assert ">not known</td>" in text


def test_refused_wear_is_said(page):
    text = tire_page(dataclasses.replace(page, wear_refused="No overlap."))
    assert "There is no wear: No overlap." in text


def line(**changes):
    facts = CaptureLine("t7-1", "t7", "100 mi", "cal-1", 0.97, 0.2, None, [])
    return dataclasses.replace(facts, **changes)


def test_the_archive_page_links_tires_and_counts_refusals():
    content = ArchivePage(
        tires=[TireCard("t7", "tires/t7/report.html", b"png", [("Captures", "2")], "refused")],
        captures=[line(warnings=["Late <calibration>."]), line(id="t7-2", refused="Bad pixels.")],
        calibrations=[("cal-1", "camera 0.02 px", False), ("cal-2", "No board.", True)],
        refused={"t9": "capture.yaml: 'kind' is <None>."},
    )
    text = archive_page(content)
    assert '<a href="tires/t7/report.html">' in text
    assert "1 tire, 2 captures, 2 calibrations; 3 refused." in text
    for sentence in (
        "t7-2 was refused: Bad pixels.",
        "cal-2 was refused: No board.",
        "t9 was refused: capture.yaml: &#x27;kind&#x27; is &lt;None&gt;.",
        "t7-1: Late &lt;calibration&gt;.",
    ):
        assert text.index(sentence) < text.index("<h2>Captures")


def test_an_archive_without_reports_has_no_links():
    text = archive_page(ArchivePage([TireCard("t7", None, None, [], "good")], [line()], [], {}))
    assert "<a " not in text
    assert "<img" not in text
    assert "nothing refused" in text


@pytest.mark.parametrize(
    ("changes", "light"),
    [
        ({}, "good"),
        ({"warnings": ["Late."]}, "look"),
        ({"coverage": 0.5}, "look"),
        ({"coverage": None}, "look"),
        ({"refused": "Bad."}, "refused"),
    ],
)
def test_the_light_says_whether_to_look_closer(changes, light):
    assert line(**changes).light == light
    text = archive_page(ArchivePage([], [line(**changes)], [], {}))
    assert f'class="light {light}"' in text


def facts(status="valid", **changes):
    row = {"wear_mm": "0.2", "wear_std_mm": "0.03", "rate_mm_per_1000km": "0.6", "status": status}
    rib = ("rib-5", {**row, "wear_mm": "0.3"})
    plain = Verdict("mi", 100.0, 300.0, row, rib, 1.6, ("the mean", 5000.0, 4000.0, np.nan), [])
    return dataclasses.replace(plain, **changes)


def test_the_verdict_says_where_how_fast_how_evenly_and_how_sure():
    text = verdict(facts())
    for part in (
        "200 \u00b1 30",
        "valid rate of 0.60",
        "fastest on rib-5 (300",
        "no irregular",
        "1.6\u202fmm at about 5000 mi (4000 to no upper end) by the mean.",
    ):
        assert part in text
    assert "unevenly (slight cupping)" in verdict(facts(irregular=["slight cupping"]))
    assert "indicative rate" in verdict(facts(status="indicative"))


def test_the_verdict_draws_nothing_from_wear_that_is_not_detected():
    text = verdict(facts(status="not_detected"))
    assert text.startswith("No wear is detected from 100 to 300 mi")
    assert "rate" not in text
