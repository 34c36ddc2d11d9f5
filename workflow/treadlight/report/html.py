"""Small pieces of HTML; whatever is text goes through `text`."""

import base64
import hashlib
import html
import json
import re
from collections.abc import Iterable, Sequence
from typing import SupportsFloat

_STYLE = """
body{font:15px/1.5 system-ui,sans-serif;color:#222;background:#fff;max-width:1360px;
margin:2rem auto;padding:0 1rem}
h1{font-size:1.6rem;margin:0 0 .3rem}h2{font-size:1.15rem;margin:2.2rem 0 .6rem}
h3{font-size:.95rem;margin:1.2rem 0 .3rem}
table{border-collapse:collapse;font-size:.88rem;margin:.5rem 0}
th,td{padding:.25rem .7rem;border-bottom:1px solid #e3e3e3;text-align:left;vertical-align:top}
thead th{border-bottom:2px solid #999}td.n{text-align:right;font-variant-numeric:tabular-nums}
td.s{white-space:nowrap}
.scroll{overflow-x:auto}img{max-width:100%;height:auto}figure{margin:1rem 0}
figcaption{color:#555;font-size:.88rem;margin-top:.4rem;max-width:60rem}
.verdict{font-size:1.05rem;border-left:4px solid #0072b2;background:#eef5fa;padding:.5rem 1rem}
.warn{background:#fff6e0;border-left:4px solid #d89000;padding:.5rem 1rem;margin:.5rem 0}
.bad{background:#fdeaea;border-left:4px solid #c03030;padding:.5rem 1rem;margin:.5rem 0}
.light{white-space:nowrap}.light::before{content:"";display:inline-block;width:.75em;height:.75em;
margin-right:.4em;background:#009e73;border-radius:50%}
.light.look::before{background:#e69f00;border-radius:0;transform:rotate(45deg) scale(.85)}
.light.refused::before{background:#c03030;border-radius:0}
.cards{display:flex;flex-wrap:wrap;gap:1rem}
.card{border:1px solid #ddd;padding:.8rem 1rem;width:330px;max-width:100%;box-sizing:border-box}
dl{display:grid;grid-template-columns:max-content 1fr;gap:.1rem 1rem;margin:.5rem 0}
dt{color:#555}dd{margin:0}
nav{font-size:.9rem;margin:1rem 0;display:flex;flex-wrap:wrap;gap:.2rem 1rem}a{color:#005a8c}
.pick{display:flex;flex-wrap:wrap;gap:.3rem 1rem;align-items:center;margin:.4rem 0}
.pick input[type=range]{flex:1 1 260px;max-width:640px}.pick input[type=number]{width:6em}
.plot{width:100%}
"""


def page(title: str, body: Iterable[str], scripts: Sequence[str] = ()) -> str:
    """A whole document that needs nothing else and may load nothing else.

    Only these scripts may run, by their digests: no text of a capture ever can.
    """
    digests = " ".join(f"'sha256-{_sha256(script)}'" for script in scripts)
    allowed = f" script-src {digests};" if scripts else ""
    return "\n".join(
        [
            "<!DOCTYPE html>",
            '<html lang="en"><head><meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            '<meta http-equiv="Content-Security-Policy" content="default-src \'none\';'
            f" img-src data: blob:;{allowed} style-src 'unsafe-inline'\">",
            f"<title>{text(title)}</title><style>{_STYLE}</style></head><body>",
            *body,
            *(f"<script>{script}</script>" for script in scripts),
            "</body></html>",
            "",
        ]
    )


def _sha256(script: str) -> str:
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")


def data(name: str, content: object) -> str:
    """Values for a script, as JSON in which no tag can end or begin."""
    shown = json.dumps(content, separators=(",", ":"), sort_keys=True, allow_nan=False)
    for sign in "<>&":
        shown = shown.replace(sign, f"\\u{ord(sign):04x}")
    return f'<script type="application/json" id="{text(name)}">{shown}</script>'


def plot(kind: str, height_px: int, **values: object) -> str:
    """The place of an interactive figure; `values` become its data attributes."""
    attributes = "".join(f' data-{k}="{text(v)}"' for k, v in values.items())
    return (
        f'<div class="plot" data-plot="{text(kind)}"{attributes}'
        f' style="height:{height_px}px"></div>'
    )


def choice(label: str, options: Sequence[tuple[str, str]], name: str) -> str:
    """A list to choose from: (value, text)."""
    shown = "".join(f'<option value="{text(v)}">{text(t)}</option>' for v, t in options)
    return f'<label class="pick">{text(label)} <select {name}>{shown}</select></label>'


def picker(label: str, low: float, high: float, step: float) -> str:
    """A slider and a number that move together, both marked for the script."""
    ends = f'min="{low:.1f}" max="{high:.1f}" step="{step}" aria-label="{text(label)}" data-picker'
    return (
        f'<div class="pick"><span>{text(label)}</span><input type="range" {ends}>'
        f'<input type="number" {ends}></div>'
    )


def links(targets: Iterable[tuple[str, str]]) -> str:
    """Links to the sections of the page: (title, anchor)."""
    shown = "".join(f'<a href="#{text(anchor)}">{text(title)}</a>' for title, anchor in targets)
    return f"<nav>{shown}</nav>"


def caption(value: str) -> str:
    return f"<figcaption>{text(value)}</figcaption>" if value else ""


def text(value: object) -> str:
    return html.escape(str(value), quote=True)


def heading(level: int, value: str, anchor: str = "") -> str:
    mark = f' id="{text(anchor)}"' if anchor else ""
    return f"<h{level}{mark}>{text(value)}</h{level}>"


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


# Longer cells hold sentences, which may wrap.
_SHORT = 40


class Markup(str):
    """HTML that is finished: it is not escaped again."""


def light(kind: str, word: str) -> str:
    """A traffic light: colour, shape and word."""
    return f'<span class="light {text(kind)}">{text(word)}</span>'


def _cell(value: str) -> str:
    if isinstance(value, Markup):
        return f'<td class="s">{value}</td>'
    numeric = re.match("[\u2212+]?\\d+(\\.\\d+)?(?![\\d-])|\u2013", value)
    kinds = "n" * bool(numeric) + " s" * (len(value) <= _SHORT)
    return f'<td class="{kinds.strip()}">{text(value)}</td>' if kinds else f"<td>{text(value)}</td>"


def image(png: bytes, alt: str) -> str:
    shown = base64.b64encode(png).decode("ascii")
    return f'<figure><img alt="{text(alt)}" src="data:image/png;base64,{shown}"></figure>'


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
