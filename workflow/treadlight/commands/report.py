"""Write a tire's report: verdict and warnings first, maps, sections, trend, quality.

The page is one HTML file that needs no network. Refused captures are told, not drawn.
"""

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from treadlight.commands import common

if TYPE_CHECKING:
    import xarray as xr

    from treadlight.report import CaptureFacts, TirePage
    from treadlight.wear import WearSettings

# What a capture may say of its tire beside what it must.
_OPTIONAL = (
    ("position", "Position"),
    ("serial", "Serial"),
    ("rolling_direction", "Rolling direction"),
    ("outboard", "Outboard side"),
    ("inflation_kpa", "Inflation (kPa)"),
    ("temperature_c", "Temperature (\u00b0C)"),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    common.add_stage_arguments(parser)
    parser.add_argument("tire", help="the tire's id")
    parser.add_argument("--wear", type=Path, required=True, help="wear.zarr")
    parser.add_argument("--trend", type=Path, required=True, help="trend.csv")
    parser.add_argument(
        "--profiles", type=Path, nargs="+", required=True, help="profile.zarr of each capture"
    )
    parser.add_argument(
        "--quality", type=Path, nargs="+", required=True, help="quality.json, in the same order"
    )
    parser.add_argument("--calibrations", nargs="*", default=[], help="ids, in the same order")
    parser.add_argument(
        "--calibration-files",
        type=Path,
        nargs="*",
        default=[],
        help="camera.json, laser_plane.json and leds.json of each calibration",
    )
    parser.add_argument(
        "--facts",
        default="{}",
        help="what the capture says of the tire, as JSON: size, outboard ...",
    )
    parser.add_argument("--out", type=Path, required=True, help="report.html to write")


def run(args: argparse.Namespace) -> int:
    from treadlight import store
    from treadlight.errors import ConfigError
    from treadlight.report import tire_page
    from treadlight.wear import WearSettings

    if len(args.quality) != len(args.profiles):
        raise ConfigError(
            f"--quality names {len(args.quality)} files and --profiles {len(args.profiles)}."
            " Give one quality.json per profile, in the same order."
        )
    if args.calibrations and len(args.calibrations) != len(args.profiles):
        raise ConfigError("--calibrations must name one calibration per profile, or none.")
    settings = common.parse_settings(args.settings, WearSettings)
    # A refused capture is something to report, no reason to refuse the report.
    store.write_text(args.out, tire_page(_content(args, settings)))
    inputs = [args.wear, args.trend, *args.profiles, *args.quality, *args.calibration_files]
    common.write_provenance(args, inputs, [args.out])
    return 0


def _content(args: argparse.Namespace, settings: "WearSettings") -> "TirePage":
    from treadlight import store
    from treadlight.commands import report_maps as maps
    from treadlight.commands import report_numbers as numbers
    from treadlight.report import TirePage, polar_chart, share_chart

    profiles = [store.open_store(path) for path in args.profiles]
    wear = store.open_store(args.wear)
    captures = _captures(args, profiles)
    usable = [p for p in profiles if "refused" not in p.attrs]
    trend = store.read_csv(args.trend)
    facts = json.loads(args.facts)
    sides = numbers.Sides.of(facts)
    worn = maps.worn_treads(usable, wear)
    irregular = numbers.irregular_wear(worn, trend, sides)
    runout, void = maps.runout_and_void(usable)
    turn = [maps.around_the_turn(one) for one in worn]
    flags = [(c.id, c.quality["flags"]) for c in captures if c.quality.get("flags")]
    radius = float(usable[0].attrs["nominal_radius_mm"]) if usable else None
    return TirePage(
        tire=args.tire,
        facts=_tire_facts(facts, radius),
        verdict=numbers.verdict_of(trend, settings, irregular),
        captures=captures,
        wear_refused=str(wear.attrs["refused"]) if usable and "refused" in wear.attrs else None,
        warnings=[str(w) for w in wear.attrs.get("warnings", ())],
        layers=maps.layers_of(usable, wear),
        radius_mm=radius or float("nan"),
        trend=trend,
        charts=[
            *([polar_chart(turn)] if turn else []),
            *numbers.trend_charts(trend, settings),
        ],
        irregular=irregular,
        irregular_notes=numbers.irregular_notes(sides),
        runout=runout,
        void_ratio=void,
        repeats=numbers.repeats(trend),
        quality_charts=[share_chart(flags)] if flags else [],
        calibration_charts=numbers.calibration_charts(args.calibration_files),
    )


def _tire_facts(facts: dict[str, Any], radius: float | None) -> list[tuple[str, str]]:
    from treadlight.report import html

    pairs = [("Size", str(facts["size"]))] if facts.get("size") else []
    if radius is not None:
        pairs.append(("Nominal radius", html.number(radius, 1, "mm")))
    return pairs + [(label, str(facts[name])) for name, label in _OPTIONAL if name in facts]


def _captures(args: argparse.Namespace, profiles: "list[xr.Dataset]") -> "list[CaptureFacts]":
    from treadlight import store
    from treadlight.commands.report_maps import mileage_of
    from treadlight.report import CaptureFacts

    calibrations = args.calibrations or [""] * len(profiles)
    found = []
    for profile, path, calibration in zip(profiles, args.quality, calibrations, strict=True):
        quality = store.read_json(path)
        found.append(
            CaptureFacts(
                id=str(profile.attrs["source"]),
                mileage=mileage_of(profile),
                captured_at=str(profile.attrs.get("captured_at", "")),
                rig=str(profile.attrs.get("rig", "")),
                calibration=calibration,
                quality={} if "refused" in quality else quality,
                refused=profile.attrs.get("refused") or quality.get("refused"),
            )
        )
    return found
