"""The laser plane from the laser's line on checkerboards in many poses."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from treadlight.calibrate.camera import BoardPose
from treadlight.errors import CalibrationError
from treadlight.geometry import Camera, Plane
from treadlight.images.line import line_centres

# Lines of two poses already span a plane; a third shows whether it is one.
MIN_POSES = 3
# A point this many robust standard deviations off the plane is no laser point of it.
_OUTLIER = 4.0
_MAX_ROUNDS = 20
# Lines that lie closer together than this share of their length do not span a plane.
_MIN_SPREAD = 0.01
_FWHM_PER_SIGMA = 2.3548


@dataclass(frozen=True)
class LaserPlaneCalibration:
    """A laser plane and how well the points lie on it.

    Attributes
    ----------
    plane : Plane
    distances_mm : (n,) float64
        Of the points used, absolute.
    poses : int
    covariance : (4, 4) float64
        Of (A, B, C, D), poses as independent groups of points.
    """

    plane: Plane
    distances_mm: np.ndarray
    poses: int
    covariance: np.ndarray


def board_line_points(
    intensity: np.ndarray,
    pose: BoardPose,
    camera: Camera,
    inner_corners: tuple[int, int],
    square_mm: float,
    scan: str,
) -> np.ndarray:
    """Pixels at which the laser crosses a board.

    Points nearer to an edge between squares than the line is wide are left out: the step in
    albedo there pulls the line's centre to the white side.

    Parameters
    ----------
    intensity : (h, w) float32
        Of a `board_laser` frame.
    pose : BoardPose
    inner_corners, square_mm : of the board.
    scan : ``rows`` or ``columns``
        What the line crosses once each.

    Returns
    -------
    (n, 2) float64
        Column and row.
    """
    outline = _squares_outline(pose, camera, inner_corners, square_mm)
    (left, top), (right, bottom) = _bounds(outline, camera.size_px)
    if right - left < 4 or bottom - top < 4:
        return np.empty((0, 2))
    window = intensity[top:bottom, left:right]
    allowed = np.zeros(window.shape, np.uint8)
    cv2.fillConvexPoly(allowed, np.round(outline - (left, top)).astype(np.int32), 1)
    if scan == "columns":
        across, _, sigma = line_centres(window.T, allowed.T.astype(bool))
        along = np.arange(window.shape[1], dtype=float)
        pixels = np.column_stack([along + left, across + top])
    else:
        across, _, sigma = line_centres(window, allowed.astype(bool))
        along = np.arange(window.shape[0], dtype=float)
        pixels = np.column_stack([across + left, along + top])
    pixels = pixels[np.isfinite(across)]
    points = pose.to_board(pose.plane.intersect(camera.rays(pixels)))[:, :2]
    depth = pose.translation[2] / camera.matrix[0, 0]
    margin = _FWHM_PER_SIGMA * sigma * depth / square_mm
    return pixels[_off_edges(points / square_mm, inner_corners, margin)]


def _squares_outline(
    pose: BoardPose, camera: Camera, inner_corners: tuple[int, int], square_mm: float
) -> np.ndarray:
    """Pixels (4, 2) of the corners of the area that the squares cover."""
    columns, rows = inner_corners
    corners = np.array([[-1, -1, 0], [columns, -1, 0], [columns, rows, 0], [-1, rows, 0]], float)
    return camera.project(corners * square_mm @ pose.rotation.T + pose.translation)


def _bounds(
    outline: np.ndarray, size_px: tuple[int, int]
) -> tuple[tuple[int, int], tuple[int, int]]:
    low = np.floor(np.clip(outline.min(axis=0), 0, size_px)).astype(int)
    high = np.ceil(np.clip(outline.max(axis=0) + 1, 0, size_px)).astype(int)
    return (int(low[0]), int(low[1])), (int(high[0]), int(high[1]))


def _off_edges(squares: np.ndarray, inner_corners: tuple[int, int], margin: float) -> np.ndarray:
    """Points (n, 2) in units of squares that lie inside one, `margin` away from its edges.

    The margin leaves at least the middle third, so that small squares still give points.
    """
    margin = min(margin, 1 / 3)
    inside = np.all((squares > -1) & (squares < np.array(inner_corners)), axis=1)
    offset = np.abs(squares - np.round(squares))
    return inside & np.all(offset >= margin, axis=1)


def fit_laser_plane(groups: Sequence[np.ndarray]) -> LaserPlaneCalibration:
    """One plane through the laser points of all poses (dissertation 6.3.2), outliers left out.

    Parameters
    ----------
    groups : sequence of (n, 3) float
        Points of each pose in {C}, mm.

    Raises
    ------
    CalibrationError
        Fewer than `MIN_POSES` poses have points, or all lines are one.
    """
    groups = [group for group in groups if len(group)]
    if len(groups) < MIN_POSES:
        raise CalibrationError(
            f"board_laser frames: the laser line was found on {len(groups)} boards. At least"
            f" {MIN_POSES} are needed; check that each has a 'board' frame of the same pose."
        )
    points = np.concatenate(groups)
    owner = np.repeat(np.arange(len(groups)), [len(group) for group in groups])
    keep = np.ones(len(points), bool)
    for _ in range(_MAX_ROUNDS):
        plane = Plane.fit(points[keep])
        distance = plane.distance(points)
        spread = 1.4826 * np.median(np.abs(distance))
        previous, keep = keep, np.abs(distance) <= max(_OUTLIER * spread, 1e-9)
        if np.array_equal(previous, keep):
            break
    plane = _away_from_camera(Plane.fit(points[keep]))
    covariance = _plane_covariance(plane, points[keep], owner[keep])
    distances = np.abs(plane.distance(points[keep]))
    return LaserPlaneCalibration(plane, distances, len(np.unique(owner[keep])), covariance)


def _away_from_camera(plane: Plane) -> Plane:
    """Of the two signs the one with D < 0, so that two calibrations compare."""
    return plane if plane.offset <= 0 else Plane(-plane.normal, -plane.offset)


def _plane_covariance(plane: Plane, points: np.ndarray, owner: np.ndarray) -> np.ndarray:
    """Covariance of (A, B, C, D); a pose's points share its error, so sums go by pose.

    Sandwich estimator over groups (Liang and Zeger 1986) in two tilts and a shift.
    """
    centre = points.mean(axis=0)
    _, extent, axes = np.linalg.svd(points - centre, full_matrices=False)
    if extent[1] < _MIN_SPREAD * extent[0]:
        raise CalibrationError(
            "board_laser frames: all laser lines coincide. Tilt or move the board between poses."
        )
    design = np.column_stack([(points - centre) @ axes[:2].T, np.ones(len(points))])
    residual = plane.distance(points)
    groups = len(np.unique(owner))
    scores = np.stack([design[owner == k].T @ residual[owner == k] for k in np.unique(owner)])
    bread = np.linalg.inv(design.T @ design)
    local = bread @ (scores.T @ scores) @ bread * groups / max(groups - 1, 1)
    # d(n, D) / d(tilts, shift): a tilt by e along an axis adds e * axis to the normal.
    jacobian = np.zeros((4, 3))
    jacobian[:3, :2] = axes[:2].T
    jacobian[3] = [-axes[0] @ centre, -axes[1] @ centre, 1]
    return jacobian @ local @ jacobian.T
