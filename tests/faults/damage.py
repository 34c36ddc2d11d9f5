"""What a damage to a capture is, and the changes that damages are made of.

`images`, `documents` and `calibrations` list damages by hand, `mutator` makes any number more.
Every damage works on a copy whose files may be hard links to the healthy ones: files are always
replaced, never written into.
"""

import csv
import io
import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import yaml

Harm = Callable[[Path, np.random.Generator], None]


@dataclass(frozen=True)
class Damage:
    """One way to damage a capture.

    Attributes
    ----------
    name : str
    kind : str
        ``measurement`` or ``calibration``: what is damaged.
    harm : (folder, rng) -> None
    verdict : int or None
        What `treadlight check` must exit with; None where either is right.
    pixels : bool
        Whether a stage that reads the images must refuse or warn.
    """

    name: str
    kind: str
    harm: Harm
    verdict: int | None = 1
    pixels: bool = False


def listing(damages: list[Damage]):
    """A decorator that adds what it decorates to a list of damages."""

    def listed(kind: str = "measurement", verdict: int | None = 1, pixels: bool = False):
        def add(harm: Harm) -> Harm:
            damages.append(Damage(harm.__name__, kind, harm, verdict, pixels))
            return harm

        return add

    return listed


def copy_capture(source: Path, target: Path) -> Path:
    """A copy that shares its files with the source until they are replaced."""
    shutil.copytree(source, target, copy_function=os.link)
    return target


# Files, rows, images and facts.


def put(path: Path, data: bytes) -> None:
    path.unlink(missing_ok=True)
    path.write_bytes(data)


def table(folder: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO((folder / "frames.csv").read_text())))


def put_table(folder: Path, rows: list[dict[str, str]], **style) -> None:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n", **style)
    writer.writeheader()
    writer.writerows(rows)
    put(folder / "frames.csv", text.getvalue().encode("utf-8", "surrogateescape"))


def change_rows(folder: Path, change: Callable[[dict[str, str]], object], kind: str = "") -> None:
    rows = table(folder)
    for row in rows:
        if not kind or row["kind"] == kind:
            change(row)
    put_table(folder, rows)


def without_digests(folder: Path) -> None:
    change_rows(folder, lambda row: row.update(sha256=""))


def files_of(folder: Path, kind: str) -> list[Path]:
    return [folder / row["file"] for row in table(folder) if row["kind"] == kind]


def one_of(folder: Path, kind: str, rng: np.random.Generator) -> Path:
    files = files_of(folder, kind)
    return files[rng.integers(len(files))]


def pixels_of(path: Path) -> np.ndarray:
    return cv2.imread(str(path), cv2.IMREAD_UNCHANGED)


def put_pixels(path: Path, pixels: np.ndarray) -> None:
    put(path, cv2.imencode(".png", pixels)[1].tobytes())


def repaint(folder: Path, path: Path, change: Callable[[np.ndarray], np.ndarray]) -> None:
    """Another picture under a row that gives no digest."""
    without_digests(folder)
    put_pixels(path, change(pixels_of(path)))


def change_facts(folder: Path, **changes) -> None:
    """Set facts by dotted name (__ for the dot); None takes one out."""
    facts = yaml.safe_load((folder / "capture.yaml").read_text())
    for name, value in changes.items():
        *path, last = name.split("__")
        node = facts
        for part in path:
            node = node[part]
        if value is None:
            node.pop(last, None)
        else:
            node[last] = value
    put(folder / "capture.yaml", yaml.safe_dump(facts).encode())


def any_kind(folder: Path, rng: np.random.Generator) -> Path:
    return one_of(folder, ("laser", "led")[rng.integers(2)], rng)


def of_fact(name: str, value, verdict: int | None = 1, kind: str = "measurement") -> Damage:
    """The damage that puts a value into capture.yaml; see `change_facts` for the name."""

    def harm(folder, rng):
        change_facts(folder, **{name: value})

    shown = "".join(c if c.isalnum() else "_" for c in str(value)[:20])
    return Damage(f"fact_{name}_{shown}", kind, harm, verdict)
