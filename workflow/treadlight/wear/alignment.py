"""Alignment of a remounted tire on surfaces that wear cannot have touched."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from treadlight.geometry import CylinderGrid
from treadlight.tread.robust import block_medians
from treadlight.wear.coarse import Candidate, find_candidates
from treadlight.wear.motion import PARAMETERS, Motion, resample
from treadlight.wear.relief import Relief, floor_texture, patterns, smooth

# Gaussian widths (mm) at which the patterns are compared, from a match within 2 mm to the last,
# and the most edge pixels of each: enough for micrometres at the end, few enough for seconds.
_LEVELS = ((2.0, 20_000), (1.0, 50_000), (0.5, 150_000))
_FIRST_ITERATIONS = 4
_ITERATIONS = 12
# Share of the pixels with the largest gradient that count as edges.
_EDGE_SHARE = 0.3
# How differently a tire is mounted at most: tilts of 0.6 degree, centres off by half a
# millimetre, inflation. Weak where the data speak; on a sector off-centre and radius are
# nearly the same, and this keeps either from running away.
_PRIOR_STD = np.array([np.inf, np.inf, 0.01, 0.01, 0.5, 0.5, 0.5])
_UNIT = np.array([1e-3, 1.0, 1e-3, 1e-3, 1.0, 1.0, 1.0])
_BLOCK_RAD = np.deg2rad(1.0)
_PARTS = 4
_LEAST_SHARE = 0.25
# Errors of neighbours go together (laser, views, a groove's wall): tiles of this size do not.
_TILE_RAD = np.deg2rad(10.0)
_TILE_MM = 30.0
# Another place of a tire with three pitches correlates up to 0.75 without any noise, a profile of
# the laser alone (0.13 mm of noise) on its own place 0.86 to 0.87.
_LEAST_CORRELATION = 0.8
# A texture is the tire's if it correlates this many times better in its place than anywhere along
# these arcs (mm) from it: two captures reach 0.7 to 0.97, other places 0.03 to 0.08 at the most.
# Noise does not, nor what a rig draws, such as ripples from section to section.
_ALONE = 2.0
_BESIDE_MM = np.arange(2.0, 20.0)


@dataclass(frozen=True)
class Alignment:
    """The motion into the first capture's frame, or the reason why there is none.

    Attributes
    ----------
    motion : Motion
    covariance : (7, 7) float64
        Of the motion's parameters, errors that go together within tiles included.
    correlation : float
        Of the two patterns after alignment.
    groove_std_mm : float
        Standard deviation between grooves of the mean radial difference of their floors, which
        wear has not touched: what the motion cannot explain.
    reason : str or None
    """

    motion: Motion
    covariance: np.ndarray
    correlation: float = 1.0
    groove_std_mm: float = 0.0
    reason: str | None = None

    @classmethod
    def identity(cls) -> "Alignment":
        return cls(Motion.none(), np.zeros((len(PARAMETERS), len(PARAMETERS))))

    @classmethod
    def failed(cls, reason: str) -> "Alignment":
        nothing = np.full(len(PARAMETERS), np.nan)
        return cls(Motion(nothing), np.diag(nothing), np.nan, np.nan, reason)


def align(first: Relief, current: Relief) -> Alignment:
    """Find how the tire sits differently from its first capture.

    Rotation and axial shift are found over the full circle by correlation of the tread patterns,
    then all seven parameters by Gauss-Newton on three kinds of observations: the patterns'
    edges at fixed heights (Lucas-Kanade, coarse to fine: they give rotation, axial shift and, by
    skew, tilts and off-centres), medians of radial differences on groove floors (tilts,
    off-centres, radial), and at last the floors' texture, where both captures show the same
    and no repeating one: a wall has its place in whole cells, texture between them. Tukey's
    biweight in all; their relative weight follows from how much their errors go together within
    tiles.

    Returns
    -------
    Alignment
        With a `reason` where the patterns match nowhere, as for two sectors without overlap.
    """
    pair = patterns(first, current)
    candidates = find_candidates((first.grid, pair[0]), (current.grid, pair[1]))
    if not candidates:
        return Alignment.failed("The tread patterns show nothing that fixes the rotation.")
    floors = _Floors(first, current)
    # Below a cell's size there is noise only.
    cell_mm = max(first.grid.step_z, current.grid.step_z)
    levels = [(max(sigma_mm, cell_mm), most) for sigma_mm, most in _LEVELS]
    level = _Edges(first, current.grid, pair, *levels[0])
    # The first level picks the candidate; the others are costly and would not change it.
    fits = [_refine(_start(c), (level, floors), _FIRST_ITERATIONS) for c in candidates]
    fit = max(fits, key=lambda f: level.correlation(f.motion))
    for sigma_mm, most in levels[1:]:
        level = _Edges(first, current.grid, pair, sigma_mm, most)
        fit = _refine(fit.motion, (level, floors), _ITERATIONS)
    correlation = level.correlation(fit.motion)
    if not correlation > _LEAST_CORRELATION:
        return Alignment.failed(
            "Its tread pattern matches the first capture's nowhere "
            f"(best correlation {max(correlation, 0.0):.2f}), as if they showed different sectors."
        )
    textures, closer = (floor_texture(first), floor_texture(current)), fit
    for sigma_mm, most in levels[1:]:
        texture = _Edges(first, current.grid, textures, sigma_mm, most)
        closer = _refine(closer.motion, (level, floors, texture), _ITERATIONS)
    if texture.is_alone_at(closer.motion):
        fit = closer
    motion = fit.motion.normalised()
    return Alignment(motion, fit.covariance, level.correlation(motion), floors.groove_std(motion))


def _start(candidate: Candidate) -> Motion:
    values = np.zeros(len(PARAMETERS))
    values[:2] = candidate.rotation_rad, candidate.axial_mm
    return Motion(values)


@dataclass(frozen=True)
class _Observations:
    """Linearised: design (n, 7) times the parameters' change = residual (n,); tile numbers."""

    design: np.ndarray
    residual: np.ndarray
    tile: np.ndarray


