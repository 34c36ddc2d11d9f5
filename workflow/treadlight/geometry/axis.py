"""The rotation axis and the tire frame {T} that it defines."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np


def wrap_angle(angle: np.ndarray) -> np.ndarray:
    """Angles in radians brought into [-pi, pi)."""
    return (np.asarray(angle) + np.pi) % (2 * np.pi) - np.pi


@dataclass(frozen=True)
class Axis:
    """The turntable's axis: a growing encoder angle is a right-handed turn about `direction`.

    {C0} is {C} (the camera does not move); {T} has its x from the axis to the camera centre,
    its z along the axis, and turns with the tire from encoder zero.

    Attributes
    ----------
    direction : (3,) float
        Unit vector v in {C}.
    point : (3,) float
        Foot of the perpendicular from the camera centre, {C}, mm.
    """

    direction: np.ndarray
    point: np.ndarray

    @classmethod
    def through(cls, direction: np.ndarray, point: np.ndarray) -> "Axis":
        """The axis along `direction` (3,) through any `point` (3,) of it, {C}, mm."""
        direction = np.asarray(direction, float) / np.linalg.norm(direction)
        point = np.asarray(point, float)
        return cls(direction, point - direction * (point @ direction))

    @cached_property
    def basis(self) -> np.ndarray:
        """(3, 3): rows are the x, y, z axes of {T} at encoder zero, in {C}."""
        towards_camera = -self.point / np.linalg.norm(self.point)
        return np.stack([towards_camera, np.cross(self.direction, towards_camera), self.direction])

    def to_tire(
        self, points: np.ndarray, encoder: np.ndarray | float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Points seen at an encoder angle, in {T} (eqs. 3.1, with atan2, and 4.1).

        Parameters
        ----------
        points : (..., 3) float
            In {C}, mm.
        encoder : (...) float
            Encoder angle at which they were seen, rad.

        Returns
        -------
        theta, z, r : (...) float
            Rad in [-pi, pi), mm, mm.
        """
        x, y, z = np.moveaxis((points - self.point) @ self.basis.T, -1, 0)
        return wrap_angle(np.arctan2(y, x) - encoder), z, np.hypot(x, y)

    def to_camera(
        self, theta: np.ndarray, z: np.ndarray, r: np.ndarray, encoder: np.ndarray | float
    ) -> np.ndarray:
        """The inverse of `to_tire`: points (..., 3) in {C}, mm, at the encoder angle."""
        angle = np.asarray(theta) + encoder
        local = np.stack(np.broadcast_arrays(r * np.cos(angle), r * np.sin(angle), z), axis=-1)
        return local @ self.basis + self.point

    def vectors_to_local(
        self, vectors: np.ndarray, theta: np.ndarray, encoder: np.ndarray | float
    ) -> np.ndarray:
        """Vectors (..., 3) of {C} at an encoder angle in the basis (r, theta, z) at `theta`."""
        x, y, z = np.moveaxis(vectors @ self.basis.T, -1, 0)
        c, s = np.cos(theta + encoder), np.sin(theta + encoder)
        return np.stack([c * x + s * y, c * y - s * x, z], axis=-1)

    def vectors_to_camera(
        self, vectors: np.ndarray, theta: np.ndarray, encoder: np.ndarray | float
    ) -> np.ndarray:
        """The inverse of `vectors_to_local`."""
        n_r, n_t, n_z = np.moveaxis(vectors, -1, 0)
        c, s = np.cos(theta + encoder), np.sin(theta + encoder)
        return np.stack([c * n_r - s * n_t, s * n_r + c * n_t, n_z], axis=-1) @ self.basis
