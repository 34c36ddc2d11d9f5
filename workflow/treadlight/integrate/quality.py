"""Flags and figures of merit of a profile (profile.zarr `quality`, quality.json)."""

from typing import Any

import numpy as np

from treadlight import tread
from treadlight.compiling import kernel
from treadlight.geometry import Rig
from treadlight.integrate.profile import Profile
from treadlight.threads import by_ranges

# In the order of the bits that `_flags` sets.
FLAGS = ("laser", "photometric", "shadowed", "saturated", "interpolated", "step", "refused")
_AXIS = tuple(f"axis.{part}.{k}" for part in ("direction", "point") for k in "xyz")


def quality_flags(profile: Profile) -> np.ndarray:
    """Bits of `FLAGS` per cell, (n, m) uint8."""
    flags = np.empty(profile.r.shape, np.uint8)
    masks = profile.laser, profile.photometric, profile.shadowed, profile.saturated, profile.step
    by_ranges(_flags, len(flags), 1, profile.r, *masks, flags)
    return flags


@kernel
def _flags(first, last, r, laser, photometric, shadowed, saturated, step, flags):
    for i in range(first, last):
        for j in range(r.shape[1]):
            known = np.isfinite(r[i, j])
            interpolated = known and not (photometric[i, j] or laser[i, j])
            flags[i, j] = (
                laser[i, j]
                | photometric[i, j] << 1
                | shadowed[i, j] << 2
                | saturated[i, j] << 3
                | interpolated << 4
                | step[i, j] << 5
                | (not known) << 6
            )


def quality_report(
    profile: Profile,
    regions: tread.Regions,
    rig: Rig,
    closure_mm: float | None,
    warnings: list[str],
) -> dict[str, Any]:
    """The content of quality.json."""
    finite = np.isfinite(profile.r)
    flags = quality_flags(profile)
    median, high = profile.normal_residual
    held = profile.held_out
    return {
        "coverage": {
            "tread": float(finite.mean()),
            "rib": _share(finite[:, regions.rib_of_column > 0]),
            "groove": _share(finite[:, regions.floor_of_column > 0]),
        },
        "laser_points": profile.laser_points,
        "held_out_laser_mm": {
            "n": held.n,
            "bias": held.bias,
            "rms": held.rms,
            "laser_std": held.laser_std,
            "shape_rms": held.shape_rms,
        },
        "frame_std": frame_std(rig),
        "closure_mm": closure_mm,
        "normal_residual": {"median": median, "p95": high},
        "flags": {name: float(np.mean((flags >> bit) & 1)) for bit, name in enumerate(FLAGS)},
        "warnings": warnings,
    }


def _share(mask: np.ndarray) -> float | None:
    return float(mask.mean()) if mask.size else None


def frame_std(rig: Rig) -> dict[str, float | None]:
    """What the calibration adds to the frame, from the covariance of the axis; None if unknown.

    An axis that is `d` mm too deep makes every radius `d` too large, to first order; moved along
    itself it shifts z; turned, it tilts the whole tire.
    """
    missing: dict[str, float | None] = {"radial_mm": None, "axial_mm": None, "tilt_rad": None}
    if rig.covariance is None or rig.axis is None:
        return missing
    if any(name not in rig.covariance_order for name in _AXIS):
        return missing
    index = [rig.covariance_order.index(name) for name in _AXIS]
    covariance = rig.covariance[np.ix_(index, index)]
    turn, shift = covariance[:3, :3], covariance[3:, 3:]
    towards_camera, across, _ = rig.axis.basis
    # z is counted from the camera's foot: its shift is that of the foot, point and turn both.
    lever = float(np.linalg.norm(rig.axis.point))
    return {
        "radial_mm": _std(towards_camera, shift),
        "axial_mm": lever * _std(towards_camera, turn),
        "tilt_rad": float(np.hypot(_std(towards_camera, turn), _std(across, turn))),
    }


def _std(direction: np.ndarray, covariance: np.ndarray) -> float:
    return float(np.sqrt(max(direction @ covariance @ direction, 0.0)))
