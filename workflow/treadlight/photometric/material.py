"""What a region's pixels have in common: shininess, ratio of diffuse to gloss, misfit of the model.

Fitted anew at every pixel, alpha and k_d / k_s are ill-posed where no LED shows the highlight;
shared by all, they deny texture and patches of other rubber. So they are given a distribution,
learned from the region itself (empirical Bayes): its mean is found by a search over shared
materials, mean and width by expectation and maximisation.
"""

from dataclasses import dataclass, replace

import numpy as np

from treadlight.photometric import map_kernels, map_report, map_starts
from treadlight.photometric.observations import Observations

_SEARCH_PX, _SAMPLE_PX = 256, 4096
_SEARCH_ALPHA = 2.0 ** np.arange(1, 10)
_SEARCH_RATIO = 10.0 ** np.arange(-2, 2.1, 0.5)
# Between two trial materials of the search, in logarithms; then, before anything is known.
_SEARCH_STD, _FIRST_STD = 0.3, 0.7
# Misfit of a model that is about right, relative to the light: the search needs no better.
_SEARCH_MISFIT = 0.1
_ROUNDS = 12
_LEAST_STD = 0.02
_LEAST_MISFIT = 1e-3
# The percentile of a normal distribution's absolute values at so many standard deviations: of
# errors with long tails the tails count too.
_TAIL, _TAIL_SIGMA = 90.0, 1.6449
# Parameters fitted at a pixel.
_FITTED = 5
# Pixels whose cost is beyond this many medians are no tread, or shadowed unknown.
_TRIM_AT = 3.0


@dataclass(frozen=True)
class Material:
    """Distribution of (ln alpha, ln(k_d / k_s)) over a region, and how well the model fits there.

    Attributes
    ----------
    mean : (2,) float64
    covariance : (2, 2) float64
    misfit : float
        Standard deviation of what the model does not explain, relative to the root mean square
        of an LED's intensity and the pixel's brightest one: a lobe of another shape misfits in
        proportion, a neighbour's reflection adds to dim LEDs too.
    """

    mean: np.ndarray
    covariance: np.ndarray
    misfit: float

    @property
    def prior(self) -> np.ndarray:
        """As the kernel wants it, (5,) float32."""
        inverse = np.linalg.inv(self.covariance)
        values = [*self.mean, inverse[0, 0], inverse[0, 1], inverse[1, 1]]
        return np.array(values, np.float32)


def fit(observations: Observations, material: Material) -> np.ndarray:
    """The kernel's results, (n, map_report.RESULTS) float64."""
    out = np.empty((observations.intensity.shape[1], map_report.RESULTS))
    map_kernels.fit_pixels(
        *observations.arrays(),
        _directions(),
        material.prior,
        np.float32(material.misfit**2),
        out,
    )
    return out


def _directions() -> np.ndarray:
    """Unit vectors evenly about (0, 0, 1), by the golden angle, (DIRECTIONS, 3) float32."""
    place = np.arange(map_starts.DIRECTIONS) + 0.5
    cosine = 1 - place / map_starts.DIRECTIONS * (1 - np.cos(map_starts.WIDEST))
    turn = np.pi * (1 + np.sqrt(5)) * place
    sine = np.sqrt(1 - cosine**2)
    return np.stack([sine * np.cos(turn), sine * np.sin(turn), cosine], axis=1).astype(np.float32)


def learn_material(observations: Observations) -> Material:
    """The region's material from its own pixels.

    Parameters
    ----------
    observations : Observations
        A sample of the region, evenly spread; some thousand pixels are enough.
    """
    sample = spread(observations, _SAMPLE_PX)
    return settle(sample, search(spread(sample, _SEARCH_PX)), _ROUNDS)


