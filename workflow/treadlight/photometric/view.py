"""Normals of one field of view: scene points, shadows, light, and specular photometric stereo."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from treadlight.geometry import Axis, Camera, CylinderGrid, Led
from treadlight.geometry.axis import wrap_angle
from treadlight.photometric import scene, view_kernels
from treadlight.photometric.closure import covariance_scale
from treadlight.photometric.light_tiles import tiles_of
from treadlight.photometric.map import map_normals
from treadlight.photometric.material import learn_material
from treadlight.photometric.observations import (
    OUTSIDE,
    POOR_FIT,
    Estimate,
    Observations,
)
from treadlight.photometric.settings import PhotometrySettings
from treadlight.photometric.sps import sps, typical_misfit
from treadlight.spool import IN_MEMORY, Memory, Spool
from treadlight.threads import by_ranges, share

# Of a chunk: keeps 16 LEDs' vectors and masks below 32 MiB a core. Pixels of its first row have
# none above to begin where that one ended: at four times the time of another.
_CHUNK_ROWS, _CHUNK_COLUMNS = 64, 1024
_LEAST_PX = 1 << 13
_SAMPLE_PX = 20_000
# Medians of more are those of so many, evenly spaced.
_SPREAD_PX = 1_000_000
_MAD_TO_STD = 1.4826
_POOR_SIGMAS = 3.0


class Light(Protocol):
    """Calibrated near lights, such as `treadlight.geometry.light.Illumination`."""

    @property
    def leds(self) -> Sequence[Led]: ...

    def irradiance(self, k: int, points: np.ndarray) -> np.ndarray: ...


@dataclass(frozen=True)
class View:
    """One field of view: its frames, and the rig that took them.

    Attributes
    ----------
    intensity : (n_leds, h, w) float32
        Linear, divided by exposure; NaN where saturated.
    noise : (n_leds,) float
        Standard deviation of `intensity` where it is dark.
    leds : (n_leds,) of int
        Index of each frame's LED in `light.leds`.
    light : Light
    camera : Camera
    axis : Axis
    encoder : float
        Rad.
    """

    intensity: np.ndarray
    noise: np.ndarray
    leds: tuple[int, ...]
    light: Light
    camera: Camera
    axis: Axis
    encoder: float


@dataclass(frozen=True)
class ViewNormals:
    """The maps of a view; NaN (0 in counts) where a pixel has none.

    Attributes
    ----------
    normal : (h, w, 3) float32
        In {T}'s local basis (r, theta, z) at the scene point.
    normal_cov : (h, w, 3) float32
        Variance of n_theta, covariance of n_theta and n_z, variance of n_z; rad2. Scaled so
        that it explains how far the view's normals are from those of a surface (`closure`).
    k_d, k_s, alpha, residual : (h, w) float32
    leds_used : (h, w) uint8
    r, theta, z : (h, w) float32
        The assumed scene point in {T}: mm, rad in [-pi, pi), mm.
    quality : (h, w) uint8
        Bits of `observations.FLAGS`.
    """

    normal: np.ndarray
    normal_cov: np.ndarray
    k_d: np.ndarray
    k_s: np.ndarray
    alpha: np.ndarray
    residual: np.ndarray
    leds_used: np.ndarray
    r: np.ndarray
    theta: np.ndarray
    z: np.ndarray
    quality: np.ndarray


def solve_view(
    view: View,
    grid: CylinderGrid,
    r: np.ndarray,
    r_std: np.ndarray,
    settings: PhotometrySettings,
    memory: Memory | Spool = IN_MEMORY,
) -> ViewNormals:
    """Specular photometric stereo at every pixel of a view, chunk by chunk.

    Parameters
    ----------
    view : View
    grid : CylinderGrid
    r, r_std : (n_theta, n_z) float
        The current surface and its standard uncertainty, mm; NaN where unknown.
    settings : PhotometrySettings
    memory : Memory or Spool
        Where the maps lie (54 bytes per pixel), handed back after each chunk.

    Returns
    -------
    ViewNormals
    """
    patch = scene.cut_patch(grid, r, r_std, view.encoder, _seen_angles(view, r))
    obstacles = _obstacles(patch)
    height, width = view.intensity.shape[1:]
    total = height * width
    sample = np.arange(0, total, max(1, total // _SAMPLE_PX))
    counts = _gather(view.intensity.reshape(len(view.leds), total), sample, memory)
    observed, _, _ = _observe(view, patch, obstacles, sample, counts)
    estimator = _estimator(observed, settings)
    maps = _empty_maps(height, width, memory)

    def solve(chunk: tuple[slice, slice]) -> None:
        light = view.intensity[:, *chunk]
        columns = light.shape[2]
        counts = light.reshape(len(light), -1)
        observed, points, quality = _observe(
            view, patch, obstacles, _pixels(chunk, width), counts, columns
        )
        _place(maps, chunk, estimator(observed, columns), points, quality, view.encoder)
        memory.release()

    # Each core has its own chunk, so that what is not compiled is shared among them too.
    share(solve, _chunks(height, width))
    maps.quality[_is_poor(maps.residual)] |= POOR_FIT
    scale = covariance_scale(maps.normal, maps.normal_cov, maps.theta, maps.z, maps.r)
    np.multiply(maps.normal_cov, np.float32(scale**2), out=maps.normal_cov)
    memory.release()
    return maps


def observe_view(view: View, grid: CylinderGrid, r: np.ndarray, r_std: np.ndarray) -> Observations:
    """All pixels of a view as `solve_view` gives them to its method, row by row.

    But for edges of shadows within a square of pixels of a chunk's border.
    """
    patch = scene.cut_patch(grid, r, r_std, view.encoder, _seen_angles(view, r))
    counts = view.intensity.reshape(len(view.leds), -1)
    pixels, width = np.arange(counts.shape[1]), view.intensity.shape[2]
    return _observe(view, patch, _obstacles(patch), pixels, counts, width)[0]


def _gather(light: np.ndarray, pixels: np.ndarray, memory: Memory | Spool) -> np.ndarray:
    """A few pixels of all LEDs, (n_leds, n): scattered ones take all pages of a frame."""
    few = np.empty((len(light), len(pixels)), light.dtype)
    for seen, frame in zip(few, light, strict=True):
        seen[:] = frame[pixels]
        memory.release()
    return few


def _estimator(
    sample: Observations, settings: PhotometrySettings
) -> Callable[[Observations, int], Estimate]:
    """The method, of pixels with so many a row, with what it learns from a sample of the view."""
    if settings.method == "map":
        material = learn_material(sample)
        return lambda seen, width: map_normals(seen, material=material, width=width)
    refinements = settings.max_refinements
    misfit = typical_misfit(sample, max_refinements=refinements)
    return lambda seen, _: sps(seen, max_refinements=refinements, misfit=misfit)


def _chunks(height: int, width: int) -> Iterator[tuple[slice, slice]]:
    """Rows and columns of parts of an image, row by row."""
    for row in range(0, height, _CHUNK_ROWS):
        for column in range(0, width, _CHUNK_COLUMNS):
            yield (
                slice(row, min(height, row + _CHUNK_ROWS)),
                slice(column, min(width, column + _CHUNK_COLUMNS)),
            )


def _pixels(chunk: tuple[slice, slice], width: int) -> np.ndarray:
    """Numbers (n,) of a chunk's pixels in an image of a width, counted row by row."""
    rows, columns = (np.arange(part.start, part.stop) for part in chunk)
    return (rows[:, None] * width + columns).ravel()


