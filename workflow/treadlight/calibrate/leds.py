"""LED positions from their highlights on chrome balls."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.sparse import lil_matrix

from treadlight.calibrate.balls import MIN_BALLS, BallSet
from treadlight.errors import CalibrationError
from treadlight.geometry import Camera, Plane

# Tukey's biweight: 95 % efficient on Gaussian noise.
_TUKEY = 4.685
_ROUNDS = 10
_SCALE_ROUNDS = 4
# A glint further off than this many times what is usual is no glint of that LED and ball.
_REJECT = 5.0
# No glint is placed better than this; exact ones would be rejected for rounding.
_LEAST_ERROR_MM = 1e-3
_MAD_TO_STD = 1.4826


@dataclass(frozen=True)
class LedFit:
    """One LED.

    Attributes
    ----------
    number : int
    position : (3,) float64
        {C}, mm.
    distances_mm : (n_balls,) float64
        Of the reflected lines from the position; NaN where a ball shows no highlight.
    used : (n_balls,) bool
        False also where a line disagrees with the others and had no say.
    """

    number: int
    position: np.ndarray
    distances_mm: np.ndarray
    used: np.ndarray


@dataclass(frozen=True)
class LightFit:
    """All LEDs and the balls they were found with.

    Attributes
    ----------
    leds : tuple of LedFit
    centres : (n_balls, 3) float64
        Of the balls, from outlines and highlights, {C}, mm.
    """

    leds: tuple[LedFit, ...]
    centres: np.ndarray


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
    """The point nearest to most of some lines (eqs. 6.9 to 6.13).

    Of the points midway between two lines the one with the least median distance to all is
    where Tukey's weights start from: up to half of the lines may lead anywhere.

    Parameters
    ----------
    points, directions : (n, 3) float
        mm; unit vectors.

    Returns
    -------
    (3,) float64
        mm.
    """
    across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
    moved = np.einsum("nij,nj->ni", across, points)
    first, second = np.triu_indices(len(points), 1)
    # The pseudo-inverse, since two lines may be parallel.
    midway = np.einsum(
        "nij,nj->ni",
        np.linalg.pinv(across[first] + across[second], hermitian=True),
        moved[first] + moved[second],
    )
    distances = np.linalg.norm(np.einsum("nij,mj->mni", across, midway) - moved, axis=2)
    position = midway[np.argmin(np.median(distances, axis=1))]
    for _ in range(20):
        distance = np.linalg.norm(across @ position - moved, axis=1)
        scale = _TUKEY * max(_MAD_TO_STD * float(np.median(distance)), 1e-9)
        weights = np.maximum(0.0, 1 - (distance / scale) ** 2) ** 2
        system = np.sum(weights[:, None, None] * across, axis=0)
        position = np.linalg.solve(system, weights @ moved)
    return position


def calibrate_leds(camera: Camera, balls: BallSet, numbers: list[int]) -> LightFit:
    """All LEDs and, with them, the balls' centres, in one fit.

    The outlines place each ball to a fraction of a pixel, yet an error of the centre turns the
    normal by that over the radius. All highlights of a ball share its centre, so the centres
    are unknowns too, held by their outlines: the fit weighs both by what their residuals show.
    Highlights that disagree with the rest are rejected, and may come back as the fit changes.

    Parameters
    ----------
    camera : Camera
    balls : BallSet
    numbers : list of int
        LED number of each image.

    Raises
    ------
    CalibrationError
        No LED is seen in `MIN_BALLS` balls that agree.
    """
    points, directions = _mirrored(camera, balls, balls.centres)
    trusted = np.isfinite(points).all(axis=2)
    images = _with_enough_balls(trusted)
    positions = np.full((len(numbers), 3), np.nan)
    for k in images:
        chosen = trusted[:, k]
        positions[k] = intersect_lines(points[chosen, k], directions[chosen, k])
    # What all highlights of a ball share is its outline's error, which the fit will mend.
    errors = _errors(camera, balls, positions, balls.centres)
    trusted = _agreeing(errors - _shared(errors)[:, None], trusted)
    for _ in range(_ROUNDS):
        images = _with_enough_balls(trusted)
        positions[images], centres = _bundle(camera, balls, images, trusted, positions[images])
        errors = _errors(camera, balls, positions, centres)
        before, trusted = trusted, _agreeing(errors, trusted)
        if (before == trusted).all():
            break
    points, directions = _mirrored(camera, balls, centres)
    distances = np.linalg.norm(np.cross(positions - points, directions), axis=2)
    leds = [LedFit(numbers[k], positions[k], distances[:, k], before[:, k]) for k in images]
    return LightFit(tuple(leds), centres)


def _with_enough_balls(trusted: np.ndarray) -> np.ndarray:
    images = np.flatnonzero(trusted.sum(axis=0) >= MIN_BALLS)
    if not len(images):
        raise CalibrationError(
            f"balls frames: no LED shows a highlight on {MIN_BALLS} balls that agree on where it"
            " is. Check the exposure: highlights must be brighter than the card."
        )
    return images


def _mirrored(camera: Camera, balls: BallSet, centres: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points and directions (n_balls, n_images, 3) of all reflected lines; NaN where none."""
    shape = balls.highlights.shape[:2]
    points, directions = reflected_lines(
        camera,
        balls.highlights.reshape(-1, 2),
        np.repeat(centres, shape[1], axis=0),
        balls.radius_mm,
    )
    return points.reshape(*shape, 3), directions.reshape(*shape, 3)


def _errors(
    camera: Camera, balls: BallSet, positions: np.ndarray, centres: np.ndarray
) -> np.ndarray:
    """`_glint_errors` of all highlights, (n_balls, n_images, 2) mm; NaN where none."""
    seen = np.isfinite(balls.highlights).all(axis=2) & np.isfinite(positions).all(axis=1)
    ball, image = np.nonzero(seen)
    errors = np.full((*seen.shape, 2), np.nan)
    errors[seen] = _glint_errors(
        camera, balls.highlights[seen], centres[ball], positions[image], balls.radius_mm
    )
    return errors


def _shared(errors: np.ndarray) -> np.ndarray:
    """Median error (n_balls, 2) of each ball's highlights, 0 where it has none."""
    known = [row[np.isfinite(row[:, 0])] for row in errors]
    return np.stack([np.median(row, axis=0) if len(row) else np.zeros(2) for row in known])


def _agreeing(errors: np.ndarray, trusted: np.ndarray) -> np.ndarray:
    """Which highlights (n_balls, n_images) are within `_REJECT` of what is usual."""
    usual = _MAD_TO_STD * float(np.nanmedian(np.abs(errors[trusted])))
    with np.errstate(invalid="ignore"):
        return np.linalg.norm(errors, axis=2) <= _REJECT * max(usual, _LEAST_ERROR_MM)


def _bundle(
    camera: Camera,
    balls: BallSet,
    images: np.ndarray,
    trusted: np.ndarray,
    start: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Positions (k, 3) and centres (n, 3) that explain highlights and outlines best."""
    axes = _plane_axes(balls.plane)
    ball, image = np.nonzero(trusted[:, images])
    pixels = balls.highlights[ball, images[image]]
    count, leds = len(balls.centres), len(images)
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
    for _ in range(_SCALE_ROUNDS):
        # Standard deviations follow from the residuals themselves, robustly.
        glint_std = max(_MAD_TO_STD * float(np.median(np.abs(glint_errors(x)))), 1e-6)

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
