"""The groove reference: a surface of revolution through the floors of the grooves."""

from dataclasses import dataclass

import numpy as np

from treadlight.geometry import CylinderGrid
from treadlight.tread.regions import Regions
from treadlight.tread.robust import block_medians, solve_robust
from treadlight.tread.runout import Runout, runout_basis

_RUNOUT_ORDERS = 4
# How far rims sit off centre (mm) or, at 100 mm from it, tilted, at the most; and how far a
# carcass is from round. Only a sector, which cannot tell them from the radius, feels these.
_FIRST_PRIOR_MM = 1.0
_HIGHER_PRIOR_MM = 0.5
_BLOCK_RAD = np.deg2rad(1.0)
_BLOCKS_ACROSS = 8
_LEAST_BLOCKS = 5
_PARABOLA_NEEDS = 3
_Z_UNIT_MM = 100.0


@dataclass(frozen=True)
class GrooveReference:
    """Radius of the floors about the tire's own axis, continued over ribs and shoulders.

    Attributes
    ----------
    crown : (3,) float64
        Coefficients of 1, z, z2 (mm) of the parabola that the floors follow: fitted to them if
        there are four grooves or more, else parallel to the tops.
    grooves : (k, 2) float64
        z intervals of the grooves used, mm.
    offsets : (k,) float64
        Radius of each floor over the parabola, mm.
    numbers : tuple of int
        Numbers of these grooves in the regions.
    runout : Runout
        The tire's own axis in the rig's frame, and low harmonics.
    block_std_mm : float
        Robust standard deviation of the medians of blocks of 1 degree about the surface.
    reason : str or None
        Why there is no reference (all radii are NaN then).
    """

    crown: np.ndarray
    grooves: np.ndarray
    offsets: np.ndarray
    numbers: tuple[int, ...]
    runout: Runout
    block_std_mm: float
    reason: str | None = None

    def radius(self, theta: np.ndarray, z: np.ndarray, groove: int | None = None) -> np.ndarray:
        """Radius of the reference, mm, (n, m), on the grid of theta (n,) rad and z (m,) mm.

        Parameters
        ----------
        groove : int, optional
            Continue the floor of this groove (its number) parallel to the crown, instead of
            passing evenly from groove to groove.
        """
        if self.reason is not None:
            return np.full((len(theta), len(z)), np.nan)
        return self.runout.radius(theta, z) + self._meridian(np.asarray(z, float), groove)

    def height(self, r: np.ndarray, theta: np.ndarray, z: np.ndarray) -> np.ndarray:
        """r over the reference, mm: 0 on floors, the tread depth on ribs; shapes as `radius`."""
        return r - self.radius(theta, z)

    def _meridian(self, z: np.ndarray, groove: int | None) -> np.ndarray:
        level = np.polynomial.polynomial.polyval(z, self.crown)
        if groove is not None:
            return level + self.offsets[self.numbers.index(groove)]
        return level + np.interp(z, self.grooves.ravel(), np.repeat(self.offsets, 2))


