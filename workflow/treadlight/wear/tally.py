"""Statistics of regions, gathered block by block."""

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from treadlight.tread import FLOOR, TOP, GrooveReference, Regions
from treadlight.wear.alignment import Alignment

_BIN_MM = 1e-3
_LOW_MM, _HIGH_MM = -20.0, 60.0
_BINS = round((_HIGH_MM - _LOW_MM) / _BIN_MM)
_TILES = 36
# Cells that lie further out are no part of the region: stones, burrs, walls.
_CLIP_SIGMAS = 4.0
_LEAST_STD_MM = 1e-4
# Where a depth gauge's foot stands, beside a groove.
_BESIDE_MM = 10.0


@dataclass
class Tally:
    """A histogram of micrometres, and sums per tile of 10 degrees of the turn."""

    counts: np.ndarray = field(default_factory=lambda: np.zeros(_BINS, np.int64))
    # Per tile: number, sum of values, of inverse variances, of z.
    tiles: np.ndarray = field(default_factory=lambda: np.zeros((4, _TILES)))

    def add(self, values: np.ndarray, std: np.ndarray, theta: np.ndarray, z: np.ndarray) -> None:
        """Add cells (n,): values and their standard uncertainties (mm), theta (rad), z (mm)."""
        known = np.isfinite(values)
        values, theta, z = values[known], theta[known], z[known]
        precision = 1.0 / np.fmax(std[known], _LEAST_STD_MM) ** 2
        bins = np.clip((values - _LOW_MM) / _BIN_MM, 0, _BINS - 1).astype(int)
        self.counts += np.bincount(bins, minlength=_BINS)
        tile = np.floor((theta % (2 * np.pi)) / (2 * np.pi) * _TILES).astype(int) % _TILES
        for row, column in enumerate((np.ones_like(values), values, precision, z)):
            self.tiles[row] += np.bincount(tile, column, minlength=_TILES)

    def quantiles(self, shares: tuple[float, ...]) -> list[float]:
        """To a micrometre; NaN of nothing."""
        total = np.cumsum(self.counts)
        if not total[-1]:
            return [np.nan] * len(shares)
        bins = np.searchsorted(total, np.array(shares) * total[-1], side="left")
        return [float(_LOW_MM + (b + 0.5) * _BIN_MM) for b in bins]

    def mean_and_spread(self) -> tuple[float, float]:
        """Mean and standard deviation of the cells within four robust sigmas of the median."""
        weights, values = self._near()
        if not weights.sum():
            return np.nan, np.nan
        mean = float(np.average(values, weights=weights))
        return mean, float(np.sqrt(np.average((values - mean) ** 2, weights=weights)))

    def least(self) -> float:
        """The lowest of the cells within four robust sigmas of the median; NaN of nothing."""
        weights, values = self._near()
        return float(values[weights > 0].min(initial=np.inf)) if weights.sum() else np.nan

    def _near(self) -> tuple[np.ndarray, np.ndarray]:
        """Counts and values of the bins within four robust sigmas of the median."""
        low, median, high = self.quantiles((0.1587, 0.5, 0.8413))
        reach = _CLIP_SIGMAS * max(0.5 * (high - low), 2 * _BIN_MM)
        values = _LOW_MM + (np.arange(_BINS) + 0.5) * _BIN_MM
        near = np.abs(values - median) <= reach
        return self.counts[near], values[near]

    def std_of_mean(self, share: float) -> float:
        """Standard uncertainty of the mean, from its tiles: within them errors go together.

        The larger of the scatter of the tiles' means and of what the cells' own uncertainties
        say if this share of their variance is common to a tile (`common_share`).
        """
        count, total, precision, _ = self.tiles
        used = count > 0
        if not used.any():
            return np.nan
        weight = count[used] / count[used].sum()
        means = total[used] / count[used]
        number = len(means)
        deviation = weight * (means - weight @ means)
        scatter = deviation @ deviation * number / max(number - 1, 1)
        # The harmonic mean: a cell at a wall is uncertain on its own, not with its tile.
        own = weight**2 @ (count[used] / precision[used])
        return float(np.sqrt(max(scatter, share * own)))

    def mean_design(self, alignment: Alignment) -> np.ndarray:
        """(7,): how the mean radius of these cells moves with the alignment's parameters."""
        count, _, _, z = self.tiles
        used = count > 0
        if not used.any():
            return np.zeros(7)
        theta = (np.flatnonzero(used) + 0.5) * 2 * np.pi / _TILES
        radius = np.ones_like(theta)
        d_r = alignment.motion.jacobian(theta, z[used] / count[used], radius)[2]
        return count[used] / count.sum() @ d_r


