"""What a tire's report says: trend, projections, irregular wear, repeatability, calibration."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from treadlight.commands.report_maps import Worn

if TYPE_CHECKING:
    import numpy as np

    from treadlight.report import Chart, IrregularWear
    from treadlight.wear import Finding, WearSettings

Rows = list[dict[str, str]]


@dataclass(frozen=True)
class Sides:
    """+1, -1 or 0 (not known): where the tread moves to in theta, which side of z is outboard."""

    rolling: int
    outboard: int

    @classmethod
    def of(cls, facts: dict[str, Any]) -> "Sides":
        signs = {"+theta": 1, "-theta": -1, "+z": 1, "-z": -1}
        return cls(
            signs.get(str(facts.get("rolling_direction")), 0),
            signs.get(str(facts.get("outboard")), 0),
        )


def column(rows: Rows, name: str) -> "np.ndarray":
    """Numbers of a column of trend.csv; NaN where empty."""
    import numpy as np

    return np.array([float(row[name]) if row.get(name) else np.nan for row in rows])


def by_region(rows: Rows) -> dict[str, Rows]:
    found: dict[str, Rows] = {}
    for row in rows:
        found.setdefault(row["region"], []).append(row)
    return found


def km_per(unit: str) -> float:
    from treadlight.wear import KM_PER

    return KM_PER[unit]


def trend_charts(rows: Rows, settings: "WearSettings") -> "list[Chart]":
    """Wear over mileage, and depth down to the limit; nothing of fewer than two mileages."""
    from treadlight.report import Projection, RegionTrend, projection_chart, trend_chart

    regions = by_region(rows)
    if not rows or len({row["mileage"] for row in rows}) < 2:
        return []
    unit = rows[0]["unit"]
    trends = [
        RegionTrend(
            name,
            column(of, "mileage"),
            column(of, "wear_mm"),
            column(of, "wear_std_mm"),
            _detected(of),
            _line(of, settings),
        )
        for name, of in regions.items()
        if not name.startswith("groove-")
    ]
    projected = [
        Projection(
            label,
            column(regions[name], "mileage"),
            column(regions[name], "depth_mm"),
            column(regions[name], "depth_std_mm"),
            *found,
        )
        for label, name, found in projections(rows, settings)
    ]
    charts = [trend_chart(trends, unit)]
    if projected:
        charts.append(projection_chart(projected, settings.wear_limit_mm, unit))
    return charts


def _detected(rows: Rows) -> "np.ndarray":
    import numpy as np

    return np.array([row["status"] != "not_detected" for row in rows])


def _line(
    rows: Rows, settings: "WearSettings"
) -> "tuple[np.ndarray, np.ndarray, np.ndarray] | None":
    """Regression of the region's wear and its prediction interval, a little past the data."""
    import numpy as np

    from treadlight.wear import fit_line

    if rows[-1]["status"] not in ("valid", "indicative"):
        return None
    mileage, wear, std = (column(rows, name) for name in ("mileage", "wear_mm", "wear_std_mm"))
    used = np.isfinite(wear) & (mileage * km_per(rows[0]["unit"]) >= settings.break_in_km)
    line = fit_line(list(zip(mileage[used], wear[used], std[used], strict=True)))
    if line is None:
        return None
    reach = 0.15 * np.ptp(mileage[used])
    x = np.linspace(mileage[used].min(), mileage[used].max() + reach, 40)
    return x, line.at(x), line.prediction_half_width(x)


def projections(
    rows: Rows, settings: "WearSettings"
) -> list[tuple[str, str, tuple[float, float, float]]]:
    """(label, region, (mileage at the limit, earliest, latest)): by the mean, and by the groove
    that reaches the limit first."""
    import numpy as np

    regions = by_region(rows)
    found = []
    tread = regions.get("tread", [])
    if tread and tread[-1].get("projected_mileage"):
        names = ("projected_mileage", "projected_low", "projected_high")
        middle, low, high = (float(column(tread[-1:], name)[0]) for name in names)
        found.append(("the mean of the tread", "tread", (middle, low, high)))
    grooves = [
        (name, groove_projection(rows, name, settings))
        for name in regions
        if name.startswith("groove-")
    ]
    grooves = [(name, ends) for name, ends in grooves if np.isfinite(ends[0])]
    if grooves:
        name, ends = min(grooves, key=lambda item: item[1][0])
        found.append((f"the fastest groove, {name}", name, ends))
    return found


