"""The default estimator: one material learned from the region, normals where no lobe is seen."""

from dataclasses import replace

import numpy as np
import pytest

from treadlight import threads
from treadlight.photometric import map_normals, sps
from treadlight.photometric.material import (
    BLINN_PHONG,
    fit,
    learn_material,
    rerender,
    spread,
)
from treadlight.photometric.observations import Observations


def hemisphere(analytic, count=2500, widest=60.0):
    """Normals all over a hemisphere within an angle of the view, (n, 3)."""
    side = int(np.sqrt(count))
    x, y = np.meshgrid(np.linspace(-1, 1, side), np.linspace(-1, 1, side))
    inside = np.hypot(x, y) < np.sin(np.radians(widest))
    x, y = x[inside], y[inside]
    return np.stack([np.sqrt(1 - x**2 - y**2), x, y], axis=1)


@pytest.mark.parametrize("ratio", [0.01, 0.1, 1.0, 10.0])
@pytest.mark.parametrize("alpha", [15, 40, 120])
def test_normals_are_found_where_no_led_shows_the_highlight(analytic, alpha, ratio):
    """The rig's rings light lobes up to 17 degrees from the view: far beyond, sps guesses."""
    normals, lights = hemisphere(analytic), analytic.two_rings()
    intensity = analytic.blinn_phong(normals, lights, 0.3 * ratio, 0.3, alpha)
    observations = analytic.observe(np.round(intensity * 65535) / 65535, lights)
    found = analytic.degrees_between(map_normals(observations).normal, normals)
    known = np.isfinite(found)
    # Where no LED lights more than quantisation nothing can be known.
    assert known.mean() > 0.9
    assert np.median(found[known]) < 0.1
    assert np.mean(found[known]) < 1.5
    assert np.nanmean(found) < 0.5 * np.nanmean(
        analytic.degrees_between(sps(observations).normal, normals)
    )


def test_the_material_of_the_region_is_learned(analytic, rng):
    """Its mean, its spread and the noise, from pixels of which none knows all."""
    normals, lights = hemisphere(analytic), analytic.two_rings()
    spread = rng.multivariate_normal([0, 0], [[0.04, 0.01], [0.01, 0.09]], len(normals))
    alpha, ratio = 30 * np.exp(spread[:, 0]), 0.4 * np.exp(spread[:, 1])
    intensity = np.concatenate(
        [
            analytic.blinn_phong(n[None], lights, 0.3 * q, 0.3, a)
            for n, a, q in zip(normals, alpha, ratio, strict=True)
        ],
        axis=1,
    )
    intensity = intensity * (1 + 0.02 * rng.standard_normal(intensity.shape))
    found = learn_material(analytic.observe(intensity, lights))
    np.testing.assert_allclose(found.mean, np.log([30, 0.4]), atol=0.1)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), [0.2, 0.3], rtol=0.35)
    assert 0.005 < found.misfit < 0.03


@pytest.mark.parametrize("gamma", [1, 2, 4])
def test_a_lobe_of_longer_tails_is_learned(analytic, rng, gamma):
    """Trowbridge and Reitz's distribution: its shape, its normals to 0.05 degree without noise."""
    normals, lights = hemisphere(analytic), analytic.two_rings()
    observations = analytic.observe(trowbridge_reitz(normals, lights, gamma), lights)
    material = learn_material(observations)
    assert 2**material.squarings == gamma
    found = map_normals(observations, material=material)
    assert np.median(analytic.degrees_between(found.normal, normals)) < 0.05
    assert np.median(np.abs(found.alpha / 40 - 1)) < 0.01
    assert np.median(found.residual) < 1e-3


def trowbridge_reitz(normals, lights, gamma):
    halves = lights + np.array([1.0, 0, 0])
    halves /= np.linalg.norm(halves, axis=1, keepdims=True)
    facing, height = lights @ normals.T, np.clip(halves @ normals.T, 1e-3, 1)
    gloss = (1 - 40 * np.log(height) / gamma) ** -gamma
    return np.where(facing > 0, 0.03 * facing + 0.3 * gloss, 0)


def test_noise_makes_no_tails(analytic, rng):
    """Blinn and Phong's lobe is kept unless others predict clearly better."""
    normals, lights = hemisphere(analytic), analytic.two_rings()
    intensity = analytic.blinn_phong(normals, lights, 0.03, 0.3, 40)
    intensity *= 1 + 0.05 * rng.standard_normal(intensity.shape)
    assert learn_material(analytic.observe(intensity, lights)).squarings == BLINN_PHONG


