"""Algorithm 4: exact where the model is, and what it says where it is not."""

import dataclasses
import math

import numpy as np
import pytest

from treadlight import threads
from treadlight.photometric import sps
from treadlight.photometric.observations import FEW_LEDS, POOR_FIT
from treadlight.photometric.sps import DISSERTATION_MISFIT, typical_misfit


@pytest.mark.parametrize("alpha", [4, 15, 40, 120])
def test_noise_free_gloss_gives_normal_and_alpha(analytic, rng, alpha):
    """Without diffuse light: the normal to 0.02 degree, alpha and k_s to 1 %."""
    normals, lights = analytic.tilted(rng, 400), analytic.two_rings()
    found = sps(analytic.observe(analytic.blinn_phong(normals, lights, 0, 0.4, alpha), lights))
    assert np.max(analytic.degrees_between(found.normal, normals)) < 0.02
    assert np.max(np.abs(found.alpha / alpha - 1)) < 0.01
    assert np.max(np.abs(found.k_s / 0.4 - 1)) < 0.01
    assert np.max(found.k_d) < 1e-4
    assert np.nanmax(found.residual) < 0.01


def test_refinement_takes_the_diffuse_light_out(analytic, rng):
    """k_d / k_s = 0.05: many refinements find the model; none leave an error ten times as large."""
    normals, lights = analytic.tilted(rng, 400, 0.1), analytic.two_rings()
    observations = analytic.observe(analytic.blinn_phong(normals, lights, 0.02, 0.4, 60), lights)
    refined = sps(observations, max_refinements=100)
    assert np.max(analytic.degrees_between(refined.normal, normals)) < 0.02
    assert np.max(np.abs(refined.alpha / 60 - 1)) < 0.01
    assert np.max(np.abs(refined.k_d - 0.02)) < 1e-3
    raw = sps(observations, max_refinements=0)
    error = analytic.degrees_between(raw.normal, normals)
    assert np.mean(error) > 10 * np.mean(analytic.degrees_between(refined.normal, normals))


def numpy_algorithm_4(intensity, lights, refinements):
    """The dissertation's steps, with every alpha of a fine grid tried at every pass."""
    halves = lights + np.array([1.0, 0, 0])
    halves /= np.linalg.norm(halves, axis=1, keepdims=True)
    result = np.empty((intensity.shape[1], 4))
    for k, light in enumerate(intensity.T):
        k_d, facing = 0.0, np.ones(len(light))
        for _ in range(refinements + 1):
            gloss = np.where(facing > 0, np.maximum(light - k_d * facing, 0), 0)
            weight = gloss / gloss.max()
            best = np.inf
            inverse = np.linalg.pinv(weight[:, None] * halves)
            for alpha in np.geomspace(1, 1024, 3000):
                power = weight * np.maximum(weight, 1e-12) ** (1 / alpha)
                n = inverse @ power
                cost = np.sum((power - weight * (halves @ n)) ** 2)
                if cost < best:
                    best, best_n, best_alpha = cost, n, alpha
            length = np.linalg.norm(best_n)
            normal = best_n / length
            k_s = gloss.max() * length**best_alpha
            facing, height = lights @ normal, halves @ normal
            darkest = np.argmin(np.where(facing > 0.1, height, np.inf))
            left = light[darkest] - k_s * height[darkest] ** best_alpha
            k_d = max(0.0, left / facing[darkest])
        result[k] = *normal, best_alpha
    return result


@pytest.mark.parametrize("refinements", [0, 2])
def test_the_kernel_does_what_the_printed_steps_do(analytic, rng, refinements):
    """Noisy pixels: normals to 0.01 degree and alpha to 1 % of the exhaustive search."""
    normals, lights = analytic.tilted(rng, 12), analytic.two_rings()
    intensity = analytic.blinn_phong(normals, lights, 0.01, 0.4, 25)
    intensity = intensity * (1 + 0.02 * rng.standard_normal(intensity.shape))
    found = sps(analytic.observe(intensity, lights), max_refinements=refinements)
    expected = numpy_algorithm_4(intensity, lights, refinements)
    assert np.max(analytic.degrees_between(found.normal, expected[:, :3])) < 0.01
    np.testing.assert_allclose(found.alpha, expected[:, 3], rtol=0.01)


def test_the_unit_of_light_does_not_matter(analytic, rng):
    normals, lights = analytic.tilted(rng, 200), analytic.two_rings()
    intensity = analytic.blinn_phong(normals, lights, 0.01, 0.4, 25)
    intensity = intensity * (1 + 0.02 * rng.standard_normal(intensity.shape))
    one = sps(analytic.observe(intensity, lights))
    other = sps(analytic.observe(1e4 * intensity, lights))
    assert np.max(analytic.degrees_between(one.normal, other.normal)) < 0.01
    np.testing.assert_allclose(other.k_s, 1e4 * one.k_s, rtol=0.01)


