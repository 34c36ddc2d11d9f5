"""make test-faults: kills, damaged inputs and corrupt results by the hundred, all seeded.

Prints how many were survived of how many were tried, stops at the first loss, and ends with one
line of JSON.
"""

import argparse
import json
import multiprocessing
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from archives import captures_of, make_project, survive_in_snakemake
from catalogue import LISTED
from corruption import inject, is_found
from kills import (
    copy_project,
    digests,
    stage_commands,
    state_of,
    survive_kill,
    survive_little_memory,
    survive_snakemake_kills,
    survive_two_at_once,
)
from mutator import mutated
from trials import Healthy, survive

# One too small for the libraries, one that just holds them.
LITTLE_MEMORY_MIB = (1000, 1700)


class LossError(Exception):
    """What was lost, and where."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=180, help="of `treadlight` stages")
    parser.add_argument("--snakemake-kills", type=int, default=20)
    parser.add_argument("--damages", type=int, default=300, help="through check and stages")
    parser.add_argument("--snakemake-damages", type=int, default=20)
    parser.add_argument("--corruptions", type=int, default=50, help="of the results")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    started = time.monotonic()
    # Thousands of small files: memory is kinder to the disk.
    base = "/dev/shm" if os.access("/dev/shm", os.W_OK) else None
    place = Path(tempfile.mkdtemp(prefix="treadlight-faults-", dir=base))
    figures: dict[str, object] = {}
    try:
        _say("making and processing a small archive")
        project = make_project(place / "project")
        before = state_of(project / "archive")
        for name, trial in (
            ("corruptions_found", _corruptions),
            ("damages_survived", _damages),
            ("kills_survived", _kills),
            ("two_at_once_survived", _two_at_once),
            ("little_memory_survived", _little_memory),
            ("snakemake_kills_survived", _snakemake_kills),
        ):
            figures[name] = trial(args, project, place)
        if state_of(project / "archive") != before:
            raise LossError("the archive was written to")
        figures["snakemake_damages_survived"] = _snakemake_damages(args, project, place)
    except LossError as loss:
        figures["lost"] = str(loss)
        print(f"LOST: {loss}", file=sys.stderr)
    finally:
        shutil.rmtree(place, ignore_errors=True)
    figures["minutes"] = round((time.monotonic() - started) / 60, 1)
    figures["processor_minutes"] = round(sum(os.times()[:4]) / 60, 1)
    print(json.dumps(figures))
    return 1 if "lost" in figures else 0


def _say(line: str) -> None:
    print(line, flush=True)


def _all(name: str, jobs: int, work: Callable, tasks: Iterable[tuple]) -> str:
    """Run the tasks in processes; each returns (label, what was lost or None)."""
    tasks = list(tasks)
    done = 0
    # Not concurrent.futures: its pool hangs when it replaces a worker (CPython issue 115634).
    with multiprocessing.get_context("spawn").Pool(jobs, maxtasksperchild=40) as pool:
        for label, lost in pool.imap_unordered(_call, [(work, *task) for task in tasks]):
            if lost is not None:
                raise LossError(f"{name}, {label}: {lost}")
            done += 1
            if done % 20 == 0 or done == len(tasks):
                _say(f"{name}: {done} of {len(tasks)} survived")
    return f"{done} of {len(tasks)}"


def _call(task: tuple) -> tuple[str, str | None]:
    work, *arguments = task
    return work(*arguments)


@contextmanager
def _copied(project: Path, place: Path) -> Iterator[Path]:
    """A copy of the project for one trial."""
    try:
        yield copy_project(project, place)
    finally:
        shutil.rmtree(place, ignore_errors=True)


def _damages(args: argparse.Namespace, project: Path, place: Path) -> str:
    measurement, calibration = captures_of(project)
    healthy = Healthy(measurement, calibration, project / "results")
    names = [damage.name for damage in LISTED][: args.damages]
    seeds = range(args.seed * 10_000, args.seed * 10_000 + args.damages - len(names))
    tasks = [(which, healthy, place / f"damage-{k}") for k, which in enumerate([*names, *seeds])]
    return _all("damaged inputs", args.jobs, _damage, tasks)


def _damage(which: str | int, healthy: Healthy, place: Path) -> tuple[str, str | None]:
    listed = {damage.name: damage for damage in LISTED}
    damage = listed[which] if isinstance(which, str) else mutated(which)
    return damage.name, survive(damage, healthy, place)


def _kills(args: argparse.Namespace, project: Path, place: Path) -> str:
    commands = stage_commands(project)
    reference = digests(project / "results")
    tasks = [
        (commands[k % len(commands)], project, reference, place / f"kill-{k}", (args.seed, k))
        for k in range(args.kills)
    ]
    return _all("kills", args.jobs, _kill, tasks)


def _kill(
    command: list[str], project: Path, reference: dict[str, str], place: Path, seed: tuple
) -> tuple[str, str | None]:
    with _copied(project, place) as copy:
        lost = survive_kill(command, copy, reference, np.random.default_rng(seed))
    return " ".join(command[:3]), lost


def _two_at_once(args: argparse.Namespace, project: Path, place: Path) -> str:
    commands = stage_commands(project)
    reference = digests(project / "results")
    stages = {command[1]: command for command in commands}
    tasks = [(c, project, reference, place / f"two-{name}") for name, c in stages.items()]
    return _all("two at once", 1, _two, tasks)


def _two(
    command: list[str], project: Path, reference: dict[str, str], place: Path
) -> tuple[str, str | None]:
    with _copied(project, place) as copy:
        return command[1], survive_two_at_once(command, copy, reference)


def _little_memory(args: argparse.Namespace, project: Path, place: Path) -> str:
    reference = digests(project / "results")
    stages = {command[1]: command for command in stage_commands(project)}
    tasks = [
        (command, project, reference, place / f"little-{name}-{mib}", mib)
        for name, command in stages.items()
        for mib in LITTLE_MEMORY_MIB
    ]
    return _all("little memory", args.jobs, _little, tasks)


def _little(
    command: list[str], project: Path, reference: dict[str, str], place: Path, mib: int
) -> tuple[str, str | None]:
    with _copied(project, place) as copy:
        return command[1], survive_little_memory(command, copy, reference, mib)


def _snakemake_kills(args: argparse.Namespace, project: Path, place: Path) -> str:
    copy = copy_project(project, place / "killed")
    reference = digests(project / "results")
    rng = np.random.default_rng(args.seed)
    lost = survive_snakemake_kills(copy, reference, args.snakemake_kills, rng, _say)
    shutil.rmtree(copy)
    if lost is not None:
        raise LossError(f"snakemake: {lost}")
    return f"{args.snakemake_kills} of {args.snakemake_kills}"


def _snakemake_damages(args: argparse.Namespace, project: Path, place: Path) -> str:
    lost = survive_in_snakemake(copy_project(project, place / "damaged"), args.snakemake_damages)
    if lost is not None:
        raise LossError(f"damaged captures through snakemake: {lost}")
    _say(f"damaged captures through snakemake: {args.snakemake_damages} survived")
    return f"{args.snakemake_damages} of {args.snakemake_damages}"


def _corruptions(args: argparse.Namespace, project: Path, place: Path) -> str:
    for k in range(args.corruptions):
        results = place / "corrupt"
        shutil.copytree(project / "results", results, copy_function=os.link)
        what = inject(results, np.random.default_rng((args.seed, k)))
        if not is_found(results):
            raise LossError(f"treadlight verify does not see: {what}")
        shutil.rmtree(results)
    _say(f"corruptions of the results: {args.corruptions} of {args.corruptions} found")
    return f"{args.corruptions} of {args.corruptions}"


if __name__ == "__main__":
    sys.exit(main())
