"""The rotation axis from a checkerboard that turns with the hub."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import OptimizeResult, least_squares
from scipy.spatial.transform import Rotation

from treadlight.calibrate.camera import BoardPose, board_pose
from treadlight.calibrate.corners import object_points, symmetric_orders
from treadlight.errors import CalibrationError
from treadlight.geometry import Axis, Camera
from treadlight.geometry.axis import wrap_angle

# Two angles leave nothing that could contradict a wrong one.
MIN_ANGLES = 3
# Below this spread of encoder angles the axis is only where the noise puts it.
_MIN_SPREAD_RAD = np.radians(3.0)
_OUTLIER = 3.0


@dataclass(frozen=True)
class AxisCalibration:
    """The axis and how well the turning board agrees with it.

    Attributes
    ----------
    axis : Axis
    rms_px : float
        Reprojection error, root mean square over corners.
    rms_mm : float
        The same at the board's distance.
    frames : int
    covariance : (6, 6) float64
        Of direction x, y, z and point x, y, z.
    """

    axis: Axis
    rms_px: float
    rms_mm: float
    frames: int
    covariance: np.ndarray


@dataclass(frozen=True)
class _Problem:
    """What stays fixed in the fit: the camera, the corners seen, the angles, and the start."""

    camera: Camera
    corners: np.ndarray
    angles: np.ndarray
    board: np.ndarray
    start: Axis

    def unpack(self, x: np.ndarray) -> tuple[Axis, Rotation, np.ndarray]:
        """Parameters (10,): two tilts and two shifts of the axis, and the board's pose."""
        towards, across, along = self.start.basis
        turn = Rotation.from_rotvec(x[0] * towards + x[1] * across)
        point = self.start.point + x[2] * towards + x[3] * across
        axis = Axis.through(turn.apply(along), point)
        return axis, Rotation.from_rotvec(x[4:7]), x[7:10]

    def residuals(self, x: np.ndarray) -> np.ndarray:
        """Reprojection errors of all corners of all frames, pixels, flat."""
        axis, rotation, translation = self.unpack(x)
        points = rotation.apply(self.board) + translation
        turns = Rotation.from_rotvec(self.angles[:, None] * axis.direction).as_matrix()
        turned = np.einsum("kij,nj->kni", turns, points - axis.point) + axis.point
        seen = self.camera.project(turned)
        return np.nan_to_num(seen - self.corners, nan=1e6).ravel()


def calibrate_axis(
    camera: Camera,
    corners: Sequence[np.ndarray],
    encoder: np.ndarray,
    inner_corners: tuple[int, int],
    square_mm: float,
) -> AxisCalibration:
    """One joint fit of the axis and the board's pose on it, by reprojection.

    X_k = C + R(v, phi_k) (X - C): four unknowns for the axis, six for the board; each frame
    adds none. The sign of v follows from the encoder. Which of its corners the detector took
    for the first is settled by the fit.

    Parameters
    ----------
    camera : Camera
    corners : sequence of (n, 2) float
        Of each frame, in the order of `corners.object_points` up to a turn of the board.
    encoder : (k,) float
        Rad.
    inner_corners, square_mm : of the board.

    Raises
    ------
    CalibrationError
        Fewer than `MIN_ANGLES` angles, or they are too alike.
    """
    _check_angles(encoder)
    # Angles are taken from their middle, where errors of the board's pose weigh least.
    middle = encoder[0] + float(np.median(wrap_angle(encoder - encoder[0])))
    angles = np.asarray(wrap_angle(encoder - middle))
    board = object_points(inner_corners, square_mm)
    orders = symmetric_orders(inner_corners)
    seen = np.stack(corners)
    axis, pose, seen = _start(camera, seen, angles, board, orders)
    used = np.arange(len(seen))
    while True:
        problem = _Problem(camera, seen[used], angles[used], board, axis)
        fit = _solve(problem, pose)
        error = np.linalg.norm(fit.fun.reshape(len(used), -1, 2), axis=2)
        per_frame = np.sqrt(np.mean(error**2, axis=1))
        keep = per_frame <= _OUTLIER * np.median(per_frame)
        if keep.all() or keep.sum() < MIN_ANGLES:
            break
        used = used[keep]
    return _result(problem, fit, error)


def _check_angles(encoder: np.ndarray) -> None:
    distinct = len(np.unique(np.round(np.asarray(wrap_angle(encoder)), 6)))
    if distinct < MIN_ANGLES:
        raise CalibrationError(
            f"axis_board frames: the board was found at {distinct} encoder angles. At least"
            f" {MIN_ANGLES} are needed; check axis_board.inner_corners in capture.yaml."
        )
    spread = np.abs(wrap_angle(encoder - encoder[0])).max()
    if spread < _MIN_SPREAD_RAD:
        raise CalibrationError(
            f"axis_board frames: the encoder angles span {np.degrees(spread):.2f} degrees only."
            f" Turn the hub by {np.degrees(_MIN_SPREAD_RAD):.0f} degrees or more between frames."
        )


