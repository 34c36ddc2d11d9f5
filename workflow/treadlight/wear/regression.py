"""A straight line through a few points, and how far a new point may lie from it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

_PROBABILITY = 0.95


@dataclass(frozen=True)
class Line:
    """Least-squares line y = level + slope (x - middle).

    Attributes
    ----------
    level, slope, middle : float
    sigma : float
        Standard deviation of a point about the line: the larger of the scatter about it and of
        the points' own standard uncertainty.
    spread : float
        Sum of squares of x about the middle.
    count : int
    reach : float
        Quantile of a 95 % interval: Student's with count - 2 degrees of freedom, the normal one
        where the points' own uncertainties rule.
    """

    level: float
    slope: float
    middle: float
    sigma: float
    spread: float
    count: int
    reach: float

    def at(self, x: np.ndarray) -> np.ndarray:
        return self.level + self.slope * (np.asarray(x, float) - self.middle)

    def prediction_half_width(self, x: np.ndarray) -> np.ndarray:
        """Half the 95 % prediction interval of one new point at x."""
        away = (np.asarray(x, float) - self.middle) ** 2 / self.spread
        return self.reach * self.sigma * np.sqrt(1 + 1 / self.count + away)


def fit_line(points: Sequence[tuple[float, float, float]]) -> Line | None:
    """Least-squares line through points (x, y, standard uncertainty of y).

    Parameters
    ----------
    points : sequence of (float, float, float)

    Returns
    -------
    Line or None
        None for fewer than two different x.
    """
    x, y, own = np.array(points, float).reshape(-1, 3).T
    if len(np.unique(x)) < 2:
        return None
    middle, level = x.mean(), y.mean()
    spread = float((x - middle) @ (x - middle))
    slope = float((x - middle) @ y) / spread
    residual = y - level - slope * (x - middle)
    free = len(x) - 2
    scatter = np.sqrt(residual @ residual / free) if free else 0.0
    # The first capture's wear is nil by definition, not by measurement.
    measured = own[own > 0]
    typical = np.sqrt(np.mean(measured**2)) if len(measured) else 0.0
    by_scatter = scatter > typical
    tail = 0.5 * (1 - _PROBABILITY)
    reach = float(stats.t.isf(tail, free) if by_scatter else stats.norm.isf(tail))
    return Line(
        float(level), slope, float(middle), float(max(scatter, typical)), spread, len(x), reach
    )
