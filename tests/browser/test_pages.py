"""What a reader does with the pages: look, point, drag, choose."""

import io
import json
import re
import shutil

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import expect

from treadlight.cli import main

pytestmark = pytest.mark.browser

REPORT = "tires/t/report.html"
WIDTHS = (1440, 400)
# Texts of one figure whose boxes share more than two pixels both ways.
OVERLAPS = """
box => {
  const kinds = ".xtick text, .ytick text, .xtitle, .ytitle, .legendtext, .cbaxis text, .cbtitle,"
    + " .annotation-text, .angularaxistick text, .radialaxistick text";
  const boxes = [...box.querySelectorAll(kinds)]
    .map(t => [t.textContent, t.getBoundingClientRect()])
    .filter(([, b]) => b.width > 0);
  const found = [];
  boxes.forEach(([a, p], i) => boxes.slice(i + 1).forEach(([b, q]) => {
    const wide = Math.min(p.right, q.right) - Math.max(p.left, q.left);
    const tall = Math.min(p.bottom, q.bottom) - Math.max(p.top, q.top);
    if (wide > 2 && tall > 2) found.push(`${a} | ${b}`);
  }));
  return found;
}
"""

TITLES = "box => [...box.querySelectorAll('.xtitle, .ytitle, .cbtitle')].map(t => t.textContent)"
# A unit, or what has none.
UNITS = r"\((mm|°|mi|px|%)\)$|^LED$|^quality flag$|^number of points$"


def drawn(page, selector):
    """The figures of this selector, scrolled to and drawn."""
    plots = page.locator(selector)
    for number in range(plots.count()):
        plots.nth(number).scroll_into_view_if_needed()
        expect(plots.nth(number)).to_have_attribute("data-drawn", "done", timeout=60_000)
    return plots


def eventually(page, holds):
    """Whether something comes true within 30 s: drawing takes its time on a busy machine."""
    for _ in range(100):
        if holds():
            return True
        page.wait_for_timeout(300)
    return False


def point_at(page, plot, share_x, share_y):
    """Move the mouse to a place of a figure's plot area, given as shares of its sides."""
    plot.scroll_into_view_if_needed()
    area = plot.locator(".nsewdrag").first.bounding_box()
    x, y = area["x"] + share_x * area["width"], area["y"] + share_y * area["height"]
    page.mouse.move(x - 3, y)
    page.mouse.move(x, y)
    return x, y


@pytest.mark.parametrize("width", WIDTHS)
def test_every_figure_is_drawn_with_units_and_no_label_covers_another(
    open_page, screenshots, width
):
    page = open_page(REPORT, width)
    plots = drawn(page, "[data-plot]")
    assert plots.count() >= 12
    for number in range(plots.count()):
        plot = plots.nth(number)
        plot.scroll_into_view_if_needed()
        kind = f"{plot.get_attribute('data-plot')}-{number}"
        plot.screenshot(path=screenshots / f"{width}-{number:02d}-{kind}.png")
        assert plot.evaluate(OVERLAPS) == [], kind
        assert [t for t in plot.evaluate(TITLES) if not re.search(UNITS, t)] == [], kind
    page.evaluate("window.scrollTo(0, 0)")
    page.screenshot(path=screenshots / f"report-{width}.png")
    assert page.evaluate("document.documentElement.scrollWidth") <= width


def test_pointing_at_a_map_says_where_and_how_high(open_page, screenshots):
    page = open_page(REPORT, 1440)
    plot = drawn(page, '[data-map="height"]').first
    point_at(page, plot, 0.5, 0.5)
    said = plot.locator(".hoverlayer")
    expect(said).to_contain_text("height")
    found = re.search(r"theta (.+)°, z (.+) mm.*height (.+) mm", said.text_content())
    theta, z, height = (float(part.replace("\u2212", "-")) for part in found.groups())
    assert abs(theta) < 2
    assert abs(z) < 2
    assert min(abs(height - 8), abs(height - 1)) < 0.3
    page.screenshot(path=screenshots / "hover.png")


def test_pointing_at_wear_says_how_sure_it_is(open_page):
    page = open_page(REPORT, 1440)
    plot = drawn(page, '[data-map="wear"]').first
    found = None
    for share in np.linspace(0.1, 0.9, 9):
        point_at(page, plot, share, 0.85)
        # Over a slot there is no wear, and no text to wait for.
        page.wait_for_timeout(300)
        text = plot.locator(".hoverlayer").text_content()
        found = None if "not detected" in text else re.search(r"wear (.+) \u00b1 (.+) mm", text)
        if found:
            break
    wear, std = (float(part) for part in found.groups())
    assert wear >= 2 * std
    assert wear == pytest.approx(0.2, abs=0.1)


def test_the_slider_and_a_click_pick_the_angle_of_the_sections(open_page, screenshots):
    page = open_page(REPORT, 1440)
    sections = drawn(page, '[data-plot="sections"]').first
    number = page.locator("input[type=number][data-picker]")
    middle = "box => Array.from(box.data[0].y).slice(40, 60)"
    heights = {}
    for theta in ("-60", "45.5"):
        number.fill(theta)
        heights[theta] = sections.evaluate(middle)
        assert page.locator("input[type=range][data-picker]").input_value() == f"{float(theta):g}"
    assert heights["-60"] != heights["45.5"]
    assert len(sections.evaluate("box => box.data.map(t => t.name)")) == 3
    sections.screenshot(path=screenshots / "sections.png")
    plot = drawn(page, '[data-map="height"]').first
    x, y = point_at(page, plot, 0.25, 0.5)
    page.mouse.click(x, y)
    assert eventually(page, lambda: abs(float(number.input_value()) + 90) < 2)


