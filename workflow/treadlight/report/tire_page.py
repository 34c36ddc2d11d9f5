"""A tire's report as one HTML page."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from treadlight.report import html

_STATUS = {
    "first": "first capture",
    "valid": "valid (ASTM F1016)",
    "indicative": "indicative",
    "not_detected": "not detected",
}


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
    tire, size : str
    nominal_radius_mm : float or None
    captures : list of CaptureFacts
        In order of mileage.
    wear_refused : str or None
    warnings : list of str
        Beside those in the captures' quality.
    trend : list of dict
        Rows of trend.csv.
    figures, calibration_figures : list of (png, alt, caption)
    """

    tire: str
    size: str
    nominal_radius_mm: float | None
    captures: list[CaptureFacts]
    wear_refused: str | None
    warnings: list[str]
    trend: list[dict[str, str]]
    figures: list[tuple[bytes, str, str]] = field(default_factory=list)
    calibration_figures: list[tuple[bytes, str, str]] = field(default_factory=list)


def tire_page(content: TirePage) -> str:
    """The document's text; everything in it is escaped."""
    body = [html.heading(1, f"Tire {content.tire}"), _head(content)]
    body += _notices(content)
    body += [html.heading(2, "Captures"), _captures(content.captures)]
    if content.figures:
        body.append(html.heading(2, "Profile and wear"))
        body += [html.image(*figure) for figure in content.figures]
    if content.trend:
        body += [html.heading(2, "Ribs and grooves"), _trend(content.trend)]
        body.append(
            html.paragraph(
                "Depth is measured against the groove reference, wear against the first capture;"
                " \u00b1 is one standard uncertainty of the mean. A rate is valid with three"
                " intervals or more and R\u00b2 of at least 0.95; wear below two standard"
                " uncertainties is not detected."
            )
        )
    usable = [c for c in content.captures if not c.refused and "refused" not in c.quality]
    if usable:
        body += [html.heading(2, "Quality"), _quality(usable)]
    if content.calibration_figures:
        body.append(html.heading(2, "Calibration of the LEDs"))
        body += [html.image(*figure) for figure in content.calibration_figures]
    return html.page(f"Tire {content.tire}", body)


def _head(content: TirePage) -> str:
    pairs = [("Captures", str(len(content.captures)))]
    if content.size:
        pairs.insert(0, ("Size", content.size))
    if content.nominal_radius_mm is not None:
        pairs.append(("Nominal radius", html.number(content.nominal_radius_mm, 1, "mm")))
    mileages = [c.mileage for c in content.captures if c.mileage]
    if mileages:
        pairs.append(("Mileages", ", ".join(mileages)))
    calibrations = sorted({c.calibration for c in content.captures if c.calibration})
    if calibrations:
        pairs.append(("Calibration", ", ".join(calibrations)))
    return html.facts(pairs)


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


def _captures(captures: Sequence[CaptureFacts]) -> str:
    head = ["Capture", "Mileage", "Taken", "Rig", "Calibration", "State"]
    return html.table(
        head,
        [
            [c.id, c.mileage, c.captured_at, c.rig, c.calibration, c.refused or "measured"]
            for c in captures
        ],
    )


def _trend(rows: Sequence[dict[str, str]]) -> str:
    head = [
        "Region",
        "Mileage",
        "Depth mm",
        "5 to 95 % mm",
        "Wear \u00b5m",
        "5 to 95 % \u00b5m",
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

    def interval(low: str, high: str, digits: int, factor: float = 1.0) -> str:
        ends = value(low, digits, factor), value(high, digits, factor)
        return ends[0] if ends[0] == ends[1] else f"{ends[0]} to {ends[1]}"

    projected = value("projected_mileage", 0)
    if row.get("projected_low") or row.get("projected_high"):
        projected += f" ({interval('projected_low', 'projected_high', 0)})"
    return [
        row["region"],
        f"{value('mileage', 0)} {row.get('unit', '')}",
        f"{value('depth_mm', 3)} \u00b1 {value('depth_std_mm', 3)}",
        interval("depth_p05_mm", "depth_p95_mm", 2),
        f"{value('wear_mm', 1, 1000)} \u00b1 {value('wear_std_mm', 1, 1000)}",
        interval("wear_p05_mm", "wear_p95_mm", 0, 1000),
        value("rate_mm_per_1000km", 3),
        value("rate_mils_per_1000mi", 2),
        value("rate_r2", 3),
        projected,
        _STATUS.get(row.get("status", ""), row.get("status", "")),
    ]


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


def _quality(captures: Sequence[CaptureFacts]) -> str:
    rows = [
        [name, *(_figure(c.quality, path, shown) for c in captures)]
        for name, path, shown in _QUALITY
    ]
    flags = sorted({name for c in captures for name in c.quality.get("flags") or {}})
    rows += [
        [
            f"Cells: {name}",
            *(html.percent((c.quality.get("flags") or {}).get(name)) for c in captures),
        ]
        for name in flags
    ]
    return html.table(["Figure", *(c.id for c in captures)], rows)


def _figure(quality: dict[str, Any], path: tuple[str, ...], shown: int | str) -> str:
    value: Any = quality
    for name in path:
        value = value.get(name) if isinstance(value, dict) else None
    return html.percent(value) if isinstance(shown, str) else html.number(value, shown)
