"""Frames that do not show what they should are found, and no others."""

import cv2
import numpy as np
import pytest

from treadlight.archive import read_capture
from treadlight.images import FrameReader, LinearFrame, doubts

LEDS = 8


def view(rng, shift=0):
    """Frames of one relief under LEDs round about it: shading, gloss, noise."""
    relief = cv2.GaussianBlur(rng.normal(size=(160, 240)), (0, 0), 2)[:, 20 : 20 + 160]
    relief = np.roll(relief, shift, axis=1)
    v, u = np.mgrid[:160, :160] / 160
    frames = []
    for k in range(LEDS):
        angle = 2 * np.pi * k / LEDS
        slope = np.cos(angle) * np.gradient(relief, axis=1)
        slope += np.sin(angle) * np.gradient(relief, axis=0)
        distance = (u - 0.5 - np.cos(angle)) ** 2 + (v - 0.5 - np.sin(angle)) ** 2
        light = (0.3 + 2 * slope) / (0.5 + distance) + rng.normal(0, 0.003, relief.shape)
        frames.append(np.clip(light, 0, 1).astype(np.float32))
    return frames


def looks(frames):
    none = np.zeros(frames[0].shape, bool)
    return {f"{k}.png": doubts.look_at(LinearFrame(f, none)) for k, f in enumerate(frames)}


def test_a_healthy_view_raises_no_doubt(rng):
    assert doubts.doubts_of_view(looks(view(rng)), "rows") == {}


def test_what_is_saturated_counts_as_full_scale(rng):
    """Whatever was stored there: a white level may lie far below the type's largest count."""
    frame = view(rng)[0]
    bright = frame > np.quantile(frame, 0.8)
    whole = doubts.look_at(LinearFrame(np.where(bright, np.float32(1), frame), bright))
    clipped = doubts.look_at(LinearFrame(np.where(bright, np.float32(0.2), frame), bright))
    assert clipped.level == whole.level
    np.testing.assert_array_equal(clipped.small, whole.small)
    np.testing.assert_array_equal(clipped.pattern, whole.pattern)


@pytest.mark.parametrize("k", range(LEDS))
def test_a_frame_that_moved_along_the_travel_is_found(rng, k):
    frames = view(rng)
    frames[k] = np.roll(frames[k], 9, axis=1)
    found = doubts.doubts_of_view(looks(frames), "rows")
    assert list(found) == [f"{k}.png"]
    assert "9 px off" in found[f"{k}.png"]


def test_travel_runs_along_the_columns_where_the_scan_does(rng):
    frames = [frame.T for frame in view(rng)]
    frames[2] = np.roll(frames[2], 9, axis=0)
    assert list(doubts.doubts_of_view(looks(frames), "columns")) == ["2.png"]


def test_dark_and_blinded_frames_are_found(rng):
    frames = view(rng)
    frames[1] = rng.normal(0, 0.003, frames[1].shape).astype(np.float32)
    seen = looks(frames)
    seen["4.png"] = doubts.look_at(LinearFrame(frames[4], np.ones(frames[4].shape, bool)))
    found = doubts.doubts_of_view(seen, "rows")
    assert "is dark" in found["1.png"]
    assert "is saturated" in found["4.png"]
    assert len(found) == 2


def patterns(frames):
    return {k: doubts.light_pattern(frame) for k, frame in enumerate(frames)}


def test_exchanged_leds_are_found_between_views_of_other_places(rng):
    one, two = patterns(view(rng)), patterns(view(rng))
    assert doubts.swapped_leds(one, two) == []
    one[2], one[5] = one[5], one[2]
    assert doubts.swapped_leds(one, two) == [(2, 5)]


def test_the_view_that_disagrees_with_most_is_the_wrong_one(rng):
    views = {number: patterns(view(rng)) for number in range(4)}
    views[3][0], views[3][1] = views[3][1], views[3][0]
    assert doubts.views_with_swapped_leds(views, lambda _: 0.0) == {3: (0, 1)}


def test_of_two_views_the_one_explained_worse_is_wrong(rng):
    views = {"a": patterns(view(rng)), "b": patterns(view(rng))}
    views["b"][0], views["b"][3] = views["b"][3], views["b"][0]
    assert doubts.views_with_swapped_leds(views, {"a": 0.02, "b": 0.3}.get) == {"b": (0, 3)}


@pytest.mark.shared
@pytest.mark.parametrize("name", ["t7-00100", "t7-00200"])
def test_the_sample_raises_no_doubt_and_a_frame_of_another_view_does(sample_archive, name):
    capture = read_capture(sample_archive / name)
    reader = FrameReader(capture)
    seen = {f.file: doubts.look_at(reader.read(f)) for f in capture.of_kind("led")}
    views = [{f.file: seen[f.file] for f in capture.view(number)} for number in capture.views]
    light = [
        {f.led: seen[f.file].pattern for f in capture.view(number)} for number in capture.views
    ]
    assert [doubts.doubts_of_view(view, "rows") for view in views] == [{}, {}, {}]
    numbered = dict(enumerate(light))
    assert doubts.views_with_swapped_leds(numbered, lambda _: 0.0) == {}
    for ours, others in ((views[0], views[1]), (views[1], views[2]), (views[2], views[0])):
        for file, other in zip(list(ours)[::5], list(others)[::5], strict=True):
            found = doubts.doubts_of_view({**ours, file: others[other]}, "rows")
            assert list(found) == [file]


def test_a_view_without_edges_is_not_judged(rng):
    blank = [np.full((160, 160), 0.4) + rng.normal(0, 0.01, (160, 160)) for _ in range(LEDS)]
    assert doubts.doubts_of_view(looks([f.astype(np.float32) for f in blank]), "rows") == {}


def test_a_frame_that_holds_only_noise_is_dark_at_any_gain(rng):
    for sigma in (1e-4, 0.05):
        frames = view(rng)
        frames[5] = rng.normal(0, sigma, frames[5].shape).astype(np.float32)
        assert "is dark" in doubts.unlit_frames(looks(frames))["5.png"]
        assert len(doubts.unlit_frames(looks(frames[5:6]))) == 1