def _solve(problem: _Problem, pose: BoardPose) -> OptimizeResult:
    start = np.zeros(10)
    start[4:7] = Rotation.from_matrix(pose.rotation).as_rotvec()
    start[7:10] = pose.translation
    scale = np.array([1e-3, 1e-3, 1, 1, 1e-3, 1e-3, 1e-3, 1, 1, 1])
    return least_squares(problem.residuals, start, x_scale=scale, xtol=1e-12, ftol=1e-12)


def _start(
    camera: Camera,
    corners: np.ndarray,
    angles: np.ndarray,
    board: np.ndarray,
    orders: list[np.ndarray],
) -> tuple[Axis, BoardPose, np.ndarray]:
    """A first axis from the boards' single poses, and the corners in one common order.

    The frame nearest to the middle angle fixes the order; the others take the order whose turn
    from there is nearest to the encoder's.
    """
    anchor = int(np.argmin(np.abs(angles)))
    first = board_pose(camera, corners[anchor], board)
    step = np.asarray(wrap_angle(angles - angles[anchor]))
    ordered = corners.copy()
    poses = []
    for k in range(len(corners)):
        candidates = [
            (board_pose(camera, corners[k][order], board), corners[k][order]) for order in orders
        ]
        turns = [_turn(pose, first).magnitude() for pose, _ in candidates]
        best = int(np.argmin(np.abs(np.array(turns) - abs(step[k]))))
        pose, ordered[k] = candidates[best]
        poses.append(pose)
    axis = _axis_of_poses(poses, first, step)
    # The pose at the middle angle: turned back by the little that the anchor is off it.
    back = Rotation.from_rotvec(-angles[anchor] * axis.direction).as_matrix()
    rotation = back @ first.rotation
    translation = back @ (first.translation - axis.point) + axis.point
    return axis, BoardPose(rotation, translation, first.rms_px), ordered


def _turn(pose: BoardPose, first: BoardPose) -> Rotation:
    return Rotation.from_matrix(pose.rotation @ first.rotation.T)


def _axis_of_poses(poses: list[BoardPose], first: BoardPose, step: np.ndarray) -> Axis:
    """The axis about which the poses turn by the steps: v by average, C by linear solve."""
    vectors = [np.sign(s) * _turn(p, first).as_rotvec() for p, s in zip(poses, step, strict=True)]
    direction = np.sum(vectors, axis=0)
    direction /= np.linalg.norm(direction)
    turns = Rotation.from_rotvec(step[:, None] * direction).as_matrix()
    shift = np.stack([p.translation for p in poses]) - turns @ first.translation
    system = (np.eye(3) - turns).reshape(-1, 3)
    # The axis' own direction is free: least squares by SVD gives the foot of the perpendicular.
    point = np.linalg.lstsq(system, shift.ravel(), rcond=1e-6)[0]
    return Axis.through(direction, point)


def _result(problem: _Problem, fit: OptimizeResult, error: np.ndarray) -> AxisCalibration:
    axis, rotation, translation = problem.unpack(fit.x)
    variance = float(np.sum(fit.fun**2)) / max(len(fit.fun) - len(fit.x), 1)
    covariance = variance * np.linalg.inv(fit.jac.T @ fit.jac)
    jacobian = np.stack(
        [
            (_six(problem, fit.x, k, h) - _six(problem, fit.x, k, -h)) / (2 * h)
            for k, h in enumerate((1e-5, 1e-5, 1e-3, 1e-3))
        ],
        axis=1,
    )
    points = rotation.apply(problem.board) + translation
    turns = Rotation.from_rotvec(problem.angles[:, None] * axis.direction).as_matrix()
    depth = np.einsum("kj,nj->kn", turns[:, 2], points - axis.point) + axis.point[2]
    focal = 0.5 * (problem.camera.matrix[0, 0] + problem.camera.matrix[1, 1])
    return AxisCalibration(
        axis=axis,
        rms_px=float(np.sqrt(np.mean(error**2))),
        rms_mm=float(np.sqrt(np.mean((error * depth / focal) ** 2))),
        frames=len(error),
        covariance=jacobian @ covariance[:4, :4] @ jacobian.T,
    )


def _six(problem: _Problem, x: np.ndarray, index: int, step: float) -> np.ndarray:
    moved = x.copy()
    moved[index] += step
    axis = problem.unpack(moved)[0]
    return np.concatenate([axis.direction, axis.point])
