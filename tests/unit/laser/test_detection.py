from dataclasses import replace

import numpy as np
import pytest

from treadlight.errors import CaptureError
from treadlight.laser import detect_section, learn_line_model
from treadlight.laser.detection import (
    MULTIPLE,
    NONE,
    SATURATED,
    WEAK,
    LineModel,
    calm_rows,
    estimate_noise,
)
from treadlight.laser.line_model import line_course
from treadlight.laser.peak_kernels import find_peaks

ROWS = 600


def course(rng, rows=ROWS):
    """A line that wanders slowly over the columns, crossing every sub-pixel phase."""
    return 48 + 6 * np.sin(np.linspace(0, 4, rows)) + rng.uniform(-0.5, 0.5)


def half_maximum_centroid(intensity):
    """Eq. 3.4: the dissertation's estimator."""
    level = 0.5 * intensity.max(axis=1, keepdims=True)
    light = np.where(intensity >= level, intensity, 0)
    return light @ np.arange(intensity.shape[1]) / light.sum(axis=1)


def test_line_centre_is_unbiased_and_beats_the_half_maximum_by_two_under_speckle(stripes, rng):
    truth = [course(rng) for _ in range(6)]
    frames = [stripes(u, rng=rng) for u in truth]
    model = learn_line_model(frames)
    error = np.concatenate(
        [detect_section(*frame, model).u[:, 0] - u for frame, u in zip(frames, truth, strict=True)]
    )
    plain = np.concatenate(
        [half_maximum_centroid(frame[0]) - u for frame, u in zip(frames, truth, strict=True)]
    )
    assert abs(np.mean(error)) < 0.01
    assert np.median(np.abs(error)) < 0.5 * np.median(np.abs(plain))


def test_standard_deviation_covers_the_errors(stripes, rng):
    truth = [course(rng) for _ in range(6)]
    frames = [stripes(u, rng=rng) for u in truth]
    model = learn_line_model(frames)
    found = [detect_section(*frame, model) for frame in frames]
    share = np.concatenate(
        [np.abs(f.u[:, 0] - u) / f.u_std[:, 0] for f, u in zip(found, truth, strict=True)]
    )
    assert 0.6 < np.mean(share < 1) < 0.8
    assert 0.87 < np.mean(share < 2) < 0.99


def test_rows_that_speckle_shapes_oddly_are_not_less_certain(stripes, rng):
    """Where the line goes on calmly, an odd row is speckle: its error is that of the others."""
    truth = [course(rng) for _ in range(6)]
    frames = [stripes(u, sigma=2.0, rng=rng) for u in truth]
    model = learn_line_model(frames)
    found = [detect_section(*frame, model) for frame in frames]
    calm = np.concatenate([calm_rows(f.u[:, 0], f.flags, model) for f in found])
    std = np.concatenate([f.u_std[:, 0] for f in found])[calm]
    error = np.concatenate([f.u[:, 0] - u for f, u in zip(found, truth, strict=True)])[calm]
    skew = np.abs(np.concatenate([f.skew[:, 0] for f in found]))[calm]
    odd = skew > np.percentile(skew, 90)
    assert calm.mean() > 0.8
    ratio = np.sqrt(np.mean(std[odd] ** 2) / np.mean(error[odd] ** 2))
    assert 0.8 < ratio < 1.25


def test_line_width_is_measured_not_assumed(stripes, rng):
    for sigma in (0.9, 2.0, 6.0):
        frames = [stripes(course(rng), sigma=sigma, rng=rng) for _ in range(3)]
        assert learn_line_model(frames).unblurred_sigma_px == pytest.approx(sigma, rel=0.2)


@pytest.mark.parametrize("sigma", [2.0, 4.0])
def test_strong_speckle_does_not_make_the_line_look_narrow(stripes, rng, sigma):
    """Grains of full contrast, as of a laser on rubber: a row's brightest is not the line."""
    truth = [course(rng) for _ in range(6)]
    frames = [stripes(u, sigma=sigma, speckle=1.0, rng=rng) for u in truth]
    model = learn_line_model(frames)
    assert model.sigma_px == pytest.approx(sigma, rel=0.1)
    u = np.concatenate(truth)
    error = np.concatenate([detect_section(*frame, model).u[:, 0] for frame in frames]) - u
    plain = np.concatenate([half_maximum_centroid(frame[0]) for frame in frames]) - u
    assert np.sqrt(np.nanmean(error**2)) < 0.5 * np.sqrt(np.mean(plain**2))


def test_line_centre_is_unbiased_under_saturation(stripes, rng):
    """A clipped stripe moves the estimate by less than 0.01 px on average."""
    truth = [course(rng) for _ in range(4)]
    frames = [stripes(u, sigma=3, peak=1.6, speckle=0.1, clip=1.0, rng=rng) for u in truth]
    model = learn_line_model(frames)
    found = [detect_section(*frame, model) for frame in frames]
    error = np.concatenate([f.u[:, 0] - u for f, u in zip(found, truth, strict=True)])
    assert abs(np.mean(error)) < 0.01
    assert np.std(error) < 0.1
    assert np.mean([(f.flags & SATURATED).all() for f in found]) == 1