def _in_view_frame(axis: Axis, points: np.ndarray) -> np.ndarray:
    """Points of {C} in {V}: the tire frame held still at the encoder angle."""
    return (points - axis.point) @ axis.basis.T


def _pixel_directions(view: View, pixels: np.ndarray) -> np.ndarray:
    """Viewing rays (n, 3) of pixels (n,), counted row by row, in {V}."""
    camera, found = view.camera, np.empty((len(pixels), 3))
    by_ranges(
        view_kernels.directions, len(pixels), _LEAST_PX,
        pixels, camera.size_px[0], camera.intrinsics, tuple(camera.distortion.tolist()),
        np.ascontiguousarray(view.axis.basis), found,
    )  # fmt: skip
    return found


def _in_camera(view: View, points: np.ndarray) -> np.ndarray:
    """Points (n, 3), phi, z, r in {V}, in {C}."""
    found = np.empty(points.shape)
    by_ranges(
        view_kernels.to_camera, len(points), _LEAST_PX,
        points, np.ascontiguousarray(view.axis.basis), view.axis.point, found,
    )  # fmt: skip
    return found


def needed_rows(view: View, grid: CylinderGrid) -> np.ndarray:
    """Rows of a surface that a view can see or be shadowed by, in order of theta.

    Wider than what `solve_view` cuts out of them: a tread's surface is taken to lie between
    0.8 and 1.1 nominal radii, and what may cast shadows within 0.3 rad of what is seen.
    """
    radii = grid.nominal_radius_mm * np.array([0.8, 1.1])
    low, high = (
        edge + sign * 0.3 for edge, sign in zip(_angles_at(view, radii), (-1, 1), strict=True)
    )
    start = float(grid.index(np.asarray(-view.encoder), np.asarray(0.0))[0])
    first, last = (math.floor(start + edge / grid.step_theta) for edge in (low, high))
    count = len(grid.theta)
    if not grid.periodic:
        # Two rows at least, so that they make a grid, even if the view sees none of it.
        first = min(max(first, 0), count - 2)
        return np.arange(first, min(max(last + 1, first + 2), count))
    if last + 1 - first >= count:
        return np.arange(count)
    return np.arange(first, last + 1) % count


def _seen_angles(view: View, r: np.ndarray) -> tuple[float, float]:
    """Range of phi at which the view's rays enter a surface or come nearest to the axis."""
    radii = np.array([np.nanmin(r, initial=np.inf), np.nanmax(r, initial=0.0)])
    return _angles_at(view, radii) if np.isfinite(radii).all() else (0.0, 0.0)