def test_covariance_tells_the_errors(analytic, rng):
    """The share of tilts within one and two standard deviations; only noise is in the errors."""
    normals, lights = hemisphere(analytic, widest=40.0), analytic.two_rings()
    clean = analytic.blinn_phong(normals, lights, 0.1, 0.3, 30)
    noise = 0.03 * np.sqrt(0.5 * (clean**2 + clean.max(axis=0) ** 2))
    found = map_normals(analytic.observe(clean + noise * rng.standard_normal(clean.shape), lights))
    axis = np.array([0.0, 1.0, 0.0])
    across = axis - normals[:, :1] * normals
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    upper = np.zeros((len(normals), 3, 3))
    upper[:, *np.triu_indices(3)] = found.covariance
    full = upper + np.triu(upper, 1).transpose(0, 2, 1)
    std = np.sqrt(np.einsum("ni,nij,nj->n", across, full, across))
    ratio = np.abs(np.sum((found.normal - normals) * across, axis=1)) / std
    assert np.mean(ratio < 1) == pytest.approx(0.683, abs=0.12)
    assert np.mean(ratio < 2) == pytest.approx(0.954, abs=0.06)


def test_a_shadow_that_nobody_knew_of_counts_little(analytic, rng):
    normals, lights = analytic.tilted(rng, 400, 0.3), analytic.two_rings()
    intensity = analytic.blinn_phong(normals, lights, 0.1, 0.3, 20)
    intensity[rng.integers(16, size=400), np.arange(400)] = 0.0
    found = map_normals(analytic.observe(intensity, lights))
    error = analytic.degrees_between(found.normal, normals)
    assert np.median(error) < 0.3
    assert np.percentile(error, 95) < 3


@pytest.mark.parametrize("dark", [slice(0), slice(0, None, 8), slice(0, 90)])
def test_a_pixel_does_not_depend_on_its_neighbours(analytic, rng, dark):
    """Nor on how many are solved at a time, or on neighbours without light; given the material."""
    normals, lights = analytic.tilted(rng, 150, 0.3), analytic.two_rings()
    intensity = analytic.blinn_phong(normals, lights, 0.1, 0.3, 20)
    intensity *= 1 + 0.02 * rng.standard_normal(intensity.shape)
    material = learn_material(analytic.observe(intensity, lights))
    usable = np.ones(intensity.shape, bool)
    usable[:, dark] = False
    whole = analytic.observe(intensity, lights, usable)
    some = slice(37, 101)
    part = Observations(
        whole.intensity[:, some],
        whole.lights[:, some],
        whole.views[some],
        whole.usable[:, some],
        whole.noise[:, some],
    )
    together = map_normals(whole, material=material).normal[some]
    np.testing.assert_array_equal(map_normals(part, material=material).normal, together)


def test_a_start_that_explains_a_pixel_is_enough(analytic, rng):
    """Where no other start is tried, all of them would have led to the same normal."""
    normals, lights = analytic.tilted(rng, 1500, 0.3), analytic.two_rings()
    intensity = analytic.blinn_phong(normals, lights, 0.1, 0.3, 20)
    intensity *= 1 + 0.02 * rng.standard_normal(intensity.shape)
    # A few pixels that no start explains.
    intensity[::3, ::50] *= 4.0
    seen = analytic.observe(intensity, lights)
    material = learn_material(seen)
    one, many = (fit(seen, material, enough)[:, :3] for enough in (3.0, 0.0))
    assert np.mean(analytic.degrees_between(one, many) < 0.1) > 0.995


