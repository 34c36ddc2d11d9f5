"""Beams and vignetting from samples of a card: exact sources, seen through an exact lens."""

import numpy as np
import pytest

from treadlight.calibrate.beams import (
    Beam,
    fit_correction,
    radiant_intensity_maps,
    solve_beams,
)
from treadlight.calibrate.illumination import PlaneSamples
from treadlight.errors import CalibrationError
from treadlight.geometry import Led, Plane, Vignetting

POWERS = (1.0, 1.25, 3.0, 8.0, 1.0, 20.0)


def natural(rays):
    """cos^4 of the angle off the optical axis, and a fifth less in the corner."""
    q = rays[:, 0] ** 2 + rays[:, 1] ** 2
    return (1 + q) ** -2 * (1 - 5 * q)


def aimed(bench, rng):
    """Beams that miss the middle of the scene by some 5 degrees."""
    axes = np.array([0, 0, 800.0]) + rng.normal(0, 40, (6, 3)) - bench.leds
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    strength = 1e5 * bench.led_power
    return [Beam(*one) for one in zip(strength, axes, POWERS, strict=True)]


def samples_of(bench, beams, leds, lens, rng, noise=0.002):
    width, height = bench.size_px
    pixels = np.mgrid[3:width:7, 3:height:7].reshape(2, -1).T.astype(float)
    rays = bench.camera.rays(pixels)
    points = bench.reference_plane.intersect(rays)
    return [
        PlaneSamples(
            pixels,
            beam(points - led) * lens(rays) * (1 + noise * rng.standard_normal(len(pixels))),
        )
        for beam, led in zip(beams, leds, strict=True)
    ]


def reach(bench):
    width, height = bench.size_px
    rays = bench.camera.rays(np.mgrid[3:width:7, 3:height:7].reshape(2, -1).T.astype(float))
    return rays[np.argmax(rays[:, 0] ** 2 + rays[:, 1] ** 2)][None]


@pytest.mark.parametrize("lens", [natural, lambda rays: np.ones(len(rays))])
def test_lens_and_beams_are_told_apart_without_bias(bench, rng, lens):
    beams = aimed(bench, rng)
    samples = samples_of(bench, beams, bench.leds, lens, rng)
    found = solve_beams(samples, bench.leds, bench.reference_plane, bench.camera)
    corner = reach(bench)
    error = (found.vignetting(corner) - lens(corner)).item()
    assert abs(error) < 0.004
    assert abs(error) < 4 * found.corner_std
    for one, true in zip(found.beams, beams, strict=True):
        assert one.intensity == pytest.approx(true.intensity, rel=0.01)
        assert one.power == pytest.approx(true.power, abs=0.15)
        assert np.degrees(np.arccos(min(one.axis @ true.axis, 1.0))) < 1.5


def test_dirt_on_the_card_changes_nothing(bench, rng):
    beams = aimed(bench, rng)
    samples = samples_of(bench, beams, bench.leds, natural, rng)
    clean = solve_beams(samples, bench.leds, bench.reference_plane, bench.camera)
    dirty = [
        PlaneSamples(s.pixels, np.where(np.arange(len(s.values)) % 17 == 0, 0.6, 1) * s.values)
        for s in samples
    ]
    found = solve_beams(dirty, bench.leds, bench.reference_plane, bench.camera)
    corner = reach(bench)
    assert found.vignetting(corner) == pytest.approx(clean.vignetting(corner), abs=0.003)
    assert [b.intensity for b in found.beams] == pytest.approx(
        [b.intensity for b in clean.beams], rel=0.005
    )


def test_a_lamp_beside_the_camera_leaves_vignetting_in_its_beam(bench, rng):
    """Rings about the optical axis may be the lamp's or the lens's: nobody can tell."""
    plane, position = Plane(np.array([0.0, 0, -1]), 800.0), np.array([[0.0, 0.0, 20.0]])
    beam = Beam(1e5, np.array([0.0, 0, 1]), 2.0)
    samples = samples_of(bench, [beam], position, natural, rng)
    found = solve_beams(samples, position, plane, bench.camera)
    assert found.corner_std == np.inf
    assert found.vignetting(reach(bench)) == pytest.approx(1)
    # cos^4 and the rest of the lens then count as the lamp's.
    assert found.beams[0].power > 5


def test_maps_hold_the_lamps_alone_whatever_their_shape(bench, rng):
    """A lamp that is brighter to one side, seen through a lens: the map has the lamp."""
    beams = aimed(bench, rng)
    samples = samples_of(bench, beams, bench.leds, natural, rng)

    def lopsided(pixels):
        return 1 + 0.1 * np.sin(pixels[:, 0] / 80)

    first = PlaneSamples(samples[0].pixels, samples[0].values * lopsided(samples[0].pixels))
    plane, camera = bench.reference_plane, bench.camera
    found = solve_beams([first, *samples[1:]], bench.leds, plane, camera)
    correction = fit_correction(
        first, found.beams[0], found.vignetting, bench.leds[0], plane, camera
    )
    leds = [Led(4, bench.leds[0], 1.0)]
    maps = radiant_intensity_maps(leds, {4: found.beams[0]}, {4: correction}, plane, camera)
    assert maps.shape == (1, 320, 240)
    pixels = np.array([[20.0, 20.0], [120.0, 160.0], [215.0, 300.0], [30.0, 290.0]])
    points = plane.intersect(camera.rays(pixels))
    true = beams[0](points - bench.leds[0]) * lopsided(pixels)
    u, v = pixels.astype(int).T
    assert maps[0, v, u] == pytest.approx(true, rel=0.01)


def test_led_without_a_card_frame_gets_its_share(bench, rng):
    leds = [Led(k, bench.leds[k], float(bench.led_power[k])) for k in range(2)]
    beams = aimed(bench, rng)[:1]
    samples = samples_of(bench, beams, bench.leds[:1], Vignetting(), rng)
    args = (bench.reference_plane, bench.camera)
    correction = fit_correction(samples[0], beams[0], Vignetting(), bench.leds[0], *args)
    maps = radiant_intensity_maps(leds, {0: beams[0]}, {0: correction}, *args)
    assert maps.dtype == np.float32
    assert np.ptp(maps[1]) == 0
    assert maps[1, 0, 0] / maps[0].mean() == pytest.approx(0.8 / 1.2, rel=1e-4)
    assert (radiant_intensity_maps(leds[:1], {}, {}, *args) == np.float32(1.2)).all()


def test_too_few_samples_are_refused(bench):
    few = PlaneSamples(np.ones((5, 2)), np.ones(5))
    with pytest.raises(CalibrationError, match="only 5 blocks"):
        solve_beams([few], bench.leds[:1], bench.reference_plane, bench.camera)
