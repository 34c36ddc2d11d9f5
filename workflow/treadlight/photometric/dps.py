"""Diffuse photometric stereo: Lambertian least squares, the baseline."""

import numpy as np

from treadlight.photometric.observations import FEW_LEDS, POOR_FIT, Estimate, Observations

_MIN_LEDS = 3
_CHUNK_PX = 1 << 16


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
    n = observations.intensity.shape[1]
    parts = [_fit(observations, slice(i, i + _CHUNK_PX)) for i in range(0, n, _CHUNK_PX)]
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


def _fit(observations: Observations, pixels: slice) -> tuple[np.ndarray, ...]:
    intensity = observations.intensity[:, pixels].astype(np.float64)
    lights = observations.lights[:, pixels].astype(np.float64)
    usable = observations.usable[:, pixels] & np.isfinite(intensity)
    intensity = np.where(usable, intensity, 0.0)
    lights = np.where(usable[..., None], lights, 0.0)
    used = usable.sum(axis=0)
    normal_matrix = np.einsum("mni,mnj->nij", lights, lights)
    right_side = np.einsum("mni,mn->ni", lights, intensity)
    solvable = (used >= _MIN_LEDS) & (np.linalg.det(normal_matrix) > 1e-9)
    normal_matrix[~solvable] = np.eye(3)
    inverse = np.linalg.inv(normal_matrix)
    scaled = np.einsum("nij,nj->ni", inverse, right_side)
    k_d = np.linalg.norm(scaled, axis=1)
    facing = np.einsum("ni,ni->n", scaled, observations.views[pixels]) > 0
    good = solvable & facing
    with np.errstate(divide="ignore", invalid="ignore"):
        normal = np.where(good[:, None], scaled / k_d[:, None], np.nan)
    model = np.maximum(np.einsum("mni,ni->mn", lights, scaled), 0.0)
    error = np.where(usable, intensity - model, 0.0)
    bright = usable & (intensity > 3 * observations.noise[:, pixels])
    residual = _mean_relative(error, intensity, bright)
    variance = np.sum(error**2, axis=0) / np.maximum(used - 3, 1)
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
