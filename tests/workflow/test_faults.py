"""A short run of `make test-faults`: some of each kind of damage, kill and corruption."""

import os
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "faults"))

from archives import captures_of, survive_in_snakemake
from catalogue import LISTED
from corruption import inject, is_found
from damage import copy_capture
from kills import (
    copy_project,
    digests,
    stage_commands,
    state_of,
    survive_kill,
    survive_two_at_once,
)
from mutator import mutated
from trials import Healthy, run_quietly, survive

# Every so many of the list, which `make test-faults` runs through as a whole.
SAMPLE = [damage.name for damage in LISTED[::9]]
# What happens to captures most, each with one cause and so one sentence.
COMMON = (
    "image_missing",
    "image_empty",
    "image_truncated_without_digest",
    "image_bit_flipped",
    "image_of_another_size",
    "text_named_png",
    "image_that_claims_100000_by_100000_pixels",
    "led_frame_all_black",
    "led_frame_all_saturated",
    "leds_swapped_in_one_view",
    "led_frame_at_another_angle",
    "laser_off_in_one_frame",
    "frames_csv_with_semicolons",
    "capture_yaml_with_a_key_twice",
    "capture_yaml_that_explodes",
)


@pytest.fixture(scope="module")
def project(processed):
    return processed.folder


@pytest.fixture(scope="module")
def healthy(project):
    measurement, calibration = captures_of(project)
    return Healthy(measurement, calibration, project / "results")


def test_healthy_captures_are_found_healthy(healthy):
    for capture in (healthy.measurement, healthy.calibration):
        assert run_quietly("check", capture) == (0, [])


@pytest.mark.parametrize("name", COMMON)
def test_check_tells_a_common_damage_in_one_sentence(name, healthy, tmp_path, rng):
    damage = next(damage for damage in LISTED if damage.name == name)
    folder = copy_capture(healthy.measurement, tmp_path / healthy.measurement.name)
    damage.harm(folder, rng)
    status, told = run_quietly("check", folder)
    assert status == 1
    assert len(told) == 1
    assert healthy.measurement.name in told[0]
    assert told[0].endswith(".")


@pytest.mark.parametrize("name", SAMPLE)
def test_a_listed_damage_is_survived(name, healthy, tmp_path):
    damage = next(damage for damage in LISTED if damage.name == name)
    before = state_of(healthy.measurement)
    assert survive(damage, healthy, tmp_path / "x") is None
    assert state_of(healthy.measurement) == before


def test_random_damages_are_survived(healthy, tmp_path):
    for seed in range(15):
        assert survive(mutated(seed), healthy, tmp_path / f"{seed}") is None, seed


def test_damaged_captures_leave_the_others_their_bits(project, tmp_path):
    before = state_of(project / "archive")
    assert survive_in_snakemake(copy_project(project, tmp_path / "p"), 3) is None
    assert state_of(project / "archive") == before


def test_50_of_50_corruptions_of_the_results_are_found(project, tmp_path):
    missed = []
    for seed in range(50):
        results = tmp_path / "results"
        shutil.copytree(project / "results", results, copy_function=os.link)
        what = inject(results, np.random.default_rng(seed))
        if not is_found(results):
            missed.append(what)
        shutil.rmtree(results)
    assert missed == []


def test_what_verify_removes_is_made_anew_with_the_same_bits(processed, tmp_path):
    copy = processed.copy(tmp_path / "p")
    reference = digests(copy.results)
    shard = next(p for p in copy.results.rglob("profile.zarr/r/c/*/*") if p.is_file())
    data = bytearray(shard.read_bytes())
    data[len(data) // 2] ^= 1
    shard.write_bytes(bytes(data))
    done = copy.run("treadlight", "verify", "results", check=False)
    assert done.returncode == 1
    assert "profile.zarr" in done.stderr
    assert "treadlight verify --remove results" in done.stdout
    assert copy.run("treadlight", "verify", "--remove", "results", check=False).returncode == 1
    copy.snakemake()
    assert digests(copy.results) == reference
    assert copy.run("treadlight", "verify", "results").returncode == 0


def test_killed_stages_run_again_to_the_same_bits(project, tmp_path):
    commands, reference = stage_commands(project), digests(project / "results")
    for seed in range(4):
        command = commands[seed * 5 % len(commands)]
        copy = copy_project(project, tmp_path / f"{seed}")
        assert survive_kill(command, copy, reference, np.random.default_rng(seed)) is None, command


def test_two_processes_of_one_stage_do_not_harm_each_other(project, tmp_path):
    commands = {command[1]: command for command in stage_commands(project)}
    reference = digests(project / "results")
    copy = copy_project(project, tmp_path / "p")
    assert survive_two_at_once(commands["triangulate"], copy, reference) is None