def test_the_section_is_the_map_at_that_angle(open_page):
    page = open_page(REPORT, 1440)
    sections = drawn(page, '[data-plot="sections"]').first
    page.locator("input[type=number][data-picker]").fill("30")
    row = page.evaluate(
        "Array.from(asRows(page.layers[1], page.layers[1].height),"
        " r => r[nearestRow(page.layers[1], 30)])"
    )
    shown = sections.evaluate("box => Array.from(box.data[1].y)")
    np.testing.assert_allclose(np.array(shown, float), np.array(row, float), equal_nan=True)


def test_the_tread_turns_with_the_mouse(open_page, screenshots):
    page = open_page(REPORT, 1440)
    surface = drawn(page, '[data-plot="surface"]').first
    camera = "box => box._fullLayout.scene._scene.getCamera().eye"
    before, picture = surface.evaluate(camera), pixels(surface)
    area = surface.bounding_box()
    x, y = area["x"] + area["width"] / 2, area["y"] + area["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 150, y + 40, steps=5)
    page.mouse.up()
    after = surface.evaluate(camera)
    assert max(abs(before[k] - after[k]) for k in "xyz") > 0.1

    # The tread, not only its axes: a tenth of the picture changes.
    def is_turned():
        return (np.abs(pixels(surface) - picture).max(axis=2) > 30).mean() > 0.1

    assert eventually(page, is_turned)
    surface.screenshot(path=screenshots / "surface.png")


def test_the_surface_can_show_wear(open_page):
    page = open_page(REPORT, 1440)
    surface = drawn(page, '[data-plot="surface"]').first
    page.locator("#surface-choice").select_option(label="b, 200 mi: wear")
    colours = "box => Array.from(box.data[0].surfacecolor[5]).filter(Number.isFinite)"
    assert eventually(page, lambda: abs(np.median(surface.evaluate(colours)) - 0.2) < 0.05)


def test_another_capture_can_be_chosen_around_the_turn(open_page):
    page = open_page(REPORT, 1440)
    plots = drawn(page, '[data-plot="chart"]')
    polar = plots.first
    first = polar.evaluate("box => box.data.map(t => t.meta)")
    page.locator("select[data-choice]").select_option("b, 200 mi")
    assert set(first) == {"c, 200 mi"}
    assert set(polar.evaluate("box => box.data.map(t => t.meta)")) == {"b, 200 mi"}


@pytest.mark.parametrize("width", WIDTHS)
def test_the_archive_page_leads_to_the_report(open_page, screenshots, width):
    page = open_page("index.html", width)
    page.screenshot(path=screenshots / f"index-{width}.png")
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    assert page.locator(".card img").evaluate("image => image.naturalWidth") > 50
    page.locator(".card a").click()
    expect(page.locator("h1")).to_have_text("Tire t")


def test_a_script_that_is_not_the_pages_own_never_runs(chromium, worn_tire):
    page = chromium.new_page()
    page.goto((worn_tire / REPORT).as_uri())
    page.evaluate(
        "const s = document.createElement('script'); s.textContent = 'window.taken = 1';"
        " document.body.append(s);"
    )
    assert page.evaluate("window.taken === undefined")
    page.close()


def pixels(locator):
    return np.asarray(Image.open(io.BytesIO(locator.screenshot())).convert("RGB")).astype(int)


SCRIPT = "<script>window.taken = 1</script><img src=x onerror='window.taken = 2'>"


@pytest.fixture(scope="module")
def hostile(worn_tire, tmp_path_factory):
    """Pages of a tire whose id, size and serial are scripts, past the check that refuses such."""
    results = tmp_path_factory.mktemp("hostile") / "results"
    shutil.copytree(worn_tire, results)
    state = json.loads((results / "archive.json").read_text())
    state["tires"] = {SCRIPT: state["tires"]["t"]}
    state["refused"] = {"d": f"d/capture.yaml: tire.id is {SCRIPT!r}. Use letters and digits."}
    state["warnings"] = {"a": SCRIPT}
    (results / "archive.json").write_text(json.dumps(state))
    captures = [results / "captures" / name for name in "abc"]
    tire = results / "tires/t"
    report = ["report", SCRIPT, "--wear", tire / "wear.zarr", "--trend", tire / "trend.csv"]
    report += ["--profiles", *(path / "profile.zarr" for path in captures)]
    report += ["--quality", *(path / "quality.json" for path in captures)]
    report += ["--calibrations", SCRIPT, SCRIPT, SCRIPT]
    report += ["--facts", json.dumps({"size": SCRIPT, "serial": SCRIPT})]
    report += ["--out", tire / "report.html"]
    index = ["index", "--results", results, "--archive-state", results / "archive.json"]
    index += ["--out", results / "index.html", "--products", results / "products.json"]
    for command in (report, index):
        assert main([str(part) for part in command]) == 0
    return results


@pytest.mark.parametrize("path", ["index.html", REPORT])
def test_a_tire_id_that_is_a_script_shows_as_text(chromium, hostile, path):
    # With the pages' own policy switched off: escaping alone must hold.
    page = chromium.new_context(offline=True, bypass_csp=True).new_page()
    page.goto((hostile / path).as_uri())
    drawn(page, "[data-plot]")
    assert SCRIPT in page.locator("body").inner_text()
    assert page.evaluate("window.taken === undefined")
    assert page.locator("img[src=x]").count() == 0
    assert "window.taken" not in "".join(page.locator("script:not([type])").all_text_contents())
    page.close()
