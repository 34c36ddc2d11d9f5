"""LED positions from their highlights on chrome balls."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import lil_matrix

from treadlight.calibrate.balls import MIN_BALLS, BallSet
from treadlight.errors import CalibrationError
from treadlight.geometry import Camera, Plane

_HUBER = 1.5
_ROUNDS = 4


@dataclass(frozen=True)
class LedFit:
    """One LED.

    Attributes
    ----------
    number : int
    position : (3,) float64
        {C}, mm.
    distances_mm : (n,) float64
        Of the reflected lines from the position, one per ball used.
    """

    number: int
    position: np.ndarray
    distances_mm: np.ndarray


def reflected_lines(
    camera: Camera, highlights: np.ndarray, centres: np.ndarray, radius_mm: float
) -> tuple[np.ndarray, np.ndarray]:
    """Lines that pass through the LED: mirror points and directions (dissertation 6.3.3).

    Parameters
    ----------
    camera : Camera
    highlights : (n, 2) float
        Pixels.
    centres : (n, 3) float
        Of the balls, {C}, mm.
    radius_mm : float

    Returns
    -------
    points, directions : (n, 3) float64
        {C}, mm; unit vectors away from the ball. NaN where the pixel's ray misses the ball.
    """
    view = camera.rays(highlights)
    view = view / np.linalg.norm(view, axis=1, keepdims=True)
    along = np.sum(view * centres, axis=1)
    with np.errstate(invalid="ignore"):
        half_chord = np.sqrt(along**2 - np.sum(centres**2, axis=1) + radius_mm**2)
    points = (along - half_chord)[:, None] * view
    normals = (points - centres) / radius_mm
    return points, view - 2 * np.sum(view * normals, axis=1, keepdims=True) * normals


def intersect_lines(points: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """The point nearest to lines (n, 3), by Huber's weights on the distances (eq. 6.9 ff.)."""
    weights = np.ones(len(points))
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    position = np.zeros(3)
    for _ in range(20):
        system = np.sum(weights[:, None, None] * across, axis=0)
        position = np.linalg.solve(system, np.einsum("n,nij,nj->i", weights, across, points))
        distance = np.linalg.norm(np.einsum("nij,nj->ni", across, position - points), axis=1)
        scale = max(1.4826 * float(np.median(distance)), 1e-9)
        weights = np.minimum(1.0, _HUBER * scale / np.maximum(distance, 1e-12))
    return position


def calibrate_leds(camera: Camera, balls: BallSet, numbers: list[int]) -> list[LedFit]:
    """All LEDs and, with them, the balls' centres, in one fit.

    The outlines place each ball to a fraction of a pixel, yet an error of the centre turns the
    normal by that over the radius. All highlights of a ball share its centre, so the centres
    are unknowns too, held by their outlines: the fit weighs both by what their residuals show.

    Parameters
    ----------
    camera : Camera
    balls : BallSet
    numbers : list of int
        LED number of each image.

    Raises
    ------
    CalibrationError
        No LED is seen in `MIN_BALLS` balls.
    """
    seen = np.isfinite(balls.highlights).all(axis=2)
    used = np.flatnonzero(seen.sum(axis=0) >= MIN_BALLS)
    if not len(used):
        raise CalibrationError(
            f"balls frames: no LED shows a highlight on {MIN_BALLS} balls. Check the exposure:"
            " highlights must be brighter than the card."
        )
    start = np.stack([_single(camera, balls, int(k)) for k in used])
    positions, centres = _bundle(camera, balls, used, start)
    return [
        LedFit(numbers[k], position, _distances(camera, balls, int(k), position, centres))
        for k, position in zip(used, positions, strict=True)
    ]


def _single(camera: Camera, balls: BallSet, image: int) -> np.ndarray:
    points, directions = _lines(camera, balls, image, balls.centres)
    return intersect_lines(points, directions)


