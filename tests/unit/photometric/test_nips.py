"""The non-linear fit of the full model."""

import math

import numpy as np
import pytest

from treadlight.photometric import nips
from treadlight.photometric.observations import POOR_FIT


def test_gloss_alone_is_found_where_the_lobe_is_wide(analytic, rng):
    """DPS is 20 degrees off there: nine fits of ten end in the true lobe, not all."""
    normals, lights = analytic.tilted(rng, 300, 0.1), analytic.two_rings()
    found = nips(analytic.observe(analytic.blinn_phong(normals, lights, 0, 0.4, 15), lights))
    right = analytic.degrees_between(found.normal, normals) < 0.02
    assert 0.9 < np.mean(right) < 1
    np.testing.assert_allclose(found.alpha[right], 15, rtol=0.01)
    assert np.max(found.k_d[right]) < 1e-3


@pytest.mark.parametrize("alpha", [15, 40, 120])
@pytest.mark.parametrize("ratio", [1.0, 3.0])
def test_noise_free_blinn_phong_is_exact(analytic, rng, alpha, ratio):
    """With diffuse light for DPS to start from: normal to 0.02 degree, alpha, k_d, k_s to 1 %."""
    normals, lights = analytic.tilted(rng, 300, 0.1), analytic.two_rings()
    intensity = analytic.blinn_phong(normals, lights, 0.4 * ratio, 0.4, alpha)
    found = nips(analytic.observe(intensity, lights))
    assert np.max(analytic.degrees_between(found.normal, normals)) < 0.02
    np.testing.assert_allclose(found.alpha, alpha, rtol=0.01)
    np.testing.assert_allclose(found.k_s, 0.4, rtol=0.01)
    np.testing.assert_allclose(found.k_d, 0.4 * ratio, rtol=0.01)
    assert np.max(found.residual) < 1e-3


def test_the_fit_is_scipys(analytic, rng):
    """Noisy pixels: the same minimum as scipy's trust region finds from the truth."""
    from scipy.optimize import least_squares

    normals, lights = analytic.tilted(rng, 20, 0.1), analytic.two_rings()
    intensity = analytic.blinn_phong(normals, lights, 0.4, 0.4, 25)
    intensity = intensity * (1 + 0.02 * rng.standard_normal(intensity.shape))
    found = nips(analytic.observe(intensity, lights))
    for k in range(20):

        def misfit(x, k=k):
            tilted = np.array([[math.sqrt(1 - x[0] ** 2 - x[1] ** 2), x[0], x[1]]])
            model = analytic.blinn_phong(tilted, lights, x[2], x[3], math.exp(x[4]))
            return model[:, 0] - intensity[:, k]

        best = least_squares(misfit, [*normals[k, 1:], 0.4, 0.4, math.log(25)], xtol=1e-12).x
        np.testing.assert_allclose(found.normal[k, 1:], best[:2], atol=2e-4)
        assert found.alpha[k] == pytest.approx(math.exp(best[4]), rel=0.01)


def test_neither_part_is_ever_negative(analytic, rng):
    """Light that no gloss explains drives k_s to its bound, not below."""
    normals, lights = analytic.tilted(rng, 100, 0.1), analytic.two_rings()
    intensity = analytic.blinn_phong(normals, lights, 0.3, -0.05, 20)
    found = nips(analytic.observe(intensity, lights))
    assert np.min(found.k_s) >= 0
    assert np.min(found.k_d) >= 0
    assert np.min(found.alpha) >= 1
    assert np.max(found.alpha) <= 1024 * (1 + 1e-6)


def test_lights_in_one_plane_give_no_normal(analytic):
    angles = np.linspace(-0.5, 0.5, 6)
    lights = np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])
    found = nips(analytic.observe(np.ones((6, 3)), lights))
    assert np.isnan(found.normal).all()
    assert (found.flags == POOR_FIT).all()


def test_the_covariance_is_that_of_repeated_trials(analytic, rng):
    """1 % of the brightest as noise: told and seen standard deviations agree within a fifth."""
    lights = analytic.two_rings()
    normal = np.array([[math.cos(0.1), math.sin(0.1), 0.0]])
    clean = np.repeat(analytic.blinn_phong(normal, lights, 0.4, 0.4, 25), 2000, axis=1)
    found = nips(analytic.observe(clean + 0.004 * rng.standard_normal(clean.shape), lights))
    seen = np.cov(found.normal[:, 1:].T)
    told = np.mean(found.covariance, axis=0)
    assert math.sqrt(told[3] / seen[0, 0]) == pytest.approx(1, abs=0.2)
    assert math.sqrt(told[5] / seen[1, 1]) == pytest.approx(1, abs=0.2)
