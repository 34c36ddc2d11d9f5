"""Estimates that outliers do not move."""

import numpy as np

# Tukey's biweight keeps 95 % efficiency at this many standard deviations.
TUKEY = 4.685
# Of a mean of squares taken from their median, against that of the mean: variance.
MEDIAN_COST = 2.7
# Median of the chi-squared distribution with one degree of freedom.
_CHI2_MEDIAN = 0.4549364


def robust_square(values: np.ndarray) -> float:
    """Mean square of Gaussian values (n,), from the median of their squares."""
    return float(np.median(values**2)) / _CHI2_MEDIAN


def solve_robust(
    basis: np.ndarray, values: np.ndarray, prior_std: np.ndarray, weights: np.ndarray | None = None
) -> tuple[np.ndarray, float]:
    """Iteratively reweighted least squares with Tukey's biweight and Gaussian priors around zero.

    The biweight's tuning constant 4.685 gives 95 % efficiency on Gaussian errors (Beaton and
    Tukey 1974); the scale is 1.4826 times the median absolute residual, found anew each time.
    It starts from Huber's weights, which have no second minimum.

    Parameters
    ----------
    basis : (n, p) float
    values : (n,) float
    prior_std : (p,) float
        In the units of the coefficients; inf for none.
    weights : (n,) float, optional
        Relative inverse variances.

    Returns
    -------
    coefficients : (p,) float64
    scale : float
        Robust standard deviation of a residual of weight 1.
    """
    root = np.ones(len(values)) if weights is None else np.sqrt(weights / np.mean(weights))
    coefficients = np.zeros(basis.shape[1])
    robust = np.ones(len(values))
    scale = _scale(root * (values - np.median(values)))
    for iteration in range(30):
        weighted = basis * (root**2 * robust)[:, None]
        normal = weighted.T @ basis + np.diag((scale / prior_std) ** 2)
        # The least solution where the data leave one open.
        found = np.linalg.lstsq(normal, weighted.T @ values, rcond=1e-12)[0]
        previous, coefficients = coefficients, found
        residual = root * (values - basis @ coefficients)
        scale = _scale(residual)
        if iteration < 8:
            robust = np.minimum(1.0, 1.345 * scale / np.maximum(np.abs(residual), 1e-12))
        else:
            robust = np.clip(1.0 - (residual / (TUKEY * scale)) ** 2, 0.0, None) ** 2
            if np.allclose(coefficients, previous, rtol=0, atol=1e-6):
                break
    return coefficients, scale


def _scale(residual: np.ndarray) -> float:
    """Robust standard deviation; a tenth of a micrometre at least, so that exact data divide."""
    return max(float(1.4826 * np.median(np.abs(residual))), 1e-4)


def block_medians(cells: np.ndarray, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Median and share of the known cells in each block of rows.

    Parameters
    ----------
    cells : (n, m) float
        NaN = missing.
    rows : int
        Per block; the last may have fewer.

    Returns
    -------
    median, share : (ceil(n / rows),) float64
        Median NaN where nothing is known.
    """
    count = -(-len(cells) // rows)
    padded = np.full((count * rows, cells.shape[1]), np.nan)
    padded[: len(cells)] = cells
    median, known = row_medians(padded.reshape(count, -1))
    return median, known / (rows * cells.shape[1])


def row_medians(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Median (n,) of the finite values in each row of (n, k), NaN if there are none; their number.

    By one sort: numpy's nanmedian takes far longer for short rows.
    """
    ordered = np.sort(values, axis=1)
    known = np.isfinite(ordered).sum(axis=1)
    last, each = np.maximum(known - 1, 0), np.arange(len(values))
    return 0.5 * (ordered[each, last // 2] + ordered[each, (last + 1) // 2]), known
