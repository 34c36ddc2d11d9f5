"""Any number of seeded damages: random changes of a measurement's files, rows, facts and images."""

import csv
from pathlib import Path

import cv2
import numpy as np
import yaml
from damage import (
    Damage,
    any_kind,
    put,
    put_table,
    repaint,
    table,
    without_digests,
)

_NASTY = ("", "nan", "-1", "1e308", "../x", "/etc/passwd", "\0", "'", '"', "\n", ",", ";", "[", "{",
          "&a", "*a", "!!python/name:os.system", "true", "null", "0", "9" * 400, "<script>", "é",
          "${HOME}", "`id`", "%s%n", "-", ": ", "# ", "\t", "|", ">", "\u0661", "\u202e",
          "a" * 5000)  # fmt: skip


def mutated(seed: int) -> Damage:
    """Damage number `seed` of the mutator: one to three random changes of a measurement."""
    rng = np.random.default_rng([20261124, seed])
    chosen = [_MUTATIONS[k] for k in rng.integers(len(_MUTATIONS), size=rng.integers(1, 4))]

    def harm(folder: Path, rng: np.random.Generator) -> None:
        for mutation in chosen:
            try:
                mutation(folder, rng)
            # An earlier change may have left nothing for this one to change.
            except (OSError, ValueError, IndexError, KeyError, TypeError, cv2.error, csv.Error):
                continue

    name = "+".join(mutation.__name__.strip("_") for mutation in chosen)
    return Damage(f"mutation_{seed}:{name}", "measurement", harm, None)


def _flip_bytes(path: Path, rng: np.random.Generator) -> None:
    data = bytearray(path.read_bytes())
    for at in rng.integers(len(data), size=rng.integers(1, 6)):
        data[at] = rng.integers(256)
    put(path, bytes(data))


def _cut_bytes(path: Path, rng: np.random.Generator) -> None:
    data = path.read_bytes()
    start, stop = np.sort(rng.integers(len(data) + 1, size=2))
    put(path, data[:start] + data[stop:])


def _insert_nasty(path: Path, rng: np.random.Generator) -> None:
    data, word = path.read_bytes(), _NASTY[rng.integers(len(_NASTY))]
    at = rng.integers(len(data) + 1)
    put(path, data[:at] + word.encode() + data[at:])


def _document(folder: Path, rng: np.random.Generator) -> Path:
    return folder / ("capture.yaml", "frames.csv")[rng.integers(2)]


def flip_bytes_of_a_document(folder, rng):
    _flip_bytes(_document(folder, rng), rng)


def cut_bytes_of_a_document(folder, rng):
    _cut_bytes(_document(folder, rng), rng)


def insert_into_a_document(folder, rng):
    _insert_nasty(_document(folder, rng), rng)


def flip_bytes_of_an_image(folder, rng):
    _flip_bytes(any_kind(folder, rng), rng)


def flip_bytes_of_an_image_without_digest(folder, rng):
    without_digests(folder)
    _flip_bytes(any_kind(folder, rng), rng)


def cut_bytes_of_an_image(folder, rng):
    without_digests(folder)
    _cut_bytes(any_kind(folder, rng), rng)


def exchange_two_images(folder, rng):
    a, b = any_kind(folder, rng), any_kind(folder, rng)
    one, two = a.read_bytes(), b.read_bytes()
    put(a, two)
    put(b, one)


def change_a_cell(folder, rng):
    rows = table(folder)
    row = rows[rng.integers(len(rows))]
    row[list(row)[rng.integers(len(row))]] = _NASTY[rng.integers(len(_NASTY))]
    put_table(folder, rows)


def change_a_fact(folder, rng):
    facts = yaml.safe_load((folder / "capture.yaml").read_text())
    node, name = facts, list(facts)[rng.integers(len(facts))]
    if isinstance(facts[name], dict) and rng.integers(2):
        node = facts[name]
        name = list(node)[rng.integers(len(node))]
    values = (None, [], {}, -1, 1e308, float("nan"), True, "x", [[1]], 10**30)
    node[name] = values[rng.integers(len(values))]
    put(folder / "capture.yaml", yaml.safe_dump(facts).encode())


def drop_a_line(folder, rng):
    path = _document(folder, rng)
    lines = path.read_bytes().splitlines(keepends=True)
    del lines[rng.integers(len(lines))]
    put(path, b"".join(lines))


def repeat_a_line(folder, rng):
    path = _document(folder, rng)
    lines = path.read_bytes().splitlines(keepends=True)
    lines.insert(int(rng.integers(len(lines))), lines[rng.integers(len(lines))])
    put(path, b"".join(lines))


def repaint_an_image(folder, rng):
    noise = rng.integers(65536, size=(2, 2), dtype=np.uint16)

    def change(image):
        paints = (
            np.zeros_like,
            lambda i: np.full_like(i, 65535),
            lambda i: np.rot90(i),
            lambda i: i[::-1],
            lambda i: np.roll(i, 40, axis=1),
            lambda i: cv2.resize(noise, i.shape[1::-1]),
            lambda i: i.astype(np.uint8),
            lambda i: np.dstack([i] * 3) if i.ndim == 2 else i[:, :, 0],
            lambda i: np.repeat(i, 3, axis=1),
        )
        return paints[rng.integers(len(paints))](image)

    repaint(folder, any_kind(folder, rng), change)


_MUTATIONS = (
    flip_bytes_of_a_document,
    cut_bytes_of_a_document,
    insert_into_a_document,
    flip_bytes_of_an_image,
    flip_bytes_of_an_image_without_digest,
    cut_bytes_of_an_image,
    exchange_two_images,
    change_a_cell,
    change_a_fact,
    drop_a_line,
    repeat_a_line,
    repaint_an_image,
)
