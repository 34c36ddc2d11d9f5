"""A made-up rig: camera with distortion, laser sheet, tilted axis, jittered LEDs, targets."""

from dataclasses import dataclass

import numpy as np

from treadlight.archive.manifest import Board
from treadlight.geometry import Axis, Camera, Led, Plane, Rig
from treadlight.simulate.random import stream
from treadlight.simulate.settings import (
    FIELD_ALONG_AXIS_MM,
    NOMINAL_RADIUS_MM,
    SimulationSettings,
)

TREAD_DISTANCE_MM = 800.0
# LEDs shine as cos^1.25: two square roots, no call of pow.
BEAM_COS_POWER = 1.25
_LASER_ANGLE_DEG = 22.0
_LASER_DISTANCE_MM = 480.0
_BOARD_POSES = 20
_AXIS_POSES = 12


@dataclass(frozen=True)
class SimulatedRig:
    """A rig and everything its calibration capture shows; lengths mm, frames {C}.

    Attributes
    ----------
    rig : Rig
    laser_source : (3,) float
        Where the laser sheet spreads from.
    laser_fwhm_mm : float
        Thickness of the sheet.
    beams : (n, 3) float
        Directions in which the LEDs point.
    hub_z_mm : float
        z of the hub in {T}.
    board, axis_board : Board
    board_poses : tuple of (4, 4) float
        Board to {C}; the origin is the board's middle, z looks at the camera.
    reference_pose : (4, 4) float
    axis_board_to_tire : (4, 4) float
        Board to {T} at encoder zero.
    axis_encoders_deg : tuple of float
    ball_centres : (n, 3) float
    ball_diameter_mm : float
    """

    rig: Rig
    laser_source: np.ndarray
    laser_fwhm_mm: float
    beams: np.ndarray
    hub_z_mm: float
    board: Board
    axis_board: Board
    board_poses: tuple[np.ndarray, ...]
    reference_pose: np.ndarray
    axis_board_to_tire: np.ndarray
    axis_encoders_deg: tuple[float, ...]
    ball_centres: np.ndarray
    ball_diameter_mm: float

    @property
    def camera(self) -> Camera:
        return self.rig.camera

    @property
    def axis(self) -> Axis:
        assert self.rig.axis is not None
        return self.rig.axis

    @property
    def laser_plane(self) -> Plane:
        assert self.rig.laser_plane is not None
        return self.rig.laser_plane

    @property
    def reference_plane(self) -> Plane:
        assert self.rig.reference_plane is not None
        return self.rig.reference_plane

    @property
    def lens(self) -> np.ndarray:
        """(9,) fx, fy, cx, cy, k1, k2, p1, p2, k3, as `kernels` takes it."""
        m = self.camera.matrix
        return np.array([m[0, 0], m[1, 1], m[0, 2], m[1, 2], *self.camera.distortion])

    def axis_board_pose(self, encoder_deg: float) -> np.ndarray:
        """Board to {C} at an encoder angle, (4, 4)."""
        turn = _about_z(np.radians(encoder_deg)) @ self.axis_board_to_tire[:3, :3]
        pose = np.eye(4)
        pose[:3, :3] = self.axis.basis.T @ turn
        centre = _about_z(np.radians(encoder_deg)) @ self.axis_board_to_tire[:3, 3]
        pose[:3, 3] = self.axis.basis.T @ centre + self.axis.point
        return pose


