"""Where a view's pixels meet the tire's surface, and which LEDs a rib hides from them.

The surface is a height field r(theta, z), so rays are marched through it directly: that needs
no mesh and no tree, keeps its memory to the grid itself, and gives the same bits on any number
of cores. Coarse grids of the highest surface in a block of cells tell which of their steps cannot
meet anything: those are skipped, and nothing else changes.

Everything here happens in {V}, the tire frame {T} held still at one encoder angle: x from the
axis to the camera centre, z along the axis, and phi = theta + encoder.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from treadlight.geometry import CylinderGrid
from treadlight.photometric import block_kernels, ray_kernels, shadow_kernels
from treadlight.threads import by_ranges

# A ray that leaves the surface flatter than this (72 degrees off its normal) is not looked for
# beyond the seen sector: the patch reaches this many height ranges past it.
_REACH = 3.0
# Cells along a side of the blocks whose highest and lowest values are kept.
_NEAR, _FAR = ray_kernels.BLOCKS
_LEAST_SQUARES, _LEAST_TILES, _LEAST_BLOCKS = 1 << 8, 1 << 4, 1 << 4


@dataclass(frozen=True)
class SurfacePatch:
    """The part of a surface that one view can see or be shadowed by, in {V}.

    Attributes
    ----------
    phi_0, step_phi : float
        First row's angle and the rows' distance, rad.
    z_0, step_z : float
        First column and the columns' distance, mm.
    r : (rows, columns) float32
        mm; NaN where there is no surface.
    r_std : (rows, columns) float32
        Standard uncertainty of `r`, mm; never NaN.
    """

    phi_0: float
    step_phi: float
    z_0: float
    step_z: float
    r: np.ndarray
    r_std: np.ndarray

    @cached_property
    def r_max(self) -> float:
        """mm; -inf if the patch holds no surface."""
        return float(np.nanmax(self.r, initial=-np.inf))

    @cached_property
    def r_min(self) -> float:
        return float(np.nanmin(self.r, initial=np.inf))

    @property
    def step_mm(self) -> float:
        """The finer of the two grid steps, mm."""
        return min(self.step_phi * self.r_max, self.step_z)

    @cached_property
    def tops(self) -> tuple[np.ndarray, np.ndarray]:
        """Highest `r` within blocks of cells (`ray_kernels.BLOCKS`) and those around each."""
        near = block_tops(self.r, _NEAR)
        far = _highest_of(near, _FAR // _NEAR)
        return _with_neighbours(near), _with_neighbours(far)

    @cached_property
    def obstacles(self) -> tuple[np.ndarray, np.ndarray]:
        """Highest `r` and least `r_std` within blocks of `shadow_kernels.BLOCK` cells."""
        size = shadow_kernels.BLOCK
        return block_tops(self.r, size), -block_tops(-self.r_std, size)

    @cached_property
    def hurdles(self) -> np.ndarray:
        """Highest `r` within blocks of `shadow_kernels.BLOCK` cells and those around each."""
        return _with_neighbours(self.obstacles[0])

    @cached_property
    def crests(self) -> np.ndarray:
        """Highest surface at a column or beyond it, towards -z (row 0) and +z (row 1)."""
        crest = np.fmax.reduce(self.r, axis=0, initial=-np.inf)
        return np.stack([np.maximum.accumulate(crest), np.maximum.accumulate(crest[::-1])[::-1]])


def block_tops(field: np.ndarray, size: int) -> np.ndarray:
    """Highest values within blocks of `size` x `size` cells and the next row and column.

    So that what is interpolated within a block is never above. -inf where nothing is known.
    """
    out = np.empty([-(-n // size) for n in field.shape], np.float32)
    by_ranges(block_kernels.tops, len(out), _LEAST_BLOCKS, np.asarray(field), size, out)
    return out


def _highest_of(tops: np.ndarray, size: int) -> np.ndarray:
    """Those of blocks of `size` x `size` blocks: these share their borders already."""
    down = np.maximum.reduceat(tops, np.arange(0, tops.shape[0], size), axis=0)
    return np.maximum.reduceat(down, np.arange(0, tops.shape[1], size), axis=1)


def _with_neighbours(tops: np.ndarray) -> np.ndarray:
    padded = np.pad(tops, 1, constant_values=-np.inf)
    rows, columns = tops.shape
    return np.maximum.reduce(
        [padded[i : i + rows, j : j + columns] for i in range(3) for j in range(3)]
    )


def cut_patch(
    grid: CylinderGrid,
    r: np.ndarray,
    r_std: np.ndarray,
    encoder: float,
    phi_range: tuple[float, float],
) -> SurfacePatch:
    """The rows of a surface that matter to a view.

    Parameters
    ----------
    grid : CylinderGrid
    r, r_std : (n_theta, n_z) float
        mm; where `r` is known and `r_std` is not, its median stands in (0 if none is known).
    encoder : float
        Rad.
    phi_range : (float, float)
        Seen angles phi = theta + encoder, rad; widened here by what may cast shadows.

    Returns
    -------
    SurfacePatch
        Without rows if the surface has none there.
    """
    height = np.nanmax(r, initial=-np.inf) - np.nanmin(r, initial=np.inf)
    margin = _REACH * max(float(height), 0.0) / grid.nominal_radius_mm
    start, _ = grid.index(np.asarray(-encoder), np.asarray(0.0))
    low = math.floor(float(start) + (phi_range[0] - margin) / grid.step_theta)
    high = math.ceil(float(start) + (phi_range[1] + margin) / grid.step_theta) + 1
    count = len(grid.theta)
    if grid.periodic:
        rows = np.arange(low, min(high, low + count))
    else:
        rows = np.arange(max(low, 0), min(high, count))
    first = float(rows[0]) if len(rows) else 0.0
    return SurfacePatch(
        phi_0=(first - float(start)) * grid.step_theta,
        step_phi=grid.step_theta,
        z_0=float(grid.z[0]),
        step_z=grid.step_z,
        r=np.ascontiguousarray(_take_rows(r, rows), np.float32),
        r_std=np.ascontiguousarray(_take_rows(_filled(r_std), rows), np.float32),
    )


def _take_rows(field: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Consecutive rows of a field, counted on around the turn; not copied unless they wrap."""
    if len(rows) and rows[0] >= 0 and rows[-1] < len(field):
        return field[rows[0] : rows[-1] + 1]
    return field[rows % len(field)]