def settle(sample: Observations, material: Material, rounds: int) -> Material:
    """The sample's material by expectation and maximisation, from a first one."""
    for _ in range(rounds):
        found = fit(sample, material)
        cost = found[:, map_report.FOUND_COST]
        known = np.isfinite(cost)
        if not known.any():
            return material
        kept = known & (cost <= _TRIM_AT * np.median(cost[known]))
        mean, covariance = _maximise(found[kept], material.mean)
        material = Material(mean, covariance, _misfit(sample, found, kept))
    return material


def spread(observations: Observations, count: int) -> Observations:
    """About so many of the pixels that have enough light to say something, evenly spread."""
    with np.errstate(invalid="ignore"):
        lit = (observations.usable & (observations.intensity > 3 * observations.noise)).sum(axis=0)
    pixels = np.flatnonzero(lit > _FITTED)
    pixels = pixels[:: max(1, len(pixels) // count)]
    return Observations(
        observations.intensity[:, pixels],
        observations.lights[:, pixels],
        observations.views[pixels],
        observations.usable[:, pixels],
        observations.noise[:, pixels],
    )


def search(sample: Observations) -> Material:
    """The material that all pixels together fit best, by trying them all."""
    best, least = None, np.inf
    for alpha in _SEARCH_ALPHA:
        for ratio in _SEARCH_RATIO:
            trial = Material(np.log([alpha, ratio]), _SEARCH_STD**2 * np.eye(2), _SEARCH_MISFIT)
            cost = fit(sample, trial)[:, map_report.FOUND_COST]
            cost = cost[np.isfinite(cost)]
            # The logarithm: a material that fits most pixels wins, whatever the others are.
            total = float(np.mean(np.log(cost + _LEAST_MISFIT))) if len(cost) else 0.0
            if best is None or total < least:
                best, least = trial, total
    assert best is not None
    return replace(best, covariance=_FIRST_STD**2 * np.eye(2))


def _maximise(found: np.ndarray, before: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance from the pixels' posteriors, their own uncertainty included."""
    value = found[:, [map_report.FOUND_LN_ALPHA, map_report.FOUND_LN_RATIO]]
    mean = value.mean(axis=0)
    away = value - mean
    own = found[:, [map_report.CAA, map_report.CAR, map_report.CRR]].mean(axis=0)
    covariance = away.T @ away / len(away) + np.array([[own[0], own[1]], [own[1], own[2]]])
    return mean, covariance + _LEAST_STD**2 * np.eye(2)


def _misfit(sample: Observations, found: np.ndarray, kept: np.ndarray) -> float:
    """What the model leaves beyond the sensor's noise, as `Material` defines it."""
    light = np.where(sample.usable, sample.intensity, np.nan)[:, kept].astype(np.float64)
    used = np.isfinite(light).sum(axis=0)
    scale = np.sqrt(0.5 * (light**2 + np.nanmax(light, axis=0) ** 2))
    error = (light - rerender(sample, found)[:, kept]) / scale
    error *= np.sqrt(used / np.maximum(used - _FITTED, 1))
    own = sample.noise[:, kept] / scale
    good = np.isfinite(error)
    spread = np.percentile(np.abs(error[good]), _TAIL) / _TAIL_SIGMA
    return max(float(np.sqrt(max(spread**2 - np.median(own[good] ** 2), 0.0))), _LEAST_MISFIT)


def rerender(observations: Observations, found: np.ndarray) -> np.ndarray:
    """What the model shows of the kernel's results (eq. 5.1), (n_leds, n)."""
    normal = found[:, map_report.NORMAL_X : map_report.NORMAL_Z + 1]
    k_d, k_s, alpha = found[:, map_report.FOUND_K_D : map_report.FOUND_ALPHA + 1].T
    half = observations.lights + observations.views
    half = half / np.linalg.norm(half, axis=-1, keepdims=True)
    cos_l = np.einsum("mni,ni->mn", observations.lights, normal)
    cos_h = np.clip(np.einsum("mni,ni->mn", half, normal), 1e-6, 1)
    return np.where(
        cos_l > 0, k_d * cos_l + k_s * cos_h**alpha, np.where(np.isnan(cos_l), np.nan, 0)
    )
