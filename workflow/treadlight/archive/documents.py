"""What people write (capture.yaml, frames.csv), read within limits that no real file reaches."""

import csv
import io
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

from treadlight.errors import CaptureError

_MAX_YAML_BYTES = 256 << 10
_MAX_YAML_DEPTH = 20
_MAX_YAML_NODES = 20_000
_MAX_CSV_BYTES = 64 << 20
_MAX_ROWS = 200_000


def read_yaml(path: Path) -> dict[str, Any]:
    """A YAML mapping of plain values: no objects are built, no key stands twice.

    Raises
    ------
    CaptureError
        The file is missing, too large, too deep, swollen by aliases, or no such mapping.
    """
    text = _read_text(path, _MAX_YAML_BYTES)
    loader = None
    try:
        loader = _Loader(text)
        node = loader.get_single_node()
        if node is not None:
            _count_nodes(node, {})
        data = loader.construct_document(node) if node is not None else None
    except Exception as error:  # the library raises whatever its converters raise
        reason = _yaml_reason(error)
        raise CaptureError(f"{path}: is not valid YAML ({reason}). Correct it.") from None
    finally:
        if loader is not None:
            loader.dispose()
    if not isinstance(data, dict):
        raise CaptureError(f"{path}: must be a mapping of names to values.")
    return data


def read_rows(path: Path, needed: tuple[str, ...]) -> list[tuple[int, dict[str, str]]]:
    """Rows of a CSV file with a header: (line number, cell by column).

    A byte order mark, either kind of line end, and columns that nobody asked for do no harm.

    Raises
    ------
    CaptureError
        The file is missing, too large, not separated by commas, has a ragged row, or lacks a
        needed column.
    """
    text = _read_text(path, _MAX_CSV_BYTES, encoding="utf-8-sig")
    try:
        reader = csv.reader(io.StringIO(text, newline=""), strict=True)
        header = [name.strip() for name in next(reader, [])]
        _check_header(path, header, needed)
        return [*_cells(path, reader, header)]
    except csv.Error as error:
        raise CaptureError(
            f"{path}, row {reader.line_num}: is not valid CSV ({error}). Correct the row."
        ) from None


def _read_text(path: Path, limit: int, encoding: str = "utf-8") -> str:
    try:
        status = path.stat()
        # A pipe or a device would be waited for, perhaps for ever.
        if not stat.S_ISREG(status.st_mode):
            raise CaptureError(f"{path}: is no file. Put the document there.")
        if status.st_size > limit:
            raise CaptureError(
                f"{path}: is larger than {limit >> 10} KiB, which no such document is. Put the"
                " right file there."
            )
        with path.open("rb") as stream:
            return stream.read(limit).decode(encoding)
    except FileNotFoundError:
        raise CaptureError(
            f"{path}: cannot be read (it is not there). A capture needs it; add it."
        ) from None
    except OSError as error:
        raise CaptureError(f"{path}: cannot be read ({error.strerror}). Mend that.") from None
    except UnicodeDecodeError as error:
        raise CaptureError(
            f"{path}: is not UTF-8 text (byte {error.start}). Save it as UTF-8."
        ) from None


class _Loader(yaml.SafeLoader):
    """Plain values only; keys that stand twice are refused, nesting is limited."""

    def compose_node(self, parent: Any, index: Any) -> yaml.Node | None:
        self._depth = getattr(self, "_depth", 0) + 1
        if self._depth > _MAX_YAML_DEPTH:
            raise yaml.YAMLError(f"nested deeper than {_MAX_YAML_DEPTH}")
        try:
            return super().compose_node(parent, index)
        finally:
            self._depth -= 1

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        seen: set[Any] = set()
        for key_node, _ in node.value:
            if key_node.tag == "tag:yaml.org,2002:merge":
                continue
            if not isinstance(key_node, yaml.ScalarNode):
                raise yaml.YAMLError("a key that is no plain text")
            key = self.construct_object(key_node, deep=True)
            if key in seen:
                line = key_node.start_mark.line + 1
                raise yaml.YAMLError(f"line {line} gives {key!r} a second time")
            seen.add(key)
        return super().construct_mapping(node, deep)


def _count_nodes(node: yaml.Node, known: dict[int, int]) -> int:
    """Nodes of a document with every alias written out."""
    if id(node) in known:
        if known[id(node)] < 0:
            raise yaml.YAMLError("an anchor that contains itself")
        return known[id(node)]
    known[id(node)] = -1
    count = 1
    if isinstance(node, yaml.SequenceNode):
        count += sum(_count_nodes(child, known) for child in node.value)
    elif isinstance(node, yaml.MappingNode):
        count += sum(_count_nodes(part, known) for pair in node.value for part in pair)
    if count > _MAX_YAML_NODES:
        raise yaml.YAMLError(f"more than {_MAX_YAML_NODES} values, aliases written out")
    known[id(node)] = count
    return count


def _yaml_reason(error: Exception) -> str:
    mark = getattr(error, "problem_mark", None)
    problem = getattr(error, "problem", None)
    if isinstance(error, RecursionError):
        return "nested too deep"
    if mark is not None and problem:
        return f"line {mark.line + 1}: {problem}"
    return " ".join(str(error).split())


def _check_header(path: Path, header: list[str], needed: tuple[str, ...]) -> None:
    twice = next((name for name in header if name and header.count(name) > 1), None)
    if twice:
        raise CaptureError(f"{path}: has the column {twice!r} twice. Leave one of them out.")
    missing = [name for name in needed if name not in header]
    if not missing:
        return
    separator = next((s for s in (";", "\t", "|") if any(s in name for name in header)), None)
    if separator:
        raise CaptureError(
            f"{path}: is separated by {separator!r} in its header. Separate its columns by commas."
        )
    raise CaptureError(f"{path}: has no column '{missing[0]}'. Add it to the header.")


def _cells(path: Path, reader: Any, header: list[str]) -> Iterator[tuple[int, dict[str, str]]]:
    for count, row in enumerate(reader):
        if not row:
            continue
        if len(row) != len(header):
            raise CaptureError(
                f"{path}, row {reader.line_num}: has {len(row)} cells, the header {len(header)}."
                " Give each row one cell per column."
            )
        if count >= _MAX_ROWS:
            raise CaptureError(f"{path}: has more than {_MAX_ROWS} rows. Split the capture.")
        yield reader.line_num, dict(zip(header, (cell.strip() for cell in row), strict=True))
