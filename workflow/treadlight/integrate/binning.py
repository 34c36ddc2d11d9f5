"""Neighbouring pixels of a view as one, for cells that are several pixels wide."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from treadlight.compiling import kernel
from treadlight.geometry import CylinderGrid
from treadlight.geometry.angle_kernel import wrapped
from treadlight.geometry.axis import wrap_angle
from treadlight.integrate.gather import View, ViewNormals, slopes_of, steepened
from treadlight.spool import IN_MEMORY, Memory, Spool
from treadlight.threads import by_ranges

# Bins along the side of a cell, at least: a bin's place is known to half of one.
_PER_CELL = 3
_LEAST_ROWS = 8
_FLOATS = 15


@dataclass(frozen=True)
class BinnedView:
    """Parts of a view whose pixels are bins."""

    parts: tuple[ViewNormals, ...]

    def blocks(self, grid: CylinderGrid) -> Iterator[ViewNormals]:
        """All parts."""
        del grid
        yield from self.parts


def views_for_cells(
    views: Iterable[View], cells: CylinderGrid, memory: Memory | Spool = IN_MEMORY
) -> list[View]:
    """Views with pixels no finer than what cells tell apart.

    Where they are finer, squares of pixels are brought together to bins. A bin lies where its
    middle pixel does, or its first known one. Its slopes are the means of its pixels' weighted by
    their information, all of which it has; material is the mean of those with a normal, flags are
    the shares of those that lie anywhere.

    Parameters
    ----------
    views : iterable of View
    cells : CylinderGrid
        What is needed of the views.
    memory : Memory or Spool
        Where the bins of a view lie in the end (60 bytes each), handed back after each view.
    """
    return [_with_bins(view, cells, memory) for view in views]


def _with_bins(view: View, cells: CylinderGrid, memory: Memory | Spool) -> View:
    width = min(cells.step_theta * cells.nominal_radius_mm, cells.step_z)
    side = int(width / (_PER_CELL * _first_spacing(view, cells)))
    return view if side < 2 else _binned_view(view, cells, side, memory)


def _first_spacing(view: View, cells: CylinderGrid) -> float:
    """That of the first part that tells one, mm; infinite where none does."""
    spacings = (_spacing_mm(block) for block in view.blocks(cells))
    return next((mm for mm in spacings if mm > 0), np.inf)


def _spacing_mm(view: ViewNormals) -> float:
    """Usual distance of neighbouring pixels' scene points, the larger of both ways; or NaN."""
    if view.theta.ndim < 2 or min(view.theta.shape) < 2:
        return np.nan
    across = (wrap_angle(np.diff(view.theta, axis=k)) * np.nanmedian(view.r) for k in range(2))
    along = (np.diff(view.z, axis=k) for k in range(2))
    steps = [np.hypot(a, b) for a, b in zip(across, along, strict=True)]
    known = [step[np.isfinite(step)] for step in steps]
    return max(float(np.median(step)) for step in known) if all(map(len, known)) else np.nan


def _binned_view(view: View, cells: CylinderGrid, side: int, memory: Memory | Spool) -> BinnedView:
    made = [(_bins(block, side), _count(block, side), block.camera) for block in view.blocks(cells)]
    floats = memory.empty((sum(bins.size for bins, _, _ in made),), np.float32)
    parts, begin = [], 0
    for bins, shape, camera in made:
        own = floats[begin : begin + bins.size]
        own[:] = bins
        parts.append(_view_of(own, shape, camera))
        begin += bins.size
    memory.release()
    return BinnedView(tuple(parts))


