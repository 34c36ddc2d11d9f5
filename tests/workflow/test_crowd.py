"""Archives of many captures: what is added plans itself alone, what fails leaves the others."""

import runpy
from pathlib import Path
from types import SimpleNamespace

import pytest

BENCHMARKS = Path(__file__).resolve().parents[1] / "benchmarks"
crowd = SimpleNamespace(**runpy.run_path(str(BENCHMARKS / "plan/crowd.py")))
SIZE = crowd.Size(captures=6, sections=3, views=2, leds=4, captures_per_tire=3)


@pytest.fixture(scope="module")
def six(tmp_path_factory):
    """Two tires at three mileages, all done as far as Snakemake knows."""
    made = crowd.Crowd(tmp_path_factory.mktemp("crowd") / "six", SIZE)
    made.write()
    assert made.pretend().status == 0
    return made


def test_a_plan_has_a_job_per_capture_and_view(tmp_path):
    made = crowd.Crowd(tmp_path / "six", SIZE)
    made.write()
    plan = made.snakemake("-n")
    assert plan.jobs["detect_laser_pixels"] == plan.jobs["integrate"] == 6
    assert plan.jobs["photometric_stereo"] == 12
    assert plan.jobs["wear"] == 2


def test_an_added_capture_plans_its_own_jobs_alone(six):
    assert six.snakemake("-n").jobs == {}
    six.add(6)
    assert six.snakemake("-n").jobs == crowd.jobs_of_one_more(SIZE)


def test_a_capture_whose_job_fails_leaves_the_others(tmp_path):
    made = crowd.Crowd(tmp_path / "six", SIZE)
    made.write()
    blocked = made.block(2)
    assert made.snakemake(*made.inventories()).status == 1
    assert made.uninspected() == [blocked]