def _angles_at(view: View, radii: np.ndarray) -> tuple[float, float]:
    width, height = view.camera.size_px
    u, v = np.meshgrid(np.linspace(0, width - 1, 33), np.linspace(0, height - 1, 33))
    rays = view.camera.rays(np.column_stack([u.ravel(), v.ravel()])) @ view.axis.basis.T
    origin = _in_view_frame(view.axis, np.zeros(3))
    a = np.sum(rays[:, :2] ** 2, axis=1)
    b = rays[:, :2] @ origin[:2]
    phis = []
    for radius in radii:
        disc = b * b - a * (origin[:2] @ origin[:2] - radius * radius)
        t = (-b - np.sqrt(np.maximum(disc, 0.0))) / a
        x, y = origin[:2, None] + t * rays[:, :2].T
        phis.append(np.arctan2(y, x))
    return float(np.min(phis)), float(np.max(phis))


def _obstacles(patch: scene.SurfacePatch) -> scene.SurfacePatch:
    """The patch for shadow rays: detail finer than its own uncertainty would only cost time."""
    some = patch.r_std.ravel()[:: max(1, patch.r_std.size // _SPREAD_PX)]
    cell = float(np.median(some)) if some.size else 0.0
    return scene.coarsen(patch, cell)


def _observe(
    view: View,
    patch: scene.SurfacePatch,
    obstacles: scene.SurfacePatch,
    pixels: np.ndarray,
    counts: np.ndarray,
    width: int | None = None,
) -> tuple[Observations, np.ndarray, np.ndarray]:
    """What pixels saw, in the local basis (r, theta, z) of their scene points.

    `counts` (n_leds, n) are the view's intensities there; with `width`, the pixels are those of a
    rectangle, row by row, with so many in a row.

    Returns
    -------
    observations : Observations
    points : (n, 3) float64
        phi, z, r in {V}.
    quality : (n,) uint8
    """
    origin = _in_view_frame(view.axis, np.zeros(3))
    leds = np.array([view.light.leds[k].position for k in view.leds])
    leds = _in_view_frame(view.axis, leds)
    points = scene.cast(patch, origin, _pixel_directions(view, pixels), width)
    lit = scene.lit(obstacles, points, leds, width)
    shape = lit.shape
    tiles = tiles_of(points, width)
    places = _in_camera(view, tiles.places)
    terms = np.stack([tiles.terms(view.light.irradiance(k, places)) for k in view.leds])
    seen = Observations(
        intensity=np.empty(shape, np.float32),
        lights=np.moveaxis(np.empty((shape[0], 3, shape[1]), np.float32), 1, 2),
        views=np.empty((shape[1], 3), np.float32),
        usable=np.empty(shape, np.bool_),
        noise=np.empty(shape, np.float32),
    )
    quality = np.empty(shape[1], np.uint8)
    wide = len(points) if width is None else width
    by_ranges(
        view_kernels.observe, -(-len(points) // max(wide, 1)), -(-_LEAST_PX // max(wide, 1)),
        wide, points, counts, terms, tiles.shape, tiles.middle, tiles.half,
        view.noise.astype(np.float32), lit, leds, origin,
        seen.intensity, seen.noise, np.moveaxis(seen.lights, 2, 1), seen.views, seen.usable,
        quality,
    )  # fmt: skip
    return seen, points, quality


def _empty_maps(height: int, width: int, memory: Memory | Spool) -> ViewNormals:
    def floats(*size: int) -> np.ndarray:
        return memory.empty((height, width, *size), np.float32)

    def counts() -> np.ndarray:
        return memory.empty((height, width), np.uint8)

    return ViewNormals(
        floats(3), floats(3), floats(), floats(), floats(), floats(), counts(),
        floats(), floats(), floats(), counts(),
    )  # fmt: skip


def _place(
    maps: ViewNormals,
    chunk: tuple[slice, slice],
    estimate: Estimate,
    points: np.ndarray,
    quality: np.ndarray,
    encoder: float,
) -> None:
    outside = (quality & OUTSIDE) > 0
    found = {
        "normal": estimate.normal,
        "normal_cov": estimate.covariance[:, 3:],
        "k_d": estimate.k_d,
        "k_s": estimate.k_s,
        "alpha": estimate.alpha,
        "residual": estimate.residual,
        "leds_used": estimate.leds_used,
        "theta": wrap_angle(points[:, 0] - encoder),
        "z": points[:, 1],
        "r": points[:, 2],
        "quality": quality | np.where(outside, np.uint8(0), estimate.flags),
    }
    for name, values in found.items():
        part = getattr(maps, name)[chunk]
        part[:] = values.reshape(part.shape)


def _is_poor(residual: np.ndarray) -> np.ndarray:
    """Residuals that stand three robust standard deviations above the view's, on a log scale.

    Those of a sample of the view tell: of a million pixels, to less than a hundredth of them.
    """
    some = residual.ravel()[:: max(1, residual.size // _SPREAD_PX)]
    known = np.log(np.maximum(some[np.isfinite(some)], 1e-6))
    if not known.size:
        return np.zeros(residual.shape, bool)
    middle = np.median(known)
    spread = _MAD_TO_STD * np.median(np.abs(known - middle))
    return residual > np.exp(middle + _POOR_SIGMAS * spread)
