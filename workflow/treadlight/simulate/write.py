"""Captures on disk: images, frames.csv, capture.yaml and truth/, published in one move."""

import csv
import hashlib
import io
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from treadlight import store

_COLUMNS = ("file", "kind", "pose", "led", "encoder_deg", "exposure_s", "sha256")
# Level 1 of zlib: 12 noisy bits hardly pack better at any other.
_PNG = (cv2.IMWRITE_PNG_COMPRESSION, 1)


class CaptureWriter:
    """Writes one capture into a temporary sibling of its folder; `publish` moves it there.

    Parameters
    ----------
    folder : Path
        The capture's folder in the archive.
    """

    def __init__(self, folder: Path):
        self.folder = folder
        self._temporary = folder.with_name(f".{folder.name}.writing")
        shutil.rmtree(self._temporary, ignore_errors=True)
        (self._temporary / "truth").mkdir(parents=True)
        self._rows: list[dict[str, Any]] = []

    def image(self, file: str, counts: np.ndarray, **row: Any) -> None:
        """Write a frame, (h, w) or (h, w, 3) BGR uint16, and its row of frames.csv."""
        data = cv2.imencode(".png", counts, _PNG)[1].tobytes()
        path = self._temporary / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
        self._rows.append({"file": file, "sha256": hashlib.sha256(data).hexdigest(), **row})

    def arrays(self, name: str, **arrays: np.ndarray) -> None:
        """Write truth/<name>.npz."""
        # Not as they came: numpy's stubs take arrays by keyword for the option allow_pickle.
        contents: dict[str, Any] = dict(arrays)
        np.savez_compressed(self._temporary / "truth" / f"{name}.npz", **contents)

    def publish(self, facts: dict[str, Any], truth: dict[str, Any]) -> None:
        """Write capture.yaml, frames.csv and truth/rig.yaml, then move the capture into place."""
        table = io.StringIO()
        rows = csv.DictWriter(table, _COLUMNS, restval="", lineterminator="\n")
        rows.writeheader()
        rows.writerows(self._rows)
        (self._temporary / "frames.csv").write_text(table.getvalue(), encoding="utf-8")
        _write_yaml(self._temporary / "capture.yaml", facts)
        _write_yaml(self._temporary / "truth" / "rig.yaml", truth)
        store.publish(self._temporary, self.folder)


def _write_yaml(path: Path, content: dict[str, Any]) -> None:
    text = yaml.safe_dump(_plain(content), sort_keys=False, default_flow_style=None, width=100)
    path.write_text(text, encoding="utf-8")


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value.item() if isinstance(value, np.generic) else value
