"""The frames of a calibration capture: boards, laser on boards, chrome balls, card."""

import math

import numpy as np

from treadlight.archive.manifest import Board
from treadlight.compiling import kernel
from treadlight.geometry import Led
from treadlight.simulate import kernels
from treadlight.simulate.render import CARD_ALBEDO, MANY_PIXELS, beam_irradiance
from treadlight.simulate.rig import TREAD_DISTANCE_MM, SimulatedRig, board_outline
from treadlight.threads import by_ranges

_WHITE, _BLACK = 0.8, 0.07
_FWHM_PER_SIGMA = 2.3548200450309493
_CHROME = 0.6
# A pixel is the mean of so many rays; images with millions of pixels make do with fewer.
_RAYS, _FEW_RAYS = 16, 4
# An LED's image in a ball is far under a pixel; its blob is the lens's and the chip's.
_HIGHLIGHT_SIGMA_PX = 0.7


def render_board(sim: SimulatedRig, board: Board, pose: np.ndarray) -> np.ndarray:
    """A checkerboard under even light.

    Parameters
    ----------
    sim : SimulatedRig
    board : Board
    pose : (4, 4) float
        Board to {C}, mm.

    Returns
    -------
    (h, w) float32
        About 0.8 on the white of a board that faces the camera at the tread's distance.
    """
    return _board(sim, board, pose, np.zeros(4), 0.0, sim.laser_source)


def render_board_laser(sim: SimulatedRig, board: Board, pose: np.ndarray) -> np.ndarray:
    """The same board under the laser sheet alone, (h, w) float32, scaled as `render_laser`."""
    plane = np.array([*sim.laser_plane.normal, sim.laser_plane.offset])
    sigma = sim.laser_fwhm_mm / _FWHM_PER_SIGMA
    return _board(sim, board, pose, plane, sigma, sim.laser_source)


def _board(
    sim: SimulatedRig,
    board: Board,
    pose: np.ndarray,
    plane: np.ndarray,
    sigma: float,
    source: np.ndarray,
) -> np.ndarray:
    width, height = sim.camera.size_px
    out = np.zeros((height, width), np.float32)
    shape = np.array([*board.inner_corners, board.square_mm, *board_outline(board)[2]], float)
    by_ranges(
        _render_board, len(out), 1, out, _rays(out), sim.lens, pose, shape, plane, sigma, source
    )
    return out


def _rays(image: np.ndarray) -> np.ndarray:
    """Offsets (n, 2) of the rays within a pixel.

    Hammersley's points: no two share a row or column, so that an edge along the pixels lies
    within 1/2n of a pixel and not, as on a square grid, within 1/2 sqrt(n).
    """
    count = _RAYS if image.size < MANY_PIXELS else _FEW_RAYS
    bits = count.bit_length() - 1
    mirrored = [int(f"{k:0{bits}b}"[::-1], 2) for k in range(count)]
    return (np.column_stack([np.arange(count), mirrored]) + 0.5) / count - 0.5


