"""A made-up tire: its surface r(theta, z) in its own frame {B}, new and worn, and its mounting.

{B} has z along the tire's own axis with 0 at the middle of the tread. What is made here is a
plausible road tire, different for each seed: five ribs between four circumferential grooves
with wear bars, slanted slots and sipes in pitches of uneven length, a zigzag sipe in the
middle rib, a round shoulder, runout and a rubber texture.
"""

import itertools
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from treadlight.compiling import kernel
from treadlight.simulate import kernels
from treadlight.simulate.random import stream
from treadlight.simulate.settings import NOMINAL_RADIUS_MM
from treadlight.threads import by_ranges

HALF_WIDTH_MM = 112.0
_TWO_PI = 2 * np.pi
_TILE = (1024, 512)
_LEAST_POINTS = 1 << 12
# Texture of moulded rubber: wavelength mm, amplitude mm of the lattice noise.
_TEXTURE = np.array([[0.9, 0.035], [2.6, 0.05], [9.0, 0.06]])
_WEAR_BAR_MM = 1.6


@dataclass(frozen=True)
class Tire:
    """One tire; every array below follows from its seed.

    Attributes
    ----------
    grooves : (n, 4) float
        Circumferential grooves: z of the middle, half width at the top, depth, mm, and run
        of the wall per depth.
    features : (n, 10) float
        Slots and sipes: z from, z to, fraction of the pitch, half width, depth, run of the
        wall per depth, slant (mm along theta per mm of z), zigzag amplitude mm, zigzag
        wavelength mm, shift of the pitch sequence rad.
    pitches : (n + 1,) float
        Boundaries of the pitches, rad, from 0 to 2 pi.
    wear_bars : (n,) float
        Theta of the wear bars in the circumferential grooves, rad.
    runout : (n, 2) float
        Amplitude mm and phase rad of the harmonics 1, 2, ...
    rib_wear : (n, 2) float
        z of a rib's middle and its wear relative to the mean.
    wear_harmonics : (2, 2) float
        Relative amplitude and phase of the wear's harmonics 1 and 3.
    tile : (1024, 512) float32
        Lattice noise in [-1, 1].
    """

    grooves: np.ndarray
    features: np.ndarray
    pitches: np.ndarray
    wear_bars: np.ndarray
    runout: np.ndarray
    rib_wear: np.ndarray
    wear_harmonics: np.ndarray
    tile: np.ndarray


def make_tire(seed: int, name: str) -> Tire:
    """A tire that depends on the seed and its name alone."""
    rng = stream(seed, "tire", name)
    middles = np.array([-61.0, -21.0, 21.0, 61.0]) + rng.uniform(-1.5, 1.5, 4)
    grooves = np.column_stack(
        [middles, rng.uniform(4.6, 5.6, 4), rng.uniform(7.7, 8.3, 4), np.full(4, 0.13)]
    )
    edges = np.concatenate([[-HALF_WIDTH_MM], middles, [HALF_WIDTH_MM]])
    rib_middles = 0.5 * (edges[1:] + edges[:-1])
    rib_middles[[0, -1]] = [-80.0, 80.0]
    lengths = rng.permutation(np.repeat([0.86, 1.0, 1.17], 20)) * rng.uniform(0.98, 1.02, 60)
    return Tire(
        grooves=grooves,
        features=_features(edges, rng),
        pitches=_TWO_PI * np.concatenate([[0.0], np.cumsum(lengths) / lengths.sum()]),
        wear_bars=_TWO_PI * (np.arange(6) + rng.uniform(-0.2, 0.2, 6)) / 6,
        runout=np.column_stack(
            [rng.uniform(0.5, 1.0, 4) * [0.12, 0.05, 0.03, 0.02], rng.uniform(0, _TWO_PI, 4)]
        ),
        rib_wear=np.column_stack([rib_middles, _rib_wear(rng)]),
        wear_harmonics=np.column_stack([[0.22, 0.12], rng.uniform(0, _TWO_PI, 2)]),
        tile=rng.uniform(-1.0, 1.0, _TILE).astype(np.float32),
    )


def _rib_wear(rng: np.random.Generator) -> np.ndarray:
    wear = np.array([1.25, 0.95, 0.8, 0.9, 1.1]) + rng.uniform(-0.1, 0.1, 5)
    return wear / wear.mean()


