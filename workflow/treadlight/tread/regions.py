"""Circumferential grooves and ribs, found in the profile itself."""

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from treadlight.geometry import CylinderGrid
from treadlight.tread.robust import solve_robust
from treadlight.tread.runout import Runout, runout_basis

# Classes of cells.
OUTSIDE, TOP, FLOOR, OTHER = range(4)

# Tires are taken off at 1.6 mm of tread; what is shallower than this is no groove to anyone.
_LEAST_DEPTH_MM = 1.0
# Narrower circumferential cuts are sipes or decoration.
_LEAST_WIDTH_MM = 2.0
# Half the widest groove that the envelope has to bridge.
_BRIDGE_MM = 15.0
# A circumferential groove is open over most of the turn; a column of zigzag groove or of a
# block row with many lateral grooves is not (the share is that of evaluation.md's floors).
_OPEN_SHARE = 0.6
# Tops: high enough that lateral grooves do not count, low enough that noise does not rule.
_TOP_QUANTILE = 0.85
# Beyond 20 degrees the tread turns into the shoulder.
_SHOULDER_SLOPE = 0.35
# Share of its depth that a groove's column must reach to be floor rather than wall.
_FLOOR_SHARE = 0.85
# A column with fewer rows than this share says nothing.
_LEAST_ROWS = 0.05
_SAMPLE_ROWS = 2048
_SAMPLE_CELLS = 100_000


@dataclass(frozen=True)
class Regions:
    """Ribs and circumferential grooves of a tread, numbered from 1 by increasing z.

    Attributes
    ----------
    z : (m,) float64
        Columns of the grid, mm.
    grooves : tuple of (low, high)
        z intervals, mm, between the places where half the groove's depth is reached.
    ribs : tuple of (low, high)
        z intervals, mm, between the grooves; the outer two end where the shoulder begins.
    groove_of_column, rib_of_column, floor_of_column : (m,) int16
        Number of the groove, rib, or groove floor (walls left out) of each column; 0 = none.
    crown : (m,) float64
        Radius of the tops, mm, bridging the grooves, without `runout`.
    floor : (m,) float64
        Radius of the floor in its columns, mm, without `runout`; NaN elsewhere.
    noise_mm : float
        Robust standard deviation of cells on the floors (on the ribs where there is no groove).
    runout : Runout
    """

    z: np.ndarray
    grooves: tuple[tuple[float, float], ...]
    ribs: tuple[tuple[float, float], ...]
    groove_of_column: np.ndarray
    rib_of_column: np.ndarray
    floor_of_column: np.ndarray
    crown: np.ndarray
    floor: np.ndarray
    noise_mm: float
    runout: Runout

    @property
    def depth_mm(self) -> float:
        """Median depth of the floors below the crown, mm; NaN where there is no groove."""
        columns = self.floor_of_column > 0
        return float(np.median((self.crown - self.floor)[columns])) if columns.any() else np.nan

    def classify(self, r: np.ndarray, theta: np.ndarray) -> np.ndarray:
        """Classes of the cells of some rows.

        Parameters
        ----------
        r : (n, m) float
            mm; NaN = missing.
        theta : (n,) float
            rad.

        Returns
        -------
        (n, m) uint8
            TOP: a rib's surface. FLOOR: floor of a circumferential groove. OTHER: walls, lateral
            grooves, sipes, wear bars and cells without a radius. OUTSIDE: no rib and no groove.
        """
        flat = r - self.runout.radius(theta, self.z)
        below = max(0.5 * _LEAST_DEPTH_MM, min(1.2, 0.5 * np.nan_to_num(self.depth_mm, nan=2.4)))
        # Wear bars and stone ejectors stand 1 mm and more over the floor.
        near = np.clip(4.0 * self.noise_mm, 0.3, 0.8)
        top = (self.rib_of_column > 0) & (self.crown - flat < below)
        floor = (self.floor_of_column > 0) & (np.abs(flat - self.floor) < near)
        inside = (self.rib_of_column > 0) | (self.groove_of_column > 0)
        classes = np.where(inside, OTHER, OUTSIDE) * np.ones((len(r), 1), int)
        classes[top] = TOP
        classes[floor] = FLOOR
        return classes.astype(np.uint8)

    def on_columns(self, z: np.ndarray) -> "Regions":
        """The same regions on other z columns, mm."""
        nearest = np.rint(np.interp(z, self.z, np.arange(len(self.z)))).astype(int)
        floor = np.full(len(z), np.nan)
        floors = self.floor_of_column[nearest]
        for number in range(1, len(self.grooves) + 1):
            known = self.floor_of_column == number
            floor[floors == number] = np.interp(
                z[floors == number], self.z[known], self.floor[known]
            )
        return replace(
            self,
            z=np.asarray(z, float),
            groove_of_column=_numbers(z, self.grooves),
            rib_of_column=_numbers(z, self.ribs),
            floor_of_column=floors,
            crown=np.interp(z, self.z, self.crown),
            floor=floor,
        )


