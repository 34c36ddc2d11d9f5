"""Plotly charts as plain dicts; the same arrays give the same text."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

# Okabe and Ito's colours, told apart by colour-blind eyes; dashes tell more than eight.
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#7f7f7f")
DASHES = ("solid", "dash", "dot")
NOT_DETECTED = "#c8c8c8"
_LEGEND = {"orientation": "h", "y": 1.03, "yanchor": "bottom", "x": 0}
_MARGIN = {"l": 60, "r": 15, "t": 15, "b": 50}


@dataclass(frozen=True)
class Chart:
    """A Plotly figure with what stands around it.

    Attributes
    ----------
    title, caption : str
    data : list of dict
        Plotly's traces; `meta` holds the choice that a trace belongs to.
    layout : dict
    height_px : int
    choices : list of str
        What the reader chooses from; empty = everything is shown.
    """

    title: str
    caption: str
    data: list[dict[str, Any]]
    layout: dict[str, Any]
    height_px: int = 340
    choices: tuple[str, ...] = ()


@dataclass(frozen=True)
class RegionTrend:
    """Wear of one region over mileage.

    Attributes
    ----------
    name : str
    mileage, wear_mm, std_mm : (n,) float
    detected : (n,) bool
        Two standard uncertainties or more (the first capture counts as detected: it is nil).
    line : (x, y, half width) or None
        Regression and its 95 % prediction interval, arrays (k,).
    """

    name: str
    mileage: np.ndarray
    wear_mm: np.ndarray
    std_mm: np.ndarray
    detected: np.ndarray
    line: tuple[np.ndarray, np.ndarray, np.ndarray] | None


def line_style(number: int) -> dict[str, str]:
    """Colour and dash of the k-th curve."""
    count = len(COLOURS)
    return {"color": COLOURS[number % count], "dash": DASHES[number // count % len(DASHES)]}


def trend_chart(regions: Sequence[RegionTrend], unit: str) -> Chart:
    """Wear over mileage with regression lines; undetected wear is an upper limit, not a point."""
    data: list[dict[str, Any]] = []
    for number, region in enumerate(regions):
        style = line_style(number)
        if region.line is not None:
            data += _line_and_band(region, style, banded=number == 0)
        data.append(_points(region, style))
    limits = [
        (region, k) for region in regions for k in np.flatnonzero(~region.detected & ~_gap(region))
    ]
    if limits:
        data.append(
            {
                **_scatter("not detected, below", [r.mileage[k] for r, k in limits]),
                "y": numbers([2 * r.std_mm[k] for r, k in limits]),
                "mode": "markers",
                "marker": {"symbol": "triangle-down-open", "color": "#777", "size": 9},
                "text": [r.name for r, _ in limits],
                "hovertemplate": f"%{{text}}, %{{x}} {unit}<br>not detected, below %{{y:.3f}} mm"
                "<extra></extra>",
            }
        )
    layout = axes(f"mileage ({unit})", "wear since the first capture (mm)")
    return Chart(
        "Wear over mileage",
        "Bars are two standard uncertainties; lines are least squares as in ASTM F1016; the band"
        " is the 95 % prediction interval of a further capture's mean wear of the tread. Wear"
        " below two standard uncertainties is shown as its upper limit only.",
        data,
        layout,
    )


def _gap(region: RegionTrend) -> np.ndarray:
    return ~np.isfinite(region.wear_mm)


def _points(region: RegionTrend, style: dict[str, str]) -> dict[str, Any]:
    shown = region.detected & ~_gap(region)
    return {
        **_scatter(region.name, region.mileage[shown]),
        "y": numbers(region.wear_mm[shown]),
        "mode": "markers",
        "legendgroup": region.name,
        "marker": {"color": style["color"], "size": 7},
        "error_y": {"type": "data", "array": numbers(2 * region.std_mm[shown]), "thickness": 1},
        "hovertemplate": f"{region.name}, %{{x}}<br>wear %{{y:.3f}} mm<extra></extra>",
    }


def _line_and_band(region: RegionTrend, style: dict[str, str], banded: bool) -> list[dict]:
    assert region.line is not None
    x, y, half = region.line
    line = {
        **_scatter(region.name, x),
        "y": numbers(y),
        "mode": "lines",
        "legendgroup": region.name,
        "showlegend": False,
        "hoverinfo": "skip",
        "line": {**style, "width": 1.4},
    }
    if not banded:
        return [line]
    band = {
        **_scatter("95 % prediction, " + region.name, np.concatenate([x, x[::-1]])),
        "y": numbers(np.concatenate([y + half, (y - half)[::-1]])),
        "mode": "lines",
        "fill": "toself",
        "fillcolor": _faint(style["color"]),
        "line": {"width": 0},
        "hoverinfo": "skip",
    }
    return [band, line]


def _faint(colour: str) -> str:
    red, green, blue = (int(colour[k : k + 2], 16) for k in (1, 3, 5))
    return f"rgba({red},{green},{blue},0.15)"


@dataclass(frozen=True)
class Projection:
    """When a region reaches the wear limit.

    Attributes
    ----------
    name : str
    mileage, depth_mm, std_mm : (n,) float
    middle, low, high : float
        Mileage at the limit and its interval; NaN = not known.
    """

    name: str
    mileage: np.ndarray
    depth_mm: np.ndarray
    std_mm: np.ndarray
    middle: float
    low: float
    high: float


def projection_chart(regions: Sequence[Projection], limit_mm: float, unit: str) -> Chart:
    """Depth over mileage down to the wear limit."""
    data: list[dict[str, Any]] = []
    for number, region in enumerate(regions):
        colour = COLOURS[number]
        known = np.isfinite(region.depth_mm)
        data.append(
            {
                **_scatter(region.name, region.mileage[known]),
                "y": numbers(region.depth_mm[known]),
                "mode": "markers",
                "marker": {"color": colour, "size": 7},
                "error_y": {
                    "type": "data",
                    "array": numbers(2 * region.std_mm[known]),
                    "thickness": 1,
                },
                "hovertemplate": f"{region.name}, %{{x}} {unit}<br>depth %{{y:.3f}} mm"
                "<extra></extra>",
            }
        )
        if np.isfinite(region.middle) and known.any():
            last = np.flatnonzero(known)[-1]
            plus = region.high - region.middle if np.isfinite(region.high) else 0.0
            data.append(
                {
                    **_scatter(region.name, [region.mileage[last], region.middle]),
                    "y": numbers([region.depth_mm[last], limit_mm]),
                    "mode": "lines+markers",
                    "showlegend": False,
                    "line": {"color": colour, "dash": "dot", "width": 1.4},
                    "marker": {"symbol": ["circle", "diamond"], "color": colour, "size": [1, 9]},
                    "error_x": {
                        "type": "data",
                        "symmetric": False,
                        "array": numbers([0, plus]),
                        "arrayminus": numbers([0, region.middle - region.low]),
                        "thickness": 1.4,
                    },
                    "hovertemplate": f"{region.name}: {limit_mm:g} mm at %{{x:.0f}} {unit}"
                    "<extra></extra>",
                }
            )
    layout = axes(f"mileage ({unit})", "tread depth (mm)")
    layout["yaxis"]["rangemode"] = "tozero"
    layout["shapes"] = [
        {
            "type": "line",
            "xref": "paper",
            "x0": 0,
            "x1": 1,
            "y0": limit_mm,
            "y1": limit_mm,
            "line": {"color": "#777", "width": 1, "dash": "dash"},
        }
    ]
    return Chart(
        "Projection to the wear limit",
        f"The dashed line is the limit of {limit_mm:g} mm. Horizontal bars run from the earliest"
        " to the latest mileage within two standard uncertainties of depth and rate; a bar"
        " without a right end has none.",
        data,
        layout,
    )


def polar_chart(
    captures: Sequence[tuple[str, np.ndarray, dict[str, tuple[np.ndarray, np.ndarray]]]],
) -> Chart:
    """Wear of every rib around the turn.

    Parameters
    ----------
    captures : sequence of (title, theta_deg, {rib: (wear_mm, detected)})
        Arrays (n,); wear that is not detected is left out of the curve.
    """
    data = []
    shown_values = [np.zeros(1)]
    for title, theta, ribs in captures:
        for number, (rib, (wear, detected)) in enumerate(ribs.items()):
            shown = np.where(detected, wear, np.nan)
            shown_values.append(shown[np.isfinite(shown)])
            data.append(
                {
                    "type": "scatterpolar",
                    "name": rib,
                    "mode": "lines+markers",
                    "meta": title,
                    "theta": numbers(theta),
                    "r": numbers(shown),
                    "line": {**line_style(number), "width": 1.4},
                    "marker": {"color": line_style(number)["color"], "size": 3},
                    "connectgaps": False,
                    "hovertemplate": f"{rib}, theta %{{theta:.0f}}°<br>wear %{{r:.3f}} mm"
                    "<extra></extra>",
                }
            )
    top = float(np.percentile(np.concatenate(shown_values), 99))
    layout = {
        "polar": {
            "angularaxis": {"ticksuffix": "°", "direction": "counterclockwise"},
            "radialaxis": {
                "ticksuffix": " mm",
                "nticks": 4,
                "range": [0, round(1.15 * top, 3) or 0.1],
                "angle": 45,
                "tickangle": 45,
            },
        },
        "legend": {**_LEGEND, "y": 1.1},
        "margin": {"l": 40, "r": 40, "t": 20, "b": 40},
    }
    return Chart(
        "Rib wear around the turn",
        "Means over 2 degrees of each rib's tops. What is below two standard uncertainties of"
        " its cells, or not measured, is a gap; one value in a hundred may lie outside.",
        data,
        layout,
        460,
        tuple(title for title, _, _ in captures),
    )


def box_chart(groups: Sequence[tuple[str, np.ndarray, np.ndarray]], title: str, caption: str):
    """Distances of rays from each LED as boxes; rejected ones are crosses.

    Parameters
    ----------
    groups : sequence of (name, values, rejected)
        mm, (n,) and (m,); rejected ones beyond the rest stand at the upper border.
    """
    values = np.concatenate([values for _, values, _ in groups])
    top = 1.1 * float(values.max(initial=0.0)) or 1.0
    boxes = [
        {
            "type": "box",
            "name": name,
            "y": numbers(values),
            "boxpoints": "outliers",
            "marker": {"color": COLOURS[0], "size": 4},
            "line": {"width": 1},
            "showlegend": False,
        }
        for name, values, _ in groups
    ]
    crosses = [(name, value) for name, _, rejected in groups for value in rejected]
    if crosses:
        boxes.append(
            {
                **_scatter("rejected", []),
                "x": [name for name, _ in crosses],
                "y": numbers([min(value, top) for _, value in crosses]),
                "mode": "markers",
                "marker": {"symbol": "x", "color": COLOURS[1], "size": 7},
                "customdata": numbers([value for _, value in crosses]),
                "hovertemplate": "LED %{x}: %{customdata:.2f} mm, rejected<extra></extra>",
            }
        )
    layout = axes("LED", "distance (mm)")
    layout["xaxis"]["type"] = "category"
    layout["yaxis"]["range"] = [0, round(1.02 * top, 4)]
    return Chart(title, caption, boxes, layout, 300)


def histogram_chart(edges: np.ndarray, counts: np.ndarray, x: str, title: str, caption: str):
    """Counts between edges (k + 1,)."""
    middle, width = 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)
    bars = {
        "type": "bar",
        "x": numbers(middle),
        "y": numbers(counts),
        "width": numbers(width),
        "marker": {"color": COLOURS[0]},
        "hovertemplate": "%{x:.3f}: %{y}<extra></extra>",
    }
    return Chart(title, caption, [bars], {**axes(x, "number of points"), "bargap": 0}, 280)


def residual_chart(residual_px: np.ndarray, title: str, caption: str) -> Chart:
    """Reprojection residuals (n, 2) in u and v, with equal axes."""
    points = {
        **_scatter("corners", residual_px[:, 0]),
        "y": numbers(residual_px[:, 1]),
        "mode": "markers",
        "marker": {"color": COLOURS[0], "size": 3, "opacity": 0.5},
        "hovertemplate": "u %{x:.4f} px, v %{y:.4f} px<extra></extra>",
    }
    layout = axes("residual in u (px)", "residual in v (px)")
    layout["yaxis"]["scaleanchor"] = "x"
    return Chart(title, caption, [points], layout, 380)


def share_chart(captures: Sequence[tuple[str, dict[str, float]]]) -> Chart:
    """Share of cells per quality flag, one bar per capture and flag."""
    flags = list(dict.fromkeys(name for _, shares in captures for name in shares))
    bars = [
        {
            "type": "bar",
            "name": title,
            "x": flags,
            "y": numbers([100 * shares.get(flag, 0.0) for flag in flags]),
            "marker": {"color": COLOURS[number % len(COLOURS)]},
            "hovertemplate": f"{title}, %{{x}}: %{{y:.1f}} %<extra></extra>",
        }
        for number, (title, shares) in enumerate(captures)
    ]
    layout = {**axes("quality flag", "share of the cells (%)"), "barmode": "group"}
    return Chart(
        "Quality flags",
        "A cell may carry several flags; what they mean stands in the store's variable 'quality'.",
        bars,
        layout,
        300,
    )


def axes(x: str, y: str) -> dict[str, Any]:
    """A layout with named axes."""
    grid = {"gridcolor": "#e8e8e8", "zerolinecolor": "#bbb", "automargin": True}
    return {
        "xaxis": {"title": {"text": x}, **grid},
        "yaxis": {"title": {"text": y}, **grid},
        "plot_bgcolor": "#fff",
        "legend": dict(_LEGEND),
        "margin": dict(_MARGIN),
    }


def numbers(values: Any) -> list[float | None]:
    """Six significant digits; None where there is no number."""
    return [float(f"{v:.6g}") if np.isfinite(v) else None for v in np.asarray(values, float)]


def _scatter(name: str, x: Any) -> dict[str, Any]:
    return {"type": "scatter", "name": name, "x": numbers(x)}
