"""Connected cells of the grid: cuts, and what may be one."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import ndimage

from treadlight.geometry import CylinderGrid

_NEIGHBOURS = np.ones((3, 3), bool)
# Fewer cells are noise.
_LEAST_CELLS = 8
# Cuts of one kind are about equally wide: at most this many times.
_SAME_WIDTH = 2.0


@dataclass(frozen=True)
class Patches:
    """Connected cells of the grid (n, m), numbered from 1.

    Attributes
    ----------
    label : (n, m) int32
        Number of the patch, 0 outside.
    count : int
    """

    label: np.ndarray
    count: int

    @property
    def mask(self) -> np.ndarray:
        """Cells inside, (n, m) bool."""
        return self.label > 0

    def cells(self) -> Iterator[np.ndarray]:
        """Rows and columns (k, 2) of the cells of each patch."""
        rows, columns = np.nonzero(self.label)
        label = self.label[rows, columns]
        order = np.argsort(label, kind="stable")
        starts = np.searchsorted(label[order], np.arange(1, self.count + 2))
        place = np.column_stack([rows, columns])[order]
        for first, last in pairwise(starts):
            yield place[first:last]

    def share(self, mask: np.ndarray) -> np.ndarray:
        """Share of each patch's cells that lie in a mask (n, m), (count,)."""
        size = np.bincount(self.label.ravel(), minlength=self.count + 1)
        inside = np.bincount(self.label[mask], minlength=self.count + 1)
        return inside[1:] / np.maximum(size[1:], 1)

    def select(self, kept: np.ndarray) -> "Patches":
        """The patches of a mask (count,), numbered anew."""
        chosen = np.concatenate([[False], kept])
        number = np.where(chosen, np.cumsum(chosen), 0).astype(np.int32)
        return Patches(number[self.label], int(chosen.sum()))


@dataclass(frozen=True)
class Kinds:
    """What makes cuts alike: the columns they cross, first and last (k, 2), and width (k,)."""

    columns: np.ndarray
    width: np.ndarray

    def alike(self, one: int) -> np.ndarray:
        """Patches (k,) of about the width of one, in the same columns by half at least."""
        shared = np.minimum(self.columns[:, 1], self.columns[one, 1])
        shared = shared - np.maximum(self.columns[:, 0], self.columns[one, 0]) + 1
        length = self.columns[:, 1] - self.columns[:, 0]
        overlap = 2 * shared > np.minimum(length, length[one]) + 1
        wide, narrow = (pick(self.width, self.width[one]) for pick in (np.maximum, np.minimum))
        return overlap & (wide <= _SAME_WIDTH * narrow)


def find_patches(mask: np.ndarray, grid: CylinderGrid) -> Patches:
    """Connected patches that are no noise; on a whole turn also across its end."""
    label, _ = ndimage.label(mask, _NEIGHBOURS)
    if grid.periodic:
        last = np.pad(label[-1], 1)
        for shift in range(3):
            _join(label, last[shift : shift + label.shape[1]])
    kept = np.bincount(label.ravel()) >= _LEAST_CELLS
    kept[0] = False
    number = np.where(kept, np.cumsum(kept), 0).astype(np.int32)
    return Patches(number[label], int(kept.sum()))


def way_out(mask: np.ndarray, grid: CylinderGrid) -> np.ndarray:
    """Distance of each cell of a mask from the nearest one outside, in cells; infinite without any.

    On a whole turn also across its end, up to as far as the tread is wide.
    """
    if mask.all():
        return np.full(mask.shape, np.inf)
    rows = min(mask.shape) if grid.periodic else 0
    around = np.pad(mask, ((rows, rows), (0, 0)), mode="wrap")
    return ndimage.distance_transform_edt(around)[rows : rows + len(mask)]


def kinds_of(patches: Patches) -> Kinds:
    columns = np.zeros((patches.count, 2), int)
    width = np.zeros(patches.count)
    for k, cells in enumerate(patches.cells()):
        columns[k] = cells[:, 1].min(), cells[:, 1].max()
        width[k] = len(cells) / (columns[k, 1] - columns[k, 0] + 1)
    return Kinds(columns, width)


def _join(label: np.ndarray, last: np.ndarray) -> None:
    """Give patches of the first row the numbers of those that they touch in the last, in place."""
    for j in np.flatnonzero((label[0] > 0) & (last > 0)):
        if label[0, j] != last[j]:
            old, new = label[0, j], last[j]
            last[last == old] = new
            label[label == old] = new
