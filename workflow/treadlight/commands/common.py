"""What the commands share: settings, refusal, provenance, progress."""

import argparse
import contextlib
import dataclasses
import hashlib
import importlib.metadata
import json
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import treadlight
from treadlight import store
from treadlight.errors import CaptureError, ConfigError, StoreError, sentence_of

if TYPE_CHECKING:
    from treadlight.archive import Frame
    from treadlight.images import FrameReader, LinearFrame

T = TypeVar("T")
# The machine's trouble (disk, memory, threads) and damaged products: mended, the same command
# makes the product. All else is the data's, foreseen or not, and must not stop other captures.
_NOT_OF_THE_DATA = (
    OSError,
    MemoryError,
    ImportError,
    SystemError,
    RuntimeError,
    ConfigError,
    StoreError,
)
# Set by the workflow where its own messages go to a terminal.
TERMINAL = "TREADLIGHT_TERMINAL"
_VERSIONED = ("numpy", "scipy", "opencv-python-headless", "zarr", "xarray", "open3d", "numba")


def add_stage_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of every pipeline stage."""
    parser.add_argument("--settings", default="{}", help="the stage's part of the config, as JSON")
    parser.add_argument("--code", default="", help="digest of the stage's code, for provenance")


def parse_settings(text: str, cls: type[T]) -> T:
    """A settings dataclass from JSON.

    Raises
    ------
    ConfigError
        A key is unknown, or the text is no JSON mapping.
    """
    try:
        values = json.loads(text)
        return cls(**values)
    except (ValueError, TypeError) as error:
        raise ConfigError(f"--settings for {cls.__name__}: {error}.") from None


def run_stage(
    args: argparse.Namespace,
    *,
    inputs: Sequence[Path],
    outputs: Sequence[Path],
    title: str,
    source: str,
    work: Callable[[], None],
) -> int:
    """Run a stage's work; publish refused products where an input or a frame is unusable.

    Parameters
    ----------
    args : the parsed arguments, with `settings` and `code`.
    inputs, outputs : products, stores named by folder or root zarr.json.
    title, source : of a refused product.
    work : reads the inputs, computes, publishes the outputs.
    """
    reason = next((r for r in map(store.refused_reason, inputs) if r), None)
    if reason is None:
        try:
            work()
        except _NOT_OF_THE_DATA:
            raise
        except Exception as error:
            if "nsufficient memory" in str(error):  # as OpenCV says it
                raise MemoryError from error
            reason = sentence_of(error)
    if reason is not None:
        print(f"Refused: {reason}", file=sys.stderr)
        for output in outputs:
            store.write_refused(output, reason, title=title, source=source)
    write_provenance(args, inputs, outputs)
    return 0


def write_provenance(
    args: argparse.Namespace, inputs: Sequence[Path], outputs: Sequence[Path]
) -> None:
    """What a product was made from, in a file beside it that no rule reads."""
    content = {
        "command": args.command,
        "treadlight": treadlight.__version__,
        "code_digest": args.code,
        "config_digest": hashlib.sha256(args.settings.encode()).hexdigest(),
        "config": json.loads(args.settings),
        "inputs": {_short(path): product_digest(path) for path in inputs},
        "versions": {name: importlib.metadata.version(name) for name in _VERSIONED},
    }
    for output in outputs:
        whole = {"product": _short(output), "product_digest": product_digest(output)} | content
        path = store.provenance_of(store.store_folder(output))
        store.write_json(path, whole | {"digest": provenance_digest(whole)})


def provenance_digest(content: dict[str, Any]) -> str:
    """Digest of a provenance file's content but for the digest itself."""
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def print_report(report: Any, render: Callable[[Any], str], as_json: bool) -> None:
    """A report on stdout: one JSON object, or the text that `render` makes of it."""
    print(json.dumps(report, indent=1) + "\n" if as_json else render(report), end="")


def recorded_settings(product: Path) -> dict[str, Any]:
    """The settings that a product was made with, from what is written beside it."""
    content = store.read_json(store.provenance_of(product))
    settings: dict[str, Any] = content["config"]
    return settings


def _short(path: Path) -> str:
    """A product's name without the place of the results folder."""
    parts = store.store_folder(path).parts
    return "/".join(parts[-3:])


def product_digest(path: Path) -> str:
    """The content digest of a store, or the SHA-256 of a file."""
    folder = store.store_folder(path)
    if folder.is_dir():
        metadata = store.read_json(folder / store.ROOT_METADATA)
        return str(metadata["attributes"]["content_digest"])
    return hashlib.sha256(folder.read_bytes()).hexdigest()


def read_or_warn(
    reader: "FrameReader", frame: "Frame", warnings: list[str]
) -> "LinearFrame | None":
    """The frame as light; None, and a sentence among the warnings, where it is damaged."""
    try:
        return reader.read(frame)
    except CaptureError as error:
        warnings.append(f"{error} It is left out.")
        return None


def with_warnings(content: dict[str, Any], warnings: list[str]) -> dict[str, Any]:
    """A JSON product's content with its warnings, where there are any."""
    for warning in warnings:
        print(f"Warning: {warning}", file=sys.stderr)
    return {**content, "warnings": warnings} if warnings else content


def progress(
    items: Iterable[T], label: str, count: int | None = None, every_s: float = 5.0
) -> Iterator[T]:
    """Yield the items, saying how far the work is (`label`: 57 of 200), every few seconds.

    With a `count` the items may be made while they are asked for.
    """
    if count is None:
        items = list(items)
        count = len(items)
    last = time.monotonic()
    for done, item in enumerate(items):
        if time.monotonic() - last > every_s:
            say(f"{label}: {done} of {count}")
            last = time.monotonic()
        yield item


def say(line: str) -> None:
    """A line to the log (stderr) and, if Snakemake runs in one, to its terminal."""
    print(line, file=sys.stderr, flush=True)
    if os.environ.get(TERMINAL) and not sys.stderr.isatty():
        with contextlib.suppress(OSError), open("/dev/tty", "w", encoding="utf-8") as terminal:
            terminal.write(line + "\n")


def settings_defaults(cls: type) -> dict[str, Any]:
    """The defaults of a settings dataclass by name."""
    return {field.name: field.default for field in dataclasses.fields(cls)}
