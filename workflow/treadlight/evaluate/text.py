"""The figures as aligned tables for people."""

from collections.abc import Iterable, Sequence
from typing import Any

from treadlight.evaluate.budget import SOURCES

_CLASSES = ("top", "floor", "slot", "deep", "wall", "all")
_COLUMNS = ("bias_mm", "median_abs_mm", "rms_mm", "p95_mm")


def render(report: dict[str, Any]) -> str:
    """Text of a report of `treadlight evaluate` (see the command for its structure)."""
    lines: list[str] = []
    for name, figures in report["calibrations"].items():
        lines += [f"Calibration {name}", *_calibration(figures), ""]
    for name, figures in report["captures"].items():
        lines += [f"Capture {name}", *_capture(figures), ""]
    for tire, captures in report["wear"].items():
        for name, figures in captures.items():
            lines += [f"Wear of tire {tire} at {name}", *_wear(figures), ""]
    if not lines:
        lines = ["No capture of the archive carries a truth/ folder: nothing to compare.", ""]
    return "\n".join(lines)


def render_budget(report: dict[str, Any]) -> str:
    """Text of a report of `treadlight budget` (see the command for its structure)."""
    lines: list[str] = []
    for name, sources in report["captures"].items():
        lines += [f"Capture {name}", *_budget(sources), ""]
    for tire, captures in report["wear"].items():
        for name, sources in captures.items():
            lines += [f"Wear of tire {tire} at {name}", *_wear_budget(sources), ""]
    if not lines:
        lines = ["No capture with a truth/ folder has a profile: nothing to take apart.", ""]
    return "\n".join(lines)


def _budget(sources: dict[str, Any]) -> list[str]:
    parts = [(rows, name) for rows in ("all", "seen") for name in ("top", "floor")]
    head = ["median / rms um", *(f"{name}, {rows} rows" for rows, name in parts), "edges"]
    rows = [head]
    for source, figures in sources.items():
        cells = [figures[rows_of][name] for rows_of, name in parts]
        texts = [f"{_um(c['median_abs_mm'])} / {_um(c['rms_mm'])}" for c in cells]
        rows.append([SOURCES[source], *texts, _percent(figures["edges"])])
    return _table(rows, right=True)


def _wear_budget(sources: dict[str, Any]) -> list[str]:
    rows = [["", "mean error um", "5 mm cells rms um"]]
    for source, figures in sources.items():
        texts = [_um(figures[name]) for name in ("mean_error_mm", "block_rms_mm")]
        rows.append([SOURCES[source], *texts])
    return _table(rows, right=True)


def _calibration(figures: dict[str, Any]) -> list[str]:
    if "missing" in figures:
        return [f"  {figures['missing']}"]
    rows = []
    if camera := figures["camera"]:
        focal = f"fx {_signed(camera['fx_percent'])} %, fy {_signed(camera['fy_percent'])} %"
        centre = f"cx {_signed(camera['cx_px'])} px, cy {_signed(camera['cy_px'])} px"
        rows.append(("camera", f"{focal}, {centre}, rays {camera['ray_px']:.3f} px"))
    for part in ("laser_plane", "reference_plane"):
        if plane := figures[part]:
            text = f"{plane['angle_deg']:.4f} deg, {_signed(plane['offset_mm'])} mm"
            rows.append((part.replace("_", " "), text))
    if axis := figures["axis"]:
        line = f"{axis['line_mm']:.3f} mm from the line, {axis['foot_mm']:.3f} mm between the feet"
        rows.append(("axis", f"{axis['angle_deg']:.4f} deg, {line}"))
    if leds := figures["leds"]:
        text = f"mean {_number(leds['mean_mm'])} mm, largest {_number(leds['max_mm'])} mm"
        missing = f", missing {leds['missing']}" if leds["missing"] else ""
        rows.append(("LEDs", text + missing))
    absent = [n for n in ("laser_plane", "axis", "reference_plane", "leds") if not figures[n]]
    if absent:
        rows.append(("not compared", ", ".join(name.replace("_", " ") for name in absent)))
    return _table(rows)


