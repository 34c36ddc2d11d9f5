"""Cuts where no view looks: a tread's pattern repeats, and the sections say where it stands."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import ndimage

from treadlight.compiling import kernel
from treadlight.geometry import CylinderGrid
from treadlight.integrate.laser import LaserCells
from treadlight.threads import by_ranges

# Points count by a Gaussian of their distance in sections, up to this many.
_REACH = 2.0
# A place of the pattern is told by no less than this share of what is around a window: none that
# is moved so little that it is hidden itself.
_LEAST_KNOWN = 0.75
# Places and columns this share of the sections' distance apart tell the same.
_FINE = 1 / 32
# Less likely than the best place by this factor: nothing to add.
_NEGLIGIBLE = 1e-3


def repeated(
    cuts: np.ndarray,
    looked: np.ndarray,
    laser: LaserCells,
    deep: np.ndarray,
    ribs: Sequence[slice],
    spacing: float,
    shared_rows: float,
    grid: CylinderGrid,
) -> np.ndarray:
    """How likely a cell that no view looks at lies in a cut, as other places of its rib show them.

    Window by window along the tire the rib is laid onto every other place of itself that views
    look at. A place is as likely as it explains which points of the sections around lie below the
    tread, and how the rib goes on where views look again; how often a point deceives is told by
    the cuts that views see and their own sections. The likelihood of a cut is the mean over the
    places; where they explain the points no better than the rib's usual share of cuts does, the
    pattern is another, and nothing is known.

    Parameters
    ----------
    cuts : (n, m) bool
        Where views look.
    looked : (n, m) bool
        Cells that views look at.
    laser : LaserCells
    deep : (k,) bool
        Points below the tread.
    ribs : sequence of slice
        Columns of each rib.
    spacing : float
        Distance of sections, cells along theta.
    shared_rows : float
        How many neighbouring points share their errors.
    grid : CylinderGrid

    Returns
    -------
    (n, m) float64
        0..1; NaN where views look, and where nothing tells.
    """
    found = np.full(grid.shape, np.nan)
    for rib in ribs:
        here = (laser.column >= rib.start) & (laser.column < rib.stop)
        weight = np.full(np.count_nonzero(here), 1 / shared_rows)
        points = _Points(laser.row[here], laser.column[here] - rib.start, deep[here], weight)
        strip = _Strip(cuts[:, rib], looked[:, rib], spacing, grid.periodic)
        found[:, rib] = strip.hidden(points)
    return found


@dataclass(frozen=True)
class _Points:
    """Points (k,) of a rib, and how much each counts."""

    row: np.ndarray
    column: np.ndarray
    deep: np.ndarray
    weight: np.ndarray


@dataclass(frozen=True)
class _Wrong:
    """How often a point deceives: at all, away from the edges of cuts, at them."""

    usual: float
    away: float
    at_edges: float

    def surprise(self) -> np.ndarray:
        """What a point that differs costs away from edges and at them, (2,), at least nothing.

        One that agrees costs nothing anywhere: a place is not worse for having edges at points.
        """
        share = np.array([self.away, self.at_edges])
        return np.maximum(np.log((1 - share) / share), 0.0)


def _share(deceived: np.ndarray, usual: float) -> float:
    """Share of points that deceive, drawn to the usual one as by two more points.

    No point that deceived is no proof that none ever does.
    """
    return float((np.count_nonzero(deceived) + 2 * usual) / (len(deceived) + 2))


class _Strip:
    """The columns (n, w) of one rib.

    How often a point deceives is told apart for cells at the edges of cuts: where those are seen
    a cell aside, a place that is right but for that would be as unlikely as one that lacks a cut.
    """

    def __init__(self, cuts: np.ndarray, looked: np.ndarray, spacing: float, periodic: bool):
        self.cuts, self.looked = cuts, looked
        self.spacing, self.periodic = spacing, periodic
        self.step = max(1, round(spacing * _FINE))
        # A true place lies up to half a step from the nearest that is tried.
        self.edges = _at_edges(cuts, looked, max(1, self.step // 2), periodic)
        n = len(cuts)
        first = self.step if periodic else 1 - n
        self.shifts = np.arange(first, n, self.step)

    def hidden(self, points: _Points) -> np.ndarray:
        """Likelihood (n, w) of a cut, NaN where views look."""
        found = np.full(self.cuts.shape, np.nan)
        wrong = self._wrong(points)
        if wrong.usual < 0.5:
            points = self._with_views(points)
            for window in self._windows():
                hidden = ~self.looked[window]
                if hidden.any():
                    likely = self._likely(window, self._near(window, points), wrong)
                    found[window] = np.where(hidden, likely, np.nan)
        return found

    def _wrong(self, points: _Points) -> _Wrong:
        """How often points deceive where views look."""
        place = points.row, points.column
        seen, edges = self.looked[place], self.edges[place]
        deceived = self.cuts[place] != points.deep
        # Laplace's rule of succession.
        usual = _share(deceived[seen], 0.5)
        return _Wrong(usual, *(_share(deceived[seen & some], usual) for some in (~edges, edges)))

    def _with_views(self, points: _Points) -> _Points:
        """The points, thinned, and twice as many rows of what views see."""
        lattice = np.zeros(self.cuts.shape, bool)
        lattice[:: max(1, round(self.spacing / 2)), :: self.step] = True
        row, column = np.nonzero(self.looked & lattice)
        kept = points.column % self.step == 0
        weight = self.step * points.weight[kept]
        return _Points(
            np.append(points.row[kept], row),
            np.append(points.column[kept], column),
            np.append(points.deep[kept], self.cuts[row, column]),
            np.append(weight, np.full(len(row), np.median(weight) if weight.size else 0.0)),
        )

    def _windows(self) -> Iterator[np.ndarray]:
        """Rows, half of the sections' distance at a time."""
        n = len(self.cuts)
        bounds = np.linspace(0, n, max(1, round(2 * n / self.spacing)) + 1).round().astype(int)
        for first, last in pairwise(bounds):
            yield np.arange(first, last)

    def _near(self, window: np.ndarray, points: _Points) -> _Points:
        """The points around a window; the farther, the less they count."""
        n, away = len(self.cuts), points.row - window.mean()
        if self.periodic:
            away = (away + n / 2) % n - n / 2
        near = np.abs(away) <= _REACH * self.spacing
        weight = points.weight[near] * np.exp(-0.5 * (away[near] / self.spacing) ** 2)
        return _Points(points.row[near], points.column[near], points.deep[near], weight)

    def _likely(self, window: np.ndarray, points: _Points, wrong: _Wrong) -> np.ndarray:
        """Likelihood (w, columns) of a cut; NaN where no place explains the points."""
        total, known = np.zeros((2, len(window), self.cuts.shape[1]))
        costs = self._costs(points, wrong)
        least = costs.min()
        share = np.exp(least - costs[np.isfinite(costs)])
        if not share.size or share.mean() < np.exp(least - self._usual_cost(points, wrong.usual)):
            return np.full(total.shape, np.nan)
        for k in np.flatnonzero(costs < least - np.log(_NEGLIGIBLE)):
            source, inside = self._moved(window, int(self.shifts[k]))
            weight = np.exp(least - costs[k]) * (inside[:, None] & self.looked[source])
            total += weight * self.cuts[source]
            known += weight
        with np.errstate(invalid="ignore"):
            return total / known

    def _usual_cost(self, points: _Points, wrong: float) -> float:
        """As `_costs`, of a pattern that shows nowhere: points are deep as often as the rib is."""
        usual = np.clip(self.cuts[self.looked].mean(), wrong, 1 - wrong)
        surprise = np.log(1 - wrong) - np.log(np.where(points.deep, usual, 1 - usual))
        return float((points.weight * surprise).sum())

    def _costs(self, points: _Points, wrong: _Wrong) -> np.ndarray:
        """How unlikely each shift is (k,), a logarithm; infinite where little tells."""
        known, cost = np.empty((2, len(self.shifts)))
        pattern = self.cuts, self.looked, self.edges, wrong.surprise(), self.periodic
        told = points.row, points.column, points.deep, points.weight
        by_ranges(_compare, len(self.shifts), 1, self.shifts, *pattern, *told, known, cost)
        everything = points.weight.sum()
        with np.errstate(divide="ignore", invalid="ignore"):
            cost *= everything / known
        return np.where(known > _LEAST_KNOWN * everything, cost, np.inf)

    def _moved(self, row: np.ndarray, shift: int) -> tuple[np.ndarray, np.ndarray]:
        """Rows moved by a shift, and which of them are on the grid."""
        n = len(self.cuts)
        moved = row + shift
        if self.periodic:
            return moved % n, np.ones(len(row), bool)
        return np.clip(moved, 0, n - 1), (moved >= 0) & (moved < n)


def _at_edges(cuts: np.ndarray, looked: np.ndarray, reach: int, periodic: bool) -> np.ndarray:
    """Cells (n, w) that views see both cuts and tread near, within `reach` cells."""
    size, mode = 2 * reach + 1, ("wrap" if periodic else "nearest", "nearest")
    cut, tread = (
        ndimage.maximum_filter(mask, size, mode=mode) for mask in (cuts & looked, ~cuts & looked)
    )
    return cut & tread


@kernel
def _compare(
    first, last, shifts, cuts, looked, edges, surprise, periodic, row, column, deep, weight,
    known, cost,
):  # fmt: skip
    """Weight of the points that views look at once moved, and what those that differ cost."""
    n = len(cuts)
    for k in range(first, last):
        known[k], cost[k] = 0.0, 0.0
        for point in range(len(row)):
            moved = row[point] + shifts[k]
            if periodic:
                moved %= n
            elif not 0 <= moved < n:
                continue
            if looked[moved, column[point]]:
                known[k] += weight[point]
                if cuts[moved, column[point]] != deep[point]:
                    cost[k] += surprise[int(edges[moved, column[point]])] * weight[point]