def find_regions(r: np.ndarray, grid: CylinderGrid) -> Regions:
    """Find the circumferential grooves and the ribs between them.

    Eccentricity and tilt of the tire on the rig are taken out, then each z column is judged by
    its quantiles over theta: the 85th is the top, and where the 60th lies more than 1 mm below
    the tops on both sides (their closing over 30 mm along z), the column is open over most of
    the turn. Lateral grooves, sipes, wear bars, noise and missing cells do not move quantiles.

    Parameters
    ----------
    r : (n, m) float
        mm; NaN = missing.
    grid : CylinderGrid

    Returns
    -------
    Regions
        Without grooves if there are none (or nothing was measured): one rib, or no rib.
    """
    stride = -(-grid.shape[0] // _SAMPLE_ROWS)
    sample = np.asarray(r[::stride], np.float32)
    theta = grid.theta[::stride]
    runout = _fit_runout(sample, theta, grid)
    flat = sample - runout.radius(theta, grid.z).astype(np.float32)
    quantiles = _column_quantiles(flat, (0.5, _OPEN_SHARE, _TOP_QUANTILE))
    known = np.isfinite(quantiles[0])
    if known.sum() < 3:
        return _nothing(grid, runout)
    middle, most, top = (np.interp(grid.z, grid.z[known], row[known]) for row in quantiles)
    crown = _closing(top, _BRIDGE_MM / grid.step_z)
    first, last = _between_shoulders(crown, grid.step_z, known)
    spans = _groove_spans(np.where(known, crown - most, 0.0), grid.step_z)
    # What the view's border makes of a falling shoulder is no groove.
    spans = [(a, b) for a, b in spans if first < a and b < last]
    floors = _floor_columns(spans, crown - middle, grid)
    ribs = _rib_spans(spans, first, last, grid.step_z)
    floor = np.where(floors > 0, middle, np.nan)
    grooves_mm, ribs_mm = (_as_mm(s, grid) for s in (spans, ribs))
    return Regions(
        grid.z,
        grooves_mm,
        ribs_mm,
        _numbers(grid.z, grooves_mm),
        _numbers(grid.z, ribs_mm),
        floors,
        crown,
        floor,
        _noise(flat, floors, middle, top),
        runout,
    )


def _nothing(grid: CylinderGrid, runout: Runout) -> Regions:
    none = np.zeros(grid.shape[1], np.int16)
    unknown = np.full(grid.shape[1], np.nan)
    return Regions(grid.z, (), (), none, none, none, unknown, unknown, np.nan, runout)


def _fit_runout(sample: np.ndarray, theta: np.ndarray, grid: CylinderGrid) -> Runout:
    """Low harmonics of the cells' distances from their column's median."""
    orders = 2 if grid.periodic else 1
    rows = max(1, int(np.sqrt(sample.size / _SAMPLE_CELLS)))
    cells = sample[::rows, ::rows].astype(np.float64)
    middle = _column_quantiles(cells, (0.5,))[0]
    i, j = np.nonzero(np.isfinite(cells - middle))
    if len(i) < 100:
        return Runout(orders, np.zeros(2 * orders + 2))
    basis = runout_basis(theta[::rows][i], grid.z[::rows][j], orders)
    # The medians took each column's mean runout with them, which is linear in z.
    mean = np.column_stack([np.ones(len(i)), grid.z[::rows][j]])
    # On a sector the first harmonic is nearly a constant: a millimetre holds it.
    prior = np.append(np.full(basis.shape[1], 1.0), [np.inf, np.inf])
    found, _ = solve_robust(np.hstack([basis, mean]), (cells - middle)[i, j], prior)
    return Runout(orders, found[:-2])


def _column_quantiles(values: np.ndarray, shares: tuple[float, ...]) -> np.ndarray:
    """(k, m) quantiles over the finite rows of each column; NaN where these are too few."""
    # Each column's in one piece: sorted in a tenth of the time.
    ordered = np.array(values.T, order="C")
    ordered.sort(axis=1)
    count = np.isfinite(values).sum(axis=0)
    columns = np.arange(values.shape[1])
    enough = count >= max(3, _LEAST_ROWS * len(values))
    found = [ordered[columns, (share * np.maximum(count - 1, 0)).astype(int)] for share in shares]
    return np.where(enough, found, np.nan).astype(np.float64)


def _closing(top: np.ndarray, half: float) -> np.ndarray:
    """Running maximum, then running minimum; continued evenly, or shoulders would be lifted."""
    half = max(1, round(half))
    padded = np.pad(top, 2 * half, mode="edge")
    size = 2 * half + 1
    closed = ndimage.minimum_filter1d(ndimage.maximum_filter1d(padded, size), size)
    return closed[2 * half : -2 * half]


def _runs(mask: np.ndarray) -> list[tuple[int, int]]:
    """Runs of True as [start, stop)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _groove_spans(depth: np.ndarray, step: float) -> list[tuple[int, int]]:
    spans = []
    for start, stop in _runs(depth > _LEAST_DEPTH_MM):
        half = 0.5 * np.quantile(depth[start:stop], 0.9)
        inner = _runs(depth[start:stop] > max(half, _LEAST_DEPTH_MM))
        spans += [(start + a, start + b) for a, b in inner]
    # At the border of the view a groove cannot be told from a shoulder.
    return [
        (a, b)
        for a, b in spans
        if (b - a) * step >= _LEAST_WIDTH_MM and b - a >= 2 and a > 0 and b < len(depth)
    ]


def _floor_columns(
    spans: list[tuple[int, int]], depth: np.ndarray, grid: CylinderGrid
) -> np.ndarray:
    floors = np.zeros(len(depth), np.int16)
    for number, (start, stop) in enumerate(spans, 1):
        deepest = np.quantile(depth[start:stop], 0.9)
        inside = depth[start:stop] > _FLOOR_SHARE * deepest
        a, b = max(_runs(inside), key=lambda run: run[1] - run[0])
        # The columns at a wall's foot hold the fillet, and whatever a wall throws onto it.
        trim = min(round(0.5 / grid.step_z), (b - a - 1) // 3)
        floors[start + a + trim : start + b - trim] = number
    return floors


def _between_shoulders(crown: np.ndarray, step: float, known: np.ndarray) -> tuple[int, int]:
    """First column and one past the last column of the tread."""
    columns = np.flatnonzero(known)
    # Two millimetres: a rib that stands higher than its neighbours is no shoulder.
    sigma = max(1.0, 2.0 / step)
    steep = np.abs(ndimage.gaussian_filter1d(crown, sigma, order=1)) / step > _SHOULDER_SLOPE
    highest = int(np.argmax(ndimage.gaussian_filter1d(crown, sigma)))
    left, right = np.flatnonzero(steep[:highest]), np.flatnonzero(steep[highest:])
    first = max(int(columns[0]), int(left[-1]) + 1 if len(left) else 0)
    last = min(int(columns[-1]) + 1, highest + int(right[0]) if len(right) else len(crown))
    return first, last


def _rib_spans(
    spans: list[tuple[int, int]], first: int, last: int, step: float
) -> list[tuple[int, int]]:
    starts = [first, *(stop for _, stop in spans)]
    stops = [*(start for start, _ in spans), last]
    found = zip(starts, stops, strict=True)
    return [(a, b) for a, b in found if (b - a) * step >= _LEAST_WIDTH_MM]


def _as_mm(spans: list[tuple[int, int]], grid: CylinderGrid) -> tuple[tuple[float, float], ...]:
    half = 0.5 * grid.step_z
    return tuple((float(grid.z[a]) - half, float(grid.z[b - 1]) + half) for a, b in spans)


def _numbers(z: np.ndarray, intervals: tuple[tuple[float, float], ...]) -> np.ndarray:
    numbers = np.zeros(len(z), np.int16)
    for number, (low, high) in enumerate(intervals, 1):
        numbers[(z >= low) & (z <= high)] = number
    return numbers


def _noise(flat: np.ndarray, floors: np.ndarray, middle: np.ndarray, top: np.ndarray) -> float:
    columns = floors > 0 if np.any(floors > 0) else np.abs(top - middle) < _LEAST_DEPTH_MM
    distance = np.abs(flat[:, columns] - middle[columns])
    distance = distance[np.isfinite(distance)]
    return float(1.4826 * np.median(distance)) if len(distance) else np.nan
