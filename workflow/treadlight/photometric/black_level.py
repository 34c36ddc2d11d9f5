"""How much too high a black level was taken out of all images of a stack.

A few percent tilt the normals of a whole stack. No pixel alone can tell them from less k_d, but
all pixels with one material can. A constant too much, such as ambient light, is not looked for:
broad tails of the gloss look like it.
"""

from dataclasses import replace

import numpy as np
from scipy.optimize import minimize_scalar

from treadlight.photometric import map_report
from treadlight.photometric.material import Material, fit, search, settle, spread
from treadlight.photometric.observations import Observations

_SAMPLE_PX, _SEARCH_PX = 1024, 256
_ROUNDS = 8
# How much it may be, as a share of the median intensity, and how closely it is found.
_MOST, _CLOSELY = 0.3, 1e-3
# Of a pixel's log-likelihood: less says nothing, since the model is not all of the truth.
_LEAST_GAIN = 1.0
_SIGMAS = 3.0


def excess_black_level(observations: Observations) -> float:
    """The most probable constant that all intensities lack, of the unit of intensity.

    That of the largest likelihood of pixels that share a material, up to 0.3 of the median
    intensity; 0 where it is not e times as likely per pixel as none.

    Parameters
    ----------
    observations : Observations
        Lights far away, or images that were not yet divided by their irradiance: a constant of
        the counts.
    """
    sample = _lit_alone(spread(observations, _SAMPLE_PX))
    if not sample.usable.any():
        return 0.0
    usual = float(np.median(sample.intensity[sample.usable]))
    first = search(spread(sample, _SEARCH_PX))

    def cost(share: float) -> float:
        trial = replace(sample, intensity=sample.intensity + np.float32(share * usual))
        return _cost(trial, settle(trial, first, _ROUNDS))

    found = minimize_scalar(
        cost, bounds=(0.0, _MOST), method="bounded", options={"xatol": _CLOSELY}
    )
    return float(found.x) * usual if found.fun < cost(0.0) - _LEAST_GAIN else 0.0


def give_back_black_level(observations: Observations, excess: float) -> Observations:
    """Observations with a constant added to all intensities.

    What is dark was cut off at zero: it says nothing any more, and is not usable.
    """
    if excess == 0.0:
        return observations
    return replace(_lit_alone(observations), intensity=observations.intensity + np.float32(excess))


def _lit_alone(observations: Observations) -> Observations:
    with np.errstate(invalid="ignore"):
        lit = observations.intensity > _SIGMAS * observations.noise
    return replace(observations, usable=observations.usable & lit)


def _cost(sample: Observations, material: Material) -> float:
    """Negative logarithm of the likelihood of a pixel, the mean over the sample."""
    cost = fit(sample, material)[:, map_report.FOUND_COST]
    lit = np.where(sample.usable, sample.intensity, 0.0)
    variance = sample.noise**2 + 0.5 * material.misfit**2 * (lit**2 + lit.max(axis=0) ** 2)
    width = np.where(sample.usable, 0.5 * np.log(variance), 0.0).sum(axis=0)
    known = np.isfinite(cost)
    return float(np.mean((0.5 * cost + width)[known])) if known.any() else np.inf
