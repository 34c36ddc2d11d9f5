"""What the camera sees of a mounted tire under the laser sheet."""

import cv2
import numpy as np

from treadlight.compiling import kernel
from treadlight.simulate import kernels
from treadlight.simulate.render import F0, Scene, material
from treadlight.simulate.rig import TREAD_DISTANCE_MM, SimulatedRig
from treadlight.threads import by_ranges

_FWHM_PER_SIGMA = 2.3548200450309493
# Grain of the speckle on the tread; a pixel that holds many grains shows little of it.
_GRAIN_MM = 0.16
# Every pixel is the mean of 2x2 rays: a Gaussian sampled closer than its sigma sums exactly.
_RAYS = 2


def render_laser(scene: Scene, encoder_deg: float) -> np.ndarray:
    """The tire under the laser sheet, without speckle.

    Returns
    -------
    (h, w) float32
        Reflected light: 1 is a Lambertian surface of albedo 1 that faces the sheet's source,
        in the middle of the stripe.
    """
    sim = scene.sim
    width, height = sim.camera.size_px
    rotation, shift = scene.to_body(encoder_deg)
    normal = rotation @ sim.laser_plane.normal
    plane = np.array([*normal, sim.laser_plane.offset - normal @ shift])
    out = np.zeros((height, width), np.float32)
    field = scene.field
    by_ranges(
        _render,
        height,
        1,
        out,
        sim.lens,
        shift,
        rotation,
        field.grid,
        field.envelope,
        field.meta,
        plane,
        rotation @ sim.laser_source + shift,
        sim.laser_fwhm_mm / _FWHM_PER_SIGMA,
        scene.tile,
    )
    return out


@kernel
def _may_see_stripe(o, dx, dy, dz, meta, plane, reach):
    """Whether a ray, between the largest and the smallest radius, comes near the sheet."""
    enter = kernels.enter_cylinder(o[0], o[1], dx, dy, meta[kernels.R_MAX])
    if enter < 0.0:
        return False  # within a pixel of the horizon, where no sheet arrives
    leave = kernels.enter_cylinder(o[0], o[1], dx, dy, meta[kernels.R_MIN])
    if leave < 0.0:
        leave = enter + 200.0
    base = plane[0] * o[0] + plane[1] * o[1] + plane[2] * o[2] + plane[3]
    slope = plane[0] * dx + plane[1] * dy + plane[2] * dz
    a, b = base + enter * slope, base + leave * slope
    return min(a, b) < reach and max(a, b) > -reach


@kernel
def _render(first, last, out, lens, o, rotation, grid, envelope, meta, plane, source, sigma, tile):
    weight = 1.0 / (_RAYS * _RAYS)
    reach = 4.5 * sigma
    # One pixel on the tread more, so that the middle ray can speak for the whole pixel.
    pixel_reach = reach + TREAD_DISTANCE_MM / lens[0]
    for v in range(first, last):
        for u in range(out.shape[1]):
            dx, dy, dz = kernels.ray(u, v, lens, rotation)
            if not _may_see_stripe(o, dx, dy, dz, meta, plane, pixel_reach):
                continue
            for sub in range(_RAYS * _RAYS):
                su = u + (sub % _RAYS + 0.5) / _RAYS - 0.5
                sv = v + (sub // _RAYS + 0.5) / _RAYS - 0.5
                dx, dy, dz = kernels.ray(su, sv, lens, rotation)
                t = kernels.first_hit(grid, envelope, meta, o, dx, dy, dz)
                if t < 0.0:
                    continue
                px, py, pz = o[0] + t * dx, o[1] + t * dy, o[2] + t * dz
                away = plane[0] * px + plane[1] * py + plane[2] * pz + plane[3]
                if abs(away) > reach:
                    continue
                out[v, u] += (
                    weight
                    * _reflected(grid, envelope, meta, px, py, pz, dx, dy, dz, source, tile)
                    * np.exp(-0.5 * away * away / (sigma * sigma))
                )


@kernel
def _reflected(grid, envelope, meta, px, py, pz, dx, dy, dz, source, tile):
    """Light of the sheet's source that a surface point sends to the camera, 0 in shadow."""
    r = np.sqrt(px * px + py * py)
    theta = kernels.fast_atan2(py, px)
    nr, nt, nz = kernels.normal_at(grid, meta, theta, pz, r)
    nx, ny = (nr * px - nt * py) / r, (nr * py + nt * px) / r
    lx, ly, lz = source[0] - px, source[1] - py, source[2] - pz
    scale = 1.0 / np.sqrt(lx * lx + ly * ly + lz * lz)
    lx, ly, lz = lx * scale, ly * scale, lz * scale
    nl = nx * lx + ny * ly + nz * lz
    nv = -(nx * dx + ny * dy + nz * dz)
    if nl <= 0.0 or nv <= 0.0:
        return 0.0
    if not kernels.is_lit(grid, envelope, meta, px, py, pz, lx, ly, lz):
        return 0.0
    top = kernels.envelope_at(envelope, meta, pz)
    albedo, alpha2 = material(tile, theta, pz, r, top)
    hx, hy, hz = lx - dx, ly - dy, lz - dz
    inverse = 1.0 / np.sqrt(hx * hx + hy * hy + hz * hz)
    vh = (1.0 - (lx * dx + ly * dy + lz * dz)) * inverse
    return kernels.reflect(albedo, alpha2, F0, nl, nv, (nl + nv) * inverse, vh)


def speckle(sim: SimulatedRig, rng: np.random.Generator) -> np.ndarray:
    """Speckle as a factor of mean 1, (h, w) float32.

    Fully developed speckle has an exponential intensity; the mean over the N grains in a
    pixel is gamma distributed with shape N (Goodman, Speckle Phenomena in Optics, ch. 4).
    """
    width, height = sim.camera.size_px
    pixel_mm = TREAD_DISTANCE_MM / sim.lens[0]
    grains = max(1.0, (pixel_mm / _GRAIN_MM) ** 2)
    cell_px = max(1.0, _GRAIN_MM / pixel_mm)
    shape = (int(np.ceil(height / cell_px)), int(np.ceil(width / cell_px)))
    factor = rng.standard_gamma(grains, shape, dtype=np.float32) / np.float32(grains)
    if cell_px > 1:
        return cv2.resize(factor, (width, height), interpolation=cv2.INTER_LINEAR)
    return factor


def add_ghosts(stripe: np.ndarray, scan: str, rng: np.random.Generator) -> np.ndarray:
    """A few weak copies of pieces of the stripe beside it, as light that bounced in a groove.

    Parameters
    ----------
    stripe : (h, w) float32
    scan : str
        ``rows``: the copy is shifted along the rows; ``columns``: along the columns.

    Returns
    -------
    (h, w) float32
    """
    image = stripe if scan == "rows" else stripe.T
    lines, across = image.shape
    ghosts = np.zeros_like(image)
    for _ in range(rng.poisson(2.0)):
        first = int(rng.integers(0, lines))
        count = max(2, int(rng.uniform(0.02, 0.06) * lines))
        shift = int(rng.choice([-1, 1]) * max(4, rng.uniform(0.03, 0.08) * across))
        piece = rng.uniform(0.03, 0.1) * np.roll(image[first : first + count], shift, axis=1)
        ghosts[first : first + count] += piece.astype(np.float32)
    return stripe + (ghosts if scan == "rows" else ghosts.T)