def _lines(
    camera: Camera, balls: BallSet, image: int, centres: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    seen = np.isfinite(balls.highlights[:, image]).all(axis=1)
    points, directions = reflected_lines(
        camera, balls.highlights[seen, image], centres[seen], balls.radius_mm
    )
    hit = np.isfinite(points).all(axis=1)
    return points[hit], directions[hit]


def _distances(
    camera: Camera, balls: BallSet, image: int, position: np.ndarray, centres: np.ndarray
) -> np.ndarray:
    points, directions = _lines(camera, balls, image, centres)
    offset = position - points
    along = np.sum(offset * directions, axis=1, keepdims=True) * directions
    return np.linalg.norm(offset - along, axis=1)


def _bundle(
    camera: Camera, balls: BallSet, used: np.ndarray, start: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Positions (k, 3) and centres (n, 3) that explain highlights and outlines best."""
    axes = _plane_axes(balls.plane)
    ball, image = np.nonzero(np.isfinite(balls.highlights[:, used]).all(axis=2))
    pixels = balls.highlights[ball, used[image]]
    count, leds = len(balls.centres), len(used)
    outline_std = np.where(np.isfinite(balls.centre_std_mm), balls.centre_std_mm, balls.radius_mm)
    outline_std = np.maximum(outline_std, 1e-6)

    def split(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return x[: 3 * leds].reshape(leds, 3), balls.centres + x[3 * leds :].reshape(-1, 2) @ axes

    def glint_errors(x: np.ndarray) -> np.ndarray:
        positions, centres = split(x)
        return _glint_errors(camera, pixels, centres[ball], positions[image], balls.radius_mm)

    pattern = lil_matrix((2 * len(ball) + 2 * count, 3 * leds + 2 * count), dtype=int)
    for row, (b, k) in enumerate(zip(ball, image, strict=True)):
        pattern[2 * row : 2 * row + 2, 3 * k : 3 * k + 3] = 1
        pattern[2 * row : 2 * row + 2, 3 * leds + 2 * b : 3 * leds + 2 * b + 2] = 1
    for column in range(2 * count):
        pattern[2 * len(ball) + column, 3 * leds + column] = 1

    x = np.concatenate([start.ravel(), np.zeros(2 * count)])
    for _ in range(_ROUNDS):
        # Standard deviations follow from the residuals themselves, robustly.
        glint_std = max(1.4826 * float(np.median(np.abs(glint_errors(x)))), 1e-6)

        def residuals(x: np.ndarray, glint_std: float = glint_std) -> np.ndarray:
            shifts = x[3 * leds :].reshape(-1, 2) / outline_std[:, None]
            return np.concatenate([glint_errors(x).ravel() / glint_std, shifts.ravel()])

        x = least_squares(
            residuals,
            x,
            jac_sparsity=pattern,
            loss="soft_l1",
            f_scale=2.0,
            x_scale=np.concatenate([np.ones(3 * leds), np.full(2 * count, 0.01)]),
        ).x
    return split(x)


def _plane_axes(plane: Plane) -> np.ndarray:
    """Two unit vectors (2, 3) along a plane."""
    first = np.cross(plane.normal, [0.0, 1.0, 0.0])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(plane.normal, first)])


def _glint_errors(
    camera: Camera,
    pixels: np.ndarray,
    centres: np.ndarray,
    positions: np.ndarray,
    radius_mm: float,
) -> np.ndarray:
    """How far (n, 2) each glint lies on its ball from where the LED's mirror point is, mm.

    The mirror law wants the normal halfway between the views to camera and LED; the normal that
    the glint's pixel has there differs by that distance over the radius.
    """
    points, _ = reflected_lines(camera, pixels, centres, radius_mm)
    normals = (points - centres) / radius_mm
    view = -points / np.linalg.norm(points, axis=1, keepdims=True)
    light = positions - points
    light = light / np.linalg.norm(light, axis=1, keepdims=True)
    halfway = view + light
    halfway = halfway / np.linalg.norm(halfway, axis=1, keepdims=True)
    return np.nan_to_num(radius_mm * (normals - halfway)[:, :2], nan=10 * radius_mm)
