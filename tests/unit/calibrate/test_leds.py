"""LEDs from highlights: the mirror law, the joint fit, the balls in rendered images."""

import dataclasses

import cv2
import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.special import erf

from treadlight.calibrate.balls import BallSet, find_balls, find_highlight, outline
from treadlight.calibrate.leds import calibrate_leds, intersect_lines, reflected_lines
from treadlight.errors import CalibrationError
from treadlight.geometry import Camera, Plane
from treadlight.images import LinearFrame


def linear_frames(images):
    return [LinearFrame(image, image >= 1) for image in images]


def mirror_point(centre, radius, led):
    """Where the path camera - sphere - LED is shortest (Fermat)."""

    def point(x):
        normal = np.array([np.sin(x[0]), np.sin(x[1]), 0.0])
        normal[2] = -np.sqrt(1 - normal[:2] @ normal[:2])
        return centre + radius * normal

    def length(x):
        p = point(x)
        return np.linalg.norm(p) + np.linalg.norm(led - p)

    found = minimize(length, [0.0, 0.0], method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 0})
    return point(found.x)


@pytest.fixture
def exact_balls(bench):
    centres, radius = bench.ball_centres, bench.ball_radius
    glints = [[mirror_point(c, radius, led) for led in bench.leds] for c in centres]
    plane = Plane(bench.reference_plane.normal, bench.reference_plane.offset - radius)
    pixels = bench.camera.project(np.array(glints))
    return BallSet(centres, np.full(len(centres), 0.01), pixels, radius, plane)


def test_reflected_lines_pass_through_the_led(bench, exact_balls):
    for led, position in enumerate(bench.leds):
        points, directions = reflected_lines(
            bench.camera, exact_balls.highlights[:, led], exact_balls.centres, bench.ball_radius
        )
        offset = position - points
        distance = np.linalg.norm(np.cross(offset, directions), axis=1)
        assert distance.max() < 0.05


def test_ray_that_misses_the_ball_gives_no_line(bench):
    points, directions = reflected_lines(
        bench.camera, np.array([[5.0, 5.0]]), bench.ball_centres[5:6], bench.ball_radius
    )
    assert np.isnan(points).all()
    assert np.isnan(directions).all()