@dataclass(frozen=True)
class _Fit:
    motion: Motion
    covariance: np.ndarray


class _Edges:
    """Differences of two smoothed patterns, or textures, where the first one is steepest."""

    def __init__(
        self,
        first: Relief,
        grid: CylinderGrid,
        pair: tuple[np.ndarray, np.ndarray],
        sigma_mm: float,
        most: int,
    ):
        self.grid = grid
        self.mean = smooth(pair[1], grid, sigma_mm)
        self.slope_theta = smooth(pair[1], grid, sigma_mm, (1, 0))
        self.slope_z = smooth(pair[1], grid, sigma_mm, (0, 1))
        mean = smooth(pair[0], first.grid, sigma_mm)
        slopes = [smooth(pair[0], first.grid, sigma_mm, o) for o in ((1, 0), (0, 1))]
        self.all_cells = _Cells.some(first, mean, slopes, np.isfinite(mean), most)
        steepness = np.hypot(*slopes)
        known = np.isfinite(steepness)
        least = np.quantile(steepness[known], 1 - _EDGE_SHARE) if known.any() else np.inf
        self.cells = _Cells.some(first, mean, slopes, known & (steepness > least), most)

    def observe(self, motion: Motion) -> _Observations:
        cells = self.cells
        row, column = _source_index(motion, cells, self.grid)
        mean, slope_theta, slope_z = (
            _at(image, row, column, self.grid)
            for image in (self.mean, self.slope_theta, self.slope_z)
        )
        d_theta, d_z, _ = motion.jacobian(cells.theta, cells.z, cells.r)
        # The mean of both gradients doubles the order of convergence (Malis 2004).
        along = 0.5 * (slope_theta + cells.slope_theta) * cells.r
        across = 0.5 * (slope_z + cells.slope_z)
        design = along[:, None] * d_theta + across[:, None] * d_z
        return _known(_Observations(design, mean - cells.mean, cells.tile))

    def correlation(self, motion: Motion) -> float:
        """Of the patterns, without their means along theta; 0 where too little overlaps."""
        cells = self.all_cells
        row, column = _source_index(motion, cells, self.grid)
        other = _at(self.mean, row, column, self.grid)
        known = np.isfinite(other)
        if known.sum() < 100:
            return 0.0
        a, b = (_without_column_means(v[known], cells.column[known]) for v in (cells.mean, other))
        norm = np.sqrt((a @ a) * (b @ b))
        return float(a @ b / norm) if norm > 1e-6 * known.sum() else 0.0

    def is_alone_at(self, motion: Motion) -> bool:
        """Whether the patterns agree there and hardly anywhere beside it along theta."""
        beside = np.concatenate([-_BESIDE_MM, _BESIDE_MM]) / self.grid.nominal_radius_mm
        turns = np.zeros((len(beside), len(PARAMETERS)))
        turns[:, 0] = beside
        elsewhere = [self.correlation(Motion(motion.values + turn)) for turn in turns]
        return self.correlation(motion) > _ALONE * max(elsewhere)