def test_dim_rows_are_weak_and_less_certain_and_dark_rows_are_none(stripes, rng):
    peak = np.full(ROWS, 0.5)
    peak[200:250] = 0.003
    peak[400:420] = 0
    frame = stripes(course(rng), peak=peak, rng=rng)
    model = learn_line_model([frame])
    found = detect_section(*frame, model)
    assert np.all(found.flags[402:418] & NONE)
    seen = np.isfinite(found.u[205:245, 0])
    assert seen.mean() > 0.8
    assert np.mean((found.flags[205:245] & WEAK)[seen] > 0) > 0.8
    assert np.nanmedian(found.u_std[205:245, 0]) > 1.5 * np.nanmedian(found.u_std[:200, 0])


def test_noise_is_told_from_the_dark_part_and_never_below_rounding(stripes, rng):
    intensity, _ = stripes(course(rng), width=400, noise=2e-3, rng=rng)
    assert estimate_noise(intensity) == pytest.approx(2e-3, rel=0.1)
    steps = np.round(intensity * 200) / 200
    assert estimate_noise(steps.astype(np.float32)) >= 1 / 200 / np.sqrt(12) * 0.999
    assert estimate_noise(np.zeros((4, 4), np.float32)) > 0


def test_dark_frames_are_refused_with_a_sentence():
    dark = (np.zeros((60, 80), np.float32), np.zeros((60, 80), bool))
    with pytest.raises(CaptureError, match="no line above the noise"):
        learn_line_model([dark])


def test_second_stripe_is_kept_and_flagged_and_does_not_pull_the_first(stripes, rng):
    u = course(rng)
    clean = stripes(u, rng=rng)
    model = learn_line_model([clean])
    ghost, _ = stripes(np.where(np.arange(ROWS) < 300, u + 9, np.nan), peak=0.3, rng=rng)
    found = detect_section(clean[0] + ghost, clean[1], model)
    both = found.flags[10:290] & MULTIPLE > 0
    assert both.mean() > 0.95
    assert abs(np.mean(found.u[10:290, 0] - u[10:290])) < 0.12
    assert abs(np.median(found.u[10:290, 1] - u[10:290] - 9)) < 0.15
    assert not np.any(found.flags[310:590] & MULTIPLE)


def test_stripe_cut_by_a_wall_or_skewed_by_a_reflection_is_less_certain(stripes, rng):
    u = course(rng)
    intensity, saturated = stripes(u, speckle=0.1, rng=rng)
    model = learn_line_model([(intensity, saturated)])
    cut = intensity.copy()
    columns = np.arange(cut.shape[1])
    cut[300:][columns > u[300:, None] + 0.3] *= 0.02
    found = detect_section(cut, saturated, model)
    off = np.abs(found.u[310:590, 0] - u[310:590])
    assert np.median(off) > 2 * np.nanmedian(found.u_std[:290, 0])
    assert np.mean(off < 2 * found.u_std[310:590, 0]) > 0.7


def test_peaks_come_strongest_first_and_unresolved_ones_give_way():
    row = np.zeros((1, 40), np.float32)
    row[0, [5, 7, 20, 26, 30, 36]] = [3, 4, 9, 5, 2, 1]
    assert find_peaks(row, 0.5, 3.0).tolist() == [[20, 26, 7, 30]]
    assert find_peaks(row, 4.5, 3.0).tolist() == [[20, 26, -1, -1]]
    # The weaker neighbour comes second along the row, too.
    row[0, 22] = 6
    assert find_peaks(row, 4.5, 3.0).tolist() == [[20, 26, -1, -1]]


def test_frames_too_small_to_learn_from_fall_back_to_the_gaussian_filter(stripes, rng):
    frame = stripes(np.full(24, 30.3), width=64, speckle=0.1, rng=rng)
    model = learn_line_model([frame])
    assert isinstance(model, LineModel)
    found = detect_section(*frame, model)
    assert np.abs(found.u[:, 0] - 30.3).max() < 0.3


def test_detection_does_not_depend_on_the_scale_of_light(stripes, rng):
    frame = stripes(course(rng), rng=rng)
    model = learn_line_model([frame])
    faint = (np.float32(2**-6) * frame[0], frame[1])
    weak = learn_line_model([faint])
    a, b = detect_section(*frame, model), detect_section(*faint, weak)
    np.testing.assert_allclose(a.u[:, 0], b.u[:, 0], atol=1e-3)


def test_undersampled_line_is_not_drawn_to_the_pixels(stripes, rng):
    """At a sigma of 0.55 px the mean error stays under 0.05 px at every place in the pixel."""
    frames, truth = [], []
    for start in np.linspace(0, 1, 6, endpoint=False):
        u = 40 + start + np.linspace(0, 5, ROWS)
        truth.append(u)
        frames.append(stripes(u, sigma=0.55, speckle=0.1, rng=rng))
    model = learn_line_model(frames)
    error = np.concatenate(
        [detect_section(*f, model).u[:, 0] - u for f, u in zip(frames, truth, strict=True)]
    )
    phase = np.floor(8 * (np.concatenate(truth) % 1)).astype(int)
    means = [np.mean(error[phase == k]) for k in range(8)]
    assert np.abs(means).max() < 0.05
    assert model.blur_px > 0


