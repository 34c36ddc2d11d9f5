"""Digests of the frames of a capture, and the check of their headers, both remembered.

A file is read again only if its size or one of its times changed: planning stays quick on
archives of many captures, and an image that was touched but not changed reruns nothing.
"""

import hashlib
import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from treadlight.archive import Capture, Frame
from treadlight.errors import CaptureError
from treadlight.images import check_frame

_BLOCK = 1 << 20


class FrameDigests:
    """SHA-256 of the files of captures, remembered in a folder.

    Parameters
    ----------
    folder : Path
        Where what is known of each capture is kept, one JSON file per capture.
    """

    def __init__(self, folder: Path):
        self.folder = folder
        self._known: dict[str, dict[str, list[Any]]] = {}

    def check(self, capture: Capture) -> None:
        """Hash what changed and hold each changed image's header against the manifest.

        Raises
        ------
        CaptureError
            An image cannot be read, or its header is wrong.
        """
        memory = self.folder / f"{capture.id}.json"
        old = _load(memory, capture)
        new = {}
        for frame in capture.frames:
            path = capture.path(frame)
            try:
                stamp = _stamp(path)
                entry = old.get(frame.file)
                if entry is None or entry[:3] != stamp:
                    check_frame(capture, frame)
                    entry = [*stamp, _sha256(path)]
            except OSError as error:
                raise CaptureError(
                    f"{path}: cannot be read ({error.strerror}). Mend that, or drop its row."
                ) from None
            new[frame.file] = entry
        self._known[capture.id] = new
        if new != old:
            _save(memory, capture, new)

    def of_frames(self, capture: Capture, frames: Iterable[Frame]) -> str:
        """One digest over what the frames show and what the manifest says of each."""
        known = self._known[capture.id]
        rows = sorted(
            (
                f.kind,
                str(f.pose),
                str(f.led),
                str(f.encoder_deg),
                str(f.exposure_s),
                known[f.file][3],
            )
            for f in frames
        )
        return hashlib.sha256(json.dumps(rows).encode()).hexdigest()


def facts_digest(capture: Capture) -> str:
    """Digest of what capture.yaml says and of the angles in frames.csv, not of any pixel."""
    angles = sorted({(f.kind, f.pose or 0, f.encoder_deg or 0.0) for f in capture.frames})
    text = json.dumps([capture.facts, angles], default=str, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _stamp(path: Path) -> list[int]:
    stat = path.stat()
    return [stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns]


def _key(capture: Capture) -> str:
    return f"{capture.folder.resolve()} {capture.encoding.size_px} {capture.encoding.white_level}"


def _load(memory: Path, capture: Capture) -> dict[str, list[Any]]:
    try:
        content = json.loads(memory.read_text(encoding="utf-8"))
        return content["files"] if content["capture"] == _key(capture) else {}
    except (OSError, ValueError, KeyError, TypeError):
        return {}


def _save(memory: Path, capture: Capture, files: dict[str, list[Any]]) -> None:
    memory.parent.mkdir(parents=True, exist_ok=True)
    temporary = memory.with_name(f".{memory.name}.{os.getpid()}")
    temporary.write_text(json.dumps({"capture": _key(capture), "files": files}), encoding="utf-8")
    os.replace(temporary, memory)


def _sha256(path: Path) -> str:
    digest = hashlib.sha256()
    with path.open("rb") as stream:
        while block := stream.read(_BLOCK):
            digest.update(block)
    return digest.hexdigest()
