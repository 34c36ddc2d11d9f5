"""The tables of a tire's report."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from treadlight.report import html

_STATUS = {
    "first": "first capture",
    "valid": "valid (ASTM F1016)",
    "indicative": "indicative",
    "not_detected": "not detected",
}


@dataclass(frozen=True)
class IrregularWear:
    """One figure of irregular wear over the captures.

    Attributes
    ----------
    term, place, note : str
    values : list of (capture, value mm, standard uncertainty mm, word)
    """

    term: str
    place: str
    note: str
    values: list[tuple[str, float, float, str]]


@dataclass(frozen=True)
class RibRunout:
    """Radial harmonics of a rib in one capture; amplitudes (n,) mm of the orders 1..n."""

    capture: str
    rib: str
    amplitude_mm: np.ndarray
    std_mm: float
    peak_to_peak_mm: float


def trend_table(rows: Sequence[dict[str, str]]) -> str:
    """trend.csv, sorted by region, then mileage."""
    head = [
        "Region",
        "Capture",
        "Mileage",
        "Depth mm",
        "Least mm",
        "5 / 50 / 95 % mm",
        "CV %",
        "Wear \u00b5m",
        "5 / 50 / 95 % \u00b5m",
        "Rate mm/1000 km",
        "mils/1000 mi",
        "R\u00b2",
        "Projected mileage",
        "Status",
    ]
    order = list(dict.fromkeys(row["region"] for row in rows))
    ranked = sorted(rows, key=lambda row: order.index(row["region"]))
    return html.table(head, [_trend_row(row) for row in ranked])


def _trend_row(row: dict[str, str]) -> list[str]:
    def value(name: str, digits: int, factor: float = 1.0) -> str:
        cell = row.get(name) or ""
        return html.number(float(cell) * factor if cell else None, digits)

    def quantiles(of: str, digits: int, factor: float = 1.0) -> str:
        parts = [value(f"{of}_{share}_mm", digits, factor) for share in ("p05", "p50", "p95")]
        return parts[0] if len(set(parts)) == 1 else " / ".join(parts)

    projected = value("projected_mileage", 0)
    if row.get("projected_low") or row.get("projected_high"):
        projected += f" ({value('projected_low', 0)} to {value('projected_high', 0)})"
    return [
        row["region"],
        row.get("capture", ""),
        f"{value('mileage', 0)} {row.get('unit', '')}",
        f"{value('depth_mm', 3)} \u00b1 {value('depth_std_mm', 3)}",
        value("depth_min_mm", 2),
        quantiles("depth", 2),
        value("depth_cov", 2, 100),
        f"{value('wear_mm', 1, 1000)} \u00b1 {value('wear_std_mm', 1, 1000)}",
        quantiles("wear", 0, 1000),
        value("rate_mm_per_1000km", 3),
        value("rate_mils_per_1000mi", 2),
        value("rate_r2", 3),
        projected,
        _STATUS.get(row.get("status", ""), row.get("status", "")),
    ]


def irregular_table(rows: Sequence[IrregularWear]) -> str:
    """One row per term and place, two columns per capture."""
    captures = list(dict.fromkeys(name for row in rows for name, *_ in row.values))
    head = ["Wear", "Where", *(f"{name} \u00b5m" for name in captures), "Meaning"]
    return html.table(head, [_irregular_row(row, captures) for row in rows])


def _irregular_row(row: IrregularWear, captures: list[str]) -> list[str]:
    by_capture = {name: (value, std, word) for name, value, std, word in row.values}
    cells = []
    for name in captures:
        value, std, word = by_capture.get(name, (np.nan, np.nan, "not known"))
        known = np.isfinite(value)
        shown = f"{html.number(1000 * value, 0)} \u00b1 {html.number(1000 * std, 0)}: {word}"
        cells.append(shown if known else word)
    return [row.term, row.place, *cells, row.note]


def runout_table(rows: Sequence[RibRunout]) -> str:
    """Amplitudes per rib and order."""
    orders = max(len(row.amplitude_mm) for row in rows)
    numbers = [f"Order {k} \u00b5m" for k in range(1, orders + 1)]
    head = ["Capture", "Rib", *numbers, "\u00b1 \u00b5m", "Peak to peak \u00b5m"]
    return html.table(
        head,
        [
            [
                row.capture,
                row.rib,
                *(html.number(1000 * a, 0) for a in row.amplitude_mm),
                html.number(1000 * row.std_mm, 1),
                html.number(1000 * row.peak_to_peak_mm, 0),
            ]
            for row in rows
        ],
    )


def repeat_table(rows: Sequence[tuple[str, str, int, float, float]]) -> str:
    """Repeatability of mean depths."""
    head = ["Mileage", "Region", "Captures", "Standard deviation \u00b5m", "Claimed \u00b5m"]
    return html.table(
        head,
        [
            [
                mileage,
                region,
                str(count),
                html.number(1000 * spread, 1),
                html.number(1000 * claimed, 1),
            ]
            for mileage, region, count, spread, claimed in rows
        ],
    )


_QUALITY = (
    ("Coverage of the tread", ("coverage", "tread"), "%"),
    ("Coverage of the ribs", ("coverage", "rib"), "%"),
    ("Coverage of the grooves", ("coverage", "groove"), "%"),
    ("Laser points", ("laser_points",), 0),
    ("Held-out laser points", ("held_out_laser_mm", "n"), 0),
    ("Held-out bias (mm)", ("held_out_laser_mm", "bias"), 3),
    ("Held-out RMS (mm)", ("held_out_laser_mm", "rms"), 3),
    ("of it the laser's own (mm)", ("held_out_laser_mm", "laser_std"), 3),
    ("of it the surface's (mm)", ("held_out_laser_mm", "shape_rms"), 3),
    ("Frame, radial (mm)", ("frame_std", "radial_mm"), 3),
    ("Frame, axial (mm)", ("frame_std", "axial_mm"), 3),
    ("Frame, tilt (rad)", ("frame_std", "tilt_rad"), 5),
    ("Closure of the turn (mm)", ("closure_mm",), 3),
    ("Rerendering error, median", ("normal_residual", "median"), "%"),
    ("Rerendering error, 95 %", ("normal_residual", "p95"), "%"),
)


def quality_table(captures: Sequence[tuple[str, dict[str, Any]]]) -> str:
    """quality.json of each capture, (id, content)."""
    rows = [
        [name, *(_figure(q, path, shown) for _, q in captures)] for name, path, shown in _QUALITY
    ]
    flags = sorted({name for _, quality in captures for name in quality.get("flags") or {}})
    rows += [
        [f"Cells: {name}", *(html.percent((q.get("flags") or {}).get(name)) for _, q in captures)]
        for name in flags
    ]
    return html.table(["Figure", *(name for name, _ in captures)], rows)


def _figure(quality: dict[str, Any], path: tuple[str, ...], shown: int | str) -> str:
    value: Any = quality
    for name in path:
        value = value.get(name) if isinstance(value, dict) else None
    return html.percent(value) if isinstance(shown, str) else html.number(value, shown)
