"""How the camera's uncertainty reaches what was calibrated with it."""

from collections.abc import Callable

import numpy as np

from treadlight.geometry import Camera

# A step as large as the uncertainty itself: a smaller one would only see rounding.
_MIN_STEP = 1e-9


def camera_jacobian(
    camera: Camera, covariance: np.ndarray, calibrate: Callable[[Camera], np.ndarray]
) -> np.ndarray:
    """Derivatives (m, 9) of what `calibrate` returns (m,) by the camera's parameters.

    Parameters
    ----------
    camera : Camera
    covariance : (9, 9) float
        Of fx, fy, cx, cy, k1, k2, p1, p2, k3; a parameter of zero variance was held.
    calibrate : function of a camera
        The calibration, from the same pixels.
    """
    columns: list[np.ndarray] = []
    for k, std in enumerate(np.sqrt(np.diag(covariance))):
        if std < _MIN_STEP:
            columns.append(np.zeros_like(calibrate(camera)) if not columns else 0 * columns[0])
            continue
        above, below = calibrate(_moved(camera, k, std)), calibrate(_moved(camera, k, -std))
        columns.append((above - below) / (2 * std))
    return np.stack(columns, axis=1)


def _moved(camera: Camera, index: int, step: float) -> Camera:
    matrix, distortion = camera.matrix.copy(), camera.distortion.copy()
    if index < 4:
        matrix[((0, 0), (1, 1), (0, 2), (1, 2))[index]] += step
    else:
        distortion[index - 4] += step
    return Camera(matrix, distortion, camera.size_px)


def joint_covariance(camera: np.ndarray, parts: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Covariance of the camera's parameters and of parts calibrated with that camera.

    Parameters
    ----------
    camera : (9, 9) float
    parts : list of (covariance (m, m) with the camera fixed, jacobian (m, 9))
        Their own errors are independent; the camera's they share.
    """
    own = [np.zeros_like(camera), *(covariance for covariance, _ in parts)]
    spread = np.concatenate([np.eye(len(camera)), *(jacobian for _, jacobian in parts)])
    total = spread @ camera @ spread.T
    start = 0
    for block in own:
        end = start + len(block)
        total[start:end, start:end] += block
        start = end
    return total
