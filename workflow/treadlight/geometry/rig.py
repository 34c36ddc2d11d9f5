"""A calibrated rig: what every stage after the calibration needs to know of it."""

from dataclasses import dataclass

import numpy as np

from treadlight.geometry.axis import Axis
from treadlight.geometry.camera import Camera
from treadlight.geometry.plane import Plane


@dataclass(frozen=True)
class Led:
    """One LED as a near point source.

    Attributes
    ----------
    number : int
    position : (3,) float
        {C}, mm.
    intensity : float
        Relative to the mean of all LEDs.
    """

    number: int
    position: np.ndarray
    intensity: float


@dataclass(frozen=True)
class Rig:
    """The calibrated rig. A part that the calibration had no frames for is None (or empty).

    Attributes
    ----------
    camera : Camera
    laser_plane : Plane or None
    axis : Axis or None
    reference_plane : Plane or None
    leds : tuple of Led
    covariance_order : tuple of str
        Names of the rows of `covariance`, such as ``camera.fx`` or ``axis.point.z``.
    covariance : (n, n) float
        Of the named parameters, in their own units.
    """

    camera: Camera
    laser_plane: Plane | None = None
    axis: Axis | None = None
    reference_plane: Plane | None = None
    leds: tuple[Led, ...] = ()
    covariance_order: tuple[str, ...] = ()
    covariance: np.ndarray | None = None
