"""A capture too large for the memory, integrated sector by sector of the turn.

The sections hold the surface down: what is wrong at the end of a sector is forgotten a few of
their distances further in. So every sector is solved with a margin, and neighbours are faded into
each other where both are far from their ends.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from treadlight.geometry import CylinderGrid
from treadlight.integrate.profile import Profile
from treadlight.integrate.uncertainty import HeldOut

# Sections' distances that a sector goes on beyond its core, and over which it is faded there.
_MARGIN_SECTIONS = 2.0
_FADED_SECTIONS = 1.0
# Neighbours that differ by more of their standard deviations found another cut: none is the mean.
_SAME_SIGMA = 3.0
_MASKS = ("laser", "photometric", "step", "shadowed", "saturated")


@dataclass(frozen=True)
class Sector:
    """Some rows of a grid.

    Attributes
    ----------
    rows : (k,) int
        Rows of the whole grid, consecutive modulo its length.
    grid : CylinderGrid
        Of these rows.
    core : slice
        Of the k rows, those that no other sector has in its core.
    weight : (k,) float32
        1 in the core, falling to 0 in the margins.
    """

    rows: np.ndarray
    grid: CylinderGrid
    core: slice
    weight: np.ndarray


def sectors_of(grid: CylinderGrid, spacing: float, most_cells: int) -> Iterator[Sector]:
    """Sectors that hold about `most_cells` with their margins; one, if the grid has no more.

    Parameters
    ----------
    grid : CylinderGrid
    spacing : float
        Distance of sections, cells along theta.
    most_cells : int
        Fewer than the margins and as much again have are not worth a sector.
    """
    n, m = grid.shape
    margin, faded = (round(share * spacing) for share in (_MARGIN_SECTIONS, _FADED_SECTIONS))
    # Margins may at most double the work.
    core = max(most_cells // m - 2 * margin, 2 * margin)
    count = -(-n // core) if n * m > most_cells else 1
    bounds = np.linspace(0, n, count + 1).round().astype(int)
    if count == 1 or np.diff(bounds).max() + 2 * margin >= n:
        yield Sector(np.arange(n), grid, slice(0, n), np.ones(n, np.float32))
        return
    for first, last in pairwise(bounds):
        rows = np.arange(first - margin, last + margin)
        if not grid.periodic:
            rows = rows[(rows >= 0) & (rows < n)]
        before, behind = first - rows, rows - last + 1
        if not grid.periodic:
            # Nobody goes on where the grid ends.
            before, behind = before - n * (first == 0), behind - n * (last == n)
        outside = np.maximum(before, behind)
        weight = np.clip(0.5 - (outside - 0.5) / max(faded, 1), 0, 1).astype(np.float32)
        core_rows = slice(int(first - rows[0]), int(last - rows[0]))
        yield Sector(rows % n, grid.part(rows % n), core_rows, weight)


class Joined:
    """The profile of a whole grid (n, m), laid from those of its sectors.

    Parameters
    ----------
    shape : (n, m)
    empty : function of a shape and a dtype
        Makes the arrays, in memory or in files.
    """

    def __init__(
        self, shape: tuple[int, int], empty: Callable[[tuple[int, ...], type], np.ndarray]
    ) -> None:
        self._laid = np.zeros(shape[0], bool)
        self._figures: list[tuple[HeldOut, int, tuple[float, float]]] = []
        self._arrays = {
            "r": empty(shape, np.float64),
            "r_std": empty(shape, np.float32),
            "normal": empty((*shape, 3), np.float32),
            "material": empty((3, *shape), np.float32),
            **{name: empty(shape, np.bool_) for name in _MASKS},
        }

    def add(self, part: Profile, sector: Sector) -> None:
        """Lay a sector, fading it into what lies there already."""
        own = np.flatnonzero(sector.weight > 0)
        laid = self._laid[sector.rows[own]]
        self._put(part, sector.rows[own[~laid]], own[~laid], None)
        if laid.any():
            own = own[laid]
            rows = sector.rows[own]
            share = self._share(part, rows, own, sector.weight[own])
            self._put(part, rows, own, share)
        self._laid[sector.rows] |= sector.weight > 0
        self._figures.append((part.held_out, part.laser_points, part.normal_residual))

    def profile(self) -> Profile:
        """What was laid, with the figures of all sectors; normals' quantiles by their mean.

        Rows of which no sector was added are empty.
        """
        for name, into in self._arrays.items():
            rows = np.moveaxis(into, 0, -1) if name == "material" else into
            rows[~self._laid] = False if name in _MASKS else np.nan
        held, points, residual = zip(*self._figures, strict=True)
        count = np.array(points, float)
        median, high = (_mean(values, count) for values in np.array(residual).T)
        return Profile(
            **self._arrays,
            held_out=_pooled(held),
            laser_points=sum(points),
            normal_residual=(median, high),
        )

    def _share(
        self, part: Profile, rows: np.ndarray, own: np.ndarray, weight: np.ndarray
    ) -> np.ndarray:
        """How much of the new part counts, (k, m); all or nothing where the two disagree."""
        before, here = self._arrays["r"][rows], part.r[own]
        with np.errstate(invalid="ignore"):
            std = np.fmax(part.r_std[own], self._arrays["r_std"][rows])
            same = np.abs(here - before) < _SAME_SIGMA * std
        return np.where(same, weight[:, None], np.round(weight[:, None])).astype(np.float32)

    def _put(
        self, part: Profile, rows: np.ndarray, own: np.ndarray, share: np.ndarray | None
    ) -> None:
        for name, into in self._arrays.items():
            new = getattr(part, name)
            if name == "material":
                into, new = np.moveaxis(into, 0, -1), np.moveaxis(new, 0, -1)
            into[rows] = new[own] if share is None else _faded(into[rows], new[own], share)
        if share is not None:
            normal = self._arrays["normal"][rows]
            self._arrays["normal"][rows] = normal / np.linalg.norm(normal, axis=-1, keepdims=True)


def _faded(before: np.ndarray, new: np.ndarray, share: np.ndarray) -> np.ndarray:
    """A share (k, m) of the new values (k, m, ...) and the rest of those before."""
    share = share.reshape(share.shape + (1,) * (new.ndim - 2))
    chosen = np.where(share < 0.5, before, new)
    if new.dtype == bool:
        return chosen
    mixed = before + share * (new - before)
    return np.where((share > 0) & (share < 1) & np.isfinite(mixed), mixed, chosen)


def _pooled(held: Sequence[HeldOut]) -> HeldOut:
    """The held-out points of all sectors as one set."""
    n = np.array([h.n for h in held], float)
    rms = np.sqrt(_mean(np.square([h.rms for h in held]), n))
    laser = np.sqrt(_mean(np.square([h.laser_std for h in held]), n))
    bias = _mean(np.array([h.bias for h in held]), n)
    return HeldOut(int(n.sum()), bias, rms, laser, float(np.sqrt(max(rms**2 - laser**2, 0.0))))


def _mean(values: np.ndarray, weight: np.ndarray) -> float:
    """Weighted mean of what is known; NaN where nothing is."""
    known = np.isfinite(values) & (weight > 0)
    return float(np.average(values[known], weights=weight[known])) if known.any() else np.nan
