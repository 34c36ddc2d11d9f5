"""A tire's report as one HTML page: verdict and warnings first, then what moves, then tables."""

import importlib.resources
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

from plotly.offline import get_plotlyjs

from treadlight.report import html
from treadlight.report.charts import NOT_DETECTED, Chart, line_style
from treadlight.report.layers import Layer, colour_scale, layer_data
from treadlight.report.tables import (
    IrregularWear,
    RibRunout,
    irregular_table,
    quality_table,
    repeat_table,
    runout_table,
    trend_table,
)

_MAP_PX = 300
_LINES = 16


@dataclass(frozen=True)
class CaptureFacts:
    """One capture of the tire.

    Attributes
    ----------
    id, captured_at, rig, calibration : str
        `calibration` is empty where it is not known.
    mileage : str
        With its unit.
    quality : dict
        quality.json.
    refused : str or None
        Why there is no profile.
    """

    id: str
    mileage: str
    captured_at: str
    rig: str
    calibration: str
    quality: dict[str, Any]
    refused: str | None


@dataclass(frozen=True)
class TirePage:
    """What the page of a tire shows.

    Attributes
    ----------
    tire : str
    facts : list of (name, value)
        Of the tire, beside its captures'.
    verdict : str
        One sentence; empty = none.
    captures : list of CaptureFacts
        In order of mileage.
    wear_refused : str or None
    warnings : list of str
        Beside those in the captures' quality.
    layers : list of Layer
        Maps of the usable captures.
    radius_mm : float
        Of the tread, by which degrees become mm.
    trend : list of dict
        Rows of trend.csv.
    charts : list of Chart
        Wear around the turn and over mileage.
    irregular : list of IrregularWear
    irregular_notes : list of str
        What its figures stand on.
    runout : list of RibRunout
    void_ratio : list of (capture, share, standard uncertainty)
    repeats : list of (mileage, region, captures, spread mm, standard uncertainty mm)
    quality_charts, calibration_charts : list of Chart
    """

    tire: str
    facts: list[tuple[str, str]]
    verdict: str
    captures: list[CaptureFacts]
    wear_refused: str | None
    warnings: list[str]
    layers: list[Layer] = field(default_factory=list)
    radius_mm: float = float("nan")
    trend: list[dict[str, str]] = field(default_factory=list)
    charts: list[Chart] = field(default_factory=list)
    irregular: list[IrregularWear] = field(default_factory=list)
    irregular_notes: list[str] = field(default_factory=list)
    runout: list[RibRunout] = field(default_factory=list)
    void_ratio: list[tuple[str, float, float]] = field(default_factory=list)
    repeats: list[tuple[str, str, int, float, float]] = field(default_factory=list)
    quality_charts: list[Chart] = field(default_factory=list)
    calibration_charts: list[Chart] = field(default_factory=list)


@dataclass(frozen=True)
class _Section:
    title: str
    anchor: str
    pieces: list[str]


def tire_page(content: TirePage) -> str:
    """The document's text; everything in it is escaped."""
    charts = [*content.charts, *content.quality_charts, *content.calibration_charts]
    sections = [s for s in _sections(content, charts) if s.pieces]
    body = [html.heading(1, f"Tire {content.tire}")]
    if content.verdict:
        body.append(html.paragraph(content.verdict, "verdict"))
    body += _notices(content)
    body += [html.facts(_head(content)), html.links([(s.title, s.anchor) for s in sections])]
    for section in sections:
        body += [html.heading(2, section.title, section.anchor), *section.pieces]
    if not (content.layers or charts):
        return html.page(f"Tire {content.tire}", body)
    body.append(html.data("page-data", _data(content, charts)))
    return html.page(f"Tire {content.tire}", body, [get_plotlyjs(), _own_script()])


def _sections(content: TirePage, charts: list[Chart]) -> list[_Section]:
    usable = [c for c in content.captures if not c.refused and c.quality]
    quality = [quality_table([(c.id, c.quality) for c in usable])] if usable else []
    return [
        _Section("Height", "height", _height(content.layers)),
        _Section("Wear", "wear", _wear(content.layers)),
        _Section("Cross-sections", "cross-sections", _cross_sections(content.layers)),
        _Section("Three dimensions", "three-dimensions", _surface(content.layers)),
        _Section("Around the turn and over mileage", "trend", _drawn(content.charts, charts)),
        _Section("Ribs and grooves", "ribs-and-grooves", _trend(content.trend)),
        _Section("Irregular wear", "irregular-wear", _irregular(content)),
        _Section("Runout and void ratio", "runout", _runout(content)),
        _Section("Repeatability", "repeatability", _repeats(content)),
        _Section("Captures", "captures", [_captures(content.captures)]),
        _Section("Quality", "quality", [*quality, *_drawn(content.quality_charts, charts)]),
        _Section("Calibration", "calibration", _drawn(content.calibration_charts, charts)),
    ]


def _own_script() -> str:
    source = importlib.resources.files("treadlight.report") / "report.js"
    return source.read_text(encoding="utf-8")


def _data(content: TirePage, charts: Iterable[Chart]) -> dict[str, Any]:
    layers = content.layers
    wear = [layer.wear for layer in layers if layer.wear is not None]
    scales = {
        # From the floors up; shoulders fall far below them and would take most of the colours.
        "height": colour_scale([layer.height for layer in layers], "viridis", 99.5),
        # Below nil is no wear, and what is not detected has its own colour.
        "wear": colour_scale(wear, "plasma", 98),
    }
    return {
        "layers": [layer_data(layer) for layer in layers],
        "radius_mm": content.radius_mm if layers else None,
        "scales": scales,
        "undetected": NOT_DETECTED,
        "lines": [line_style(number) for number in range(_LINES)],
        "charts": [{"data": chart.data, "layout": chart.layout} for chart in charts],
    }


