"""What a region's pixels have in common: shininess, ratio of diffuse to gloss, misfit of the model.

Fitted anew at every pixel, alpha and k_d / k_s are ill-posed where no LED shows the highlight;
shared by all, they deny texture and patches of other rubber. So they are given a distribution,
learned from the region itself (empirical Bayes): its mean is found by a search over shared
materials, mean and width by expectation and maximisation. The shape of the lobe is the region's
too: the one with which some LEDs predict the others best.
"""

from dataclasses import dataclass, replace

import numpy as np

from treadlight.photometric import map_kernels, map_report, map_starts
from treadlight.photometric.observations import Observations
from treadlight.threads import by_ranges, share

_SEARCH_PX, _LOBE_PX, _SAMPLE_PX = 256, 1024, 4096
# As many pixels of a strip stand as far apart as strips do: their LEDs stand most alike.
_STRIP_PX = 32
_SEARCH_ALPHA = 2.0 ** np.arange(1, 10)
_SEARCH_RATIO = 10.0 ** np.arange(-2, 2.1, 0.5)
# Between two trial materials of the search, in logarithms; then, before anything is known.
_SEARCH_STD, _FIRST_STD = 0.3, 0.7
# Misfit of a model that is about right, relative to the light: the search needs no better.
_SEARCH_MISFIT = 0.1
_ROUNDS = 12
# Rows of an image that are fitted one after the other; bands of them are shared among cores.
_BAND_ROWS = 32
# Lobes that are tried, from the shortest tails on: gamma infinite, 8, 4, 2, 1.
BLINN_PHONG = -1
_SQUARINGS = (BLINN_PHONG, 3, 2, 1, 0)
# LEDs are predicted in so many groups, each from all others. A lobe must predict better than
# Blinn and Phong's by so many standard errors.
_GROUPS, _SIGMAS = 4, 3.0
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
    squarings : int
        The lobe is k_s (1 - alpha ln(n.h) / gamma)^-gamma with gamma = 2^squarings, the generalised
        distribution of Trowbridge and Reitz; `BLINN_PHONG` stands for gamma without bound, which
        is k_s (n.h)^alpha. All are as sharp at their peak.
    """

    mean: np.ndarray
    covariance: np.ndarray
    misfit: float
    squarings: int = BLINN_PHONG

    @property
    def packed(self) -> np.ndarray:
        """For the kernel, (6,) float32: mean, inverse covariance (xx, xy, yy), squarings."""
        inverse = np.linalg.inv(self.covariance)
        values = [*self.mean, inverse[0, 0], inverse[0, 1], inverse[1, 1], self.squarings]
        return np.array(values, np.float32)


def fit(
    observations: Observations, material: Material, enough: float = 0.0, width: int | None = None
) -> np.ndarray:
    """The kernel's results, (n, map_report.RESULTS) float32.

    A pixel needs no other start if one leaves a cost of at most `enough` per degree of freedom.
    With `width`, the pixels are those of an image, row by row, with so many in a row: they start
    where the ones above ended, within bands of rows.
    """
    out = np.empty((map_report.RESULTS, observations.intensity.shape[1]), np.float32)
    band = _BAND_ROWS * width if width else map_kernels.SPAN
    by_ranges(
        map_kernels.fit_pixels,
        -(-out.shape[1] // band),
        1,
        *observations.arrays(),
        _directions(),
        material.packed,
        np.float32(material.misfit**2),
        np.float32(enough),
        width or 0,
        band,
        out,
    )
    return out.T


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
    return settle(sample, _choose_lobe(sample), _ROUNDS)


def _choose_lobe(sample: Observations) -> Material:
    """The material, of any lobe, with which the LEDs predict each other best."""
    some, few = spread(sample, _LOBE_PX), spread(sample, _SEARCH_PX)
    trials: dict[int, Material] = {}
    errors_of: dict[int, np.ndarray] = {}

    def try_lobe(squarings: int) -> None:
        trials[squarings] = settle(some, search(few, squarings), _ROUNDS)
        errors_of[squarings] = _prediction_error(sample, trials[squarings])

    share(try_lobe, _SQUARINGS)
    errors = np.stack([errors_of[squarings] for squarings in _SQUARINGS])
    errors = errors[:, np.isfinite(errors).all(axis=0)]
    if errors.shape[1] < 2:
        return trials[BLINN_PHONG]
    best = int(np.argmin(errors.mean(axis=1)))
    gain = errors[0] - errors[best]
    sure = gain.mean() > _SIGMAS * gain.std() / np.sqrt(len(gain))
    return trials[_SQUARINGS[best if sure else 0]]


def _prediction_error(sample: Observations, material: Material) -> np.ndarray:
    """Of LEDs from others, (n,): the mean logarithm of the error, which is at least the noise."""
    light = np.where(sample.usable, sample.intensity, np.nan)
    groups = np.arange(len(light)) % _GROUPS
    error = np.full(light.shape, np.nan)
    for group in range(_GROUPS):
        out = groups == group
        others = replace(sample, usable=sample.usable & ~out[:, None])
        error[out] = (light - rerender(sample, fit(others, material), material))[out]
    logarithm = np.log(np.abs(error) + sample.noise)
    known = np.isfinite(logarithm)
    with np.errstate(invalid="ignore"):
        return np.where(known, logarithm, 0).sum(axis=0) / known.sum(axis=0)


def settle(sample: Observations, material: Material, rounds: int) -> Material:
    """The sample's material by expectation and maximisation, from a first one."""
    for _ in range(rounds):
        found = fit(sample, material).astype(np.float64)
        cost = found[:, map_report.FOUND_COST]
        known = np.isfinite(cost)
        if not known.any():
            return material
        kept = known & (cost <= _TRIM_AT * np.median(cost[known]))
        mean, covariance = _maximise(found[kept], material.mean)
        misfit = _misfit(sample, found, kept, material)
        material = replace(material, mean=mean, covariance=covariance, misfit=misfit)
    return material


