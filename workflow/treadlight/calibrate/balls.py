"""Chrome balls in images of one LED each: where they are and where they glint."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy import ndimage
from scipy.optimize import least_squares

from treadlight.errors import CalibrationError
from treadlight.geometry import Camera, Plane
from treadlight.images import LinearFrame

# Lines from two balls meet in a point; the third shows how well.
MIN_BALLS = 3
# Directions about a ball's centre in which its outline is looked for.
_ANGLES = 96
# How far from the mean of its glints a ball's centre is looked for, and then how far from there
# its outline, in radii: the first covers a camera and LEDs that are all on one side.
_COARSE_SEARCH = 0.6
_FINE_SEARCH = 0.12
# Highlights lie well inside the outline: where the normal halves the angle to the LED.
_HIGHLIGHT_REACH = 0.85
# A glint is what is brighter than this share of its top.
_FOOT = 0.05
# A clipped top of so many pixels is placed by its outline to better than a tenth of a pixel,
# while what surrounds it (glare, the lamp's housing) has grown with it and need not be even.
_LARGE_TOP_PX = 100
# A glint is oval where the lamp or its mirror image is; fewer flank pixels cannot tell.
_OVAL_PX = 30
# Balls are enlarged or shrunk to these radii before their outlines are looked for: a gradient's
# magnitude holds finer detail than the image, which small balls have no pixels for.
_EDGE_RADII_PX = (20.0, 64.0)
# Smoothing before the gradient, in pixels of the scaled image and of the original, whichever is
# more: less leaves pixel noise, more mixes the outline with the reflections inside it.
_EDGE_SIGMA_PX = (0.7, 0.35)
_ROUNDS = 6
_HUBER = 1.5


@dataclass(frozen=True)
class BallSet:
    """Balls in the field of view and their glints.

    Attributes
    ----------
    centres : (n, 3) float64
        From the outlines, {C}, mm.
    centre_std_mm : (n,) float64
        Along the plane that holds the centres, each coordinate.
    highlights : (n, k, 2) float64
        Pixel of each image's glint on each ball; NaN where there is none.
    radius_mm : float
    plane : Plane
        Holds the centres.
    """

    centres: np.ndarray
    centre_std_mm: np.ndarray
    highlights: np.ndarray
    radius_mm: float
    plane: Plane


def find_balls(
    frames: Sequence[LinearFrame],
    camera: Camera,
    reference_plane: Plane,
    count: int,
    diameter_mm: float,
    centre_height_mm: float,
) -> BallSet:
    """Find the balls by their glints, then place them by their outlines.

    Glints are the brightest compact blobs of each image. Those of one ball lie within its
    radius of each other, whichever LED is lit, so that they cluster into balls.

    Parameters
    ----------
    frames : sequence of LinearFrame
        One LED lit in each; read twice, one by one, so that a sequence may decode them when
        asked.
    camera : Camera
    reference_plane : Plane
        Normal towards the camera.
    count : int
        How many balls there are.
    diameter_mm, centre_height_mm : float
        The height is over the reference plane, towards the camera.

    Raises
    ------
    CalibrationError
        Fewer than `MIN_BALLS` are found.
    """
    radius = diameter_mm / 2
    plane = Plane(reference_plane.normal, reference_plane.offset - centre_height_mm)
    radius_px = _radius_px(camera, plane, radius)
    edges = _Edges(radius_px / float(np.clip(radius_px, *_EDGE_RADII_PX)))
    glints = []
    for frame in frames:
        glints.append(_glints(frame.intensity, radius_px))
        edges.add(frame.intensity)
    seeds = _seeds(glints, count, radius_px)
    if len(seeds) < MIN_BALLS:
        raise CalibrationError(
            f"balls frames: {len(seeds)} of {count} balls were found by their highlights. At least"
            f" {MIN_BALLS} are needed; check balls.count, balls.diameter_mm and the exposure."
        )
    fits = [_fit_outline(edges, _on_plane(camera, plane, s), camera, plane, radius) for s in seeds]
    centres = np.stack([centre for centre, _ in fits])
    highlights = np.stack(
        [[find_highlight(frame, camera, c, radius) for c in centres] for frame in frames], axis=1
    )
    return BallSet(centres, np.array([s for _, s in fits]), highlights, radius, plane)


def _radius_px(camera: Camera, plane: Plane, radius_mm: float) -> float:
    """A ball's radius in the middle of the image, pixels."""
    middle = np.array([[camera.size_px[0] / 2, camera.size_px[1] / 2]])
    depth = plane.intersect(camera.rays(middle))[0, 2]
    return float(camera.matrix[0, 0] * radius_mm / depth)


