"""What every estimator does with an LED that shows nothing of the surface, and with none."""

import numpy as np
import pytest

from treadlight.photometric import METHODS
from treadlight.photometric.observations import FEW_LEDS, MIN_LEDS, POOR_FIT

# Unknowns of the model: a normal and k_d; two more for the lobe.
FEWEST = {"dps": 3, "dps-l1": 3, "nips": 5}
LAMBERTIAN = ("dps", "dps-l1")
# k_d, k_s, alpha of what the method is made for; `nips` needs light that `dps` can start from,
# `map` a ratio k_d / k_s that has a logarithm.
MATERIAL = {
    "map": (0.1, 0.4, 30),
    "dps": (0.3, 0, 1),
    "dps-l1": (0.3, 0, 1),
    "nips": (0.8, 0.4, 20),
}


def pixels(analytic, rng, method):
    """Slightly tilted facets of the material that the method is made for."""
    normals, lights = analytic.tilted(rng, 200, 0.1), analytic.two_rings()
    material = MATERIAL.get(method, (0, 0.4, 30))
    return normals, lights, analytic.blinn_phong(normals, lights, *material), material


@pytest.mark.parametrize("method", METHODS)
def test_noise_free_pixels_are_exact(analytic, rng, method):
    """The normal to 0.02 degree; alpha, k_d and k_s to 1 %."""
    normals, lights, intensity, (k_d, k_s, alpha) = pixels(analytic, rng, method)
    found = METHODS[method](analytic.observe(intensity, lights))
    assert np.max(analytic.degrees_between(found.normal, normals)) < 0.02
    np.testing.assert_allclose(found.k_d, k_d, rtol=0.01, atol=1e-4)
    np.testing.assert_allclose(found.k_s, k_s, rtol=0.01, atol=1e-4)
    if k_s:
        np.testing.assert_allclose(found.alpha, alpha, rtol=0.01)
    assert np.max(found.residual) < 0.01
    assert not found.flags.any()


@pytest.mark.parametrize("wrong", [0.0, np.nan, 5.0], ids=["shadowed", "saturated", "glare"])
@pytest.mark.parametrize("method", METHODS)
def test_an_led_that_is_not_usable_has_no_say(analytic, rng, method, wrong):
    normals, lights, intensity, _ = pixels(analytic, rng, method)
    usable = np.ones(intensity.shape, bool)
    for pixel in range(intensity.shape[1]):
        usable[rng.choice(16, 3, replace=False), pixel] = False
    intensity[~usable] = wrong
    found = METHODS[method](analytic.observe(intensity, lights, usable))
    assert np.max(analytic.degrees_between(found.normal, normals)) < 0.02
    assert set(found.leds_used) == {13}


@pytest.mark.parametrize("method", METHODS)
def test_a_saturated_led_is_never_usable(analytic, rng, method):
    """NaN alone is enough: no mask has to say it again."""
    normals, lights, intensity, _ = pixels(analytic, rng, method)
    intensity[5] = np.nan
    found = METHODS[method](analytic.observe(intensity, lights))
    assert np.max(analytic.degrees_between(found.normal, normals)) < 0.02
    assert set(found.leds_used) == {15}


@pytest.mark.parametrize("method", METHODS)
def test_fewer_leds_than_unknowns_give_no_normal(analytic, rng, method):
    _, lights, intensity, _ = pixels(analytic, rng, method)
    fewest = FEWEST.get(method, MIN_LEDS)
    usable = np.zeros(intensity.shape, bool)
    usable[[0, 3, 6, 9, 12][: fewest - 1]] = True
    found = METHODS[method](analytic.observe(intensity, lights, usable))
    for values in (found.normal, found.k_d, found.k_s, found.alpha, found.residual):
        assert np.isnan(values).all()
    assert np.isnan(found.covariance).all()
    assert (found.leds_used == fewest - 1).all()
    assert (found.flags == FEW_LEDS).all()


@pytest.mark.parametrize("method", METHODS)
def test_three_leds_suffice_for_lambertian_methods_alone(analytic, rng, method):
    normals, lights, intensity, _ = pixels(analytic, rng, method)
    usable = np.zeros(intensity.shape, bool)
    usable[[0, 3, 6]] = True
    found = METHODS[method](analytic.observe(intensity, lights, usable))
    if method in LAMBERTIAN:
        assert np.max(analytic.degrees_between(found.normal, normals)) < 0.02
    else:
        assert np.isnan(found.normal).all()
        assert (found.flags == FEW_LEDS).all()


@pytest.mark.parametrize("level", [0.0, -0.01])
@pytest.mark.parametrize("method", METHODS)
def test_a_black_pixel_has_no_normal(analytic, method, level):
    found = METHODS[method](analytic.observe(np.full((16, 5), level), analytic.two_rings()))
    assert np.isnan(found.normal).all()
    assert np.isnan(found.k_s).all()
    assert np.isnan(found.covariance).all()
    assert (found.flags == POOR_FIT).all()


@pytest.mark.parametrize("method", METHODS)
def test_the_unit_of_light_does_not_matter(analytic, rng, method):
    normals, lights = analytic.tilted(rng, 200), analytic.two_rings()
    intensity = analytic.blinn_phong(normals, lights, 0.02, 0.4, 25)
    intensity = intensity * (1 + 0.02 * rng.standard_normal(intensity.shape))
    one = METHODS[method](analytic.observe(intensity, lights))
    other = METHODS[method](analytic.observe(1e4 * intensity, lights))
    assert np.median(analytic.degrees_between(one.normal, other.normal)) < 0.01
    assert np.mean(analytic.degrees_between(one.normal, other.normal)) < 0.05


@pytest.mark.parametrize("method", METHODS)
def test_no_pixels_give_no_normals(analytic, method):
    found = METHODS[method](analytic.observe(np.zeros((16, 0)), analytic.two_rings()))
    assert found.normal.shape == (0, 3)
    assert found.covariance.shape == (0, 6)
