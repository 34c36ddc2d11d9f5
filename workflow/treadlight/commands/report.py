"""Write a tire's report: maps, sections, ribs, trend, quality, LEDs, warnings first.

The page is one HTML file that needs no network. Refused captures are told, not drawn.
"""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from treadlight.commands import common

if TYPE_CHECKING:
    import numpy as np
    import xarray as xr

    from treadlight.report import CaptureFacts, Map

# More blocks than this along theta and z cannot be told apart on a page.
_PAGE_CELLS = (1600, 600)
_KM_PER_MI = 1.609344


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
        "--leds", type=Path, nargs="*", default=[], help="leds.json of each calibration"
    )
    parser.add_argument("--size", default="", help="the tire's size, such as 215/70R16")
    parser.add_argument("--out", type=Path, required=True, help="report.html to write")


def run(args: argparse.Namespace) -> int:
    from treadlight import store
    from treadlight.errors import ConfigError
    from treadlight.report import TirePage, tire_page

    if len(args.quality) != len(args.profiles):
        raise ConfigError(
            f"--quality names {len(args.quality)} files and --profiles {len(args.profiles)}."
            " Give one quality.json per profile, in the same order."
        )
    if args.calibrations and len(args.calibrations) != len(args.profiles):
        raise ConfigError("--calibrations must name one calibration per profile, or none.")

    def work() -> None:
        profiles = [store.open_store(path) for path in args.profiles]
        wear = store.open_store(args.wear)
        captures = _captures(args, profiles)
        usable = [p for p in profiles if "refused" not in p.attrs]
        trend = store.read_csv(args.trend)
        refused = str(wear.attrs["refused"]) if usable and "refused" in wear.attrs else None
        content = TirePage(
            tire=args.tire,
            size=args.size,
            nominal_radius_mm=float(usable[0].attrs["nominal_radius_mm"]) if usable else None,
            captures=captures,
            wear_refused=refused,
            warnings=[str(w) for w in wear.attrs.get("warnings", ())],
            trend=trend,
            figures=_figures(usable, wear, trend),
            calibration_figures=[f for f in map(_led_distances, args.leds) if f],
        )
        store.write_text(args.out, tire_page(content))

    # A refused capture is something to report, no reason to refuse the report.
    inputs = [args.wear, args.trend, *args.profiles, *args.quality, *args.leds]
    work()
    common.write_provenance(args, inputs, [args.out])
    return 0


def _captures(args: argparse.Namespace, profiles: "list[xr.Dataset]") -> "list[CaptureFacts]":
    from treadlight import store
    from treadlight.report import CaptureFacts

    calibrations = args.calibrations or [""] * len(profiles)
    found = []
    for profile, path, calibration in zip(profiles, args.quality, calibrations, strict=True):
        quality = store.read_json(path)
        found.append(
            CaptureFacts(
                id=str(profile.attrs["source"]),
                mileage=_mileage(profile),
                captured_at=str(profile.attrs.get("captured_at", "")),
                rig=str(profile.attrs.get("rig", "")),
                calibration=calibration,
                quality={} if "refused" in quality else quality,
                refused=profile.attrs.get("refused") or quality.get("refused"),
            )
        )
    return found


def _mileage(profile: "xr.Dataset") -> str:
    if "mileage" not in profile.attrs:
        return ""
    return f"{float(profile.attrs['mileage']):g} {profile.attrs['mileage_unit']}"


def _figures(
    profiles: "list[xr.Dataset]", wear: "xr.Dataset", trend: list[dict[str, str]]
) -> list[tuple[bytes, str, str]]:
    from treadlight.report import map_figure

    if not profiles:
        return []
    radius = float(profiles[0].attrs["nominal_radius_mm"])
    heights = [_map(p, "height", f"{p.attrs['source']}, {_mileage(p)}") for p in profiles]
    figures = [
        (
            map_figure(heights, "height over the groove reference (mm)", radius, "viridis"),
            "Unrolled height maps",
            "Height over the groove reference; grey where nothing was measured.",
        )
    ]
    wears = _wear_maps(wear)
    if wears:
        png = map_figure(wears, "wear (mm)", radius, "magma")
        caption = f"Material lost since {profiles[0].attrs['source']}, in its frame."
        figures.append((png, "Unrolled wear maps", caption))
    figures.append(_sections(profiles, heights, wears))
    drawn = _trend(trend)
    return [*figures, drawn] if drawn else figures


