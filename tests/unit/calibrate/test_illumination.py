"""Radiant intensity maps from a card."""

import numpy as np
import pytest

from treadlight.calibrate.illumination import (
    CardFrame,
    PlaneSamples,
    fit_smooth_map,
    map_step,
    plane_samples,
    relative_intensities,
)
from treadlight.errors import CalibrationError


def card_frame(bench, led, albedo=0.18):
    image = bench.card(led, albedo)
    return CardFrame(led, image, image >= 1.0)


def true_radiant_intensity(bench, led, pixels):
    points = bench.reference_plane.intersect(bench.camera.rays(pixels))
    to_led = bench.leds[led] - points
    distance = np.linalg.norm(to_led, axis=1)
    cosine = to_led @ bench.reference_plane.normal / distance
    return bench.radiance_of_plane(points, led) * distance**2 / cosine


def test_map_follows_the_beam_without_bias(bench):
    samples = plane_samples(
        card_frame(bench, 0), bench.leds[0], bench.reference_plane, bench.camera, 0.18
    )
    fit = fit_smooth_map(samples)
    pixels = np.array([[20.0, 20.0], [120.0, 160.0], [215.0, 300.0], [30.0, 290.0]])
    ratio = fit(pixels) / true_radiant_intensity(bench, 0, pixels)
    assert np.abs(ratio - 1).max() < 0.01
    assert abs(np.mean(ratio) - 1) < 0.004
    assert fit.residual < 0.01


def test_card_that_covers_a_part_and_is_dirty_gives_the_same_map(bench):
    whole = card_frame(bench, 1)
    image = whole.intensity.copy()
    image[:, :60] = 0.001
    image[100:130, 120:150] *= 0.7
    part = CardFrame(1, image, whole.saturated)
    args = (bench.leds[1], bench.reference_plane, bench.camera, 0.18)
    a, b = (fit_smooth_map(plane_samples(frame, *args)) for frame in (whole, part))
    pixels = np.array([[100.0, 50.0], [135.0, 115.0], [200.0, 250.0]])
    assert b(pixels) == pytest.approx(a(pixels), rel=0.01)
    # Where there was no card the map holds its border's value.
    assert b(np.array([[0.0, 160.0]])) == pytest.approx(b(np.array([[b.low[0], 160.0]])))


def test_saturated_blocks_are_left_out(bench):
    frame = card_frame(bench, 0)
    clipped = frame.saturated.copy()
    clipped[:, 120:] = True
    args = (bench.leds[0], bench.reference_plane, bench.camera, 0.18)
    samples = plane_samples(CardFrame(0, frame.intensity, clipped), *args)
    assert samples.pixels[:, 0].max() < 120
    dark = CardFrame(0, frame.intensity, np.ones_like(clipped))
    with pytest.raises(CalibrationError, match="0 blocks"):
        fit_smooth_map(plane_samples(dark, *args))


def test_relative_intensities_have_mean_one_and_survive_an_empty_led(bench):
    samples = [
        plane_samples(card_frame(bench, k), bench.leds[k], bench.reference_plane, bench.camera, 1.0)
        for k in range(3)
    ]
    found = relative_intensities(samples)
    assert found.mean() == pytest.approx(1)
    width, height = bench.size_px
    pixels = np.mgrid[5:width:10, 5:height:10].reshape(2, -1).T.astype(float)
    true = [np.median(true_radiant_intensity(bench, k, pixels)) for k in range(3)]
    assert found / found[2] == pytest.approx(np.array(true) / true[2], rel=0.01)
    empty = PlaneSamples(np.empty((0, 2)), np.empty(0))
    assert relative_intensities([samples[0], empty])[1] == pytest.approx(1)
    assert list(relative_intensities([empty, empty])) == [1, 1]


def test_large_images_get_coarser_maps():
    assert map_step((512, 768)) == 1
    assert map_step((5120, 7680)) == 7
