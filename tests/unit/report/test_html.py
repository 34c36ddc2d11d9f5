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
        html.image(b"png", NASTY, NASTY),
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
    assert row.count('<td class="n">') == 3
    assert "<td>2020-01-15" in row