def make_rig(settings: SimulationSettings) -> SimulatedRig:
    """The rig of an archive; it depends on the seed and the image size alone."""
    rng = stream(settings.seed, "rig")
    camera = _camera(settings, rng)
    # Everything is laid out for a camera whose rows run along the axis, then turned about
    # the optical axis where its columns do.
    turn = np.eye(3) if settings.scan == "rows" else np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]])
    axis = _axis(rng, turn)
    laser_plane, source = _laser(rng, turn)
    positions, beams = _leds(settings.leds, rng)
    intensities = rng.uniform(0.72, 1.25, settings.leds)
    intensities /= intensities.mean()
    leds = tuple(
        Led(k, turn @ position, float(value))
        for k, (position, value) in enumerate(zip(positions, intensities, strict=True))
    )
    reference_pose = _tilted(rng, 0.02, TREAD_DISTANCE_MM + rng.uniform(-3, 3), turn)
    normal = reference_pose[:3, 2]
    reference_plane = Plane(normal, float(-normal @ reference_pose[:3, 3]))
    rig = Rig(camera, laser_plane, axis, reference_plane, leds)
    field = _field_mm(settings)
    axis_board_to_tire, axis_encoders = _axis_board(rng)
    board = Board((7, 5) if min(settings.size_px) < 256 else (9, 6), 1.0)
    square = _square_mm(board, field)
    board = Board(board.inner_corners, square)
    axis_board = Board(board.inner_corners, float(np.round(square * 1.35)))
    ball_mm = 25.4 if settings.pixel_mm > 0.5 else 12.7
    return SimulatedRig(
        rig=rig,
        laser_source=source,
        laser_fwhm_mm=1.2,
        beams=beams @ turn.T,
        hub_z_mm=round(float(rng.uniform(-8, 8)), 3),
        board=board,
        axis_board=axis_board,
        board_poses=_board_poses(board, camera, turn, rng),
        reference_pose=reference_pose,
        axis_board_to_tire=axis_board_to_tire,
        axis_encoders_deg=axis_encoders,
        ball_centres=_balls(reference_pose, ball_mm, field, rng),
        ball_diameter_mm=ball_mm,
    )


def _camera(settings: SimulationSettings, rng: np.random.Generator) -> Camera:
    width, height = settings.size_px
    focal = settings.along_px * TREAD_DISTANCE_MM / FIELD_ALONG_AXIS_MM * rng.uniform(0.99, 1.01)
    cx = (width - 1) / 2 + 0.012 * width * rng.uniform(-1, 1)
    cy = (height - 1) / 2 + 0.012 * height * rng.uniform(-1, 1)
    matrix = np.array([[focal, 0, cx], [0, focal, cy], [0, 0, 1]])
    distortion = np.array([-0.08, 0.05, 4e-4, -3e-4, 0.0])
    distortion[:4] *= rng.uniform(0.7, 1.3, 4)
    return Camera(matrix, distortion, settings.size_px)


def _axis(rng: np.random.Generator, turn: np.ndarray) -> Axis:
    direction = np.array([rng.normal(0, 0.015), 1.0, rng.normal(0, 0.015)])
    direction *= rng.choice([-1.0, 1.0])
    depth = TREAD_DISTANCE_MM + NOMINAL_RADIUS_MM
    point = np.array([rng.uniform(-5, 5), 0.0, depth + rng.uniform(-3, 3)])
    return Axis.through(turn @ direction, turn @ point)


def _laser(rng: np.random.Generator, turn: np.ndarray) -> tuple[Plane, np.ndarray]:
    """A sheet that crosses the optical axis at the tread, nearly along the tire's axis."""
    angle = np.radians(_LASER_ANGLE_DEG + rng.uniform(-1, 1))
    normal = np.array([np.cos(angle), rng.normal(0, 0.01), np.sin(angle)])
    normal = turn @ (normal / np.linalg.norm(normal))
    middle = np.array([0, 0, TREAD_DISTANCE_MM + rng.uniform(-4, 4)])
    plane = Plane(normal, float(-normal @ middle))
    away = np.array([np.sin(angle), rng.uniform(-0.02, 0.02), -np.cos(angle)])
    source = middle + turn @ (_LASER_DISTANCE_MM * away)
    return plane, source - normal * plane.distance(source)


def _leds(count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Two rings about the optical axis, zenith angles near 35 and 15 degrees on the tread."""
    outer = (count + 1) // 2
    ring = np.arange(count) < outer
    number = np.where(ring, np.arange(count), np.arange(count) - outer)
    around = 2 * np.pi * (number + np.where(ring, 0.0, 0.5)) / np.where(ring, outer, count - outer)
    radius, depth = np.where(ring, 232.0, 108.0), np.where(ring, 472.0, 414.0)
    positions = np.column_stack([radius * np.cos(around), radius * np.sin(around), depth])
    positions += rng.normal(0, 2.5, positions.shape)
    beams = np.array([0, 0, TREAD_DISTANCE_MM]) + rng.normal(0, 8, positions.shape) - positions
    return positions, beams / np.linalg.norm(beams, axis=1, keepdims=True)


def _about_z(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def _facing(turn: np.ndarray) -> np.ndarray:
    """A board that faces the camera: its x along the tire's axis, z towards the camera."""
    return turn @ np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])