@pytest.mark.parametrize("sigma", [0.8, 1.0, 1.5])
def test_a_narrow_line_may_lie_anywhere_in_its_pixel(stripes, rng, sigma):
    """The mean error stays under 0.02 px at every place in the pixel."""
    frames, truth = [], []
    for start in np.linspace(0, 1, 6, endpoint=False):
        u = 40 + start + np.linspace(0, 5, ROWS)
        truth.append(u)
        frames.append(stripes(u, sigma=sigma, speckle=0.1, rng=rng))
    model = learn_line_model(frames)
    error = np.concatenate(
        [detect_section(*f, model).u[:, 0] - u for f, u in zip(frames, truth, strict=True)]
    )
    phase = np.floor(8 * (np.concatenate(truth) % 1)).astype(int)
    assert np.abs([np.mean(error[phase == k]) for k in range(8)]).max() < 0.02


def test_a_filter_that_few_sections_taught_does_not_feel_the_pixels(stripes, rng):
    """All rows of a round tire lie at nearly one place in their pixels, which is what is learnt."""
    taught = [stripes(40.2 + np.linspace(0, 0.3, ROWS), sigma=0.8, speckle=0.1, rng=rng)]
    model = learn_line_model(taught)
    u = 40 + np.linspace(0, 5, ROWS)
    error = detect_section(*stripes(u, sigma=0.8, speckle=0.1, rng=rng), model).u[:, 0] - u
    phase = np.floor(8 * (u % 1)).astype(int)
    assert np.abs([np.mean(error[phase == k]) for k in range(8)]).max() < 0.03


def test_the_filter_of_a_narrow_line_is_not_taught_the_pixels(stripes, rng):
    """Sections of a round tire, each at nearly one place in its pixels along all its rows."""
    most = []
    for _ in range(4):
        starts = 40 + np.linspace(0, 1, 12, endpoint=False)
        truth = [start + 1.5 * np.sin(np.linspace(0, 3, ROWS)) for start in starts]
        frames = [stripes(u, sigma=0.9, rng=rng) for u in truth]
        model = learn_line_model(frames[::2])
        error = np.concatenate(
            [detect_section(*f, model).u[:, 0] - u for f, u in zip(frames, truth, strict=True)]
        )
        phase = np.floor(8 * (np.concatenate(truth) % 1)).astype(int)
        most.append(np.abs([np.nanmean(error[phase == k]) for k in range(8)]).max())
    assert np.mean(most) < 0.014


def test_what_draws_a_narrow_line_to_the_pixels_is_taken_back(stripes):
    """The filter weighs flanks that are rounded to a few levels: first harmonic of the error."""
    drawn = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        starts = 40 + np.linspace(0, 1, 24, endpoint=False)
        truth = np.stack([start + 1.5 * np.sin(np.linspace(0, 3, ROWS)) for start in starts])
        frames = []
        for u in truth:
            light, saturated = stripes(u, sigma=0.68, peak=0.35, noise=3e-4, rng=rng)
            rounded = np.round(63 * np.clip(light, 0, 1)) / 63
            frames.append((rounded.astype(np.float32), saturated))
        model = learn_line_model(frames)
        for used in (model, replace(model, locking_px=np.zeros(4))):
            found = np.stack([detect_section(*frame, used).u[:, 0] for frame in frames])
            error = np.clip(found - truth, -0.5, 0.5)
            known = np.isfinite(error)
            waves = np.exp(2j * np.pi * truth[known])
            drawn.append(2 * np.abs(np.mean(error[known] * waves)))
    assert np.mean(drawn[::2]) < 0.0035
    assert np.mean(drawn[::2]) < 0.7 * np.mean(drawn[1::2])


def test_a_line_at_one_place_in_its_pixel_tells_nothing_of_the_others(stripes, rng):
    still = [stripes(np.full(ROWS, 40.3), sigma=1.0, speckle=0, noise=0, rng=rng)]
    model = learn_line_model(still)
    u = 40 + np.linspace(0, 5, ROWS)
    error = detect_section(*stripes(u, sigma=1.0, speckle=0, noise=0, rng=rng), model).u[:, 0] - u
    assert np.abs(error).max() < 0.05


def test_the_course_is_told_by_both_sides(stripes, rng):
    model = learn_line_model([stripes(course(rng), sigma=2.0, rng=rng) for _ in range(3)])
    rows = np.arange(ROWS)
    u = 40 + 2e-4 * (rows - 300.0) ** 2
    bent = line_course(u, model)
    known = np.isfinite(bent)
    assert known.mean() > 0.8
    np.testing.assert_allclose(bent[known], u[known], atol=1e-6)
    beside = line_course(np.where(rows < 200, u, np.nan), model)
    assert np.isnan(beside[195:]).all()
    assert np.isnan(line_course(np.where(rows < 200, u, u + 9), model)[195:205]).all()