def _map(data: "xr.Dataset", name: str, title: str, **select: int) -> "Map":
    """A variable over (theta, z) at page size."""
    import numpy as np

    from treadlight.report import Map, block_size, reduce_map

    variable = data[name].isel(select)
    shape = variable.sizes["theta"], variable.sizes["z"]

    def read(rows: slice) -> "np.ndarray":
        return variable.isel(theta=rows).to_numpy()

    values = reduce_map(read, shape, _PAGE_CELLS)
    tall, wide = block_size(shape, _PAGE_CELLS)
    theta = _borders(np.degrees(data["theta"].values), tall * values.shape[0])
    return Map(title, values, theta, _borders(data["z"].values, wide * values.shape[1]))


def _borders(centres: "np.ndarray", cells: int) -> tuple[float, float]:
    """Outer borders of this many cells, of which the last may lie outside the map."""
    step = float(centres[-1] - centres[0]) / (len(centres) - 1)
    low = float(centres[0]) - 0.5 * step
    return low, low + cells * step


def _wear_maps(wear: "xr.Dataset") -> "list[Map]":
    """Of every capture but the first."""
    if "wear" not in wear:
        return []
    unit = wear["mileage"].attrs.get("units", "")
    labels = [
        f"{name}, {float(mileage):g} {unit}"
        for name, mileage in zip(wear["capture"].values, wear["mileage"].values, strict=True)
    ]
    return [_map(wear, "wear", label, capture=k) for k, label in enumerate(labels) if k]


def _sections(
    profiles: "list[xr.Dataset]", heights: "list[Map]", wears: "list[Map]"
) -> tuple[bytes, str, str]:
    """The typical cross-section of every mileage, in the first capture's frame."""
    import warnings

    import numpy as np

    from treadlight.report import section_figure

    first = heights[0]
    layers = [(first.title, first.values)]
    layers += [(w.title, first.values - w.values) for w in wears]
    low, high = first.z_mm
    columns = first.values.shape[1]
    z = low + (np.arange(columns) + 0.5) * (high - low) / columns
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # columns without any data
        curves = [(title, z, np.nanmedian(values, axis=0)) for title, values in layers]
    png = section_figure(curves, "height (mm)", "Cross-section")
    caption = (
        "Median over all angles. Later mileages are the first one's height less the wear, so"
        " that all stand in one frame."
    )
    return png, "Cross-sections of all mileages", caption


def _trend(rows: list[dict[str, str]]) -> tuple[bytes, str, str] | None:
    """Depth of the ribs over mileage; None with fewer than two mileages."""
    import numpy as np

    from treadlight.report import trend_figure

    ribs: dict[str, list[dict[str, str]]] = {}
    for row in rows:
        if row["region"].startswith("rib-"):
            ribs.setdefault(row["region"], []).append(row)
    if not ribs or max(map(len, ribs.values())) < 2:
        return None
    unit = rows[0]["unit"]

    def column(of: list[dict[str, str]], name: str) -> "np.ndarray":
        return np.array([float(row[name]) if row[name] else np.nan for row in of])

    regions = [
        (
            name,
            column(of, "mileage"),
            column(of, "depth_mm"),
            column(of, "depth_std_mm"),
            _slope(of[-1], unit),
        )
        for name, of in ribs.items()
    ]
    png = trend_figure(regions, unit, "tread depth (mm)", "Depth of the ribs")
    return png, "Depth of each rib over mileage", "Bars are one standard uncertainty."


def _led_distances(path: Path) -> tuple[bytes, str, str] | None:
    """The dissertation's figure 7.6 of one calibration; None where no LED was found."""
    import numpy as np

    from treadlight import store
    from treadlight.report import box_figure

    content = store.read_json(path)
    if not content.get("leds"):
        return None
    groups = []
    for led in content["leds"]:
        rays = [ray for ray in content["rays"] if ray["led"] == led["led"]]
        distance = np.array([ray["distance_mm"] for ray in rays])
        used = np.array([ray["used"] for ray in rays])
        groups.append((str(led["led"]), distance[used], distance[~used]))
    png = box_figure(groups, "LED", "distance (mm)", path.parent.name)
    mean = np.concatenate([distance for _, distance, _ in groups]).mean()
    rejected = sum(len(crosses) for _, _, crosses in groups)
    caption = (
        f"Distance of the rays reflected by the balls from the LED found: {mean:.2f} mm in the"
        f" mean of {len(content['rays']) - rejected} rays."
    )
    if rejected:
        caption += f" {rejected} more disagreed and were rejected (crosses, the far ones on top)."
    return png, f"Distance of reflected rays from the LEDs, {path.parent.name}", caption


def _slope(row: dict[str, Any], unit: str) -> float | None:
    """Depth per mileage from the last row's rate."""
    if not row.get("rate_mm_per_1000km"):
        return None
    per_km = -float(row["rate_mm_per_1000km"]) / 1000
    return per_km * (_KM_PER_MI if unit == "mi" else 1.0)