def _tilted(
    rng: np.random.Generator, spread: float, distance_mm: float, turn: np.ndarray
) -> np.ndarray:
    a, b = rng.normal(0, spread, 2)
    pose = np.eye(4)
    pose[:3, :3] = _euler(a, b, 0.0) @ _facing(turn)
    pose[:3, 3] = [0, 0, distance_mm]
    return pose


def _euler(a: float, b: float, c: float) -> np.ndarray:
    rx = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    ry = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    return rx @ ry @ _about_z(c)


def _field_mm(settings: SimulationSettings) -> tuple[float, float]:
    """What the camera sees at the tread, mm: along the tire's axis and across it."""
    return FIELD_ALONG_AXIS_MM, settings.across_px * settings.pixel_mm


def _square_mm(board: Board, field: tuple[float, float]) -> float:
    """Squares so large that the board fills two thirds of the narrower way."""
    n_long, n_short = board.inner_corners
    fits = min(field[0] / (n_long + 2.5), field[1] / (n_short + 2.5))
    return float(max(np.floor(0.9 * fits), 2.0))


def board_outline(board: Board) -> np.ndarray:
    """Corners of the sheet with its white margin, (4, 2) mm from the middle."""
    nx, ny = board.inner_corners
    x, y = (0.5 * (n + 1) * board.square_mm + 0.4 * board.square_mm for n in (nx, ny))
    return np.array([[-x, -y], [x, -y], [x, y], [-x, y]])


def _board_poses(
    board: Board, camera: Camera, turn: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, ...]:
    """Tilts of 10 to 40 degrees about any direction, all squares inside the image."""
    nx, ny = board.inner_corners
    reach = 0.5 * board.square_mm * np.array([nx + 1, ny + 1])
    corners = np.column_stack([reach * [[-1, -1], [1, -1], [1, 1], [-1, 1]], np.zeros(4)])
    size = np.array(camera.size_px)
    poses: list[np.ndarray] = []
    shrink = 1.0
    while len(poses) < _BOARD_POSES:
        tilt, way = np.radians(rng.uniform(10, 40)), rng.uniform(0, 2 * np.pi)
        pose = np.eye(4)
        spin = rng.uniform(-0.2, 0.2)
        pose[:3, :3] = _euler(tilt * np.cos(way), tilt * np.sin(way), spin) @ _facing(turn)
        pose[:3, 3] = [
            *(shrink * rng.uniform(-30, 30, 2)),
            TREAD_DISTANCE_MM + rng.uniform(-25, 60),
        ]
        uv = camera.project(corners @ pose[:3, :3].T + pose[:3, 3])
        if np.all((uv > 2) & (uv < size - 3)):
            poses.append(pose)
        else:
            shrink = max(0.2, 0.98 * shrink)
    return tuple(poses)


def _axis_board(rng: np.random.Generator) -> tuple[np.ndarray, tuple[float, ...]]:
    """A board on the hub that looks outwards, and the encoder angles that turn it past the camera.

    It sits 50 to 65 mm off the axis.
    """
    theta = rng.uniform(-np.pi, np.pi)
    outwards = np.array([np.cos(theta), np.sin(theta), 0])
    along = np.array([0, 0, 1.0])
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([along, np.cross(outwards, along), outwards])
    pose[:3, :3] = pose[:3, :3] @ _euler(*rng.normal(0, 0.03, 3))
    pose[:3, 3] = rng.uniform(50, 65) * outwards + [0, 0, rng.uniform(-6, 6)]
    offsets = np.linspace(-30, 30, _AXIS_POSES) + rng.uniform(-0.6, 0.6, _AXIS_POSES)
    return pose, tuple(np.round(offsets - np.degrees(theta), 3).tolist())


def _balls(
    reference_pose: np.ndarray,
    diameter_mm: float,
    field: tuple[float, float],
    rng: np.random.Generator,
) -> np.ndarray:
    """Three by five balls that rest on the reference plane."""
    along = np.linspace(-0.37, 0.37, 5) * field[0]
    across = np.linspace(-0.3, 0.3, 3) * min(field[1], field[0])
    x, y = (a.ravel() for a in np.meshgrid(along, across, indexing="ij"))
    x, y = x + rng.uniform(-2, 2, 15), y + rng.uniform(-2, 2, 15)
    local = np.column_stack([x, y, np.full(15, diameter_mm / 2)])
    return local @ reference_pose[:3, :3].T + reference_pose[:3, 3]
