"""Near point lights and how strongly each lights a point of the scene."""

from dataclasses import dataclass

import numpy as np

from treadlight.geometry.camera import Camera
from treadlight.geometry.plane import Plane
from treadlight.geometry.rig import Led
from treadlight.threads import by_ranges

_LEAST_POINTS = 1 << 14


@dataclass(frozen=True)
class Vignetting:
    """What a lens leaves of the light: 1 on the optical axis, less towards the corners.

    Attributes
    ----------
    linear, quadratic : float
        V = 1 + linear q + quadratic q^2, where q = tan^2 of the angle off the optical axis.
    reach : float
        q up to which it is known; V is held constant beyond.
    """

    linear: float = 0.0
    quadratic: float = 0.0
    reach: float = 0.0

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """V (...) at points (..., 3) in {C}, of any unit."""
        q = (points[..., 0] ** 2 + points[..., 1] ** 2) / points[..., 2] ** 2
        q = np.minimum(q, self.reach)
        return 1 + q * (self.linear + q * self.quadratic)


@dataclass(frozen=True)
class Illumination:
    """The LEDs as near point sources whose strength depends on the direction.

    Attributes
    ----------
    leds : tuple of Led
    reference_plane : Plane
        Holds the points whose directions the maps are given for.
    camera : Camera
    radiant_intensity : (n_leds, m, n) float32
        Irradiance times squared distance, mm2, of each LED in the direction of the point of
        the reference plane that the camera sees at pixel (v, u) = (row, column) * `step_px`.
        Scaled so that intensity / exposure = E (n.l) on a Lambertian surface of albedo 1.
    step_px : int
        Distance between the maps' nodes, pixels. Maps have at least two nodes each way.
    vignetting : Vignetting
        Of the camera's lens.
    """

    leds: tuple[Led, ...]
    reference_plane: Plane
    camera: Camera
    radiant_intensity: np.ndarray
    step_px: int = 1
    vignetting: Vignetting = Vignetting()

    def irradiance(self, index: int, points: np.ndarray) -> np.ndarray:
        """E at a surface that faces the LED, as the camera sees it, for points in front of it.

        The map is looked up where the line from the LED through the point meets the reference
        plane (beyond the image: at its border) and divided by the squared distance, so that a
        point off the plane gets its own irradiance (the dissertation's 6.3.4 takes the
        plane's). What the lens leaves of the light is that of the point's own pixel.

        Parameters
        ----------
        index : int
            Position in `leds` (not the LED's number).
        points : (..., 3) float
            {C}, mm.

        Returns
        -------
        (...) float64
            Intensity / exposure of a Lambertian albedo-1 surface at n.l = 1. NaN for NaN
            points, 0 for points that the LED has behind it, seen from the plane.
        """
        from treadlight.geometry.light_kernel import irradiance

        points = np.asarray(points, np.float64)
        position, plane = self.leds[index].position, self.reference_plane
        lit = np.empty(points.size // 3)
        by_ranges(
            irradiance,
            lit.size,
            _LEAST_POINTS,
            np.ascontiguousarray(points).reshape(-1, 3),
            np.asarray(position, np.float64),
            np.asarray(plane.normal, np.float64),
            float(plane.distance(position)),
            self.camera.intrinsics,
            tuple(float(k) for k in self.camera.distortion),
            self.radiant_intensity[index],
            self.step_px,
            (self.vignetting.linear, self.vignetting.quadratic, self.vignetting.reach),
            lit,
        )
        return lit.reshape(points.shape[:-1])


def map_nodes(size_px: tuple[int, int], step_px: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns (pixels, int64) of the nodes of a map over a whole image."""
    width, height = size_px
    columns = np.arange(-(-(width - 1) // step_px) + 1) * step_px
    return np.arange(-(-(height - 1) // step_px) + 1) * step_px, columns