@pytest.mark.parametrize("wrong", [0.0, np.nan, 5.0], ids=["shadowed", "saturated", "glare"])
def test_an_led_that_is_not_usable_has_no_say(analytic, rng, wrong):
    normals, lights = analytic.tilted(rng, 200), analytic.two_rings()
    intensity = analytic.blinn_phong(normals, lights, 0, 0.4, 30)
    usable = np.ones(intensity.shape, bool)
    for pixel in range(200):
        usable[rng.choice(16, 3, replace=False), pixel] = False
    intensity[~usable] = wrong
    found = sps(analytic.observe(intensity, lights, usable))
    assert np.max(analytic.degrees_between(found.normal, normals)) < 0.02
    assert set(found.leds_used) == {13}


def test_four_usable_leds_give_a_normal_and_three_give_none(analytic, rng):
    normals, lights = analytic.tilted(rng, 50, 0.1), analytic.two_rings()
    intensity = analytic.blinn_phong(normals, lights, 0, 0.4, 30)
    usable = np.zeros(intensity.shape, bool)
    usable[[0, 3, 6, 12]] = True
    four = sps(analytic.observe(intensity, lights, usable))
    assert np.median(analytic.degrees_between(four.normal, normals)) < 0.05
    assert not four.flags.any()
    usable[12] = False
    three = sps(analytic.observe(intensity, lights, usable))
    assert np.isnan(three.normal).all()
    assert np.isnan(three.covariance).all()
    assert (three.leds_used == 3).all()
    assert (three.flags == FEW_LEDS).all()


@pytest.mark.parametrize("level", [0.0, -0.01])
def test_a_black_pixel_has_no_normal(analytic, level):
    lights = analytic.two_rings()
    found = sps(analytic.observe(np.full((16, 5), level), lights))
    assert np.isnan(found.normal).all()
    assert np.isnan(found.k_s).all()
    assert (found.flags == POOR_FIT).all()


def test_a_normal_that_faces_away_from_the_camera_is_none(analytic, rng):
    lights = analytic.two_rings()
    observations = analytic.observe(analytic.blinn_phong(np.eye(3)[:1], lights, 0, 0.4, 30), lights)
    # Seen from behind, with the halfway vectors unchanged.
    behind = dataclasses.replace(
        observations, views=-observations.views, lights=observations.lights + np.float32([2, 0, 0])
    )
    found = sps(behind)
    assert np.isnan(found.normal).all()
    assert (found.flags == POOR_FIT).all()


def test_an_led_behind_the_surface_is_left_out(analytic):
    """A facet tilted by 60 degrees: the LEDs that its own horizon hides are not used."""
    lights = analytic.two_rings()
    tilt = math.radians(60)
    normals = np.array([[math.cos(tilt), math.sin(tilt), 0]])
    intensity = analytic.blinn_phong(normals, lights, 0, 0.4, 10)
    found = sps(analytic.observe(intensity, lights))
    assert found.leds_used[0] == np.sum(lights @ normals[0] > 0) < 16
    assert analytic.degrees_between(found.normal, normals)[0] < 0.02


def test_more_than_sixteen_leds_are_all_used(analytic, rng):
    normals, lights = analytic.tilted(rng, 20), analytic.two_rings((15, 25, 35))
    found = sps(analytic.observe(analytic.blinn_phong(normals, lights, 0, 0.4, 30), lights))
    assert (found.leds_used == 24).all()
    assert np.max(analytic.degrees_between(found.normal, normals)) < 0.02


def test_the_covariance_is_that_of_repeated_trials(analytic, rng):
    """3 % noise: predicted and observed standard deviations agree within a quarter."""
    lights = analytic.two_rings()
    normal = np.array([[math.cos(0.1), math.sin(0.1), 0.0]])
    clean = np.repeat(analytic.blinn_phong(normal, lights, 0.01, 0.4, 25), 3000, axis=1)
    noisy = clean * (1 + 0.03 * rng.standard_normal(clean.shape))
    found = sps(analytic.observe(noisy, lights))
    seen = np.cov(found.normal[:, 1:].T)
    told = np.median(found.covariance, axis=0)
    assert math.sqrt(told[3] / seen[0, 0]) == pytest.approx(1, abs=0.25)
    assert math.sqrt(told[5] / seen[1, 1]) == pytest.approx(1, abs=0.25)