def _on_plane(camera: Camera, plane: Plane, pixel: np.ndarray) -> np.ndarray:
    return plane.intersect(camera.rays(pixel[None]))[0]


def _glints(image: np.ndarray, radius_px: float) -> np.ndarray:
    """Centres (n, 2) of blobs brighter than anything but a glint, and small against a ball.

    The threshold is the geometric mean of the card's level and the brightest pixel: halfway
    between the two in the logarithm, whatever the exposure.
    """
    card, top = float(np.median(image)), float(image.max())
    if top <= 0:
        return np.empty((0, 2))
    bright = image > max(np.sqrt(max(card, 0) * top), 0.1 * top)
    labels, number = ndimage.label(bright, structure=np.ones((3, 3)))
    if not number:
        return np.empty((0, 2))
    index = np.arange(1, number + 1)
    area = ndimage.sum_labels(bright, labels, index)
    centres = np.array(ndimage.center_of_mass(bright, labels, index))[:, ::-1]
    return centres[area < radius_px**2]


def _seeds(glints: list[np.ndarray], count: int, radius_px: float) -> np.ndarray:
    """Centres (n, 2) of the clusters of glints with most images in them, at most `count`."""
    points = np.concatenate(glints)
    owner = np.repeat(np.arange(len(glints)), [len(g) for g in glints])
    seeds: list[np.ndarray] = []
    while len(points) and len(seeds) < count:
        near = np.linalg.norm(points[:, None] - points[None], axis=2) < radius_px
        images = np.array([len(np.unique(owner[row])) for row in near])
        densest = int(np.argmax(images))
        if images[densest] < max(2, len(glints) // 2):
            break
        # Twice towards the mean: the densest glint itself lies anywhere on the ball.
        centre = points[near[densest]].mean(axis=0)
        member = np.linalg.norm(points - centre, axis=1) < radius_px
        centre = points[member].mean(axis=0)
        member |= np.linalg.norm(points - centre, axis=1) < radius_px
        seeds.append(centre)
        points, owner = points[~member], owner[~member]
    return np.array(seeds).reshape(-1, 2)


class _Edges:
    """Mean gradient magnitude over images, each relative to its card.

    Shadows and reflections move with the LED, outlines stay: the mean keeps the outlines.
    Glints are cut off first, or their flanks would outshine the outline.
    """

    def __init__(self, factor: float):
        self.factor = factor
        self.scale = np.ones(2)
        self.total: np.ndarray | None = None

    def add(self, image: np.ndarray) -> None:
        """Take in one image (h, w)."""
        clipped = np.minimum(image / max(float(np.median(image)), 1e-9), 2.0).astype(np.float32)
        if self.factor != 1:
            size = [round(n / self.factor) for n in image.shape[::-1]]
            how = cv2.INTER_AREA if self.factor > 1 else cv2.INTER_CUBIC
            clipped = np.asarray(cv2.resize(clipped, size, interpolation=how), np.float32)
        # Sizes are whole numbers, so the scales are not quite the one that was wanted.
        self.scale = np.array(clipped.shape[::-1]) / image.shape[::-1]
        scaled, original = _EDGE_SIGMA_PX
        sigma = max(scaled, original / self.factor)
        strength = ndimage.gaussian_gradient_magnitude(clipped, sigma)
        self.total = strength if self.total is None else self.total + strength

    def at(self, pixels: np.ndarray) -> np.ndarray:
        """Strength (m, n) at pixels (m, n, 2) of the full image; 0 outside."""
        assert self.total is not None
        places = ((pixels + 0.5) * self.scale - 0.5).astype(np.float32)
        return cv2.remap(
            self.total,
            np.ascontiguousarray(places[..., 0]),
            np.ascontiguousarray(places[..., 1]),
            cv2.INTER_CUBIC,
            borderMode=cv2.BORDER_CONSTANT,
        )


def outline(camera: Camera, centre: np.ndarray, radius_mm: float, scale: float = 1.0) -> np.ndarray:
    """Pixels (`_ANGLES`, 2) of a sphere's outline, `scale` times as large.

    The viewing cone touches the sphere in a circle of radius R sqrt(1 - (R/d)^2) about a centre
    that lies R^2/d nearer to the camera.
    """
    distance = np.linalg.norm(centre)
    towards = centre / distance
    across = np.cross(towards, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    angle = np.arange(_ANGLES) * (2 * np.pi / _ANGLES)
    circle = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * np.cross(across, towards)
    ratio = radius_mm / distance
    return camera.project(
        centre * (1 - ratio**2) + circle * (scale * radius_mm * np.sqrt(1 - ratio**2))
    )


def _coarse_centre(
    edges: _Edges, centre: np.ndarray, camera: Camera, plane: Plane, radius_mm: float
) -> np.ndarray:
    """The centre nearby whose outline, of known size, runs along the strongest edges."""
    middle = camera.project(centre)
    rim = outline(camera, centre, radius_mm)
    radius_px = float(np.linalg.norm(rim - rim.mean(axis=0), axis=1).mean())
    reach = np.arange(-_COARSE_SEARCH, _COARSE_SEARCH + 1e-9, min(0.05, 0.5 / radius_px))
    shift = np.stack(np.meshgrid(reach, reach), axis=-1).reshape(-1, 2) * radius_px
    score = edges.at(rim[None] + shift[:, None]).mean(axis=1)
    return _on_plane(camera, plane, middle + shift[int(np.argmax(score))])


def _fit_outline(
    edges: _Edges, centre: np.ndarray, camera: Camera, plane: Plane, radius_mm: float
) -> tuple[np.ndarray, float]:
    """A ball's centre on the plane from the strongest edges near its expected outline.

    Along each direction the peak of the edges is found to a fraction of a pixel. The offsets
    from the expected outline are explained by a shift and by one common stretch (what shading
    next to the rim does to the peak, it does all round), by Huber's weights. Directions that
    are less than two pixels apart on the outline do not count as independent.
    """
    centre = _coarse_centre(edges, centre, camera, plane, radius_mm)
    std_px = np.inf
    for _ in range(_ROUNDS):
        rim = outline(camera, centre, radius_mm)
        middle = rim.mean(axis=0)
        radii = np.linalg.norm(rim - middle, axis=1)
        normals = (rim - middle) / radii[:, None]
        offset = _peak_offsets(edges, rim, normals, max(_FINE_SEARCH * float(radii.mean()), 1.5))
        design = np.column_stack([normals, np.ones(len(normals))])
        shift, std_px = _huber_fit(design, offset)
        centre = _on_plane(camera, plane, camera.project(centre) + shift[:2])
    depth = centre[2] / camera.matrix[0, 0]
    independent = min(np.pi * float(radii.mean()), _ANGLES)
    return centre, std_px * depth * float(np.sqrt(_ANGLES / independent))


def _peak_offsets(edges: _Edges, rim: np.ndarray, normals: np.ndarray, reach: float) -> np.ndarray:
    """Signed distance (n,) of the strongest edge along each normal, pixels; NaN where none."""
    steps = np.arange(-reach, reach + 0.25, 0.25)
    profile = edges.at(rim[:, None] + steps[None, :, None] * normals[:, None])
    peak = np.argmax(profile, axis=1)
    inner = np.clip(peak, 1, len(steps) - 2)
    rows = np.arange(len(rim))
    before, at, after = (profile[rows, inner + k] for k in (-1, 0, 1))
    curvature = before - 2 * at + after
    with np.errstate(divide="ignore", invalid="ignore"):
        vertex = 0.5 * (before - after) / curvature
    good = (peak == inner) & (curvature < 0)
    return np.where(good, steps[inner] + 0.25 * vertex, np.nan)


def _huber_fit(design: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, float]:
    """Robust linear fit; returns the parameters and the standard deviation of the first two."""
    usable = np.isfinite(values)
    if usable.sum() < 8:
        return np.zeros(design.shape[1]), np.inf
    design, values = design[usable], values[usable]
    weights = np.ones(len(values))
    for _ in range(20):
        root = np.sqrt(weights)[:, None]
        parameters = np.linalg.lstsq(design * root, values * root[:, 0], rcond=None)[0]
        residual = np.abs(values - design @ parameters)
        scale = max(1.4826 * float(np.median(residual)), 1e-6)
        weights = np.minimum(1.0, _HUBER * scale / np.maximum(residual, 1e-12))
    covariance = np.linalg.inv(design.T @ (design * weights[:, None])) * scale**2
    return parameters, float(np.sqrt(0.5 * (covariance[0, 0] + covariance[1, 1])))


def find_highlight(
    frame: LinearFrame, camera: Camera, centre: np.ndarray, radius_mm: float
) -> np.ndarray:
    """Pixel (2,) of the LED's glint on a ball, NaN where there is none.

    What is not saturated tells its place: the logarithm of the flanks falls off steeply and
    evenly all round, while the centroid of a clipped top jumps with every pixel that saturates.

    Parameters
    ----------
    frame : LinearFrame
    camera : Camera
    centre : (3,) float
        Of the ball, {C}, mm.
    radius_mm : float
    """
    nothing = np.full(2, np.nan)
    rim = outline(camera, centre, radius_mm, _HIGHLIGHT_REACH)
    if not np.isfinite(rim).all():
        return nothing
    low = np.floor(rim.min(axis=0)).astype(int)
    high = np.ceil(rim.max(axis=0)).astype(int) + 1
    if (low < 0).any() or (high > camera.size_px).any():
        return nothing
    part = np.s_[low[1] : high[1], low[0] : high[0]]
    window = frame.intensity[part].astype(np.float64)
    inside = np.zeros(window.shape, np.uint8)
    cv2.fillConvexPoly(inside, np.round(rim - low).astype(np.int32), 1)
    window = np.where(inside > 0, window, 0)
    top, card = float(window.max()), max(float(np.median(frame.intensity)), 0.0)
    floor = max(_FOOT * top, min(2 * card, 0.5 * top))
    if top <= 2 * card or top <= 0:
        return nothing
    labels, _ = ndimage.label(window > floor, structure=np.ones((3, 3)))
    blob = labels == 1 + int(np.argmax(np.bincount(labels.ravel())[1:]))
    return _blob_centre(window, blob, blob & frame.saturated[part], floor) + low


def _blob_centre(
    window: np.ndarray, blob: np.ndarray, plateau: np.ndarray, floor: float
) -> np.ndarray:
    """Centre (2,) of a blob: ln I = a + b q + c q^2 off its plateau, q the squared distance.

    Where there are pixels enough q may grow faster one way than across it. A large clipped top
    is placed by its own outline: its centroid. Where the flanks have too few pixels the centroid
    of ln(I / floor) has to do.
    """
    if np.count_nonzero(plateau) >= _LARGE_TOP_PX:
        return np.array(ndimage.center_of_mass(plateau))[::-1]
    v, u = np.nonzero(blob)
    level = np.log(window[v, u])
    weight = level - np.log(floor)
    centroid = np.array([u @ weight, v @ weight]) / weight.sum()
    flank = ~plateau[v, u]
    u, v, level = u[flank], v[flank], level[flank]
    if len(u) < 8:
        return centroid

    def misfit(x: np.ndarray) -> np.ndarray:
        across, down = u - x[0], v - x[1]
        q = across**2 + down**2
        if len(x) > 5:
            q = q + x[5] * (across**2 - down**2) + 2 * x[6] * across * down
        return x[2] + x[3] * q + x[4] * q**2 - level

    radius2 = max(len(weight) / np.pi, 1.0)
    start = [*centroid, level.max() + 1, -1 / radius2, 0.0]
    scale = [0.1, 0.1, 1.0, 1 / radius2, 1 / radius2**2]
    if len(u) >= _OVAL_PX:
        start, scale = [*start, 0.0, 0.0], [*scale, 0.3, 0.3]
    centre = least_squares(misfit, start, x_scale=scale, loss="soft_l1", f_scale=0.2).x[:2]
    # The fit may only refine: further than a pixel or so it follows something else.
    return centre if np.linalg.norm(centre - centroid) < 0.5 + 0.3 * np.sqrt(radius2) else centroid