def groove_projection(
    rows: Rows, name: str, settings: "WearSettings"
) -> tuple[float, float, float]:
    """Mileage at which a groove's depth reaches the limit, earliest, latest; NaN if not known.

    Its loss of depth is that of the tops beside it; a loss is as uncertain as the wear of the
    less certain rib next to it.
    """
    import numpy as np

    from treadlight.wear import fit_rate, project

    regions = by_region(rows)
    of, unit = regions[name], rows[0]["unit"]
    depth, depth_std = column(of, "depth_mm"), column(of, "depth_std_mm")
    number = int(name.partition("-")[2])
    beside = [regions[rib] for rib in (f"rib-{number}", f"rib-{number + 1}") if rib in regions]
    if not beside or not np.isfinite(depth[-1]):
        return np.nan, np.nan, np.nan
    std = np.max([column(rib, "wear_std_mm") for rib in beside], axis=0)
    loss, km = depth[0] - depth, column(of, "mileage") * km_per(unit)
    if not loss[-1] >= 2 * std[-1]:
        return np.nan, np.nan, np.nan
    used = np.isfinite(loss) & (km >= settings.break_in_km)
    rate = fit_rate(list(zip(km[used], loss[used], std[used], strict=True)))
    ends = project(km[-1], depth[-1], depth_std[-1], rate, settings.wear_limit_mm)
    middle, low, high = (end / km_per(unit) for end in ends)
    return middle, low, high


def irregular_wear(worn: Sequence[Worn], rows: Rows, sides: Sides) -> "list[IrregularWear]":
    """Every figure of irregular wear, over the later captures."""
    from treadlight.report import IrregularWear

    found: dict[tuple[str, str], IrregularWear] = {}
    for one in worn:
        capture = one.title.partition(",")[0]
        for finding in _findings(one, [r for r in rows if r["capture"] == capture], sides):
            value = (capture, finding.value_mm, finding.std_mm, finding.word)
            before = found.get((finding.term, finding.place))
            values = [*before.values, value] if before else [value]
            found[finding.term, finding.place] = IrregularWear(
                finding.term, finding.place, finding.note, values
            )
    return list(found.values())


def _findings(one: Worn, rows: Rows, sides: Sides) -> "list[Finding]":
    import numpy as np

    from treadlight import wear

    ribs = [row for row in rows if row["region"].startswith("rib-")]
    loss, std = column(ribs, "wear_mm"), column(ribs, "wear_std_mm")
    numbers = range(1, int(one.tread.rib.max(initial=0)) + 1)
    middles = [np.flatnonzero(one.tread.rib == n).mean() * one.tread.step_mm for n in numbers]
    slope_std = 0.0
    if len(ribs) > 1 and len(ribs) == len(middles):
        slope_std = float(np.hypot(std[0], std[-1]) / (middles[-1] - middles[0]))
    return [
        *(wear.heel_and_toe(one.tread, n, sides.rolling) for n in numbers),
        *(wear.feathering(one.tread, n, slope_std, sides.outboard) for n in numbers),
        *(wear.cupping(one.tread, n, bias) for n, bias in zip(numbers, std, strict=False)),
        wear.one_sided(list(loss), list(std), sides.outboard),
        wear.shoulder_or_centre(list(loss), list(std)),
        wear.flat_spot(one.tread),
    ]


def irregular_notes(sides: Sides) -> list[str]:
    """What the figures of irregular wear stand on."""
    from treadlight.wear import WORDS

    words = ", ".join(f"{word} from {least:g} mm" for least, word in WORDS if least)
    notes = [
        "Terms of ASTM F1426; \u00b1 is one standard uncertainty. A figure below two of them (for"
        " cupping and flat spots, below what the largest of as many waves or places shows by"
        f" chance) is not detected; else it is slight, {words}."
    ]
    unknown = []
    if not sides.rolling:
        unknown.append("which way the tire rolls (rolling_direction)")
    if not sides.outboard:
        unknown.append("which side is outboard (outboard)")
    if unknown:
        notes.append(
            f"The capture does not say {' nor '.join(unknown)}: signs are those of theta and z."
        )
    return notes


def repeats(rows: Rows) -> list[tuple[str, str, int, float, float]]:
    """Scatter of the mean depths of captures at one mileage, beside what each claims."""
    import numpy as np

    groups: dict[tuple[str, str], Rows] = {}
    for row in rows:
        groups.setdefault((row["mileage"], row["region"]), []).append(row)
    found = []
    for (mileage, region), of in groups.items():
        depth, std = column(of, "depth_mm"), column(of, "depth_std_mm")
        known = np.isfinite(depth)
        if known.sum() > 1:
            spread = float(depth[known].std(ddof=1))
            claimed = float(np.sqrt(np.mean(std[known] ** 2)))
            found.append((f"{mileage} {of[0]['unit']}", region, int(known.sum()), spread, claimed))
    return found