@dataclass(frozen=True)
class _Cells:
    """Cells of the first relief: place, tile, column, smoothed pattern and its slopes per mm."""

    theta: np.ndarray
    z: np.ndarray
    r: np.ndarray
    tile: np.ndarray
    column: np.ndarray
    mean: np.ndarray
    slope_theta: np.ndarray
    slope_z: np.ndarray

    @classmethod
    def some(
        cls,
        first: Relief,
        mean: np.ndarray,
        slopes: list[np.ndarray],
        mask: np.ndarray,
        most: int,
    ) -> "_Cells":
        """Every n-th cell of the mask, so that at most so many are left."""
        i, j = np.nonzero(mask)
        stride = max(1, -(-len(i) // most))
        i, j = i[::stride], j[::stride]
        grid = first.grid
        radius = np.where(np.isfinite(first.r), first.r, first.regions.crown)[i, j]
        tile = _tiles(grid.theta[i], grid.theta[0], np.floor((grid.z[j] - grid.z[0]) / _TILE_MM))
        place = (grid.theta[i], grid.z[j], radius)
        return cls(*place, tile, j, mean[i, j], slopes[0][i, j], slopes[1][i, j])


class _Floors:
    """Radial differences on the floors of the first relief's grooves, as medians of blocks."""

    def __init__(self, first: Relief, current: Relief):
        self.first, self.current = first, current
        floors = first.regions.floor_of_column
        self.columns = np.flatnonzero(floors)
        self.rows = max(1, round(_BLOCK_RAD / first.grid.step_theta))
        self.count = -(-first.grid.shape[0] // self.rows)
        self.parts = [
            (number, part)
            for number in np.unique(floors[self.columns])
            for part in np.array_split(np.flatnonzero(floors[self.columns] == number), _PARTS)
            if len(part)
        ]
        self.r = np.where(first.floor, first.r, np.nan)[:, self.columns]

    def observe(self, motion: Motion) -> _Observations:
        theta, z, _, difference, tile = self._blocks(motion)
        radius = np.full(len(theta), self.first.grid.nominal_radius_mm)
        _, d_z, d_r = motion.jacobian(theta, z, radius)
        slope = np.polynomial.polynomial.polyval(
            z, np.polynomial.polynomial.polyder(self.first.reference.crown)
        )
        return _known(_Observations(d_r - slope[:, None] * d_z, difference, tile))

    def groove_std(self, motion: Motion) -> float:
        _, _, number, difference, _ = self._blocks(motion)
        means = [
            np.nanmedian(difference[number == n])
            for n in np.unique(number)
            if np.isfinite(difference[number == n]).any()
        ]
        return float(np.std(means, ddof=1)) if len(means) > 1 else 0.0

    def _blocks(self, motion: Motion) -> tuple[np.ndarray, ...]:
        """theta, z, groove number, median of r_first - r and tile of each block."""
        grid, source = self.first.grid, self.current.grid
        if not self.parts:
            return tuple(np.zeros(0) for _ in range(5))
        whole = self.current.r
        theta = source.theta
        if source.periodic:
            # The kernel knows open surfaces only: a row more on either end closes the turn.
            whole = np.pad(whole, ((2, 2), (0, 0)), mode="wrap")
            theta = theta[0] + source.step_theta * np.arange(-2, len(theta) + 2)
        z = grid.z[self.columns]
        moved, _ = resample(
            whole, whole, theta, source.z, motion, grid.theta, z, grid.nominal_radius_mm
        )
        difference = self.r - moved
        found = []
        starts = np.arange(self.count) * self.rows
        centre = grid.theta[0] + grid.step_theta * starts + 0.5 * (self.rows - 1) * grid.step_theta
        for number, part in self.parts:
            median, share = block_medians(difference[:, part], self.rows)
            median[share < _LEAST_SHARE] = np.nan
            tile = _tiles(centre, grid.theta[0], np.full(self.count, float(number)))
            same = (np.full(self.count, v) for v in (z[part].mean(), float(number)))
            found.append((centre, *same, median, tile))
        return tuple(np.concatenate(columns) for columns in zip(*found, strict=True))


def _tiles(theta: np.ndarray, start: float, band: np.ndarray) -> np.ndarray:
    return (np.floor((theta - start) / _TILE_RAD) * 100 + band).astype(int)


def _source_index(
    motion: Motion, cells: _Cells, grid: CylinderGrid
) -> tuple[np.ndarray, np.ndarray]:
    theta, z, _ = motion.undo(cells.theta, cells.z, cells.r)
    return grid.index(theta, z)


def _at(image: np.ndarray, row: np.ndarray, column: np.ndarray, grid: CylinderGrid) -> np.ndarray:
    """Linear interpolation; NaN outside the grid and beside missing cells."""
    rows, columns = image.shape
    mode = "grid-wrap" if grid.periodic else "nearest"
    value = ndimage.map_coordinates(image, [row, column], order=1, mode=mode)
    inside = (column >= 0) & (column <= columns - 1)
    if not grid.periodic:
        inside &= (row >= 0) & (row <= rows - 1)
    return np.where(inside, value, np.nan)


def _known(observations: _Observations) -> _Observations:
    keep = np.isfinite(observations.residual) & np.isfinite(observations.design).all(axis=1)
    return _Observations(
        observations.design[keep], observations.residual[keep], observations.tile[keep]
    )


def _without_column_means(values: np.ndarray, column: np.ndarray) -> np.ndarray:
    count = np.maximum(np.bincount(column), 1)
    return values - (np.bincount(column, values) / count)[column]


def _refine(motion: Motion, parts: Sequence[_Edges | _Floors], iterations: int) -> _Fit:
    prior = np.diag((_UNIT / _PRIOR_STD) ** 2)
    # Rotation and axial shift have no prior, only a pivot where nothing shows them.
    prior += 1e-9 * np.eye(len(PARAMETERS))
    covariance = np.full(prior.shape, np.nan)
    for _ in range(iterations):
        right = -prior @ (motion.values * _UNIT_PRIOR)
        normal, meat = prior.copy(), prior.copy()
        for part in parts:
            n, b, m = _normal_equations(part.observe(motion))
            normal, right, meat = normal + n, right + b, meat + m
        inverse = np.linalg.inv(normal)
        change = _UNIT * (inverse @ right)
        covariance = _UNIT[:, None] * (inverse @ meat @ inverse) * _UNIT
        motion = Motion(motion.values + change)
        if np.all(np.abs(change) < 1e-5 * _UNIT):
            break
    return _Fit(motion, covariance)


# The priors pull towards zero all but rotation and axial shift.
_UNIT_PRIOR = np.where(np.isfinite(_PRIOR_STD), 1.0 / _UNIT, 0.0)


def _normal_equations(
    observations: _Observations,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normal matrix, right side and their tiles' scatter, divided by how errors go together.

    The weights are Tukey's. The scatter of the tiles' gradients over what independent errors
    would give says how many observations there are in truth (a cluster-robust sandwich,
    Liang and Zeger 1986).
    """
    size = len(PARAMETERS)
    if len(observations.residual) < 50:
        return np.zeros((size, size)), np.zeros(size), np.zeros((size, size))
    scale = max(1.4826 * float(np.median(np.abs(observations.residual))), 1e-4)
    weight = np.clip(1 - (observations.residual / (4.685 * scale)) ** 2, 0, None) ** 2 / scale**2
    design = observations.design * _UNIT
    weighted = design * weight[:, None]
    normal = weighted.T @ design
    gradient = weighted * observations.residual[:, None]
    tile = np.unique(observations.tile, return_inverse=True)[1]
    sums = np.column_stack([np.bincount(tile, column) for column in gradient.T])
    meat = sums.T @ sums
    diagonal = np.maximum(np.diag(normal), 1e-12)
    together = max(1.0, float(np.mean(np.diag(meat) / diagonal)))
    return normal / together, gradient.sum(axis=0) / together, meat / together**2
