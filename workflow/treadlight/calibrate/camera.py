"""The camera's intrinsics from checkerboards in many poses, and the reference plane."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import cv2
import numpy as np

from treadlight.errors import CalibrationError
from treadlight.geometry import Camera, Plane

PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
# Zhang's method needs three poses; a fourth makes the fit testable.
MIN_POSES = 4
# A pose whose RMS is this many times the median pose's has a wrong corner or moved.
_OUTLIER = 3.0
# A focal length less certain than this comes from boards that were all parallel.
_MAX_RELATIVE_STD = 0.05
# Lens models from plain to rich: OpenCV flags and the parameters that are free.
_FIXED = cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
_MODELS = (
    (_FIXED | cv2.CALIB_FIX_K1 | cv2.CALIB_ZERO_TANGENT_DIST, ()),
    (_FIXED | cv2.CALIB_ZERO_TANGENT_DIST, ("k1",)),
    (_FIXED, ("k1", "p1", "p2")),
    (cv2.CALIB_FIX_K3, ("k1", "k2", "p1", "p2")),
    (0, ("k1", "k2", "p1", "p2", "k3")),
)


@dataclass(frozen=True)
class CameraCalibration:
    """A calibrated camera and how good it is.

    Attributes
    ----------
    camera : Camera
    rms_px : float
        Reprojection error, root mean square over corners (of the distance).
    poses : int
        Poses used.
    covariance : (9, 9) float64
        Of `PARAMETERS`; rows of parameters that were held are zero.
    """

    camera: Camera
    rms_px: float
    poses: int
    covariance: np.ndarray


@dataclass(frozen=True)
class BoardPose:
    """Where a board is: X_camera = rotation @ X_board + translation, mm."""

    rotation: np.ndarray
    translation: np.ndarray
    rms_px: float

    @property
    def plane(self) -> Plane:
        """The board's plane, its normal towards the camera."""
        normal = self.rotation[:, 2]
        offset = -float(normal @ self.translation)
        return Plane(normal, offset) if offset > 0 else Plane(-normal, -offset)

    def to_board(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 3) of {C} in the board's frame, mm."""
        return (points - self.translation) @ self.rotation


_Pair = tuple[np.ndarray, np.ndarray]


def calibrate_camera(pairs: Sequence[_Pair], size_px: tuple[int, int]) -> CameraCalibration:
    """Intrinsics from images of checkerboards (Zhang 2000; dissertation 6.3.1).

    Of a nested family of lens models the one with the least Akaike criterion is taken: higher
    coefficients that the poses cannot tell from noise run away and take the focal length along.
    Poses that fit far worse than the others are dropped.

    Parameters
    ----------
    pairs : sequence of ((n, 2), (n, 3)) float
        Corners of each board in the image, px, and in its own frame, mm.
    size_px : (int, int)
        Width and height of the images.

    Raises
    ------
    CalibrationError
        Fewer than `MIN_POSES` boards, or boards that do not determine the focal length.
    """
    if len(pairs) < MIN_POSES:
        raise CalibrationError(
            f"board frames: the checkerboard was found in {len(pairs)} frames, {MIN_POSES} are"
            " needed. Check board.inner_corners in capture.yaml, or add poses that show the"
            " whole board."
        )
    used = list(pairs)
    while True:
        fit, per_view = _best_model(used, size_px)
        keep = per_view <= _OUTLIER * np.median(per_view)
        if keep.all() or keep.sum() < MIN_POSES:
            break
        used = [pair for pair, good in zip(used, keep, strict=True) if good]
    covariance, rms = _covariance(fit, used)
    if np.sqrt(covariance[0, 0]) > _MAX_RELATIVE_STD * fit.camera.matrix[0, 0]:
        raise CalibrationError(
            "board frames: the poses do not determine the focal length. Add boards that are"
            " tilted by 20 degrees and more, about two axes."
        )
    return CameraCalibration(fit.camera, rms, len(used), covariance)


@dataclass(frozen=True)
class _Fit:
    camera: Camera
    rvecs: Sequence[np.ndarray]
    tvecs: Sequence[np.ndarray]
    free: tuple[str, ...]


def _best_model(pairs: list[_Pair], size_px: tuple[int, int]) -> tuple[_Fit, np.ndarray]:
    observed = [corners.astype(np.float32).reshape(-1, 1, 2) for corners, _ in pairs]
    boards = [board.astype(np.float32) for _, board in pairs]
    count = 2 * sum(map(len, boards))
    best: tuple[_Fit, np.ndarray] | None = None
    least = np.inf
    for flags, free in _MODELS:
        with _one_thread():
            rms, matrix, distortion, rvecs, tvecs, _, _, per_view = cv2.calibrateCameraExtended(
                boards, observed, size_px, np.empty(0), np.empty(0), flags=flags
            )
        criterion = count * np.log(rms**2) + 2 * len(free)
        if criterion < least or best is None:
            least = criterion
            camera = Camera(matrix, distortion.ravel()[:5].copy(), size_px)
            best = _Fit(camera, rvecs, tvecs, free), per_view.ravel()
    assert best is not None
    return best


@contextmanager
def _one_thread() -> Iterator[None]:
    """OpenCV's calibration sums in the order in which its threads finish: let there be one."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


def _covariance(fit: _Fit, pairs: list[_Pair]) -> tuple[np.ndarray, float]:
    """Covariance of the intrinsics with the poses marginalised (Schur complement), and RMS."""
    camera = fit.camera
    names = ("fx", "fy", "cx", "cy", *fit.free)
    columns = [PARAMETERS.index(name) for name in names]
    information = np.zeros((len(names), len(names)))
    squares, count = 0.0, 0
    for rvec, tvec, (seen, board) in zip(fit.rvecs, fit.tvecs, pairs, strict=True):
        projected, jacobian = cv2.projectPoints(board, rvec, tvec, camera.matrix, camera.distortion)
        squares += float(np.sum((projected.reshape(-1, 2) - seen) ** 2))
        count += len(board)
        pose, inner = jacobian[:, :6], jacobian[:, 6:15][:, columns]
        coupling = pose.T @ inner
        information += inner.T @ inner - coupling.T @ np.linalg.solve(pose.T @ pose, coupling)
    variance = squares / max(2 * count - len(names) - 6 * len(pairs), 1)
    covariance = np.zeros((len(PARAMETERS), len(PARAMETERS)))
    covariance[np.ix_(columns, columns)] = variance * np.linalg.inv(information)
    return covariance, float(np.sqrt(squares / count))


def board_pose(camera: Camera, corners: np.ndarray, board: np.ndarray) -> BoardPose:
    """Pose of a board (n, 3) from its corners (n, 2) by least reprojection error.

    Raises
    ------
    CalibrationError
        No pose in front of the camera explains the corners.
    """
    found, rvec, tvec = cv2.solvePnP(
        board, corners, camera.matrix, camera.distortion, flags=cv2.SOLVEPNP_IPPE
    )
    if not found or tvec[2, 0] <= 0:
        raise CalibrationError("A board's corners fit no pose in front of the camera.")
    rvec, tvec = cv2.solvePnPRefineLM(board, corners, camera.matrix, camera.distortion, rvec, tvec)
    projected, _ = cv2.projectPoints(board, rvec, tvec, camera.matrix, camera.distortion)
    rms = np.sqrt(np.mean(np.sum((projected.reshape(-1, 2) - corners) ** 2, axis=1)))
    return BoardPose(cv2.Rodrigues(rvec)[0], tvec.ravel(), float(rms))