def verdict_of(rows: Rows, settings: "WearSettings", irregular: "Sequence[IrregularWear]") -> str:
    """The report's first sentence; empty if there is no wear to speak of."""
    from treadlight.report import Verdict, verdict

    regions = by_region(rows)
    tread = regions.get("tread", [])
    if len(tread) < 2 or not tread[-1].get("wear_mm"):
        return ""
    last = [of[-1] for name, of in regions.items() if name.startswith("rib-")]
    worn = [row for row in last if row["status"] in ("valid", "indicative")]
    fastest = max(worn, key=lambda row: float(row["wear_mm"]), default=None)
    ends = [(label, *found) for label, _, found in projections(rows, settings)]
    return verdict(
        Verdict(
            tread[0]["unit"],
            float(tread[0]["mileage"]),
            float(tread[-1]["mileage"]),
            tread[-1],
            None if fastest is None else (fastest["region"], fastest),
            settings.wear_limit_mm,
            min(ends, key=lambda end: end[1], default=None),
            _detected_forms(irregular),
        )
    )


def _detected_forms(irregular: "Sequence[IrregularWear]") -> list[str]:
    """One phrase per term that is detected in the last capture, the largest first."""
    worst: dict[str, tuple[float, str]] = {}
    for row in irregular:
        _, value, _, word = row.values[-1]
        if word in ("slight", "moderate", "severe"):
            phrase = f"{word} {row.term}" + (f" on {row.place}" if row.place != "tread" else "")
            worst[row.term] = max(worst.get(row.term, (0.0, "")), (abs(value), phrase))
    return [phrase for _, phrase in sorted(worst.values(), reverse=True)]


def calibration_charts(paths: Sequence[Path]) -> "list[Chart]":
    """Pictures of a calibration's residuals, of its camera.json, laser_plane.json, leds.json."""
    from treadlight import store

    draw = {"camera": _reprojection, "laser_plane": _laser_distances, "leds": _led_distances}
    charts = [draw[path.stem](store.read_json(path), path.parent.name) for path in paths]
    return [chart for chart in charts if chart is not None]


def _reprojection(content: dict[str, Any], calibration: str) -> "Chart | None":
    import numpy as np

    from treadlight.report import residual_chart

    residual = np.array(content.get("residuals_px") or np.empty((0, 2)), float)
    if not len(residual):
        return None
    rms = content["camera"]["reprojection_rms_px"]
    caption = (
        f"Corners of {content['camera']['poses']} checkerboards less where the camera model puts"
        f" them: {rms:.3f} px root mean square."
    )
    return residual_chart(residual, f"Reprojection, {calibration}", caption)


def _laser_distances(content: dict[str, Any], calibration: str) -> "Chart | None":
    import numpy as np

    from treadlight.report import histogram_chart

    histogram = content.get("histogram_mm")
    if not histogram:
        return None
    plane = content["laser_plane"]
    caption = (
        f"Distance of {plane['points']} points on {plane['poses']} boards from the laser plane:"
        f" {plane['residual_mm']['rms']:.3f} mm root mean square, 95 % below"
        f" {plane['residual_mm']['p95']:.3f} mm."
    )
    return histogram_chart(
        np.array(histogram["edges"], float),
        np.array(histogram["counts"], float),
        "distance (mm)",
        f"Laser plane, {calibration}",
        caption,
    )


def _led_distances(content: dict[str, Any], calibration: str) -> "Chart | None":
    """The dissertation's figure 7.6 of one calibration; None where no LED was found."""
    import numpy as np

    from treadlight.report import box_chart

    if not content.get("leds"):
        return None
    groups = []
    for led in content["leds"]:
        rays = [ray for ray in content["rays"] if ray["led"] == led["led"]]
        distance = np.array([ray["distance_mm"] for ray in rays])
        used = np.array([ray["used"] for ray in rays], bool)
        groups.append((str(led["led"]), distance[used], distance[~used]))
    mean = np.concatenate([distance for _, distance, _ in groups]).mean()
    rejected = sum(len(crosses) for _, _, crosses in groups)
    caption = (
        f"Distance of the rays reflected by the balls from the LED found: {mean:.2f} mm in the"
        f" mean of {len(content['rays']) - rejected} rays."
    )
    if rejected:
        caption += f" {rejected} more disagreed and were rejected (crosses, the far ones on top)."
    return box_chart(groups, f"LEDs, {calibration}", caption)
