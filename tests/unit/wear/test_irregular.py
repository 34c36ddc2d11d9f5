"""Irregular wear with known steps, waves and spots."""

import dataclasses

import numpy as np
import pytest

from treadlight.wear import (
    Finding,
    WornTread,
    cupping,
    feathering,
    flat_spot,
    heel_and_toe,
    one_sided,
    shoulder_or_centre,
)

RADIUS = 350.0
ROWS = 2200


@pytest.fixture
def tread(rng):
    """Two ribs of 30 columns on a whole turn, worn by 0.3 mm evenly; blocks of 40 rows."""
    theta = 2 * np.pi * np.arange(ROWS) / ROWS
    wear = 0.3 + rng.normal(0, 0.02, (ROWS, 70))
    slot = np.zeros((ROWS, 70), bool)
    slot[np.arange(ROWS) % 44 >= 40] = True
    rib = np.zeros(70, int)
    rib[2:32], rib[38:68] = 1, 2
    wear[slot] = np.nan
    wear[:, rib == 0] = np.nan
    return WornTread(wear, slot, theta, rib, np.zeros(ROWS), 1.0, RADIUS, True)


def changed(tread, added, rib=None):
    columns = tread.rib > 0 if rib is None else tread.rib == rib
    wear = tread.wear.copy()
    wear[:, columns] += np.broadcast_to(added, tread.wear.shape)[:, columns]
    return dataclasses.replace(tread, wear=wear)


def in_block():
    """0 at the first row of a block, 1 at its last."""
    return (np.arange(ROWS) % 44)[:, None] / 39


def test_even_wear_is_detected_as_nothing(tread):
    found = [heel_and_toe(tread, 1), feathering(tread, 1), cupping(tread, 1), flat_spot(tread)]
    assert [one.word for one in found] == ["not detected"] * 4


def test_heel_and_toe_is_the_step_between_the_ends_of_blocks(tread):
    worn = changed(tread, 0.5 * in_block(), rib=1)
    found = heel_and_toe(worn, 1)
    # Between the middles of the first and the last fifth: four fifths of the rise.
    assert found.value_mm == pytest.approx(0.5 * 32 / 39, abs=3 * found.std_mm)
    assert found.std_mm < 0.01
    assert found.word == "slight"
    assert heel_and_toe(worn, 2).word == "not detected"


def test_a_tread_that_moves_towards_theta_leads_with_its_theta_edge(tread):
    worn = changed(tread, 0.5 * in_block())
    assert heel_and_toe(worn, 1, rolling=1).value_mm == pytest.approx(
        -heel_and_toe(worn, 1, rolling=-1).value_mm
    )
    assert heel_and_toe(worn, 1, rolling=1).value_mm < 0
    assert "trailing" in heel_and_toe(worn, 1, rolling=1).note


def test_a_rib_without_slots_has_no_blocks(tread):
    plain = dataclasses.replace(tread, slot=np.zeros_like(tread.slot))
    found = heel_and_toe(plain, 1)
    assert found.word == "not known"
    assert "no blocks" in found.note


def test_feathering_is_the_step_across_a_rib(tread):
    worn = changed(tread, 0.02 * np.arange(70.0), rib=2)
    found = feathering(worn, 2)
    # Between the middles of the outer quarters (8 of 30 columns each).
    assert found.value_mm == pytest.approx(0.02 * 22, abs=0.005)
    assert feathering(worn, 2, outboard=-1).value_mm == pytest.approx(-found.value_mm)
    assert feathering(worn, 1).word == "not detected"


def test_a_tilt_that_the_alignment_may_have_left_is_no_feathering(tread):
    worn = changed(tread, 0.002 * np.arange(70.0))
    assert feathering(worn, 1).word == "slight"
    assert feathering(worn, 1, slope_std=0.002).word == "not detected"


def test_cupping_finds_amplitude_and_length_of_a_wave(tread):
    wave = 0.2 * np.cos(20 * tread.theta)[:, None]
    found = cupping(changed(tread, wave), 1)
    assert found.value_mm == pytest.approx(0.2, rel=0.05)
    assert f"{2 * np.pi * RADIUS / 20:.0f} mm" in found.note
    assert found.word == "slight"


def test_a_wave_that_the_floors_show_too_is_no_cupping(tread):
    wave = 0.2 * np.cos(20 * tread.theta)
    seen = dataclasses.replace(changed(tread, wave[:, None]), floor=wave)
    assert cupping(seen, 1).word == "not detected"


def test_off_centre_is_no_cupping(tread):
    found = cupping(changed(tread, np.cos(tread.theta)[:, None]), 1)
    assert found.word == "not detected"


def test_chance_rarely_looks_like_cupping(tread, rng):
    words = []
    for _ in range(60):
        noise = dataclasses.replace(tread, wear=rng.normal(0.3, 0.02, tread.wear.shape))
        words.append(cupping(noise, 1).word)
    assert words.count("not detected") >= 50


def test_a_flat_spot_is_found_where_it_is(tread):
    near = np.exp(-(((np.degrees(tread.theta) - 120) / 3) ** 2))
    found = flat_spot(changed(tread, near[:, None]))
    assert found.value_mm > 0.6
    assert abs(float(found.note.split()[1]) - 120) < 5
    assert found.word in ("moderate", "severe")


def test_one_side_and_shoulders_compare_the_ribs():
    wear, std = [0.5, 0.2, 0.2, 0.1], [0.03] * 4
    side = one_sided(wear, std)
    assert (side.value_mm, side.std_mm) == pytest.approx((-0.4, 0.03 * np.sqrt(2)))
    assert one_sided(wear, std, outboard=-1).value_mm == pytest.approx(0.4)
    shoulder = shoulder_or_centre(wear, std)
    assert shoulder.value_mm == pytest.approx(0.1)
    assert shoulder.std_mm == pytest.approx(0.03 * np.sqrt(0.5 + 0.5))
    assert one_sided([0.1], [0.1]).word == "not known"
    assert shoulder_or_centre([0.1, 0.2], [0.1, 0.1]).word == "not known"


@pytest.mark.parametrize(
    ("value", "word"),
    [(0.05, "not detected"), (-0.2, "slight"), (0.6, "moderate"), (-1.2, "severe")],
)
def test_the_word_follows_limit_and_size(value, word):
    assert Finding("feathering", "rib-1", value, 0.05, 0.1).word == word


def test_missing_wear_gives_no_figure(tread):
    empty = dataclasses.replace(tread, wear=np.full_like(tread.wear, np.nan))
    found = [heel_and_toe(empty, 1), feathering(empty, 1), cupping(empty, 1), flat_spot(empty)]
    assert [one.word for one in found] == ["not known"] * 4
