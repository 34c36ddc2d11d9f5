"""How a tire that sits eccentric and tilted on the rig changes its radius over theta and z."""

from dataclasses import dataclass

import numpy as np

# z enters in units of a decimetre, so that tilts weigh like off-centres in a fit.
_Z_UNIT_MM = 100.0


@dataclass(frozen=True)
class Runout:
    """Radial runout: sum over k of (a_k cos k theta + b_k sin k theta), for k = 1 also times z.

    To first order k = 1 is an off-centre shift, and its product with z a tilt.

    Attributes
    ----------
    orders : int
        Highest harmonic.
    coefficients : (2 * orders + 2,) float64
        mm, in the order of the columns of `runout_basis`.
    """

    orders: int
    coefficients: np.ndarray

    def radius(self, theta: np.ndarray, z: np.ndarray) -> np.ndarray:
        """mm, (n, m) on the grid of theta (n,) rad and z (m,) mm."""
        angles = np.asarray(theta, float)
        level = runout_basis(angles, np.zeros_like(angles), self.orders) @ self.coefficients
        tilt = _first_harmonic(angles) @ self.coefficients[2:4]
        return level[:, None] + tilt[:, None] * (np.asarray(z, float) / _Z_UNIT_MM)

    @property
    def offset_mm(self) -> np.ndarray:
        """(2,) float64: where the tire's axis meets z = 0, along theta = 0 and theta = pi/2."""
        return self.coefficients[:2]

    @property
    def tilt_rad(self) -> np.ndarray:
        """(2,) float64: slope of the tire's axis against the rig's, along the same directions."""
        return self.coefficients[2:4] / _Z_UNIT_MM


def runout_basis(theta: np.ndarray, z: np.ndarray, orders: int) -> np.ndarray:
    """Columns cos, sin, z cos, z sin, then cos k theta, sin k theta for k = 2..orders.

    Parameters
    ----------
    theta, z : (n,) float
        rad, mm.

    Returns
    -------
    (n, 2 * orders + 2) float64
    """
    first = _first_harmonic(theta)
    higher = [f(k * theta) for k in range(2, orders + 1) for f in (np.cos, np.sin)]
    return np.column_stack([first, first * (z / _Z_UNIT_MM)[:, None], *higher])


def _first_harmonic(theta: np.ndarray) -> np.ndarray:
    return np.column_stack([np.cos(theta), np.sin(theta)])