def _count(view: ViewNormals, side: int) -> tuple[int, int]:
    height, width = view.theta.shape
    return -(-height // side), -(-width // side)


def _bins(view: ViewNormals, side: int) -> np.ndarray:
    """The floats of a view's bins; see `_view_of`."""
    shape = _count(view, side)
    bins = np.empty(_FLOATS * shape[0] * shape[1], np.float32)
    known = view.normal, view.covariance, view.r, view.theta, view.z, view.material
    flags = view.shadowed, view.saturated, view.poor_fit
    by_ranges(_bin, shape[0], _LEAST_ROWS, side, *known, *flags, *_split(bins, shape))
    return bins


def _split(bins: np.ndarray, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Vectors (3, *shape, 3): normal, covariance, material; scalars (6, *shape): place, flags."""
    vectors = 9 * shape[0] * shape[1]
    return bins[:vectors].reshape(3, *shape, 3), bins[vectors:].reshape(6, *shape)


def _view_of(bins: np.ndarray, shape: tuple[int, int], camera: np.ndarray | None) -> ViewNormals:
    vectors, scalars = _split(bins, shape)
    (normal, covariance, material), (r, theta, z, dark, bright, poor) = vectors, scalars
    return ViewNormals(normal, covariance, r, theta, z, material, dark, bright, poor, camera)


@kernel
def _middle(theta, v, u, last_v, last_u, side):
    """Row and column of the pixel that a bin lies at."""
    i, j = min(v + side // 2, last_v - 1), min(u + side // 2, last_u - 1)
    if np.isfinite(theta[i, j]):
        return i, j
    for i in range(v, last_v):
        for j in range(u, last_u):
            if np.isfinite(theta[i, j]):
                return i, j
    return v, u


@kernel
def _bin(
    first, last, side, normal, covariance, r, theta, z, material, shadowed, saturated, poor_fit,
    vectors, scalars,
):  # fmt: skip
    height, width = theta.shape
    for a in range(first, last):
        v, last_v = a * side, min((a + 1) * side, height)
        for b in range(vectors.shape[2]):
            u, last_u = b * side, min((b + 1) * side, width)
            at_v, at_u = _middle(theta, v, u, last_v, last_u, side)
            middle = theta[at_v, at_u]
            sum_p, sum_q, sum_wp, sum_wq, count = 0.0, 0.0, 0.0, 0.0, 0
            k_d, k_s, alpha = 0.0, 0.0, 0.0
            dark, bright, poor, pixels = 0, 0, 0, 0
            for i in range(v, last_v):
                for j in range(u, last_u):
                    if not np.isfinite(theta[i, j]):
                        continue
                    pixels += 1
                    dark += shadowed[i, j]
                    bright += saturated[i, j]
                    poor += poor_fit[i, j]
                    # The local basis of the middle; angles are a few mrad.
                    away = wrapped(np.float64(middle) - theta[i, j])
                    n_r = normal[i, j, 0] + away * normal[i, j, 1]
                    n_theta = normal[i, j, 1] - away * normal[i, j, 0]
                    p, q, w_p, w_q = slopes_of(
                        n_r, n_theta, normal[i, j, 2], covariance[i, j, 0], covariance[i, j, 2]
                    )
                    if np.isfinite(p + q + w_p + w_q):
                        sum_p += w_p * p
                        sum_q += w_q * q
                        sum_wp += w_p
                        sum_wq += w_q
                        k_d += material[i, j, 0]
                        k_s += material[i, j, 1]
                        alpha += material[i, j, 2]
                        count += 1
            p = sum_p / sum_wp if count else np.nan
            q = sum_q / sum_wq if count else np.nan
            n_r = 1 / np.sqrt(1 + p * p + q * q)
            vectors[0, a, b, 0] = n_r
            vectors[0, a, b, 1] = -p * n_r
            vectors[0, a, b, 2] = -q * n_r
            vectors[1, a, b, 0] = 1 / (steepened(p, q) * sum_wp)
            vectors[1, a, b, 1] = np.nan
            vectors[1, a, b, 2] = 1 / (steepened(q, p) * sum_wq)
            vectors[2, a, b, 0] = k_d / count if count else np.nan
            vectors[2, a, b, 1] = k_s / count if count else np.nan
            vectors[2, a, b, 2] = alpha / count if count else np.nan
            scalars[0, a, b], scalars[1, a, b] = r[at_v, at_u], middle
            scalars[2, a, b] = z[at_v, at_u]
            pixels = max(pixels, 1)
            scalars[3, a, b], scalars[4, a, b] = dark / pixels, bright / pixels
            scalars[5, a, b] = poor / pixels
