"""The regular (theta, z) grid on which a profile lives."""

from dataclasses import dataclass

import numpy as np

from treadlight.geometry.axis import wrap_angle


@dataclass(frozen=True)
class CylinderGrid:
    """Evenly spaced cell centres in {T}.

    Attributes
    ----------
    theta : (n,) float64
        Rad, increasing; the first lies in [-pi, pi), a sector may run past pi.
    z : (m,) float64
        mm, increasing.
    nominal_radius_mm : float
    """

    theta: np.ndarray
    z: np.ndarray
    nominal_radius_mm: float

    @property
    def shape(self) -> tuple[int, int]:
        return len(self.theta), len(self.z)

    @property
    def step_theta(self) -> float:
        """Rad."""
        return float(self.theta[-1] - self.theta[0]) / (len(self.theta) - 1)

    @property
    def step_z(self) -> float:
        """mm."""
        return float(self.z[-1] - self.z[0]) / (len(self.z) - 1)

    @property
    def periodic(self) -> bool:
        """Whether the grid is a whole turn: the last cell is a neighbour of the first."""
        return abs(len(self.theta) * self.step_theta - 2 * np.pi) < 1e-6 * self.step_theta

    @property
    def filter_mode(self) -> tuple[str, str]:
        """How scipy's filters go on beyond the borders."""
        return ("wrap" if self.periodic else "nearest", "nearest")

    @classmethod
    def whole_turn(
        cls, z_range: tuple[float, float], step_mm: float, nominal_radius_mm: float
    ) -> "CylinderGrid":
        """A periodic grid whose theta step is the nearest to `step_mm` that closes the turn."""
        n = round(2 * np.pi * nominal_radius_mm / step_mm)
        theta = -np.pi + np.arange(n) * (2 * np.pi / n)
        return cls(theta, _centres(*z_range, step_mm), nominal_radius_mm)

    @classmethod
    def sector(
        cls,
        theta_range: tuple[float, float],
        z_range: tuple[float, float],
        step_mm: float,
        nominal_radius_mm: float,
    ) -> "CylinderGrid":
        """An open grid over `theta_range` (rad, second larger than first)."""
        theta = _centres(*theta_range, step_mm / nominal_radius_mm)
        theta = theta - theta[0] + wrap_angle(theta[0])
        return cls(theta, _centres(*z_range, step_mm), nominal_radius_mm)

    def part(self, rows: np.ndarray) -> "CylinderGrid":
        """The grid of neighbouring rows (k,), which may run past the last one to the first.

        All, or none, are the grid itself.
        """
        if len(rows) in (0, len(self.theta)):
            return self
        theta = wrap_angle(self.theta[rows[0]]) + np.arange(len(rows)) * self.step_theta
        return CylinderGrid(theta, self.z, self.nominal_radius_mm)

    def index(self, theta: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Fractional row and column indices of points; theta is compared modulo 2 pi.

        On an open grid rows outside it come out below -0.5 or above n - 0.5.
        """
        middle = 0.5 * (self.theta[0] + self.theta[-1])
        offset = middle - self.theta[0] + wrap_angle(np.asarray(theta) - middle)
        row = offset / self.step_theta
        if self.periodic:
            row = row % len(self.theta)
            # The rest of a number just below zero is rounded to the divisor.
            row = np.where(row < len(self.theta), row, 0.0)
        return row, (np.asarray(z) - self.z[0]) / self.step_z


def _centres(low: float, high: float, step: float) -> np.ndarray:
    count = max(2, int(np.floor((high - low) / step + 1e-9)) + 1)
    return low + step * np.arange(count)
