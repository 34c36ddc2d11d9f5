"""The archive at a glance as one HTML page."""

from collections.abc import Sequence
from dataclasses import dataclass

from treadlight.report import html

_WELL_COVERED = 0.9
# From best to worst; shape and word say it too, not the colour alone.
LIGHTS = {"good": "good", "look": "look closer", "refused": "refused"}


@dataclass(frozen=True)
class TireCard:
    """One tire: its link, a picture of its last profile, (name, value) facts, its light."""

    tire: str
    link: str | None
    picture: bytes | None
    facts: list[tuple[str, str]]
    light: str


@dataclass(frozen=True)
class CaptureLine:
    """One capture: cells for the table, `refused` (a sentence) or `warnings`."""

    id: str
    tire: str
    mileage: str
    calibration: str
    coverage: float | None
    held_out_rms_mm: float | None
    refused: str | None
    warnings: list[str]

    @property
    def light(self) -> str:
        """refused, look (a warning, or less than nine tenths of the tread covered) or good."""
        if self.refused:
            return "refused"
        thin = self.coverage is None or self.coverage < _WELL_COVERED
        return "look" if self.warnings or thin else "good"


@dataclass(frozen=True)
class ArchivePage:
    """What the archive's page shows.

    Attributes
    ----------
    tires : list of TireCard
    captures : list of CaptureLine
    calibrations : list of (id, sentence, refused)
        `sentence` tells its residuals, or why it was refused.
    refused : dict of str to str
        Captures that were left out before anything ran.
    """

    tires: list[TireCard]
    captures: list[CaptureLine]
    calibrations: list[tuple[str, str, bool]]
    refused: dict[str, str]


def archive_page(content: ArchivePage) -> str:
    """The document's text; everything in it is escaped."""
    body = [html.heading(1, "Tread archive"), html.paragraph(_counts(content))]
    body += html.notices(
        [f"{name} was refused: {why}" for name, why in sorted(_all_refused(content).items())],
        "bad",
    )
    body += html.notices(
        [f"{c.id}: {warning}" for c in content.captures for warning in c.warnings], "warn"
    )
    if content.tires:
        cards = "".join(map(_card, content.tires))
        body += [html.heading(2, "Tires"), f'<div class="cards">{cards}</div>']
    if content.captures:
        body += [html.heading(2, "Captures"), _captures(content.captures)]
    if content.calibrations:
        rows = [[name, sentence] for name, sentence, _ in content.calibrations]
        body += [html.heading(2, "Calibrations"), html.table(["Calibration", "Residuals"], rows)]
    return html.page("Tread archive", body)


def _all_refused(content: ArchivePage) -> dict[str, str]:
    found = dict(content.refused)
    found.update({name: why for name, why, refused in content.calibrations if refused})
    found.update({c.id: c.refused for c in content.captures if c.refused})
    return found


def _counts(content: ArchivePage) -> str:
    refused = len(_all_refused(content))
    parts = [
        _plural(len(content.tires), "tire"),
        _plural(len(content.captures), "capture"),
        _plural(len(content.calibrations), "calibration"),
    ]
    return ", ".join(parts) + (f"; {refused} refused." if refused else "; nothing refused.")


def _plural(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"


def _card(card: TireCard) -> str:
    name = html.text(f"Tire {card.tire}")
    title = f'<a href="{html.text(card.link)}">{name}</a>' if card.link else name
    picture = html.image(card.picture, f"Height map of tire {card.tire}") if card.picture else ""
    light = html.light(card.light, LIGHTS[card.light])
    return (
        f'<div class="card"><strong>{title}</strong> {light}{picture}{html.facts(card.facts)}</div>'
    )


def _captures(captures: Sequence[CaptureLine]) -> str:
    head = [
        "Capture",
        "Tire",
        "Mileage",
        "Calibration",
        "Tread covered",
        "Held-out RMS mm",
        "Quality",
    ]
    note = (
        f"Quality: look closer where there is a warning or less than {html.percent(_WELL_COVERED)}"
        " of the tread is covered; what was refused says why above."
    )
    return html.table(head, map(_line, captures)) + html.caption(note)


def _line(c: CaptureLine) -> list[str]:
    rms = html.number(c.held_out_rms_mm, 3)
    cells = [c.id, c.tire, c.mileage, c.calibration, html.percent(c.coverage), rms]
    return [*cells, html.Markup(html.light(c.light, LIGHTS[c.light]))]
