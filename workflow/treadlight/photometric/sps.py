"""Specular photometric stereo: algorithms 2 to 4 of the dissertation."""

import math
from typing import Literal

import numpy as np

from treadlight.photometric import kernels, sps_report
from treadlight.photometric.observations import Estimate, Observations, estimate_of
from treadlight.threads import by_ranges

Algorithm = Literal[2, 3, 4]

MAX_REFINEMENTS = 5
# Whole blocks of lanes, worth a thread.
_LEAST_PX = 16 * kernels.PIXELS
_CONVERGED_RAD = math.radians(0.001)
# Five parameters absorb much of a pixel's misfit, so what is left of it says little of its
# error: the region's counts more than the pixel's sixteen or so LEDs.
_PRIOR_WEIGHT = 20.0
# Without a region to learn from: the dissertation's own rerendering error (figure 7.8).
DISSERTATION_MISFIT = 0.129


def sps(
    observations: Observations,
    *,
    algorithm: Algorithm = 4,
    max_refinements: int = MAX_REFINEMENTS,
    misfit: float | None = None,
) -> Estimate:
    """Normals from the gloss (section 5.3): algorithm 2, 3 or 4.

    Algorithm 2 takes all light for gloss and every LED for as good as any other (eq. 5.15);
    algorithm 3 weighs LEDs by their intensity (eq. 5.23); algorithm 4 takes the diffuse part
    out step by step, k_d from the LED that shows least gloss (eqs. 5.26 and 5.27). All search
    for alpha in [1, 1024]. Departures from the print: intensities are divided by the pixel's
    brightest first, so that the choice of alpha does not depend on the unit of light; an LED
    that shows no light has no part in algorithm 2, where the root of its noise would count as
    much as a highlight; k_d is never negative and its LED has n.l above 0.1; LEDs behind the
    surface (n.l <= 0) are left out of the sums once a normal is known; an estimate that
    faces away from the camera is no normal.

    Parameters
    ----------
    observations : Observations
    algorithm : 2, 3 or 4
        In the dissertation's numbering. k_d is 0 after algorithms 2 and 3.
    max_refinements : int
        Of algorithm 4: repetitions of steps 2 to 5, at most; it ends when the normal moves by
        less than 0.001 degree.
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
        misfit = typical_misfit(observations, algorithm=algorithm, max_refinements=max_refinements)
    found = _fit(observations, algorithm, max_refinements, misfit)
    return estimate_of(
        found[:, : sps_report.RESIDUAL + 1], found[:, sps_report.LEDS], found[:, sps_report.CXX :]
    )


def typical_misfit(
    observations: Observations,
    *,
    algorithm: Algorithm = 4,
    max_refinements: int = MAX_REFINEMENTS,
) -> float:
    """The median relative misfit of the model over these pixels, after five fitted parameters.

    Where no pixel has more than five usable LEDs, the dissertation's 12.9 % stands in.
    """
    found = _fit(observations, algorithm, max_refinements, 0.0)[:, sps_report.MISFIT]
    known = found[np.isfinite(found)]
    return float(np.sqrt(np.median(known))) if known.size else DISSERTATION_MISFIT


def _fit(
    observations: Observations, algorithm: Algorithm, max_refinements: int, misfit: float
) -> np.ndarray:
    out = np.empty((observations.intensity.shape[1], sps_report.RESULTS))
    by_ranges(
        kernels.fit_pixels,
        len(out),
        _LEAST_PX,
        *observations.arrays(),
        algorithm,
        max_refinements,
        _CONVERGED_RAD,
        misfit**2,
        _PRIOR_WEIGHT,
        out,
    )
    return out
