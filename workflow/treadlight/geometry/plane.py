"""Planes and where rays meet them."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Plane:
    """A x + B y + C z + D = 0 in {C}, mm.

    Attributes
    ----------
    normal : (3,) float
        (A, B, C), of unit length.
    offset : float
        D, mm.
    """

    normal: np.ndarray
    offset: float

    @classmethod
    def fit(cls, points: np.ndarray) -> "Plane":
        """Least-squares plane through (n, 3) points (total least squares), n >= 3."""
        centre = points.mean(axis=0)
        normal = np.linalg.svd(points - centre, full_matrices=False)[2][2]
        return cls(normal, float(-normal @ centre))

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Signed distances (...,) of points (..., 3), mm."""
        return points @ self.normal + self.offset

    def intersect(self, rays: np.ndarray) -> np.ndarray:
        """Points where viewing rays meet the plane.

        Solves the dissertation's eq. 3.6 (where both pixel terms carry a minus: with
        f X - (x - c_x) Z = 0), for undistorted rays, so that any lens model may come before.

        Parameters
        ----------
        rays : (..., 3) float
            Directions in {C}, z = 1, no unit.

        Returns
        -------
        (..., 3) float
            Points in {C}, mm. NaN where the ray runs within 1e-9 of parallel to the plane
            or meets it behind the camera.
        """
        slope = rays @ self.normal
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = np.where(np.abs(slope) > 1e-9, -self.offset / slope, np.nan)
        return np.where(depth > 0, depth, np.nan)[..., None] * rays
