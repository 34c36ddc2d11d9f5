"""Radii on the block tops of the sample archive, with the true calibration, by our detector and
by the half-maximum centroid on the same images."""

from pathlib import Path

import numpy as np
from rivals import half_maximum

from treadlight.archive import Capture, Frame, read_capture
from treadlight.commands.detect_laser_pixels import detect_capture
from treadlight.evaluate.surface import classify, interpolate_at, outer_envelope
from treadlight.evaluate.truth import read_true_profile, read_true_rig
from treadlight.images import FrameReader
from treadlight.laser import triangulate_pixels

CAPTURES = ("t7-00100", "t7-00200")
# The centroid of a row without light is nowhere: its maximum exceeds the noise so many times.
_LIT = 5.0

Figures = dict[str, float | int]


def sample_figures(archive: Path) -> dict[str, dict[str, Figures]]:
    """Errors of r on block tops by capture and detector, um, and the share of rows found."""
    return {name: _capture_figures(read_capture(archive / name)) for name in CAPTURES}


def _capture_figures(capture: Capture) -> dict[str, Figures]:
    pixels = detect_capture(capture, threads=1)
    chosen = pixels["path"].values
    taken = np.take_along_axis(pixels["u"].values, np.maximum(chosen, 0)[..., None], -1)[..., 0]
    ours = np.where(chosen >= 0, taken, np.nan).astype(float)
    frames = sorted(capture.of_kind("laser"), key=lambda f: (f.encoder_deg or 0.0, f.pose or 0))
    plain = _half_maxima(capture, frames, pixels.attrs["noise"])
    encoder = pixels["encoder"].values
    return {
        "treadlight": _figures(capture, ours, encoder),
        "half maximum": _figures(capture, plain, encoder),
    }


def _half_maxima(capture: Capture, frames: list[Frame], noise: float) -> np.ndarray:
    reader = FrameReader(capture)
    found = []
    for frame in frames:
        intensity = reader.read(frame).intensity
        if capture.laser_scan == "columns":
            intensity = intensity.T
        lit = intensity.max(axis=1) > _LIT * noise
        found.append(np.where(lit, half_maximum(intensity, np.nan), np.nan))
    return np.stack(found)


def _figures(capture: Capture, u: np.ndarray, encoder: np.ndarray) -> Figures:
    truth = read_true_profile(capture.folder / "truth" / "profile.npz")
    rig = read_true_rig(capture.folder / "truth" / "rig.yaml")
    assert rig.axis is not None
    # The uncertainties play no part.
    points, _ = triangulate_pixels(u[..., None], u[..., None], capture.laser_scan, rig)
    theta, z, r = rig.axis.to_tire(points[..., 0, :], encoder[:, None])
    top = classify(truth, outer_envelope(truth))["top"].astype(float)
    error_um = 1000 * (r - interpolate_at(truth, truth.r, theta, z))
    error_um = error_um[interpolate_at(truth, top, theta, z) > 0.5]
    error_um = error_um[np.isfinite(error_um)]
    return {
        "median_abs_um": float(np.median(np.abs(error_um))),
        "bias_um": float(np.median(error_um)),
        "rms_um": float(np.sqrt(np.mean(error_um**2))),
        "p95_um": float(np.percentile(np.abs(error_um), 95)),
        "points": len(error_um),
        "rows_found": float(np.isfinite(u).mean()),
    }
