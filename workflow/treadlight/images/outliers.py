"""Which of a few values fall below what the others let expect."""

from collections.abc import Sequence

import numpy as np
from scipy.special import stdtrit

# Of so many at most: what more of them share is no exception.
_LARGEST_SHARE = 0.25


def low_outliers(values: Sequence[float], rate: float) -> list[int]:
    """Indices of values that are too low for the others' distribution.

    The generalized extreme Studentized deviate test (Rosner, Technometrics 25, 1983), one-sided:
    outliers do not mask each other, up to a quarter of the values.

    Parameters
    ----------
    values : sequence of float
        Finite; taken as normally distributed but for the outliers. Two clusters, as of two rings
        of LEDs, have lighter tails, so that the test then errs on the safe side.
    rate : float
        How often any value is called an outlier where there is none.
    """
    left = list(range(len(values)))
    lowest: list[int] = []
    found = 0
    while len(lowest) < _LARGEST_SHARE * len(values) and len(left) > 2:
        kept = np.asarray([values[k] for k in left], np.float64)
        n = len(kept)
        quantile = stdtrit(n - 2, 1 - rate / n)
        critical = (n - 1) * quantile / np.sqrt(n * (n - 2 + quantile**2))
        spread = kept.std(ddof=1)
        lowest.append(left.pop(int(np.argmin(kept))))
        if spread > 0 and (kept.mean() - kept.min()) / spread > critical:
            found = len(lowest)
    return lowest[:found]
