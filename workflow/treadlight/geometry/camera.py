"""The pinhole camera with Brown-Conrady distortion."""

from dataclasses import dataclass

import cv2
import numpy as np

# Undistortion is a fixed-point iteration: it stops at a hundred-thousandth of a pixel.
_UNDISTORT = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-8)


@dataclass(frozen=True)
class Camera:
    """A calibrated camera at the origin of {C}: x right, y down, z along the optical axis.

    Attributes
    ----------
    matrix : (3, 3) float
        Intrinsic matrix, pixels; the centre of the first pixel is (0, 0).
    distortion : (5,) float
        k1, k2, p1, p2, k3 as in OpenCV.
    size_px : (int, int)
        Width and height.
    """

    matrix: np.ndarray
    distortion: np.ndarray
    size_px: tuple[int, int]

    @property
    def intrinsics(self) -> tuple[float, float, float, float, float]:
        """fx, skew, cx, fy, cy, pixels, for kernels."""
        (fx, skew, cx), (_, fy, cy), _ = self.matrix.tolist()
        return fx, skew, cx, fy, cy

    def rays(self, uv: np.ndarray) -> np.ndarray:
        """Viewing rays of pixels, lens distortion undone.

        Parameters
        ----------
        uv : (n, 2) float
            Column and row, pixels.

        Returns
        -------
        (n, 3) float64
            Directions in {C} with z = 1.
        """
        uv = np.ascontiguousarray(uv, np.float64).reshape(-1, 1, 2)
        if not len(uv):
            return np.empty((0, 3))
        xy = cv2.undistortPoints(
            uv, self.matrix, self.distortion, R=None, P=None, criteria=_UNDISTORT
        )
        return np.column_stack([xy.reshape(-1, 2), np.ones(len(uv))])

    def pixel_rays(self) -> np.ndarray:
        """Viewing rays of all pixel centres, (h, w, 3) float64, in {C} with z = 1."""
        width, height = self.size_px
        v, u = np.mgrid[:height, :width]
        return self.rays(np.column_stack([u.ravel(), v.ravel()])).reshape(height, width, 3)

    def project(self, points: np.ndarray) -> np.ndarray:
        """Pixels at which points appear.

        Parameters
        ----------
        points : (..., 3) float
            In {C}, mm.

        Returns
        -------
        (..., 2) float64
            Column and row, pixels. NaN for points behind the camera.
        """
        points = np.asarray(points, np.float64)
        with np.errstate(divide="ignore", invalid="ignore"):
            x, y = points[..., 0] / points[..., 2], points[..., 1] / points[..., 2]
        k1, k2, p1, p2, k3 = self.distortion
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        u = self.matrix[0, 0] * xd + self.matrix[0, 1] * yd + self.matrix[0, 2]
        v = self.matrix[1, 1] * yd + self.matrix[1, 2]
        uv = np.stack([u, v], axis=-1)
        return np.where((points[..., 2] > 0)[..., None], uv, np.nan)
