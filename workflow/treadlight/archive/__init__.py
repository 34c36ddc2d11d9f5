"""Captures on disk: manifests, discovery, validation, choice of calibration."""

from treadlight.archive.discovery import Archive, choose_calibration, find_archive
from treadlight.archive.manifest import Capture, Encoding, Frame, read_capture

__all__ = [
    "Archive",
    "Capture",
    "Encoding",
    "Frame",
    "choose_calibration",
    "find_archive",
    "read_capture",
]