def _capture(figures: dict[str, Any]) -> list[str]:
    if "missing" in figures:
        return [f"  {figures['missing']}"]
    lines = []
    for kind in ("absolute", "shape"):
        head = [f"r {kind}", "bias um", "median um", "rms um", "p95 um", "coverage", "cells"]
        rows = [head]
        for name in _CLASSES:
            row = figures[kind][name]
            coverage = _percent(row["coverage"])
            rows.append([name, *(_um(row[c]) for c in _COLUMNS), coverage, str(row["cells"])])
        lines += [*_table(rows, right=True), ""]
    lines += _table(list(_capture_rows(figures)))
    return lines


def _capture_rows(figures: dict[str, Any]) -> Iterable[tuple[str, str]]:
    detail, edges = figures["detail"], figures["edges"]
    yield (
        "detail on tops",
        f"correlation {_number(detail['correlation'])}, rms {_um(detail['rms_mm'])} um",
    )
    extent = figures["extent"]
    shares = ", ".join(f"{name} {_percent(extent[name])}" for name in ("top", "floor"))
    yield "truth on the grid", shares
    yield "edges found", f"{_percent(edges['found'])} of {edges['edges']}"
    for name, normal in figures.get("normals", {}).items():
        angles = ", ".join(
            f"{label} {_number(normal[f'{key}_deg'])}"
            for label, key in (
                ("mean", "mean"),
                ("median", "median"),
                ("on tops", "top_median"),
                ("p95", "p95"),
            )
        )
        yield f"normals {name}", f"{angles} deg, coverage {_percent(normal['coverage'])}"
    for name, std in figures.get("r_std", {}).items():
        yield f"r_std on {name}", _inside(std)
    if seams := figures.get("seams"):
        at, elsewhere = _um(seams["at_seams_mm"]), _um(seams["elsewhere_mm"])
        yield (
            "seams",
            f"rms step {at} um at {seams['seams']} view changes, {elsewhere} um elsewhere",
        )


def _wear(figures: dict[str, Any]) -> list[str]:
    if "missing" in figures:
        return [f"  {figures['missing']}"]
    blocks = figures["blocks"]
    rows = [
        (
            "worn area",
            f"measured {_um(figures['measured_mean_mm'])} um, true {_um(figures['true_mean_mm'])}"
            f" um, difference {_um(figures['mean_error_mm'])} um,"
            f" coverage {_percent(figures['coverage'])}",
        ),
        (
            "5 mm means",
            f"rms {_um(blocks['rms_mm'])} um, correlation {_number(blocks['correlation'])}"
            f" over {blocks['n']}",
        ),
    ]
    for name, std in figures.get("wear_std", {}).items():
        rows.append((f"wear_std on {name}", _inside(std["absolute"])))
        rows.append(("  after shape fit", _inside(std["shape"])))
    if alignment := figures.get("alignment"):
        turn = f"rotation {_signed(alignment['rotation_arc_mm'])} mm on the tread"
        tilts = ", ".join(f"{1000 * alignment[f'tilt_{a}_rad']:+.2f}" for a in "xy")
        offsets = ", ".join(_signed(alignment[f"offset_{a}_mm"]) for a in "xy")
        rows += [
            ("alignment error", f"{turn}, axial {_signed(alignment['axial_mm'])} mm"),
            ("", f"radial {_signed(alignment['radial_mm'])} mm, offsets {offsets} mm"),
            ("", f"tilts {tilts} mrad"),
        ]
    return _table(rows)


def _inside(std: dict[str, Any]) -> str:
    one, two = _percent(std["inside_1"]), _percent(std["inside_2"])
    return f"{one} inside 1 sigma, {two} inside 2 (median {_um(std['median_std_mm'])} um)"


def _table(rows: Sequence[Sequence[str]], right: bool = False) -> list[str]:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))] if rows else []
    lines = []
    for row in rows:
        cells = [row[0].ljust(widths[0])]
        cells += [
            cell.rjust(width) if right else cell.ljust(width)
            for cell, width in zip(row[1:], widths[1:], strict=True)
        ]
        lines.append(("  " + "  ".join(cells)).rstrip())
    return lines


def _um(value: float | None) -> str:
    return "-" if value is None else f"{1000 * value:.1f}"


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.1f} %"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _signed(value: float) -> str:
    return f"{value:+.3f}"
