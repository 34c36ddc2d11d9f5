import base64
import hashlib
import json
import re

from treadlight.report import html

NASTY = '<script>alert("1")</script>&\'"'


def test_every_piece_escapes_its_text():
    pieces = [
        html.heading(1, NASTY),
        html.paragraph(NASTY),
        *html.notices([NASTY], "bad"),
        html.facts([(NASTY, NASTY)]),
        html.table([NASTY], [[NASTY]]),
        html.image(b"png", NASTY),
        html.caption(NASTY),
        html.light("good", NASTY),
        html.plot("map", 100, layer=NASTY),
        html.choice(NASTY, [(NASTY, NASTY)], "data-choice"),
        html.links([(NASTY, NASTY)]),
        html.page(NASTY, []),
    ]
    for piece in pieces:
        assert "<script>" not in piece
        assert 'alert("' not in piece
        assert "&lt;script&gt;" in piece


def test_a_page_loads_nothing_from_anywhere():
    page = html.page("Title", [html.image(b"png", "alt")])
    assert "default-src 'none'" in page
    assert re.findall(r'(?:src|href)="(?!data:)', page) == []
    assert page.startswith("<!DOCTYPE html>")


def test_only_the_pages_own_scripts_may_run():
    script = "document.title = 1;"
    page = html.page("Title", [], [script])
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}';" in page
    assert "unsafe-eval" not in page
    assert "script-src" not in html.page("Title", [])


def test_data_for_a_script_cannot_end_it():
    content = {"name": "</script><!-- &"}
    piece = html.data("page-data", content)
    inside = piece.partition(">")[2].rpartition("</script>")[0]
    assert not set("<>&") & set(inside)
    assert json.loads(inside) == content


def test_numbers_have_a_true_minus_and_no_negative_zero():
    assert html.number(-1.25, 1) == "\u22121.2"
    assert html.number(-0.0001, 2) == "0.00"
    assert html.number(3, 1, "mm") == "3.0\u202fmm"
    assert html.percent(0.9751) == "97.5\u202f%"


def test_what_is_not_known_is_a_dash():
    for unknown in (None, float("nan"), "n/a"):
        assert html.number(unknown, 2) == "\u2013"
        assert html.percent(unknown) == "\u2013"


def test_numbers_stand_to_the_right_and_dates_do_not():
    row = html.table(["a"], [["\u22121.2 \u00b1 0.1", "2020-01-15T10:00", "t7", "\u2013", "12"]])
    assert row.count('<td class="n s">') == 3
    assert '<td class="s">2020-01-15' in row