@kernel
def _render_board(first, last, out, rays, lens, pose, shape, plane, sigma, source):
    weight = 1.0 / len(rays)
    nx, ny, square = shape[0] + 1, shape[1] + 1, shape[2]
    for v in range(first, last):
        for u in range(out.shape[1]):
            total = 0.0
            for sub in range(len(rays)):
                su, sv = u + rays[sub, 0], v + rays[sub, 1]
                x, y = kernels.undistorted(su, sv, lens)
                slope = pose[0, 2] * x + pose[1, 2] * y + pose[2, 2]
                lift = pose[0, 2] * pose[0, 3] + pose[1, 2] * pose[1, 3] + pose[2, 2] * pose[2, 3]
                t = lift / slope
                px, py, pz = t * x - pose[0, 3], t * y - pose[1, 3], t - pose[2, 3]
                bx = pose[0, 0] * px + pose[1, 0] * py + pose[2, 0] * pz
                by = pose[0, 1] * px + pose[1, 1] * py + pose[2, 1] * pz
                if abs(bx) > shape[3] or abs(by) > shape[4]:
                    continue
                i = int(np.floor(bx / square + 0.5 * nx))
                j = int(np.floor(by / square + 0.5 * ny))
                dark = 0 <= i < nx and 0 <= j < ny and (i + j) % 2 == 0
                albedo = _BLACK if dark else _WHITE
                if sigma > 0.0:
                    sx, sy, sz = source[0] - t * x, source[1] - t * y, source[2] - t
                    d = np.sqrt(sx * sx + sy * sy + sz * sz)
                    nl = (pose[0, 2] * sx + pose[1, 2] * sy + pose[2, 2] * sz) / d
                    away = plane[0] * t * x + plane[1] * t * y + plane[2] * t + plane[3]
                    if abs(away) < 4.5 * sigma and nl > 0.0:
                        total += albedo * nl * np.exp(-0.5 * away * away / (sigma * sigma))
                else:
                    facing = -slope / np.sqrt(x * x + y * y + 1.0)
                    near = TREAD_DISTANCE_MM / t
                    total += albedo * max(facing, 0.0) * near * near
            out[v, u] = weight * total


def render_card(sim: SimulatedRig, led: int) -> np.ndarray:
    """The grey card in the reference plane under one LED, (h, w) float32, as `render_leds`."""
    return _plane_with_balls(sim, led, np.zeros((0, 3)))


def render_balls(sim: SimulatedRig, led: int) -> np.ndarray:
    """The balls on the card under one LED, without the mirror image of the LED.

    The card shows the balls' shadows, the balls mirror the card.

    Returns
    -------
    (h, w) float32
        Scaled as `render_leds`.
    """
    return _plane_with_balls(sim, led, sim.ball_centres)


def _plane_with_balls(sim: SimulatedRig, led: int, balls: np.ndarray) -> np.ndarray:
    width, height = sim.camera.size_px
    out = np.zeros((height, width), np.float32)
    light = sim.rig.leds[led]
    lamp = np.array([*light.position, *sim.beams[led], light.intensity])
    plane = np.array([*sim.reference_plane.normal, sim.reference_plane.offset])
    rays = _rays(out) if len(balls) else np.zeros((1, 2))
    radius = 0.5 * sim.ball_diameter_mm
    by_ranges(_render_plane, len(out), 1, out, rays, sim.lens, plane, lamp, balls, radius)
    return out


@kernel
def _sphere(o, d, centre, radius):
    """Ray parameter at which a ray of unit direction enters a sphere; -1 where it does not."""
    mx, my, mz = o[0] - centre[0], o[1] - centre[1], o[2] - centre[2]
    b = mx * d[0] + my * d[1] + mz * d[2]
    discriminant = b * b - (mx * mx + my * my + mz * mz - radius * radius)
    if discriminant <= 0.0:
        return -1.0
    return -b - np.sqrt(discriminant)


@kernel
def _nearest(o, d, balls, radius):
    best, which = 1e30, -1
    for k in range(balls.shape[0]):
        t = _sphere(o, d, balls[k], radius)
        if 1e-6 < t < best:
            best, which = t, k
    return best, which


@kernel
def _card_light(o, d, plane, lamp, balls, radius):
    """Light of the card where a ray meets it, 0 in a ball's shadow or where it never does."""
    slope = plane[0] * d[0] + plane[1] * d[1] + plane[2] * d[2]
    lift = plane[0] * o[0] + plane[1] * o[1] + plane[2] * o[2] + plane[3]
    if slope >= -1e-9:
        return 0.0
    t = -lift / slope
    p = (o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2])
    lx, ly, lz = lamp[0] - p[0], lamp[1] - p[1], lamp[2] - p[2]
    d2 = lx * lx + ly * ly + lz * lz
    scale = 1.0 / np.sqrt(d2)
    to_light = (lx * scale, ly * scale, lz * scale)
    nl = plane[0] * to_light[0] + plane[1] * to_light[1] + plane[2] * to_light[2]
    beam = -(lamp[3] * to_light[0] + lamp[4] * to_light[1] + lamp[5] * to_light[2])
    if nl <= 0.0 or beam <= 0.0:
        return 0.0
    if _nearest(p, to_light, balls, radius)[1] >= 0:
        return 0.0
    return CARD_ALBEDO * nl * beam_irradiance(lamp[6], beam, d2)


