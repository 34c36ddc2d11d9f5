"""What the numbers say, in sentences."""

from collections.abc import Sequence
from dataclasses import dataclass

from treadlight.report import html


@dataclass(frozen=True)
class Verdict:
    """What the first sentence of a report is made of.

    Attributes
    ----------
    unit : str
        Of mileages.
    first, last : float
        Mileages.
    tread : dict of str to str
        The last row of trend.csv for the whole tread.
    fastest : (name, row) or None
        The rib that wore most, and its row.
    limit_mm : float
    worn_out : (who, middle, low, high) or None
        The earliest projected mileage at the limit.
    irregular : list of str
        Detected forms of irregular wear, worst first.
    """

    unit: str
    first: float
    last: float
    tread: dict[str, str]
    fastest: tuple[str, dict[str, str]] | None
    limit_mm: float
    worn_out: tuple[str, float, float, float] | None
    irregular: Sequence[str]


def verdict(facts: Verdict) -> str:
    """Where, how fast and how evenly the tire wears, and how sure that is."""
    since = f"from {facts.first:g} to {facts.last:g} {facts.unit}"
    row = facts.tread
    wear, std = _um(row, "wear_mm"), _um(row, "wear_std_mm")
    if row["status"] == "not_detected":
        return (
            f"No wear is detected {since}: {wear} \u00b1 {std}\u202f\u00b5m in the mean of the"
            " tread is below two standard uncertainties."
        )
    sure = "a valid rate" if row["status"] == "valid" else "an indicative rate"
    parts = [
        f"The tread lost {wear} \u00b1 {std}\u202f\u00b5m in the mean {since}, {sure} of"
        f" {html.number(row['rate_mm_per_1000km'], 2)}\u202fmm/1000\u202fkm"
    ]
    if facts.fastest is not None:
        name, fastest = facts.fastest
        parts.append(f"fastest on {name} ({_um(fastest, 'wear_mm')}\u202f\u00b5m)")
    parts.append(
        "unevenly (" + ", ".join(facts.irregular) + ")"
        if facts.irregular
        else "with no irregular wear detected"
    )
    if facts.worn_out is not None:
        who, middle, low, high = facts.worn_out
        latest = f"{html.number(high, 0)}" if high == high else "no upper end"
        parts.append(
            f"reaching {facts.limit_mm:g}\u202fmm at about {html.number(middle, 0)} {facts.unit}"
            f" ({html.number(low, 0)} to {latest}) by {who}"
        )
    return ", ".join(parts[:-1]) + "; " + parts[-1] + "."


def _um(row: dict[str, str], name: str) -> str:
    return html.number(1000 * float(row[name]) if row.get(name) else None, 0)