def _head(content: TirePage) -> list[tuple[str, str]]:
    pairs = [*content.facts, ("Captures", str(len(content.captures)))]
    mileages = [c.mileage for c in content.captures if c.mileage]
    if mileages:
        pairs.append(("Mileages", ", ".join(mileages)))
    for name, values in (
        ("Rig", [c.rig for c in content.captures]),
        ("Calibration", [c.calibration for c in content.captures]),
    ):
        if any(values):
            pairs.append((name, ", ".join(sorted(set(filter(None, values))))))
    return pairs


def _notices(content: TirePage) -> list[str]:
    refused = [f"{c.id} was refused: {c.refused}" for c in content.captures if c.refused]
    if content.wear_refused:
        refused.append(f"There is no wear: {content.wear_refused}")
    warnings = [
        f"{capture.id}: {sentence}"
        for capture in content.captures
        for sentence in capture.quality.get("warnings") or ()
    ]
    return html.notices(refused, "bad") + html.notices([*content.warnings, *warnings], "warn")


def _height(layers: Sequence[Layer]) -> list[str]:
    if not layers:
        return []
    note = (
        "Height over the groove reference, in the first capture's frame where there is wear; white"
        " where nothing was measured. Drag to zoom, double-click to zoom out, click to pick the"
        " angle of the cross-sections."
    )
    return [*_maps(layers, "height"), html.caption(note)]


def _wear(layers: Sequence[Layer]) -> list[str]:
    drawn = _maps(layers, "wear")
    if not drawn:
        return []
    note = (
        f"Radial loss since {layers[0].title}. Grey: not detected, below two standard"
        " uncertainties of the cell; white: not measured, or a wall. One colour scale for all"
        " mileages."
    )
    return [*drawn, html.caption(note)]


def _maps(layers: Sequence[Layer], kind: str) -> list[str]:
    pieces = []
    for number, layer in enumerate(layers):
        if kind == "height" or layer.wear is not None:
            pieces.append(html.heading(3, layer.title))
            pieces.append(html.plot("map", _MAP_PX, layer=number, map=kind))
    return pieces


def _cross_sections(layers: Sequence[Layer]) -> list[str]:
    if not layers:
        return []
    first, step = layers[0].theta_deg
    last = first + step * (len(layers[0].height) - 1)
    note = "Height at this angle, each mileage over the other; missing where not measured."
    return [
        html.picker("theta (\u00b0)", first, last, 0.1),
        html.plot("sections", 360),
        html.caption(note),
    ]


def _surface(layers: Sequence[Layer]) -> list[str]:
    if not layers:
        return []
    options = [(f"{k} height", f"{layer.title}: height") for k, layer in enumerate(layers)]
    options += [
        (f"{k} wear", f"{layer.title}: wear")
        for k, layer in enumerate(layers)
        if layer.wear is not None
    ]
    return [
        html.choice("Show", options, 'id="surface-choice"'),
        html.plot("surface", 560),
        html.caption("Drag to turn, scroll to zoom, right-drag to move. Every n-th cell is drawn."),
    ]


def _drawn(shown: Sequence[Chart], all_: Sequence[Chart]) -> list[str]:
    pieces = []
    for chart in shown:
        number = next(k for k, other in enumerate(all_) if other is chart)
        plot = html.plot("chart", chart.height_px, chart=number)
        if chart.choices:
            options = [(name, name) for name in reversed(chart.choices)]
            plot = html.choice("Show", options, "data-choice") + plot
        pieces += [
            html.heading(3, chart.title),
            f"<figure>{plot}{html.caption(chart.caption)}</figure>",
        ]
    return pieces


def _trend(rows: Sequence[dict[str, str]]) -> list[str]:
    if not rows:
        return []
    note = (
        "Depth is measured against the groove reference, wear against the first capture;"
        " \u00b1 is one standard uncertainty of the mean. CV is the coefficient of variation of"
        " the depth, the index of irregularity. A rate is valid (ASTM F1016) with three"
        " intervals or more and R\u00b2 of at least 0.95; wear below two standard"
        " uncertainties is not detected."
    )
    return [trend_table(rows), html.caption(note)]


def _irregular(content: TirePage) -> list[str]:
    if not content.irregular:
        return []
    return [
        irregular_table(content.irregular),
        *(html.caption(note) for note in content.irregular_notes),
    ]


def _runout(content: TirePage) -> list[str]:
    pieces = [runout_table(content.runout)] if content.runout else []
    if content.runout:
        pieces.append(
            html.caption(
                "Amplitudes of the radial harmonics of each rib's tops about the rig's axis. The"
                " first holds how the tire sat on the hub, too. They need a whole turn."
            )
        )
    rows = [
        [name, f"{html.number(100 * share, 2)} \u00b1 {html.number(100 * std, 2)}\u202f%"]
        for name, share, std in content.void_ratio
    ]
    if rows:
        pieces.append(html.table(["Capture", "Void ratio"], rows))
        pieces.append(
            html.caption("Area of grooves, slots and sipes over the area of the whole tread.")
        )
    return pieces


def _repeats(content: TirePage) -> list[str]:
    if not content.repeats:
        return []
    note = (
        "Captures of one mileage: standard deviation of their mean depths beside the standard"
        " uncertainty that each claims."
    )
    return [repeat_table(content.repeats), html.caption(note)]


def _captures(captures: Sequence[CaptureFacts]) -> str:
    head = ["Capture", "Mileage", "Taken", "Rig", "Calibration", "State"]
    return html.table(
        head,
        [
            [c.id, c.mileage, c.captured_at, c.rig, c.calibration, c.refused or "measured"]
            for c in captures
        ],
    )