@kernel
def _render_plane(first, last, out, rays, lens, plane, lamp, balls, radius):
    weight = 1.0 / len(rays)
    o = (0.0, 0.0, 0.0)
    for v in range(first, last):
        for u in range(out.shape[1]):
            total = 0.0
            for sub in range(len(rays)):
                su, sv = u + rays[sub, 0], v + rays[sub, 1]
                x, y = kernels.undistorted(su, sv, lens)
                scale = 1.0 / np.sqrt(x * x + y * y + 1.0)
                d = (x * scale, y * scale, scale)
                t, k = _nearest(o, d, balls, radius)
                if k < 0:
                    total += _card_light(o, d, plane, lamp, balls, radius)
                    continue
                p = (t * d[0], t * d[1], t * d[2])
                nx = (p[0] - balls[k, 0]) / radius
                ny = (p[1] - balls[k, 1]) / radius
                nz = (p[2] - balls[k, 2]) / radius
                dn = 2.0 * (d[0] * nx + d[1] * ny + d[2] * nz)
                mirrored = (d[0] - dn * nx, d[1] - dn * ny, d[2] - dn * nz)
                if _nearest(p, mirrored, balls, radius)[1] < 0:
                    total += _CHROME * _card_light(p, mirrored, plane, lamp, balls, radius)
            out[v, u] = weight * total


def highlight_points(centres: np.ndarray, radius_mm: float, led: Led) -> np.ndarray:
    """Points of mirror balls at which the camera sees an LED.

    The normal there halves the angle between the directions to the camera and to the LED;
    found by fixed point, which gains a factor distance / radius each time.

    Parameters
    ----------
    centres : (n, 3) float
        {C}, mm.
    radius_mm : float
    led : Led

    Returns
    -------
    (n, 3) float64
        {C}, mm.
    """
    points = np.asarray(centres, float)
    for _ in range(30):
        to_led = led.position - points
        to_camera = -points
        half = to_led / np.linalg.norm(to_led, axis=1, keepdims=True)
        half = half + to_camera / np.linalg.norm(to_camera, axis=1, keepdims=True)
        points = centres + radius_mm * half / np.linalg.norm(half, axis=1, keepdims=True)
    return points


def add_highlights(image: np.ndarray, sim: SimulatedRig, led: int, peak: float) -> np.ndarray:
    """Add the mirror image of an LED in each ball, a Gaussian blob integrated over pixels.

    Parameters
    ----------
    image : (h, w) float32
        Already blurred.
    sim : SimulatedRig
    led : int
    peak : float
        Height of the blob of an LED of intensity 1.

    Returns
    -------
    (h, w) float32
    """
    light = sim.rig.leds[led]
    points = highlight_points(sim.ball_centres, 0.5 * sim.ball_diameter_mm, light)
    out = image.copy()
    height, width = image.shape
    for u, v in sim.camera.project(points):
        column = _blob(u, width)
        row = _blob(v, height)
        out += np.float32(peak * light.intensity) * row[:, None] * column
    return out


def _blob(centre: float, count: int) -> np.ndarray:
    """A Gaussian of height 1 integrated over pixels, (count,) float32."""
    scale = 1 / (_HIGHLIGHT_SIGMA_PX * math.sqrt(2))
    edges = [math.erf(scale * (k - 0.5 - centre)) for k in range(count + 1)]
    height = _HIGHLIGHT_SIGMA_PX * math.sqrt(math.pi / 2)
    return (height * np.diff(edges)).astype(np.float32)