def spread(observations: Observations, count: int) -> Observations:
    """About so many of the pixels that have enough light to say something, evenly spread.

    Those whose LEDs stand alike are together, since they share the starts of their fits.
    """
    with np.errstate(invalid="ignore"):
        lit = (observations.usable & (observations.intensity > 3 * observations.noise)).sum(axis=0)
    pixels = np.flatnonzero(lit > _FITTED)
    pixels = pixels[:: max(1, len(pixels) // count)]
    pixels = pixels[_alike_together(observations.lights[:, pixels].mean(axis=0))]
    return Observations(
        observations.intensity[:, pixels],
        observations.lights[:, pixels],
        observations.views[pixels],
        observations.usable[:, pixels],
        observations.noise[:, pixels],
    )


def _alike_together(direction: np.ndarray) -> np.ndarray:
    """An order (n,) of directions (n, 3): in strips along theta, by z in each of them."""
    n = len(direction)
    strips = max(1, round(np.sqrt(n / _STRIP_PX)))
    strip = np.empty(n, int)
    strip[np.argsort(direction[:, 1], kind="stable")] = np.arange(n) * strips // max(n, 1)
    return np.lexsort((direction[:, 2], strip))


def search(sample: Observations, squarings: int = BLINN_PHONG) -> Material:
    """The material of this lobe that all pixels together fit best, by trying them all."""
    best, least = None, np.inf
    for alpha in _SEARCH_ALPHA:
        for ratio in _SEARCH_RATIO:
            usual, width = np.log([alpha, ratio]), _SEARCH_STD**2 * np.eye(2)
            trial = Material(usual, width, _SEARCH_MISFIT, squarings)
            cost = fit(sample, trial)[:, map_report.FOUND_COST]
            cost = cost[np.isfinite(cost)]
            # The logarithm: a material that fits most pixels wins, whatever the others are.
            total = (
                float(np.mean(np.log(cost + _LEAST_MISFIT), dtype=np.float64)) if len(cost) else 0.0
            )
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


def _misfit(sample: Observations, found: np.ndarray, kept: np.ndarray, material: Material) -> float:
    """What the model leaves beyond the sensor's noise, as `Material` defines it."""
    light = np.where(sample.usable, sample.intensity, np.nan)[:, kept].astype(np.float64)
    used = np.isfinite(light).sum(axis=0)
    scale = np.sqrt(0.5 * (light**2 + np.nanmax(light, axis=0) ** 2))
    error = (light - rerender(sample, found, material)[:, kept]) / scale
    error *= np.sqrt(used / np.maximum(used - _FITTED, 1))
    own = sample.noise[:, kept] / scale
    good = np.isfinite(error)
    spread = np.percentile(np.abs(error[good]), _TAIL) / _TAIL_SIGMA
    return max(float(np.sqrt(max(spread**2 - np.median(own[good] ** 2), 0.0))), _LEAST_MISFIT)


def rerender(observations: Observations, found: np.ndarray, material: Material) -> np.ndarray:
    """What the model shows of the kernel's results, (n_leds, n)."""
    found = np.asarray(found, np.float64)
    normal = found[:, map_report.NORMAL_X : map_report.NORMAL_Z + 1]
    k_d, k_s, alpha = found[:, map_report.FOUND_K_D : map_report.FOUND_ALPHA + 1].T
    half = observations.lights + observations.views
    half = half / np.linalg.norm(half, axis=-1, keepdims=True)
    cos_l = np.einsum("mni,ni->mn", observations.lights, normal)
    cos_h = np.clip(np.einsum("mni,ni->mn", half, normal), 1e-6, 1)
    shown = k_d * cos_l + k_s * _lobe(cos_h, alpha, material.squarings)
    return np.where(cos_l > 0, shown, np.where(np.isnan(cos_l), np.nan, 0))


def _lobe(cos_h: np.ndarray, alpha: np.ndarray, squarings: int) -> np.ndarray:
    if squarings == BLINN_PHONG:
        return cos_h**alpha
    gamma = 2.0**squarings
    return (1 - alpha * np.log(cos_h) / gamma) ** -gamma