def _features(edges: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Two slots or sipes per pitch and rib; shoulders have slots, the middle has sipes."""
    rows = []
    for rib, (low, high) in enumerate(itertools.pairwise(edges)):
        shift = rng.uniform(0, _TWO_PI / 60)
        slant = rng.uniform(0.25, 0.55) * (1 if rib < 2 else -1)
        if rib in (0, 4):
            rows.append([low, high, 0.3, 2.6, 6.6, 0.12, 0.3 * slant, 0.0, 1.0, shift])
            rows.append([low, high, 0.75, 0.55, 5.2, 0.02, 0.3 * slant, 0.0, 1.0, shift])
        elif rib == 2:
            rows.append([low, high, 0.35, 0.5, 5.5, 0.02, 0.0, 2.2, 13.0, shift])
            rows.append([low, high, 0.8, 0.5, 5.5, 0.02, 0.0, 2.2, 13.0, shift])
        else:
            rows.append([low, high, 0.3, 1.7, 6.2, 0.1, slant, 0.0, 1.0, shift])
            rows.append([low, high, 0.75, 0.45, 4.5, 0.02, slant, 0.0, 1.0, shift])
    return np.array(rows)


@dataclass(frozen=True)
class HeightField:
    """A tire's surface on a grid in {B}, as `kernels` takes it.

    A mounting's change of radius (pressure, temperature) comes in by `with_radial`.

    Attributes
    ----------
    grid : (n, m) float32
        Radii, mm.
    envelope : (2, m) float64
        Radii of the smallest convex body of revolution about the tire, and the largest
        radius near each z, mm.
    meta : (9,) float64
    """

    grid: np.ndarray
    envelope: np.ndarray
    meta: np.ndarray

    def with_radial(self, radial_mm: float) -> "HeightField":
        """The same surface with another amount added to every radius, mm."""
        meta = self.meta.copy()
        change = radial_mm - meta[kernels.RADIAL]
        meta[[kernels.RADIAL, kernels.R_MAX, kernels.R_MIN]] += change
        return replace(self, meta=meta)

    def __call__(self, theta: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Radii (mm) at points of {B}; NaN where there is no tire."""
        theta, z = np.broadcast_arrays(np.asarray(theta, float), np.asarray(z, float))
        found = np.empty(theta.size)
        place = theta.ravel(), z.ravel()
        by_ranges(_sample, found.size, _LEAST_POINTS, self.grid, self.meta, *place, found)
        return np.where(found > 0, found, np.nan).reshape(theta.shape)


@kernel
def _sample(first, last, grid, meta, theta, z, out):
    for k in range(first, last):
        out[k] = kernels.surface(grid, meta, theta[k], z[k])


def field_step_mm(pixel_mm: float) -> float:
    """Step of the height field: a third of a pixel; sipes need 0.28 mm, no pixel 0.03."""
    return float(np.clip(pixel_mm / 3, 0.03, 0.28))


def height_field(
    tire: Tire,
    wear_mm: float,
    step_mm: float,
    *,
    sector: tuple[float, float] | None = None,
) -> HeightField:
    """The surface of a tire after some wear.

    Parameters
    ----------
    tire : Tire
    wear_mm : float
        Mean loss on the block tops, mm.
    step_mm : float
    sector : (float, float) or None
        First and last theta in {B}, rad; None is the whole turn.
    """
    first, last = sector or (0.0, _TWO_PI)
    count = int(np.ceil((last - first) * NOMINAL_RADIUS_MM / step_mm))
    step_theta = (last - first) / count
    theta = first + step_theta * np.arange(count + (sector is not None))
    z = np.arange(-HALF_WIDTH_MM, HALF_WIDTH_MM + 0.5 * step_mm, step_mm)
    grid = np.empty((len(theta), len(z)), np.float32)
    by_ranges(
        _fill,
        len(theta),
        1,
        grid,
        theta,
        z,
        tire.grooves,
        tire.features,
        tire.pitches,
        tire.wear_bars,
        tire.tile,
        _runout(tire, theta),
        wear_mm * _wear_along_theta(tire, theta),
        np.interp(z, tire.rib_wear[:, 0], tire.rib_wear[:, 1]),
        _TEXTURE,
    )
    highest = np.pad(grid.max(axis=0).astype(np.float64), 1, mode="edge")
    highest = np.max([highest[:-2], highest[1:-1], highest[2:]], axis=0)
    envelope = np.stack([_hull(z, highest), highest])
    meta = np.zeros(9)
    meta[kernels.THETA0] = first
    meta[kernels.INV_STEP_THETA] = 1 / step_theta
    meta[kernels.Z0] = z[0]
    meta[kernels.INV_STEP_Z] = 1 / step_mm
    meta[kernels.R_MAX] = envelope.max() + 0.01
    meta[kernels.R_MIN] = float(grid.min()) - 0.01
    meta[kernels.WRAPS] = sector is None
    meta[kernels.STEP_MM] = step_mm
    return HeightField(grid, envelope, meta)


def _hull(z: np.ndarray, r: np.ndarray) -> np.ndarray:
    """The smallest concave function over r(z), (m,): it bridges grooves (Andrew 1979)."""
    kept: list[int] = []
    for k in range(len(z)):
        while len(kept) > 1:
            a, b = kept[-2], kept[-1]
            if (r[b] - r[a]) * (z[k] - z[a]) > (r[k] - r[a]) * (z[b] - z[a]):
                break
            kept.pop()
        kept.append(k)
    return np.interp(z, z[kept], r[kept])


def _runout(tire: Tire, theta: np.ndarray) -> np.ndarray:
    orders = np.arange(1, len(tire.runout) + 1)
    return np.cos(theta[:, None] * orders - tire.runout[:, 1]) @ tire.runout[:, 0]


def _wear_along_theta(tire: Tire, theta: np.ndarray) -> np.ndarray:
    (a1, p1), (a3, p3) = tire.wear_harmonics
    return 1 + a1 * np.cos(theta - p1) + a3 * np.cos(3 * theta - p3)


@kernel
def _slot_depth(f, pitches, theta, z):
    """Depth of one family of slots or sipes at a point, mm."""
    middle = 0.5 * (f[0] + f[1])
    shift = f[6] * (z - middle)
    if f[7] > 0.0:
        phase = z / f[8] - np.floor(z / f[8])
        shift += f[7] * (4.0 * abs(phase - 0.5) - 1.0)
    turn = (theta + shift / NOMINAL_RADIUS_MM - f[9]) / _TWO_PI
    angle = (turn - np.floor(turn)) * _TWO_PI
    k = min(max(np.searchsorted(pitches, angle, side="right") - 1, 0), pitches.shape[0] - 2)
    centre = pitches[k] + f[2] * (pitches[k + 1] - pitches[k])
    s = abs(angle - centre) * NOMINAL_RADIUS_MM
    return min(max((f[3] - s) / f[5], 0.0), f[4])


@kernel
def _groove_depth(g, wear_bars, theta, z):
    """Depth of one circumferential groove, less at a wear bar, mm."""
    depth = min(max((g[1] - abs(z - g[0])) / g[3], 0.0), g[2])
    if depth == 0.0:
        return 0.0
    for k in range(wear_bars.shape[0]):
        away = abs(theta - wear_bars[k])
        away = min(away, abs(_TWO_PI - away)) * NOMINAL_RADIUS_MM
        bar = min(max((8.0 - away) / 1.5, 0.0), _WEAR_BAR_MM)
        depth = min(depth, g[2] - bar)
    return depth


@kernel
def _fill(
    first,
    last,
    grid,
    theta,
    z,
    grooves,
    features,
    pitches,
    wear_bars,
    tile,
    runout,
    wear,
    rib_wear,
    texture,
):
    for i in range(first, last):
        t = theta[i] % _TWO_PI
        for j in range(z.shape[0]):
            zj = z[j]
            depth = 0.0
            for k in range(grooves.shape[0]):
                depth = max(depth, _groove_depth(grooves[k], wear_bars, t, zj))
            for k in range(features.shape[0]):
                if features[k, 0] <= zj <= features[k, 1]:
                    depth = max(depth, _slot_depth(features[k], pitches, t, zj))
            # A round crown, then the shoulder bends away.
            r = NOMINAL_RADIUS_MM - 5.0e-4 * zj * zj
            over = max(abs(zj) - 88.0, 0.0)
            r -= over * over / 28.0
            for k in range(texture.shape[0]):
                period = round(_TWO_PI * NOMINAL_RADIUS_MM / texture[k, 0])
                x = t / _TWO_PI * period
                r += texture[k, 1] * kernels.value_noise(tile, x, zj / texture[k, 0], period)
            # Wear takes the tops; it fades out on the walls and leaves the floors alone.
            fade = min(max(0.5 * (3.0 - depth), 0.0), 1.0)
            fade = fade * fade * (3.0 - 2.0 * fade)
            grid[i, j] = r - depth + runout[i] - wear[i] * rib_wear[j] * fade


@dataclass(frozen=True)
class Mounting:
    """How a tire sits on the rig: X_T = Rx(tilt0) Ry(tilt1) Rz(rotation) X_B + shift.

    Attributes
    ----------
    rotation_deg : float
    axial_mm : float
        Beside `hub_z_mm`.
    tilt_deg, ecc_mm : (float, float)
        About, and along, x and y of {T}.
    radius_change_mm : float
        Added to every radius in {B}, before the motion.
    hub_z_mm : float
        z of the hub in {T}.
    """

    rotation_deg: float
    axial_mm: float
    tilt_deg: tuple[float, float]
    ecc_mm: tuple[float, float]
    radius_change_mm: float
    hub_z_mm: float

    @cached_property
    def rotation(self) -> np.ndarray:
        """(3, 3), {B} to {T}."""
        a, b, c = np.radians([*self.tilt_deg, self.rotation_deg])
        rx = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
        ry = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
        rz = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
        return rx @ ry @ rz

    @cached_property
    def shift(self) -> np.ndarray:
        """(3,) mm in {T}."""
        return np.array([*self.ecc_mm, self.hub_z_mm + self.axial_mm])


def make_mounting(rng: np.random.Generator, hub_z_mm: float) -> Mounting:
    """A mounting as a careful person does it: any rotation, the rest within tenths."""
    return Mounting(
        rotation_deg=round(float(rng.uniform(-180, 180)), 3),
        axial_mm=round(float(rng.uniform(-1.2, 1.2)), 3),
        tilt_deg=(round(float(rng.uniform(-0.2, 0.2)), 4), round(float(rng.uniform(-0.2, 0.2)), 4)),
        ecc_mm=(round(float(rng.uniform(-0.3, 0.3)), 4), round(float(rng.uniform(-0.3, 0.3)), 4)),
        radius_change_mm=round(float(rng.uniform(-0.15, 0.15)), 4),
        hub_z_mm=hub_z_mm,
    )


def mounted_profile(
    field: HeightField, mounting: Mounting, theta: np.ndarray, z: np.ndarray
) -> np.ndarray:
    """Radii of a mounted tire at equal (theta, z) of {T}.

    Solved by fixed point along r: the mounting's tilts are so small that each pass gains
    more than a digit, on groove walls too.

    Parameters
    ----------
    theta, z : (n,), (m,) float
        rad, mm, in {T} at encoder zero.

    Returns
    -------
    (n, m) float32
        mm; NaN where there is no tire.
    """
    out = np.empty((len(theta), len(z)), np.float32)
    source = field.grid, field.meta, mounting.rotation, mounting.shift
    by_ranges(_mounted, len(theta), 1, *source, theta, z, out)
    return out


@kernel
def _mounted(first, last, grid, meta, rotation, shift, theta, z, out):
    for i in range(first, last):
        c, s = np.cos(theta[i]), np.sin(theta[i])
        for j in range(z.shape[0]):
            r = NOMINAL_RADIUS_MM
            found = kernels.OUTSIDE
            for _ in range(25):
                x, y, w = r * c - shift[0], r * s - shift[1], z[j] - shift[2]
                bx = rotation[0, 0] * x + rotation[1, 0] * y + rotation[2, 0] * w
                by = rotation[0, 1] * x + rotation[1, 1] * y + rotation[2, 1] * w
                bz = rotation[0, 2] * x + rotation[1, 2] * y + rotation[2, 2] * w
                found = kernels.surface(grid, meta, kernels.fast_atan2(by, bx), bz)
                if found == kernels.OUTSIDE:
                    break
                change = found - np.sqrt(bx * bx + by * by)
                r += change
                if abs(change) < 1e-5:
                    break
            out[i, j] = r if found != kernels.OUTSIDE else np.nan
