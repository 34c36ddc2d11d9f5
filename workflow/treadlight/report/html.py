"""Small pieces of HTML; whatever is text goes through `text`."""

import base64
import html
import re
from collections.abc import Iterable, Sequence
from typing import SupportsFloat

_STYLE = """
body{font:15px/1.5 system-ui,sans-serif;color:#222;max-width:1180px;margin:2rem auto;padding:0 1rem}
h1{font-size:1.6rem;margin:0 0 .3rem}h2{font-size:1.15rem;margin:2rem 0 .6rem}
table{border-collapse:collapse;font-size:.88rem;margin:.5rem 0}
th,td{padding:.25rem .7rem;border-bottom:1px solid #e3e3e3;text-align:left;vertical-align:top}
thead th{border-bottom:2px solid #999}td.n{text-align:right;font-variant-numeric:tabular-nums}
.scroll{overflow-x:auto}img{max-width:100%;height:auto}figure{margin:1rem 0}
figcaption{color:#555;font-size:.88rem}
.warn{background:#fff6e0;border-left:4px solid #d89000;padding:.5rem 1rem;margin:.5rem 0}
.bad{background:#fdeaea;border-left:4px solid #c03030;padding:.5rem 1rem;margin:.5rem 0}
.ok{color:#2c6e31}.refused{color:#b02020}
.cards{display:flex;flex-wrap:wrap;gap:1rem}
.card{border:1px solid #ddd;padding:.8rem 1rem;width:330px}
dl{display:grid;grid-template-columns:max-content 1fr;gap:.1rem 1rem;margin:.5rem 0}
dt{color:#555}dd{margin:0}
"""


def page(title: str, body: Iterable[str]) -> str:
    """A whole document that needs nothing else and may load nothing else."""
    return "\n".join(
        [
            "<!DOCTYPE html>",
            '<html lang="en"><head><meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            '<meta http-equiv="Content-Security-Policy" content="default-src \'none\';'
            " img-src data:; style-src 'unsafe-inline'\">",
            f"<title>{text(title)}</title><style>{_STYLE}</style></head><body>",
            *body,
            "</body></html>",
            "",
        ]
    )


def text(value: object) -> str:
    return html.escape(str(value), quote=True)


def heading(level: int, value: str) -> str:
    return f"<h{level}>{text(value)}</h{level}>"


def paragraph(value: str, kind: str = "") -> str:
    kind = f' class="{kind}"' if kind else ""
    return f"<p{kind}>{text(value)}</p>"


def notices(sentences: Iterable[str], kind: str) -> list[str]:
    return [f'<div class="{kind}">{text(sentence)}</div>' for sentence in sentences]


def facts(pairs: Iterable[tuple[str, str]]) -> str:
    rows = "".join(f"<dt>{text(name)}</dt><dd>{text(value)}</dd>" for name, value in pairs)
    return f"<dl>{rows}</dl>"


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of texts; cells that begin with a number stand to the right."""
    top = "".join(f'<th scope="col">{text(name)}</th>' for name in head)
    body = "".join("<tr>" + "".join(map(_cell, row)) + "</tr>" for row in rows)
    return (
        f'<div class="scroll"><table><thead><tr>{top}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def _cell(value: str) -> str:
    numeric = re.match("[\u2212+]?\\d+(\\.\\d+)?(?![\\d-])|\u2013", value)
    return f'<td class="n">{text(value)}</td>' if numeric else f"<td>{text(value)}</td>"


def image(png: bytes, alt: str, caption: str = "") -> str:
    data = base64.b64encode(png).decode("ascii")
    below = f"<figcaption>{text(caption)}</figcaption>" if caption else ""
    return f'<figure><img alt="{text(alt)}" src="data:image/png;base64,{data}">{below}</figure>'


def number(value: object, digits: int, unit: str = "") -> str:
    """A number with a true minus; a dash where there is none."""
    size = _as_float(value)
    if size != size:
        return "\u2013"
    shown = f"{size:.{digits}f}"
    if float(shown) == 0:
        shown = shown.lstrip("-")
    return shown.replace("-", "\u2212") + (f"\u202f{unit}" if unit else "")


def percent(value: object) -> str:
    return number(100 * _as_float(value), 1, "%")


def _as_float(value: object) -> float:
    """The number that a value from a file is or says; NaN where it is none."""
    try:
        return float(value) if isinstance(value, str | SupportsFloat) else float("nan")
    except ValueError:
        return float("nan")
