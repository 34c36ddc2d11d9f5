"""Specular photometric stereo: algorithm 4 of the dissertation."""

import math

import numpy as np

from treadlight.photometric import kernels
from treadlight.photometric.observations import FEW_LEDS, MIN_LEDS, POOR_FIT, Estimate, Observations

MAX_REFINEMENTS = 5
_CONVERGED_RAD = math.radians(0.001)
_WORST_RAD2 = (math.pi / 2) ** 2
# Five parameters absorb much of a pixel's misfit, so what is left of it says little of its
# error: the region's counts more than the pixel's sixteen or so LEDs.
_PRIOR_WEIGHT = 20.0
# Without a region to learn from: the dissertation's own rerendering error (figure 7.8).
DISSERTATION_MISFIT = 0.129


def sps(
    observations: Observations,
    *,
    max_refinements: int = MAX_REFINEMENTS,
    misfit: float | None = None,
) -> Estimate:
    """Normals from the gloss, the diffuse part taken out step by step (algorithm 4).

    Intensities are weights (eq. 5.21), alpha is searched for in [1, 1024], and k_d comes from
    the LED that shows least gloss (eqs. 5.26 and 5.27). Departures from the print: intensities
    are divided by the pixel's brightest first, so that the choice of alpha does not depend on
    the unit of light; k_d is never negative and its LED has n.l above 0.1; LEDs behind the
    surface (n.l <= 0) are left out of the sums once a normal is known; an estimate that
    faces away from the camera is no normal.

    Parameters
    ----------
    observations : Observations
    max_refinements : int
        Repetitions of steps 2 to 5, at most; it ends when the normal moves by less than 0.001
        degree.
    misfit : float, optional
        Relative rerendering error that is usual in the region; a pixel's own is drawn towards
        it in the covariance. By default it is learned from these observations.

    Returns
    -------
    Estimate
        few_leds: fewer than four usable LEDs, no normal. poor_fit: no LED shows light, the
        normal is not determined or faces away from the camera, no normal.
    """
    if misfit is None:
        misfit = typical_misfit(observations, max_refinements=max_refinements)
    found = _fit(observations, max_refinements, misfit)
    normal = found[:, kernels.NX : kernels.NZ + 1].astype(np.float32)
    used = found[:, kernels.LEDS]
    nothing = ~np.isfinite(normal[:, 0])
    flags = np.where(nothing & (used >= MIN_LEDS), POOR_FIT, np.uint8(0))
    flags |= np.where(used < MIN_LEDS, FEW_LEDS, np.uint8(0))
    # An angle cannot be more uncertain than this, whatever the linear propagation says.
    found[:, kernels.CXX :] = np.clip(found[:, kernels.CXX :], -_WORST_RAD2, _WORST_RAD2)
    k_d, k_s, alpha, residual = found[:, kernels.KD : kernels.RESIDUAL + 1].T.astype(np.float32)
    return Estimate(
        normal=normal,
        k_d=k_d,
        k_s=k_s,
        alpha=alpha,
        residual=residual,
        leds_used=used.astype(np.uint8),
        flags=flags.astype(np.uint8),
        covariance=found[:, kernels.CXX :].astype(np.float32),
    )


def typical_misfit(observations: Observations, *, max_refinements: int = MAX_REFINEMENTS) -> float:
    """The median relative misfit of the model over these pixels, after five fitted parameters.

    Where no pixel has more than five usable LEDs, the dissertation's 12.9 % stands in.
    """
    found = _fit(observations, max_refinements, 0.0)[:, kernels.MISFIT]
    known = found[np.isfinite(found)]
    return float(np.sqrt(np.median(known))) if known.size else DISSERTATION_MISFIT


def _fit(observations: Observations, max_refinements: int, misfit: float) -> np.ndarray:
    out = np.empty((observations.intensity.shape[1], kernels.RESULTS))
    # One memory layout and type: the kernel is then compiled once.
    kernels.fit_pixels(
        np.ascontiguousarray(observations.intensity, np.float32),
        np.ascontiguousarray(observations.lights, np.float32),
        np.ascontiguousarray(observations.views, np.float32),
        np.ascontiguousarray(observations.usable, np.bool_),
        np.ascontiguousarray(observations.noise, np.float32),
        max_refinements,
        math.cos(_CONVERGED_RAD),
        misfit**2,
        _PRIOR_WEIGHT,
        out,
    )
    return out
