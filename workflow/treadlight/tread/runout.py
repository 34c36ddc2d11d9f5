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


@dataclass(frozen=True)
class RadialHarmonics:
    """Radial runout of one rib around a whole turn.

    Attributes
    ----------
    amplitude_mm : (n,) float64
        Of the orders 1..n.
    std_mm : float
        Standard uncertainty of each.
    peak_to_peak_mm : float
        Of the sum of these orders.
    """

    amplitude_mm: np.ndarray
    std_mm: float
    peak_to_peak_mm: float


def radial_harmonics(theta: np.ndarray, r: np.ndarray, orders: int) -> RadialHarmonics | None:
    """Fourier amplitudes of a radius around the turn, by least squares over what is known.

    Parameters
    ----------
    theta : (n,) float
        rad.
    r : (n,) float
        mm; NaN = missing.
    orders : int

    Returns
    -------
    RadialHarmonics or None
        None unless nine in ten of as many sectors of the turn as have to be told apart hold
        something.
    """
    known = np.isfinite(r)
    sectors = 4 * orders
    seen = np.unique(np.floor((theta[known] % (2 * np.pi)) / (2 * np.pi) * sectors))
    if len(seen) < 0.9 * sectors:
        return None
    angles = np.outer(theta, np.arange(1, orders + 1))
    basis = np.column_stack([np.ones(len(theta)), np.cos(angles), np.sin(angles)])
    found, *_ = np.linalg.lstsq(basis[known], r[known], rcond=None)
    waves = basis[:, 1:] @ found[1:]
    residual = r[known] - basis[known] @ found
    free = max(1, known.sum() - len(found))
    std = np.sqrt(residual @ residual / free * 2 / known.sum())
    amplitude = np.hypot(found[1 : orders + 1], found[orders + 1 :])
    return RadialHarmonics(amplitude, float(std), float(np.ptp(waves)))
