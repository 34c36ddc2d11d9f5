"""The numbers behind the report: depth, wear, rates and projections per region."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from treadlight.tread import GrooveReference
from treadlight.wear.alignment import Alignment
from treadlight.wear.settings import WearSettings
from treadlight.wear.tally import RegionTally, common_share

KM_PER = {"km": 1.0, "mi": 1.609344}
_MILS_PER_MM = 1000.0 / 25.4
_SIGMAS = 2.0
# ASTM F1016: a rate is a result from three intervals on, if the line explains the points.
_LEAST_INTERVALS = 3
_LEAST_R2 = 0.95

COLUMNS = (
    "tire",
    "capture",
    "mileage",
    "unit",
    "region",
    "depth_mm",
    "depth_std_mm",
    "depth_p05_mm",
    "depth_p50_mm",
    "depth_p95_mm",
    "depth_cov",
    "wear_mm",
    "wear_std_mm",
    "wear_p05_mm",
    "wear_p50_mm",
    "wear_p95_mm",
    "rate_mm_per_1000km",
    "rate_mils_per_1000mi",
    "rate_r2",
    "projected_mileage",
    "projected_low",
    "projected_high",
    "status",
    "depth_min_mm",
)


@dataclass(frozen=True)
class Stay:
    """One capture of the tire: its id, its mileage in the first capture's unit, its regions."""

    capture: str
    mileage: float
    alignment: Alignment
    tallies: Mapping[str, RegionTally]


@dataclass(frozen=True)
class Rate:
    """Wear per km: slope, standard uncertainty, share explained, number of intervals."""

    mm_per_km: float
    std_mm_per_km: float
    r2: float
    intervals: int


def convert_mileage(value: float, unit: str, wanted: str) -> float:
    """A mileage in another unit, of km and mi."""
    return value if unit == wanted else value * KM_PER[unit] / KM_PER[wanted]


def trend_rows(
    tire: str,
    unit: str,
    stays: Sequence[Stay],
    reference: GrooveReference,
    settings: WearSettings,
) -> list[dict[str, str | float]]:
    """Rows of trend.csv (results-contract), ordered by capture, then region.

    Parameters
    ----------
    tire : str
    unit : "km" or "mi"
        Of the stays' mileages.
    stays : sequence of Stay
        In order of mileage; the first is what wear counts from.
    reference : GrooveReference
        Of the first capture.
    """
    rows: list[dict[str, str | float]] = []
    history: dict[str, list[tuple[float, float, float]]] = {}
    for number, stay in enumerate(stays):
        km = stay.mileage * KM_PER[unit]
        grooves = [t for name, t in stay.tallies.items() if name.startswith("groove-")]
        shares = [
            common_share(part) for part in ([g.floor for g in grooves], [g.wear for g in grooves])
        ]
        for region, tally in stay.tallies.items():
            depth = _depth_columns(tally, reference, shares[0])
            wear = _wear_columns(tally, stay.alignment, shares[1], first=number == 0)
            points = history.setdefault(region, [])
            # ASTM F1016 leaves the break-in out of rates.
            if np.isfinite(wear["wear_mm"]) and km >= settings.break_in_km:
                points.append((km, wear["wear_mm"], wear["wear_std_mm"]))
            rate = fit_rate(points) if number else Rate(np.nan, np.nan, np.nan, 0)
            status = _status(number, wear, rate)
            projection = _projection(status, km, depth, rate, settings.wear_limit_mm)
            rows.append(
                {
                    "tire": tire,
                    "capture": stay.capture,
                    "mileage": stay.mileage,
                    "unit": unit,
                    "region": region,
                    **depth,
                    **wear,
                    "rate_mm_per_1000km": 1e3 * rate.mm_per_km,
                    "rate_mils_per_1000mi": 1e3 * rate.mm_per_km * KM_PER["mi"] * _MILS_PER_MM,
                    "rate_r2": rate.r2,
                    **{name: value / KM_PER[unit] for name, value in projection.items()},
                    "status": status,
                }
            )
    return rows


def _depth_columns(
    tally: RegionTally, reference: GrooveReference, share: float
) -> dict[str, float]:
    mean, spread = tally.depth.mean_and_spread()
    p05, p50, p95 = tally.depth.quantiles((0.05, 0.5, 0.95))
    tiles = max(1, int(np.count_nonzero(tally.depth.tiles[0])))
    # The floor that depth is counted from has its own errors, correlated within tiles too.
    std = np.hypot(tally.depth.std_of_mean(share), reference.block_std_mm / np.sqrt(tiles))
    return {
        "depth_mm": mean,
        "depth_std_mm": float(std),
        "depth_p05_mm": p05,
        "depth_p50_mm": p50,
        "depth_p95_mm": p95,
        "depth_cov": spread / mean if mean > 0 else np.nan,
        "depth_min_mm": tally.depth.least(),
    }