def _filled(std: np.ndarray) -> np.ndarray:
    """With the median where it is not known; 0 if none is."""
    known = np.isfinite(std)
    if known.all():
        return std
    return np.where(known, std, np.median(std[known]) if known.any() else 0.0)


def coarsen(patch: SurfacePatch, cell_mm: float) -> SurfacePatch:
    """The patch on a grid whose cells are means of whole cells and at most `cell_mm` wide."""
    stride = max(1, int(cell_mm / patch.step_mm)) if patch.r.size else 1
    if stride == 1:
        return patch
    shape = [size // stride for size in patch.r.shape]
    r, r_std = np.empty(shape, np.float32), np.empty(shape, np.float32)
    for field, out in ((patch.r, r), (patch.r_std, r_std)):
        by_ranges(block_kernels.means, len(out), _LEAST_BLOCKS, field, stride, out)
    return SurfacePatch(
        phi_0=patch.phi_0 + 0.5 * (stride - 1) * patch.step_phi,
        step_phi=patch.step_phi * stride,
        z_0=patch.z_0 + 0.5 * (stride - 1) * patch.step_z,
        step_z=patch.step_z * stride,
        r=r,
        r_std=r_std,
    )


def cast(
    patch: SurfacePatch, origin: np.ndarray, directions: np.ndarray, width: int | None = None
) -> np.ndarray:
    """First points where rays from outside meet the surface.

    Parameters
    ----------
    patch : SurfacePatch
    origin : (3,) float64
        The camera centre in {V}, mm.
    directions : (n, 3) float64
        In {V}, any length.
    width : int, optional
        The rays are those of an image's pixels, row by row, with so many in a row: what
        neighbours cannot meet is then found out for them together, which changes no result.

    Returns
    -------
    (n, 3) float64
        phi (rad), z (mm), r (mm) of the points; NaN where a ray meets no known surface, or
        is below it when it leaves a hole, so that it met something unknown before.
    """
    found = np.full((len(directions), 3), np.nan)
    if patch.r_max > 0.0:
        width = max(len(directions) if width is None else width, 1)
        down, across = ray_kernels.squares(width, len(directions))
        by_ranges(
            ray_kernels.cast, down * across, _LEAST_SQUARES,
            patch.r, patch.tops, patch.phi_0, patch.step_phi, patch.z_0, patch.step_z,
            patch.r_min, patch.r_max, patch.step_mm,
            np.ascontiguousarray(origin, np.float64),
            np.ascontiguousarray(directions, np.float64), width, found,
        )  # fmt: skip
    return found


def lit(
    patch: SurfacePatch, points: np.ndarray, leds: np.ndarray, width: int | None = None
) -> np.ndarray:
    """Whether LEDs reach points, or a part of the surface stands between.

    A ray is blocked where it runs below the surface by more than `lift`: two standard
    deviations of the height difference between the point and the obstacle, and half a grid
    step, for what the grid cannot resolve. Noise of the surface so casts no shadow on itself.

    Parameters
    ----------
    patch : SurfacePatch
    points : (n, 3) float64
        phi (rad), z (mm), r (mm); NaN rows come out unlit.
    leds : (n_leds, 3) float64
        Positions in {V}, mm.
    width : int, optional
        The points are those of an image's pixels, row by row, with so many in a row: where
        neighbours are all lit is then found out for them together, and of pixels that are finer
        than the surface's cells some speak for those between them.

    Returns
    -------
    (n_leds, n) bool
    """
    out = np.zeros((len(leds), len(points)), np.bool_)
    if patch.r_max > 0.0:
        image = width is not None
        width = max(len(points) if width is None else width, 1)
        down, across = shadow_kernels.tiles(width, len(points))
        by_ranges(
            shadow_kernels.lit, down * across, _LEAST_TILES,
            patch.r, patch.r_std, patch.obstacles, patch.hurdles, patch.crests,
            patch.phi_0, patch.step_phi, patch.z_0, patch.step_z, patch.r_max, patch.step_mm,
            np.ascontiguousarray(points, np.float64), np.ascontiguousarray(leds, np.float64),
            width, image, out,
        )  # fmt: skip
    return out