def fit_reference(
    r: np.ndarray, r_std: np.ndarray | None, grid: CylinderGrid, regions: Regions
) -> GrooveReference:
    """Fit the groove reference to the floors of the circumferential grooves.

    The observations are medians of blocks (1 degree by an eighth of a floor), the fit is
    Tukey's, so that wear bars, stones and ghosts do not count. Unknown are each groove's radius
    and local slope, the tire's two off-centres and two tilts on the rig and, on a whole turn,
    harmonics up to the fourth. Weak priors hold a sector, where off-centre and radius are
    nearly the same thing: the surface is unaffected.

    Parameters
    ----------
    r : (n, m) float
        mm; NaN = missing.
    r_std : (n, m) float or None
        Standard uncertainty, mm; None weighs all cells alike.
    grid : CylinderGrid
    regions : Regions
        Of the same grid.

    Returns
    -------
    GrooveReference
        With a `reason` instead of a surface where no groove has a floor.
    """
    blocks = _floor_blocks(r, r_std, grid, regions)
    numbers = [n for n in range(1, len(regions.grooves) + 1) if (blocks[:, 2] == n).sum() >= 5]
    blocks = blocks[np.isin(blocks[:, 2], numbers)]
    if not numbers or len(blocks) < _LEAST_BLOCKS:
        return _none(regions)
    orders = _RUNOUT_ORDERS if grid.periodic and _turn_covered(blocks[:, 0]) else 1
    middle = np.array([np.mean(regions.z[regions.floor_of_column == n]) for n in numbers])
    theta, z, number, value, weight = blocks.T
    member = number[:, None] == np.array(numbers)
    basis = np.column_stack(
        [runout_basis(theta, z, orders), member, member * (z[:, None] - middle)]
    )
    prior = np.full(basis.shape[1], np.inf)
    prior[:4] = _FIRST_PRIOR_MM
    prior[4 : 2 * orders + 2] = _HIGHER_PRIOR_MM
    # Floors lie along the tread within some degrees.
    prior[-len(numbers) :] = 0.2
    level = float(np.median(value))
    found, scale = solve_robust(basis, value - level, prior, weight)
    radii = found[2 * orders + 2 :][: len(numbers)] + level
    crown = _parabola(middle, radii, regions)
    return GrooveReference(
        crown,
        np.array([regions.grooves[n - 1] for n in numbers]),
        radii - np.polynomial.polynomial.polyval(middle, crown),
        tuple(numbers),
        Runout(orders, found[: 2 * orders + 2]),
        scale,
    )


def _parabola(middle: np.ndarray, radii: np.ndarray, regions: Regions) -> np.ndarray:
    # Three floors cannot tell a crown from unequal depths: their tops can.
    if len(radii) > _PARABOLA_NEEDS:
        return np.polynomial.polynomial.polyfit(middle, radii, 2)
    ribs = regions.rib_of_column > 0
    if ribs.sum() < 10:
        return np.array([np.mean(radii), 0.0, 0.0])
    z = regions.z[ribs] / _Z_UNIT_MM
    tops = regions.crown[ribs]
    basis = np.column_stack([np.ones_like(z), z, z**2])
    found, _ = solve_robust(basis, tops - tops.mean(), np.full(3, np.inf))
    crown = found / np.array([1.0, _Z_UNIT_MM, _Z_UNIT_MM**2])
    crown[0] += np.mean(radii - np.polynomial.polynomial.polyval(middle, crown))
    return crown


def _none(regions: Regions) -> GrooveReference:
    reason = (
        "The grooves' floors hold no radius, so heights and depths have no reference."
        if regions.grooves
        else "No circumferential groove was found, so heights and depths have no reference."
    )
    empty = np.zeros(0)
    return GrooveReference(
        np.zeros(3), np.zeros((0, 2)), empty, (), Runout(1, np.zeros(4)), np.nan, reason
    )


def _turn_covered(theta: np.ndarray) -> bool:
    """Whether blocks are spread over the turn well enough for harmonics of order 4."""
    bins = np.unique(np.floor((theta % (2 * np.pi)) / (np.pi / 12)))
    return len(bins) >= 22


def _floor_blocks(
    r: np.ndarray, r_std: np.ndarray | None, grid: CylinderGrid, regions: Regions
) -> np.ndarray:
    """(k, 5): theta, z, groove, median radius, relative weight of each block of floor."""
    rows = max(1, round(_BLOCK_RAD / grid.step_theta))
    found = []
    for number in range(1, len(regions.grooves) + 1):
        columns = np.flatnonzero(regions.floor_of_column == number)
        for part in np.array_split(columns, min(_BLOCKS_ACROSS, max(1, len(columns)))):
            if not len(part):
                continue
            value, share = block_medians(r[:, part], rows)
            std = value * np.nan if r_std is None else block_medians(r_std[:, part], rows)[0]
            # No laser and no normal map is better than 10 um.
            weight = np.nan_to_num(1.0 / np.fmax(std, 0.01) ** 2, nan=1.0)
            theta = grid.theta[0] + grid.step_theta * (
                np.arange(len(value)) * rows + 0.5 * (rows - 1)
            )
            same = (np.full(len(value), x) for x in (grid.z[part].mean(), float(number)))
            block = np.column_stack([theta, *same, value, weight])
            # Fewer cells are more likely what a wall threw there than the floor.
            found.append(block[share >= 0.25])
    return np.concatenate(found) if found else np.zeros((0, 5))