def waves(analytic, rng, height, width):
    """Normals of an image (height, width, 3) that shows waves, with steps between some of them."""
    v, u = np.mgrid[:height, :width]
    slope = 0.3 * np.sin(u / 17) + np.where(u // 40 % 2 == 1, 0.25, 0.0)
    other = 0.3 * np.cos(v / 13) - np.where(v // 25 % 2 == 1, 0.2, 0.0)
    x, y = 0.6 * slope, 0.6 * other
    return np.stack([np.sqrt(1 - x**2 - y**2), x, y], axis=-1)


def an_image(analytic, rng, height=96, width=150):
    """What waves show with 2 % of noise, some pixels of it dark, and a material learned from it."""
    normals = waves(analytic, rng, height, width).reshape(-1, 3)
    lights = analytic.two_rings()
    intensity = analytic.blinn_phong(normals, lights, 0.1, 0.3, 20)
    intensity *= 1 + 0.02 * rng.standard_normal(intensity.shape)
    usable = np.ones(intensity.shape, bool)
    usable[:, rng.random(len(normals)) < 0.02] = False
    usable[:, 30 * width + 20 : 34 * width + 40] = False
    seen = analytic.observe(intensity, lights, usable)
    return normals, seen, learn_material(seen)


@pytest.mark.parametrize("width", [40, 150, 1500])
def test_pixels_that_start_above_end_where_others_do(analytic, rng, width):
    """To some hundredths of what noise does to them: from above, from all starts, it is one fit."""
    normals, seen, material = an_image(analytic, rng)
    alone, above = (map_normals(seen, material=material, width=w) for w in (None, width))
    np.testing.assert_array_equal(np.isfinite(above.normal), np.isfinite(alone.normal))
    np.testing.assert_array_equal(above.leds_used, alone.leds_used)
    known = np.isfinite(alone.normal[:, 0])
    assert 0.9 < known.mean() < 1.0
    apart = np.radians(analytic.degrees_between(above.normal[known], alone.normal[known]))
    std = np.sqrt(alone.covariance[known][:, [0, 3, 5]].sum(axis=1))
    assert np.quantile(apart / std, 0.995) < 0.05
    error = analytic.degrees_between(above.normal[known], normals[known])
    assert np.quantile(error, 0.99) < 3.0


def test_a_pixel_above_that_is_in_the_wrong_lobe_misleads_none(analytic, rng):
    """Rows that another thing hides, of other normals and light, are no start for what follows."""
    height, width = 90, 128
    normals = waves(analytic, rng, height, width)
    normals[20:24] = [0.5, np.sqrt(0.75), 0.0]
    normals = normals.reshape(-1, 3)
    lights = analytic.two_rings()
    intensity = analytic.blinn_phong(normals, lights, 0.1, 0.3, 20)
    intensity *= 1 + 0.02 * rng.standard_normal(intensity.shape)
    # What hides them shines of itself under half of the LEDs.
    intensity[::2, 20 * width : 24 * width] += 3.0
    seen = analytic.observe(intensity, lights)
    material = learn_material(seen)
    found = map_normals(seen, material=material, width=width).normal
    error = analytic.degrees_between(found, normals).reshape(height, width)
    assert np.mean(error[20:24] > 5.0) > 0.5
    assert np.mean(error[24:] < 3.0) > 0.99


def test_an_image_is_fitted_the_same_by_any_number_of_cores(analytic, rng, monkeypatch):
    """Bands of its rows are shared among them, whatever their number."""
    _, seen, material = an_image(analytic, rng)
    found = []
    for cores in (1, 2, 3):
        monkeypatch.setattr(threads, "_allowed", cores)
        found.append(fit(seen, material, 3.0, 150))
    np.testing.assert_array_equal(found[0], found[1])
    np.testing.assert_array_equal(found[0], found[2])


def test_rerendering_is_what_the_residual_says(analytic, rng):
    normals, lights = analytic.tilted(rng, 100, 0.3), analytic.two_rings()
    intensity = analytic.blinn_phong(normals, lights, 0.1, 0.3, 20)
    intensity *= 1 + 0.05 * rng.standard_normal(intensity.shape)
    observations = analytic.observe(intensity, lights)
    material = learn_material(observations)
    shown = rerender(observations, fit(observations, material), material)
    expected = np.mean(np.abs(shown - intensity) / intensity, axis=0)
    residual = map_normals(observations, material=material).residual
    np.testing.assert_allclose(residual, expected, rtol=1e-3)


def test_pixels_whose_leds_stand_anywhere_have_starts_of_their_own(analytic, rng):
    """A block's dictionary serves only those whose LEDs stand alike."""
    normals, rings = hemisphere(analytic, 900, widest=50.0), analytic.two_rings()
    turns = np.radians(rng.uniform(0, 360, len(normals)))
    c, s = np.cos(turns), np.sin(turns)
    zero, one = np.zeros_like(c), np.ones_like(c)
    turn = np.array([[one, zero, zero], [zero, c, -s], [zero, s, c]])
    turned = np.einsum("ijn,mj->mni", turn, rings)
    seen = np.einsum("ijn,ni->nj", turn, normals)
    observations = analytic.observe(analytic.blinn_phong(seen, rings, 0.03, 0.3, 40), rings)
    observations = replace(observations, lights=turned.astype(np.float32))
    found = analytic.degrees_between(map_normals(observations).normal, normals)
    assert np.nanmean(found > 1.0) < 0.01


def test_a_sample_has_pixels_whose_leds_stand_alike_together(rng):
    count, leds = 4096, 5
    lights = np.ones((leds, count, 3), np.float32)
    lights[..., 1:] = rng.uniform(-0.5, 0.5, (count, 2))
    observations = Observations(
        intensity=np.tile(1 + np.arange(count, dtype=np.float32), (leds + 1, 1)),
        lights=np.concatenate([lights, lights[:1]]),
        views=np.ones((count, 3), np.float32),
        usable=np.ones((leds + 1, count), bool),
        noise=np.full((leds + 1, count), 1e-3, np.float32),
    )
    sample = spread(observations, count)
    pixels = sample.intensity[0].astype(int) - 1
    assert sorted(pixels) == list(range(count))
    np.testing.assert_array_equal(sample.lights[0], lights[0, pixels])
    blocks = sample.lights[0, :, 1:].reshape(-1, 32, 2)
    # Of 128 blocks each takes its share of the square, not all of it.
    assert np.median(np.ptp(blocks, axis=1).max(axis=1)) < 0.2
