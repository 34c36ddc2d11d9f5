"""Write the archive's page and the list of all products with their digests.

STATE_JSON is {"tires": {tire: [capture]}, "calibration_of": {capture: calibration},
"calibrations": [id], "refused": {id: sentence}, "warnings": {id: sentence}}. products.json is
{"files": {path: sha256}, "refused": {id: sentence}}; paths are relative to the results.
"""

import argparse
import hashlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

from treadlight.commands import common
from treadlight.commands.status import (
    Outcome,
    calibrations_of,
    contract_products,
    read_outcome,
)

if TYPE_CHECKING:
    import numpy as np

    from treadlight.report import CaptureLine, TireCard

_THUMBNAIL_CELLS = (300, 80)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    common.add_stage_arguments(parser)
    parser.add_argument("--results", type=Path, required=True, help="folder of results")
    parser.add_argument(
        "--archive-state", type=Path, required=True, help="archive.json: what the archive holds"
    )
    parser.add_argument("--out", type=Path, required=True, help="index.html to write")
    parser.add_argument("--products", type=Path, required=True, help="products.json to write")


def run(args: argparse.Namespace) -> int:
    from treadlight import store
    from treadlight.report import ArchivePage, archive_page

    outcome = read_outcome(args.results, args.archive_state)
    state = outcome.state
    lines = {
        tire: [_line(args.results, tire, name, outcome) for name in names]
        for tire, names in state["tires"].items()
    }
    page = ArchivePage(
        tires=[_card(args.results, tire, of, outcome) for tire, of in lines.items()],
        captures=[line for of in lines.values() for line in of],
        calibrations=[_calibration(args.results, name, outcome) for name in calibrations_of(state)],
        refused=state["refused"],
    )
    store.write_text(args.out, archive_page(page))
    files = _file_digests(args.results, state)
    files[args.out.name] = common.product_digest(args.out)
    store.write_json(args.products, {"files": files, "refused": outcome.refused})
    common.write_provenance(args, [args.archive_state], [args.out])
    return 0


def _card(results: Path, tire: str, lines: "list[CaptureLine]", outcome: Outcome) -> "TireCard":
    from treadlight import store
    from treadlight.report import LIGHTS, TireCard, html

    folder = results / "tires" / tire
    mileages = ", ".join(line.mileage for line in lines if line.mileage)
    facts = [("Captures", str(len(lines))), ("Mileages", mileages)]
    trend = folder / "trend.csv"
    rows = store.read_csv(trend) if trend.is_file() else []
    whole = [row for row in rows if row["region"] == "tread"]
    if whole:
        last = whole[-1]
        depth = html.number(last["depth_mm"] or None, 2, "mm")
        facts += [("Tread depth", depth), ("Mean wear", _wear(last))]
    link = f"tires/{tire}/report.html" if (folder / "report.html").is_file() else None
    worst = max((line.light for line in lines), key=list(LIGHTS).index, default="refused")
    picture = _picture(results, [line.id for line in lines], outcome)
    return TireCard(tire, link, picture, facts, worst)


def _wear(row: dict[str, str]) -> str:
    """Mean wear of the tread with its standard uncertainty, or that there is none to be seen."""
    from treadlight.report import html

    value, std = (
        html.number(1000 * float(row[name]) if row.get(name) else None, 0)
        for name in ("wear_mm", "wear_std_mm")
    )
    if row["status"] == "first":
        return "\u2013"
    shown = f"{value} \u00b1 {std}\u202f\u00b5m"
    return f"not detected ({shown})" if row["status"] == "not_detected" else shown


def _picture(results: Path, names: list[str], outcome: Outcome) -> bytes | None:
    """The height map of the latest capture that has one."""
    from treadlight import store
    from treadlight.report import reduce_map, thumbnail

    for name in reversed(names):
        path = results / "captures" / name / "profile.zarr"
        if name in outcome.refused or not (path / store.ROOT_METADATA).is_file():
            continue
        height = store.open_store(path)["height"]

        def read(rows: slice, height: Any = height) -> "np.ndarray":
            return height.isel(theta=rows).to_numpy()

        values = reduce_map(read, (height.sizes["theta"], height.sizes["z"]), _THUMBNAIL_CELLS)
        return thumbnail(values)
    return None


def _line(results: Path, tire: str, name: str, outcome: Outcome) -> "CaptureLine":
    from treadlight import store
    from treadlight.report import CaptureLine

    path = results / "captures" / name / "quality.json"
    quality = store.read_json(path) if path.is_file() else {}
    warning = outcome.state["warnings"].get(name)
    warnings = [warning] if warning else []
    warnings += [w for w in quality.get("warnings") or () if w not in warnings]
    inventory = results / "captures" / name / "inventory.json"
    mileage = store.read_json(inventory).get("mileage") if inventory.is_file() else None
    return CaptureLine(
        id=name,
        tire=tire,
        mileage=f"{mileage['value']:g} {mileage['unit']}" if mileage else "",
        calibration=outcome.state["calibration_of"].get(name, ""),
        coverage=(quality.get("coverage") or {}).get("tread"),
        held_out_rms_mm=(quality.get("held_out_laser_mm") or {}).get("rms"),
        refused=outcome.refused.get(name),
        warnings=warnings,
    )


def _calibration(results: Path, name: str, outcome: Outcome) -> tuple[str, str, bool]:
    from treadlight import store
    from treadlight.report import html

    if name in outcome.refused:
        return name, outcome.refused[name], True
    path = results / "calibrations" / name / "calibration.json"
    if not path.is_file():
        return name, "not made yet", False
    content = store.read_json(path)
    camera, plane, axis = (content.get(k) or {} for k in ("camera", "laser_plane", "axis"))
    leds = content.get("leds") or []
    worst = max((led["residual_mm"]["mean"] for led in leds), default=None)
    sentence = (
        f"camera {html.number(camera.get('reprojection_rms_px'), 3, 'px')},"
        f" laser plane {html.number((plane.get('residual_mm') or {}).get('rms'), 3, 'mm')},"
        f" axis {html.number((axis.get('residual_mm') or {}).get('rms'), 3, 'mm')},"
        f" {len(leds)} LEDs, the worst {html.number(worst, 2, 'mm')}"
    )
    return name, sentence, False


def _file_digests(results: Path, state: dict[str, Any]) -> dict[str, str]:
    """SHA-256 of every file of the contract's products; hidden files are no products."""
    found = {}
    for _, product in contract_products(results, state):
        path = results / product
        for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
            name = file.relative_to(results)
            if file.is_file() and not any(part.startswith(".") for part in name.parts):
                found[name.as_posix()] = hashlib.sha256(file.read_bytes()).hexdigest()
    return dict(sorted(found.items()))