def _wear_columns(
    tally: RegionTally, alignment: Alignment, share: float, *, first: bool
) -> dict[str, float]:
    mean, _ = tally.wear.mean_and_spread()
    p05, p50, p95 = tally.wear.quantiles((0.05, 0.5, 0.95))
    if first and np.isfinite(mean):
        mean = std = p05 = p50 = p95 = 0.0
    else:
        design = tally.wear.mean_design(alignment)
        # What the motion could not explain of the floors, it cannot of the ribs either.
        parts = (
            tally.wear.std_of_mean(share) ** 2,
            float(design @ alignment.covariance @ design),
            alignment.groove_std_mm**2,
        )
        std = float(np.sqrt(sum(parts)))
    names = ("wear_mm", "wear_std_mm", "wear_p05_mm", "wear_p50_mm", "wear_p95_mm")
    return dict(zip(names, (mean, std, p05, p50, p95), strict=True))


def fit_rate(points: Sequence[tuple[float, float, float]]) -> Rate:
    """Least-squares line of wear over mileage (ASTM F1016).

    Parameters
    ----------
    points : sequence of (km, wear mm, standard uncertainty mm)

    Returns
    -------
    Rate
        The uncertainty is the larger of what the points' own says and of the scatter about
        the line. R2 of two mileages is NaN: a line through two points explains nothing. All NaN
        for fewer.
    """
    km, wear, std = np.array(points, float).reshape(-1, 3).T
    intervals = len(np.unique(km)) - 1
    if intervals < 1:
        return Rate(np.nan, np.nan, np.nan, 0)
    centred = km - km.mean()
    weight = centred / (centred @ centred)
    slope = float(weight @ wear)
    own = float(np.sqrt(np.sum((weight * std) ** 2)))
    if intervals < 2:
        return Rate(slope, own, np.nan, intervals)
    residual = wear - wear.mean() - slope * centred
    total = float(np.sum((wear - wear.mean()) ** 2))
    r2 = 1 - float(residual @ residual) / total if total > 0 else np.nan
    scatter = float(np.sqrt(residual @ residual / (len(km) - 2) / (centred @ centred)))
    return Rate(slope, max(own, scatter), r2, intervals)


def _status(number: int, wear: dict[str, float], rate: Rate) -> str:
    if number == 0:
        return "first"
    if not wear["wear_mm"] >= _SIGMAS * wear["wear_std_mm"]:
        return "not_detected"
    valid = rate.intervals >= _LEAST_INTERVALS and rate.r2 >= _LEAST_R2
    return "valid" if valid else "indicative"


def _projection(
    status: str, km: float, depth: dict[str, float], rate: Rate, limit_mm: float
) -> dict[str, float]:
    names = ("projected_mileage", "projected_low", "projected_high")
    if status not in ("valid", "indicative"):
        return dict.fromkeys(names, np.nan)
    found = project(km, depth["depth_mm"], depth["depth_std_mm"], rate, limit_mm)
    return dict(zip(names, found, strict=True))


def project(
    km: float, depth_mm: float, depth_std_mm: float, rate: Rate, limit_mm: float
) -> tuple[float, float, float]:
    """km at which the depth reaches the limit, at the rate and at two sigma to either side.

    NaN without a positive rate; a rate that may be nil has no upper end.
    """
    left = depth_mm - limit_mm
    if not (rate.mm_per_km > 0 and np.isfinite(left)):
        return np.nan, np.nan, np.nan
    margin = _SIGMAS * depth_std_mm
    slow = rate.mm_per_km - _SIGMAS * rate.std_mm_per_km
    fast = rate.mm_per_km + _SIGMAS * rate.std_mm_per_km
    high = km + max(left + margin, 0.0) / slow if slow > 0 else np.nan
    return km + max(left, 0.0) / rate.mm_per_km, km + max(left - margin, 0.0) / fast, high


def csv_text(rows: Sequence[Mapping[str, str | float]]) -> str:
    """trend.csv: six significant digits, empty where a number is not known."""
    lines = [",".join(COLUMNS)]
    lines += [",".join(_cell(row[name]) for name in COLUMNS) for row in rows]
    return "\n".join(lines) + "\n"


def _cell(value: str | float) -> str:
    if isinstance(value, str):
        return value
    return f"{value:.6g}" if np.isfinite(value) else ""