@dataclass
class RegionTally:
    """Depth and wear of one region in one capture; of a groove also the height of its floor."""

    depth: Tally = field(default_factory=Tally)
    wear: Tally = field(default_factory=Tally)
    floor: Tally = field(default_factory=Tally)


def common_share(floors: Iterable[Tally]) -> float:
    """Share of the cells' variance that is common to a tile, 0 to 1, seen on floors.

    There wear and height are nil, so that the means of tiles are errors: their mean square, over
    the mean square of the cells' standard uncertainties. 1 if there is no floor.
    """
    tiles = np.sum([_squares(tally.tiles) for tally in floors] or [np.zeros(2)], axis=0)
    return float(min(1.0, tiles[0] / tiles[1])) if tiles[1] > 0 else 1.0


def _squares(tiles: np.ndarray) -> np.ndarray:
    count, total, precision, _ = tiles[:, tiles[0] > 0]
    return np.array([np.sum((total / count) ** 2), np.sum(count / precision)])


def region_names(regions: Regions) -> list[str]:
    """tread, then ribs, then grooves, numbered by increasing z."""
    ribs = [f"rib-{k}" for k in range(1, len(regions.ribs) + 1)]
    return ["tread", *ribs, *(f"groove-{k}" for k in range(1, len(regions.grooves) + 1))]


def tally_rows(
    tallies: dict[str, RegionTally],
    r: np.ndarray,
    wear: np.ndarray,
    wear_std: np.ndarray,
    r_std: np.ndarray,
    classes: np.ndarray,
    theta: np.ndarray,
    regions: Regions,
    reference: GrooveReference,
) -> None:
    """Add some rows of a capture, aligned to the first, to the tallies of its regions.

    A rib's cells are its tops; their depth is the height over the floor of its deeper neighbour
    groove, continued parallel to the crown. A groove's depth is what a gauge finds: the height of
    the tops within 10 mm over its floor. A groove's wear is its floor's, nil by nature: it says how
    far the alignment can be trusted.

    Parameters
    ----------
    tallies : by the names of `region_names`; changed.
    r, wear, wear_std, r_std, classes : (n, m)
        r after alignment; r_std of the first capture; classes of the first capture.
    theta : (n,) float
    regions, reference : of the first capture, on these columns.
    """
    place = np.broadcast_arrays(theta[:, None], regions.z[None, :])
    top = classes == TOP

    def add(tally: Tally, mask: np.ndarray, values: np.ndarray, std: np.ndarray) -> None:
        tally.add(values[mask], std[mask], place[0][mask], place[1][mask])

    for rib in range(1, len(regions.ribs) + 1):
        mask = top & (regions.rib_of_column == rib)
        groove = deeper_groove(regions, reference, rib)
        depth = r - reference.radius(theta, regions.z, groove)
        for name in (f"rib-{rib}", "tread"):
            add(tallies[name].depth, mask, depth, r_std)
            add(tallies[name].wear, mask, wear, wear_std)
    for groove, (low, high) in enumerate(regions.grooves, 1):
        tally = tallies[f"groove-{groove}"]
        floor = (classes == FLOOR) & (regions.floor_of_column == groove)
        add(tally.wear, floor, wear, wear_std)
        beside = (regions.z > low - _BESIDE_MM) & (regions.z < high + _BESIDE_MM)
        if groove in reference.numbers:
            depth = r - reference.radius(theta, regions.z, groove)
            add(tally.depth, top & beside, depth, r_std)
            add(tally.floor, floor, depth, r_std)


def deeper_groove(regions: Regions, reference: GrooveReference, rib: int) -> int | None:
    """Number of the deeper one of a rib's neighbour grooves that have a floor, if any."""
    low, high = regions.ribs[rib - 1]
    middle = 0.5 * (low + high)
    below = [n for n in reference.numbers if regions.grooves[n - 1][1] <= middle]
    above = [n for n in reference.numbers if regions.grooves[n - 1][0] >= middle]
    neighbours = [*below[-1:], *above[:1]]
    if not neighbours:
        return None
    return min(neighbours, key=lambda n: reference.offsets[reference.numbers.index(n)])
