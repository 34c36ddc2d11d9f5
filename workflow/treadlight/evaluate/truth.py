"""Reading the truth that a rendered capture carries."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from treadlight.geometry import Axis, Camera, Led, Plane, Rig


@dataclass(frozen=True)
class Profile:
    """A true surface in {T}: theta (n,) rad, z (m,) mm, r (n, m) mm."""

    theta: np.ndarray
    z: np.ndarray
    r: np.ndarray


def read_true_rig(path: Path) -> Rig:
    """The rig of truth/rig.yaml."""
    truth: dict[str, Any] = yaml.safe_load(path.read_text(encoding="utf-8"))
    camera = truth["camera"]
    return Rig(
        camera=Camera(
            np.array(camera["matrix"], float),
            np.array(camera["distortion"], float),
            (camera["size_px"][0], camera["size_px"][1]),
        ),
        laser_plane=_plane(truth.get("laser_plane")),
        axis=Axis.through(truth["axis"]["direction"], truth["axis"]["point"]),
        reference_plane=_plane(truth.get("reference_plane")),
        leds=tuple(
            Led(led["led"], np.array(led["position"], float), float(led["intensity"]))
            for led in truth.get("leds") or ()
        ),
    )


def _plane(content: dict[str, Any] | None) -> Plane | None:
    if content is None:
        return None
    coefficients = np.array(content["coefficients"], float)
    return Plane(coefficients[:3], float(coefficients[3]))


def read_true_profile(path: Path) -> Profile:
    """truth/profile.npz."""
    with np.load(path) as data:
        return Profile(data["theta"], data["z"], data["r"].astype(np.float64))


def read_true_wear(path: Path) -> Profile:
    """truth/wear.npz; `r` holds the wear, mm, in the frame of the tire's first capture."""
    with np.load(path) as data:
        return Profile(data["theta"], data["z"], data["wear"].astype(np.float64))
