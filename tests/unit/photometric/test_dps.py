"""Lambertian least squares."""

import math

import numpy as np
import pytest

from treadlight.photometric import dps, dps_l1
from treadlight.photometric.observations import FEW_LEDS, POOR_FIT


def test_a_lambertian_surface_is_exact(analytic, rng):
    normals, lights = analytic.tilted(rng, 300), analytic.two_rings()
    found = dps(analytic.observe(analytic.blinn_phong(normals, lights, 0.3, 0, 1), lights))
    assert np.max(analytic.degrees_between(found.normal, normals)) < 1e-3
    np.testing.assert_allclose(found.k_d, 0.3, rtol=1e-5)
    assert (found.k_s == 0).all()
    assert np.isnan(found.alpha).all()
    assert np.max(found.residual) < 1e-5
    assert (found.leds_used == 16).all()


def test_three_lights_are_enough_and_two_are_not(analytic, rng):
    normals, lights = analytic.tilted(rng, 20), analytic.two_rings()
    intensity = analytic.blinn_phong(normals, lights, 0.3, 0, 1)
    usable = np.zeros(intensity.shape, bool)
    usable[[0, 3, 6]] = True
    three = dps(analytic.observe(intensity, lights, usable))
    assert np.max(analytic.degrees_between(three.normal, normals)) < 1e-2
    usable[6] = False
    two = dps(analytic.observe(intensity, lights, usable))
    assert np.isnan(two.normal).all()
    assert np.isnan(two.residual).all()
    assert (two.flags == FEW_LEDS).all()


def test_lights_in_one_plane_give_no_normal(analytic):
    angles = np.linspace(-0.5, 0.5, 5)
    lights = np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])
    found = dps(analytic.observe(np.ones((5, 3)), lights))
    assert np.isnan(found.normal).all()
    assert (found.flags == POOR_FIT).all()


def test_the_covariance_is_that_of_repeated_trials(analytic, rng):
    lights = analytic.two_rings()
    clean = np.repeat(analytic.blinn_phong(np.eye(3)[:1], lights, 0.3, 0, 1), 3000, axis=1)
    found = dps(analytic.observe(clean + 0.01 * rng.standard_normal(clean.shape), lights))
    seen = np.cov(found.normal[:, 1:].T)
    told = np.mean(found.covariance, axis=0)
    assert math.sqrt(told[3] / seen[0, 0]) == pytest.approx(1, abs=0.1)
    assert math.sqrt(told[5] / seen[1, 1]) == pytest.approx(1, abs=0.1)


def test_least_absolute_residuals_shrug_off_a_highlight(analytic, rng):
    """Two LEDs of sixteen show gloss: least squares is turned by degrees, the robust form not."""
    normals, lights = analytic.tilted(rng, 300), analytic.two_rings()
    intensity = analytic.blinn_phong(normals, lights, 0.3, 0, 1)
    for pixel in range(300):
        intensity[rng.choice(16, 2, replace=False), pixel] += 0.5
    plain = dps(analytic.observe(intensity, lights))
    robust = dps_l1(analytic.observe(intensity, lights))
    assert np.median(analytic.degrees_between(plain.normal, normals)) > 3
    assert np.max(analytic.degrees_between(robust.normal, normals)) < 0.05
    np.testing.assert_allclose(robust.k_d, 0.3, rtol=1e-3)


def test_least_absolute_residuals_are_least(analytic, rng):
    """No small turn of the found k_d n lowers the sum."""
    normals, lights = analytic.tilted(rng, 50), analytic.two_rings()
    intensity = analytic.blinn_phong(normals, lights, 0.3, 0.1, 20)
    found = dps_l1(analytic.observe(intensity, lights))
    scaled = found.normal.astype(float) * found.k_d[:, None]

    def total(scaled):
        return np.sum(np.abs(intensity - lights @ scaled.T), axis=0)

    least = total(scaled)
    for _ in range(50):
        assert np.all(total(scaled + 0.01 * rng.standard_normal((50, 3))) > least - 1e-4)


def test_the_robust_covariance_is_that_of_repeated_trials(analytic, rng):
    """Few LEDs make an asymptotic formula a rough one: within a third."""
    lights = analytic.two_rings()
    clean = np.repeat(analytic.blinn_phong(np.eye(3)[:1], lights, 0.3, 0, 1), 3000, axis=1)
    found = dps_l1(analytic.observe(clean + 0.01 * rng.standard_normal(clean.shape), lights))
    seen = np.cov(found.normal[:, 1:].T)
    told = np.mean(found.covariance, axis=0)
    assert math.sqrt(told[3] / seen[0, 0]) == pytest.approx(1, abs=0.33)
    assert math.sqrt(told[5] / seen[1, 1]) == pytest.approx(1, abs=0.33)