def test_lines_meet_in_a_point_though_four_of_ten_lead_elsewhere(rng):
    """Also where the four agree with each other, as mirror images of a lamp's reflection do."""
    target, other = np.array([10.0, -20.0, 400.0]), np.array([60.0, 40.0, 420.0])
    directions = rng.normal(size=(10, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = target - 300 * directions + rng.normal(0, 0.01, (10, 3))
    points[6:] += other - target
    assert np.linalg.norm(intersect_lines(points, directions) - target) < 0.1


def test_parallel_lines_have_no_say(rng):
    directions = np.array([[0, 0, 1.0], [0, 0, 1], [0.6, 0, 0.8], [0, 0.6, 0.8]])
    points = np.array([5.0, 6, 7]) - 100 * directions
    assert intersect_lines(points, directions) == pytest.approx([5, 6, 7])


def test_exact_highlights_give_the_exact_leds(bench, exact_balls):
    fits = calibrate_leds(bench.camera, exact_balls, list(range(10, 16))).leds
    assert [fit.number for fit in fits] == list(range(10, 16))
    for fit, position in zip(fits, bench.leds, strict=True):
        assert np.linalg.norm(fit.position - position) < 0.1
        assert fit.distances_mm.max() < 0.1
        assert fit.used.all()
        assert len(fit.used) == len(bench.ball_centres)


def test_joint_fit_mends_balls_that_are_misplaced(bench, exact_balls, rng):
    """Each ball's centre is off by itself; the highlights of all LEDs know by how much."""
    shifts = rng.normal(0, 0.05, (len(exact_balls.centres), 3))
    shifts -= np.outer(shifts @ exact_balls.plane.normal, exact_balls.plane.normal)
    noisy = dataclasses.replace(
        exact_balls,
        centres=exact_balls.centres + shifts,
        centre_std_mm=np.full(len(shifts), 0.05),
        highlights=exact_balls.highlights + rng.normal(0, 0.002, exact_balls.highlights.shape),
    )
    fits = calibrate_leds(bench.camera, noisy, list(range(6))).leds
    joint = np.mean([np.linalg.norm(f.position - p) for f, p in zip(fits, bench.leds, strict=True)])
    single = []
    for led, position in enumerate(bench.leds):
        lines = reflected_lines(
            bench.camera, noisy.highlights[:, led], noisy.centres, bench.ball_radius
        )
        single.append(np.linalg.norm(intersect_lines(*lines) - position))
    assert np.mean(single) > 2
    assert joint < 0.6 * np.mean(single)


def test_highlights_that_disagree_are_rejected_and_reported(bench, exact_balls, rng):
    """Neither wrong glints of a few balls nor a ball off its outline move an LED."""
    wrong = [(0, 1), (3, 1), (7, 1), (5, 4), (2, 0)]
    highlights = exact_balls.highlights + rng.normal(0, 0.002, exact_balls.highlights.shape)
    clean = dataclasses.replace(exact_balls, highlights=highlights.copy())
    undisturbed = calibrate_leds(bench.camera, clean, list(range(6)))
    for ball, led in wrong:
        highlights[ball, led] += rng.choice([-1, 1], 2) * rng.uniform(0.5, 4, 2)
    centres, std = exact_balls.centres.copy(), exact_balls.centre_std_mm.copy()
    centres[9] += [0.4, -0.3, 0.0]
    std[9] = 0.5
    spoilt = dataclasses.replace(
        exact_balls, centres=centres, centre_std_mm=std, highlights=highlights
    )
    fit = calibrate_leds(bench.camera, spoilt, list(range(6)))
    rejected = {(ball, k) for k, led in enumerate(fit.leds) for ball in np.flatnonzero(~led.used)}
    assert rejected == set(wrong)
    assert np.linalg.norm(fit.centres[9] - exact_balls.centres[9]) < 0.02
    for k, (led, without) in enumerate(zip(fit.leds, undisturbed.leds, strict=True)):
        assert np.linalg.norm(led.position - without.position) < 0.8
        assert led.distances_mm[led.used].max() < 0.5
        assert (led.distances_mm[[ball for ball, m in wrong if m == k]] > 5).all()


def test_led_without_highlights_is_left_out_and_none_is_refused(bench, exact_balls):
    highlights = exact_balls.highlights.copy()
    highlights[2:, 3] = np.nan
    partly = dataclasses.replace(exact_balls, highlights=highlights)
    fits = calibrate_leds(bench.camera, partly, list(range(6))).leds
    assert [fit.number for fit in fits] == [0, 1, 2, 4, 5]
    blind = dataclasses.replace(exact_balls, highlights=np.full_like(highlights, np.nan))
    with pytest.raises(CalibrationError, match="no LED shows a highlight"):
        calibrate_leds(bench.camera, blind, list(range(6)))


def test_outline_touches_the_sphere(bench):
    """Rays along the outline pass the centre at exactly one radius."""
    centre = np.array([70.0, -60.0, 790.0])
    rays = bench.camera.rays(outline(bench.camera, centre, 12.0))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    assert np.allclose(np.linalg.norm(np.cross(rays, centre), axis=1), 12.0, atol=1e-6)


def test_rendered_balls_are_found_without_bias(bench, ball_images):
    found = find_balls(
        linear_frames(ball_images),
        bench.camera,
        bench.reference_plane,
        12,
        2 * bench.ball_radius,
        10.0,
    )
    assert len(found.centres) == 12
    seen = bench.camera.project(found.centres)
    true = bench.camera.project(bench.ball_centres)
    nearest = np.argmin(np.linalg.norm(seen[:, None] - true, axis=2), axis=1)
    assert sorted(nearest) == list(range(12))
    error = seen - true[nearest]
    assert np.abs(error.mean(axis=0)).max() < 0.06
    assert error.std() < 0.1
    assert np.isfinite(found.highlights).mean() > 0.95


def glint_frame(camera, middle, sigma_px, peak, rng, channels=(1.0,)):
    """A Gaussian glint, integrated over pixels, on an even ground: clipped, less a dark frame."""
    width, height = camera.size_px
    u, v = (
        sigma * np.sqrt(np.pi / 2) * np.diff(erf((np.arange(n + 1) - 0.5 - c) / sigma / np.sqrt(2)))
        for n, c, sigma in zip((width, height), middle, sigma_px, strict=True)
    )
    light = 0.03 + peak * v[:, None] * u
    dark = 0.01 * rng.standard_normal(light.shape)
    counts = [c * light + dark + 0.003 * rng.standard_normal(light.shape) for c in channels]
    intensity = np.mean([np.minimum(count, 1) - dark for count in counts], axis=0)
    return LinearFrame(intensity.astype(np.float32), np.max(counts, axis=0) >= 1)


@pytest.mark.parametrize(
    ("sigma_px", "peak", "channels"),
    [
        ((0.7, 0.7), 0.5, (1.0,)),
        ((0.8, 0.8), 3.0, (1.0,)),
        ((1.5, 1.5), 20.0, (1.0,)),
        # Green clips long before red and blue do: the mean has a shoulder, no flat top.
        ((1.5, 1.5), 4.0, (0.4, 1.0, 0.3)),
        ((2.0, 3.0), 3.0, (1.0,)),
    ],
)
def test_glint_is_placed_to_a_hundredth_of_a_pixel_clipped_or_not(rng, sigma_px, peak, channels):
    camera = Camera(np.array([[2500.0, 0, 60], [0, 2500, 60], [0, 0, 1]]), np.zeros(5), (121, 121))
    centre, errors = np.array([0.0, 0.0, 800.0]), []
    for _ in range(40):
        middle = 60 + rng.uniform(-4, 4, 2)
        frame = glint_frame(camera, middle, sigma_px, peak, rng, channels)
        assert frame.saturated.any() == (peak > 1)
        errors.append(find_highlight(frame, camera, centre, 10.0) - middle)
    assert np.abs(np.mean(errors, axis=0)).max() < 0.006
    assert np.std(errors) < 0.015


def test_images_without_glints_are_refused(bench):
    images = [np.full(bench.size_px[::-1], 0.3, np.float32)] * 3
    black = linear_frames([0 * image for image in images])
    with pytest.raises(CalibrationError, match="0 of 12 balls"):
        find_balls(linear_frames(images), bench.camera, bench.reference_plane, 12, 20.0, 10.0)
    with pytest.raises(CalibrationError, match="0 of 12 balls"):
        find_balls(black, bench.camera, bench.reference_plane, 12, 20.0, 10.0)


@pytest.mark.shared
def test_photographed_mirror_balls_give_the_stored_directions(shared_real):
    """Distant lights, a camera far away: blob and mirror law against the stored directions."""
    errors = []
    for probe in ("LightProbe-1", "LightProbe-2"):
        folder = shared_real / "light-probes" / probe
        x, y, radius = np.loadtxt(folder / "circle_data.txt")
        true = np.loadtxt(folder / "light_directions.txt").T
        for path, direction in zip(sorted(folder.glob("Image_*.JPG")), true, strict=True):
            image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
            light = (image.astype(np.float32) / 255) ** 2.2
            height, width = image.shape
            # A camera so far away that a pixel is a millimetre and rays are parallel.
            far = 1e6
            matrix = np.array([[far, 0, x], [0, far, height - 1 - y], [0, 0, 1]])
            camera = Camera(matrix, np.zeros(5), (width, height))
            centre = np.array([0.0, 0.0, far])
            pixel = find_highlight(LinearFrame(light, image == 255), camera, centre, radius)
            _, mirrored = reflected_lines(camera, pixel[None], centre[None], radius)
            found = mirrored[0] * [1, -1, -1]
            errors.append(np.degrees(np.arccos(np.clip(found @ direction, -1, 1))))
    assert np.median(errors) < 0.7
    assert np.max(errors) < 1.2
