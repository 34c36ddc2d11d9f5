"""What a capture holds and what will be missing downstream, from its manifest alone."""

import hashlib
import json
from typing import Any

import numpy as np

from treadlight.archive.manifest import (
    CALIBRATION_KINDS,
    MEASUREMENT_KINDS,
    Capture,
    Frame,
)

# Algorithm 4 has four unknowns per pixel: two tilts, k_d and k_s.
MIN_LEDS = 4
_NEEDED_BY = {
    "board": "There are no board frames: the camera cannot be calibrated, nothing can be measured.",
    "board_laser": "There are no board_laser frames: no laser plane, so no laser sections.",
    "axis_board": "There are no axis_board frames: no rotation axis, so no profile.",
    "reference_board": "There are no reference_board frames: no reference plane, so no LED"
    " positions and no photometry.",
    "balls": "There are no balls frames: no LED positions, so captures give laser profiles only.",
    "card": "There are no card frames: the illumination is taken as even, k_d and k_s are"
    " relative.",
}


def inventory(capture: Capture, digests: dict[str, str]) -> dict[str, Any]:
    """Counts, angles, exposures, digests and plain sentences about what is missing.

    Parameters
    ----------
    capture : Capture
    digests : dict of str to str
        SHA-256 of each frame's file as it is on disk.

    Returns
    -------
    dict
        ``capture``, ``kind``, ``rig``, ``captured_at``, ``size_px``, ``kinds`` {kind: {frames,
        digest, exposure_s}}, ``views``, ``sections``, ``encoder_deg`` {kind: coverage},
        ``missing`` [sentence], ``damaged`` [sentence], ``files`` {file: sha256}; of a
        measurement also ``tire`` and ``mileage``.
    """
    kinds = MEASUREMENT_KINDS if capture.kind == "measurement" else CALIBRATION_KINDS
    content: dict[str, Any] = {
        "capture": capture.id,
        "kind": capture.kind,
        "rig": capture.rig,
        "captured_at": capture.captured_at.isoformat(),
        "size_px": list(capture.encoding.size_px),
        "kinds": {kind: _kind(capture.of_kind(kind), digests) for kind in kinds},
        "encoder_deg": {
            kind: angular_coverage([f.encoder_deg for f in frames if f.encoder_deg is not None])
            for kind in kinds
            if (frames := capture.of_kind(kind)) and frames[0].encoder_deg is not None
        },
    }
    if capture.tire is not None:
        content["tire"] = capture.tire.id
        content["mileage"] = {"value": capture.mileage, "unit": capture.mileage_unit}
        content["sections"] = len(capture.of_kind("laser"))
        content["views"] = [_view(capture, number) for number in capture.views]
    content["missing"] = missing(capture)
    content["damaged"] = [
        f"{frame.file}: its content differs from sha256 in frames.csv. Restore the image, or"
        " correct the digest if the change was meant."
        for frame in capture.frames
        if frame.sha256 and frame.sha256 != digests[frame.file]
    ]
    content["files"] = {frame.file: digests[frame.file] for frame in capture.frames}
    return content


def missing(capture: Capture) -> list[str]:
    """Plain sentences about what a capture's frames leave out, and what follows from it."""
    if capture.tire is not None:
        return _missing_of_measurement(capture)
    return _missing_of_calibration(capture)


def _kind(frames: tuple[Frame, ...], digests: dict[str, str]) -> dict[str, Any]:
    rows = sorted([frame.file, digests[frame.file]] for frame in frames)
    known = [frame.exposure_s for frame in frames if frame.exposure_s is not None]
    return {
        "frames": len(frames),
        "digest": hashlib.sha256(json.dumps(rows).encode()).hexdigest() if rows else None,
        "exposure_s": {"min": min(known), "max": max(known)} if known else None,
        "exposures_missing": len(frames) - len(known),
    }


def angular_coverage(encoder_deg: list[float]) -> dict[str, Any]:
    """How much of a turn a set of encoder angles covers.

    ``span`` is what the largest gap leaves of 360 degrees; ``whole_turn`` tells whether that
    gap is no more than one and a half times the median step.
    """
    angles = np.unique(np.mod(encoder_deg, 360.0))
    gaps = np.diff(np.append(angles, angles[0] + 360.0))
    largest = float(gaps.max())
    median = float(np.median(gaps))
    return {
        "first": float(encoder_deg[0]),
        "last": float(encoder_deg[-1]),
        "positions": len(angles),
        "median_step": round(median, 6) if len(angles) > 1 else None,
        "span": round(360.0 - largest, 6),
        "whole_turn": bool(len(angles) > 2 and largest <= 1.5 * median),
    }


def _view(capture: Capture, number: int) -> dict[str, Any]:
    frames = capture.view(number)
    present = {frame.led for frame in frames}
    return {
        "view": number,
        "encoder_deg": frames[0].encoder_deg,
        "leds": len(present),
        "missing_leds": [led for led in range(capture.leds) if led not in present],
    }


def _missing_of_measurement(capture: Capture) -> list[str]:
    found = []
    if not capture.of_kind("laser"):
        found.append(
            "There are no laser frames: photometry starts from the nominal cylinder, and absolute"
            " heights are not measured."
        )
    if not capture.of_kind("led"):
        found.append(
            "There are no LED frames: the profile comes from the laser alone, without normals."
        )
    for number in capture.views:
        view = _view(capture, number)
        if view["leds"] < MIN_LEDS:
            found.append(
                f"View {number} has {view['leds']} LED frames, fewer than {MIN_LEDS}: it gives no"
                " normals."
            )
        elif view["missing_leds"]:
            listed = ", ".join(map(str, view["missing_leds"]))
            found.append(f"View {number} lacks frames of these LEDs: {listed}.")
    return found + _missing_of_both(capture, ("led",))


def _missing_of_calibration(capture: Capture) -> list[str]:
    found = [text for kind, text in _NEEDED_BY.items() if not capture.of_kind(kind)]
    for kind in ("balls", "card"):
        present = {frame.led for frame in capture.of_kind(kind)}
        absent = [str(led) for led in range(capture.leds) if led not in present]
        if present and absent:
            found.append(f"There are no {kind} frames of these LEDs: {', '.join(absent)}.")
    boards = {frame.pose for frame in capture.of_kind("board")}
    alone = [str(f.pose) for f in capture.of_kind("board_laser") if f.pose not in boards]
    if alone:
        found.append(f"These board_laser poses have no board frame: {', '.join(alone)}.")
    return found + _missing_of_both(capture, ("balls", "card"))


def _missing_of_both(capture: Capture, lit: tuple[str, ...]) -> list[str]:
    found = []
    if not capture.of_kind("dark"):
        found.append("There is no dark frame: black_level is subtracted instead.")
    for kind in lit:
        frames = capture.of_kind(kind)
        unknown = sum(frame.exposure_s is None for frame in frames)
        if unknown:
            found.append(
                f"{unknown} of {len(frames)} {kind} frames have no exposure_s: exposures of this"
                " kind count as equal, k_d and k_s are relative."
            )
    return found
