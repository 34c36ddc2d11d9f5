"""Diffuse photometric stereo: Lambertian least squares, the baseline, and its robust form."""

import numpy as np

from treadlight.photometric.observations import FEW_LEDS, POOR_FIT, Estimate, Observations

_MIN_LEDS = 3
_CHUNK_PX = 1 << 16
# Reweighting gains a digit in some five rounds where outliers are few.
_ROUNDS = 40
# Of the pixel's brightest LED: below this a residual is as good as none, and the least sum of
# absolute residuals is turned by no more than this many radians.
_SMALLEST = 1e-4
_MAD_TO_STD = 1.4826


def dps(observations: Observations) -> Estimate:
    """Normals and k_d by linear least squares over the usable LEDs (eq. 3.19).

    Minimises the sum of (I_m - k_d n.l_m)2. An LED in attached shadow (n.l < 0) counts like
    any other here, as in the print.

    Parameters
    ----------
    observations : Observations

    Returns
    -------
    Estimate
        k_s is 0 and alpha NaN. few_leds: fewer than three usable LEDs, no normal. poor_fit:
        the LEDs lie in one plane with the point, the pixel is black, or the normal faces away
        from the camera; no normal.
    """
    return _in_chunks(observations, rounds=0)


def dps_l1(observations: Observations) -> Estimate:
    """Normals and k_d of the least sum of |I_m - k_d n.l_m|: highlights and shadows count less.

    Iteratively reweighted least squares (Schlossmacher, JASA 1973), as robust photometric stereo
    uses it: each LED weighs one over its last residual. Not in the dissertation.

    Parameters
    ----------
    observations : Observations

    Returns
    -------
    Estimate
        As `dps`. The covariance is the estimator's for errors that are Gaussian but for the
        outliers (Koenker and Bassett, Econometrica 1978).
    """
    return _in_chunks(observations, rounds=_ROUNDS)


def _in_chunks(observations: Observations, rounds: int) -> Estimate:
    n = observations.intensity.shape[1]
    starts = range(0, max(n, 1), _CHUNK_PX)
    parts = [_fit(observations, slice(i, i + _CHUNK_PX), rounds) for i in starts]
    columns = [np.concatenate(column) for column in zip(*parts, strict=True)]
    normal, k_d, residual, used, flags, covariance = columns
    missing = np.isnan(k_d)
    return Estimate(
        normal=normal.astype(np.float32),
        k_d=k_d.astype(np.float32),
        k_s=np.where(missing, np.nan, 0).astype(np.float32),
        alpha=np.full(n, np.nan, np.float32),
        residual=residual.astype(np.float32),
        leds_used=used.astype(np.uint8),
        flags=flags,
        covariance=covariance.astype(np.float32),
    )


def _fit(observations: Observations, pixels: slice, rounds: int) -> tuple[np.ndarray, ...]:
    intensity = observations.intensity[:, pixels].astype(np.float64)
    lights = observations.lights[:, pixels].astype(np.float64)
    usable = observations.usable[:, pixels] & np.isfinite(intensity)
    intensity = np.where(usable, intensity, 0.0)
    lights = np.where(usable[..., None], lights, 0.0)
    used = usable.sum(axis=0)
    normal_matrix, right_side = _normal_equations(lights, intensity, usable.astype(np.float64))
    solvable = (used >= _MIN_LEDS) & (np.linalg.det(normal_matrix) > 1e-9)
    normal_matrix[~solvable] = np.eye(3)
    inverse = np.linalg.inv(normal_matrix)
    scaled = np.einsum("nij,nj->ni", inverse, right_side)
    if rounds:
        scaled = _reweighted(lights, intensity, usable, solvable, scaled, rounds)
    k_d = np.linalg.norm(scaled, axis=1)
    facing = np.einsum("ni,ni->n", scaled, observations.views[pixels]) > 0
    good = solvable & facing
    with np.errstate(divide="ignore", invalid="ignore"):
        normal = np.where(good[:, None], scaled / k_d[:, None], np.nan)
    model = np.maximum(np.einsum("mni,ni->mn", lights, scaled), 0.0)
    error = np.where(usable, intensity - model, 0.0)
    bright = usable & (intensity > 3 * observations.noise[:, pixels])
    residual = _mean_relative(error, intensity, bright)
    variance = (_robust_variance if rounds else _variance)(error, usable)
    flags = np.where(used < _MIN_LEDS, FEW_LEDS, np.where(good, np.uint8(0), POOR_FIT))
    covariance = _tilts(inverse, normal, variance, k_d)
    nothing = ~good
    return (
        normal,
        np.where(nothing, np.nan, k_d),
        np.where(nothing, np.nan, residual),
        used,
        flags.astype(np.uint8),
        covariance,
    )


def _normal_equations(
    lights: np.ndarray, intensity: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """L'WL (n, 3, 3) and L'WI (n, 3) of lights (m, n, 3), intensity and weights (m, n)."""
    weighted = lights * weights[..., None]
    matrix = np.einsum("mni,mnj->nij", weighted, lights)
    return matrix, np.einsum("mni,mn->ni", weighted, intensity)


def _reweighted(
    lights: np.ndarray,
    intensity: np.ndarray,
    usable: np.ndarray,
    solvable: np.ndarray,
    scaled: np.ndarray,
    rounds: int,
) -> np.ndarray:
    """k_d n (n, 3) of the least absolute residuals, from those of the least squares."""
    smallest = _SMALLEST * np.maximum(np.abs(intensity).max(axis=0, initial=0.0), 1e-30)
    for _ in range(rounds):
        error = np.abs(intensity - np.einsum("mni,ni->mn", lights, scaled))
        weights = np.where(usable, smallest / np.maximum(error, smallest), 0.0)
        matrix, right_side = _normal_equations(lights, intensity, weights)
        matrix[~solvable] = np.eye(3)
        scaled = np.linalg.solve(matrix, right_side[..., None])[..., 0]
    return scaled


def _variance(error: np.ndarray, usable: np.ndarray) -> np.ndarray:
    return np.sum(error**2, axis=0) / np.maximum(usable.sum(axis=0) - 3, 1)


def _robust_variance(error: np.ndarray, usable: np.ndarray) -> np.ndarray:
    """Variance (n,) that makes (L'L)^-1 the covariance of the least absolute residuals.

    pi / 2 that of the errors but for outliers. Three residuals are 0 because three unknowns are
    fitted; the spread is that of the others.
    """
    size = np.sort(np.where(usable, np.abs(error), np.inf), axis=0)
    used = usable.sum(axis=0)
    middle = np.minimum((used + 3) // 2, np.maximum(used - 1, 0))
    spread = np.take_along_axis(size, middle[None], axis=0)[0]
    return np.pi / 2 * (_MAD_TO_STD * np.where(used > 0, spread, 0.0)) ** 2


def _mean_relative(error: np.ndarray, intensity: np.ndarray, bright: np.ndarray) -> np.ndarray:
    """Eq. 5.30 as a mean over the bright LEDs, (n,)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        relative = np.where(bright, np.abs(error) / intensity, 0.0)
        return relative.sum(axis=0) / bright.sum(axis=0)


def _tilts(
    inverse: np.ndarray, normal: np.ndarray, variance: np.ndarray, k_d: np.ndarray
) -> np.ndarray:
    """Covariance (n, 6) of the unit normal from that of the scaled one."""
    across = np.eye(3) - normal[:, :, None] * normal[:, None, :]
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = variance / k_d**2
    full = np.einsum("nij,njk,nkl->nil", across, inverse, across) * scale[:, None, None]
    return full[:, *np.triu_indices(3)]