def test_fewer_leds_are_less_certain(analytic, rng):
    normals, lights = analytic.tilted(rng, 300, 0.1), analytic.two_rings()
    intensity = analytic.blinn_phong(normals, lights, 0.01, 0.4, 25)
    intensity = intensity * (1 + 0.03 * rng.standard_normal(intensity.shape))
    usable = np.ones(intensity.shape, bool)
    usable[::3] = False
    every = sps(analytic.observe(intensity, lights), misfit=0.03)
    some = sps(analytic.observe(intensity, lights, usable), misfit=0.03)
    for entry in (3, 5):
        assert np.median(some.covariance[:, entry]) > 1.2 * np.median(every.covariance[:, entry])


def test_the_misfit_is_learned_from_the_region(analytic, rng):
    normals, lights = analytic.tilted(rng, 2000, 0.1), analytic.two_rings()
    clean = analytic.blinn_phong(normals, lights, 0, 0.4, 15)
    noisy = clean * (1 + 0.05 * rng.standard_normal(clean.shape))
    assert typical_misfit(analytic.observe(noisy, lights)) == pytest.approx(0.05, rel=0.2)
    assert typical_misfit(analytic.observe(noisy[:5], lights[:5])) == DISSERTATION_MISFIT


def test_the_number_of_cores_changes_no_bit(analytic, rng):
    normals, lights = analytic.tilted(rng, 2000, 0.1), analytic.two_rings()
    clean = analytic.blinn_phong(normals, lights, 0.01, 0.4, 15)
    observations = analytic.observe(clean * (1 + 0.05 * rng.standard_normal(clean.shape)), lights)
    before = threads.cores()
    found = []
    try:
        for count in (1, 2):
            threads.use_cores(count)
            found.append(sps(observations))
    finally:
        threads.use_cores(before)
    for name in ("normal", "alpha", "k_d", "covariance"):
        np.testing.assert_array_equal(getattr(found[0], name), getattr(found[1], name))


def test_algorithm_2_does_what_the_printed_steps_do(analytic, rng):
    """Every LED weighs the same (eqs. 5.14 to 5.17), with every alpha of a fine grid tried.

    Roots are all near 1 and differ by little: single precision shows, to 0.02 degree.
    """
    normals, lights = analytic.tilted(rng, 12), analytic.two_rings()
    intensity = analytic.blinn_phong(normals, lights, 0.01, 0.4, 25)
    intensity = intensity * (1 + 0.02 * rng.standard_normal(intensity.shape))
    found = sps(analytic.observe(intensity, lights), algorithm=2)
    halves = lights + np.array([1.0, 0, 0])
    halves /= np.linalg.norm(halves, axis=1, keepdims=True)
    for k, light in enumerate((intensity / intensity.max(axis=0)).T):
        trials = np.geomspace(1, 1024, 3000)
        roots = light[:, None] ** (1 / trials)
        solutions = np.linalg.pinv(halves) @ roots
        best = int(np.argmin(np.sum((roots - halves @ solutions) ** 2, axis=0)))
        length = np.linalg.norm(solutions[:, best])
        assert analytic.degrees_between(found.normal[k], solutions[:, best] / length) < 0.02
        assert found.alpha[k] == pytest.approx(trials[best], rel=0.01)
        strength = intensity[:, k].max() * length ** trials[best]
        assert found.k_s[k] == pytest.approx(strength, rel=0.02)
        assert found.k_d[k] == 0


def test_algorithm_3_is_algorithm_4_before_its_refinements(analytic, rng):
    """The same normal and lobe, but all light is gloss."""
    normals, lights = analytic.tilted(rng, 100), analytic.two_rings()
    observations = analytic.observe(analytic.blinn_phong(normals, lights, 0.02, 0.4, 25), lights)
    third = sps(observations, algorithm=3)
    first_pass = sps(observations, max_refinements=0)
    np.testing.assert_array_equal(third.normal, first_pass.normal)
    np.testing.assert_array_equal(third.alpha, first_pass.alpha)
    assert (third.k_d == 0).all()
    assert (first_pass.k_d > 0).all()


@pytest.mark.parametrize("algorithm", [2, 3])
def test_the_covariance_of_the_unrefined_algorithms_is_that_of_repeated_trials(
    analytic, rng, algorithm
):
    lights = analytic.two_rings()
    normal = np.array([[math.cos(0.1), math.sin(0.1), 0.0]])
    clean = np.repeat(analytic.blinn_phong(normal, lights, 0, 0.4, 15), 3000, axis=1)
    noisy = clean * (1 + 0.03 * rng.standard_normal(clean.shape))
    found = sps(analytic.observe(noisy, lights), algorithm=algorithm)
    seen = np.cov(found.normal[:, 1:].T)
    told = np.median(found.covariance, axis=0)
    assert math.sqrt(told[3] / seen[0, 0]) == pytest.approx(1, abs=0.25)
    assert math.sqrt(told[5] / seen[1, 1]) == pytest.approx(1, abs=0.25)
