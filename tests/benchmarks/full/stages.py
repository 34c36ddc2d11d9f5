"""The stages of one sector, each run as its command is under Snakemake, and what each took."""

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from sector import Sector

from treadlight import store


def run_all(
    made: Sector, results: Path, cores: int, say: Callable[[str], None]
) -> dict[str, dict[str, float]]:
    """Every stage's seconds by the clock and of the processors, largest memory, bytes written."""
    points, laser = results / "laser_points.zarr", results / "laser.zarr"
    surface, view = results / "surface.zarr", results / "photometric.zarr/fov00"
    pixels, profile = results / "laser_pixels.zarr", results / "profile.zarr"
    lit = ["--calibration", made.calibration]
    given = [*lit, "--surface", surface]
    shone = [*given, "--illumination", made.illumination]
    quality = ["--quality", results / "quality.json"]
    rows = ["--laser", laser, "--views", view]
    commands: dict[str, tuple[list[Any], list[Path]]] = {
        "detect-laser-pixels": ([made.sections, "--out", pixels], [pixels]),
        "triangulate": ([pixels, "--capture", made.capture, *lit, "--out", points], [points]),
        "register-to-cylinder": (
            [points, "--capture", made.capture, *given, "--out", laser],
            [laser, surface],
        ),
        "photometric-stereo": ([made.capture, "--view", "0", *shone, "--out", view], [view]),
        "integrate": ([made.capture, *given, *rows, "--out", profile, *quality], [profile]),
    }
    taken = {}
    for command, (arguments, written) in commands.items():
        taken[command] = _run(command, [*map(str, arguments), "--threads", str(cores)])
        for path in written:
            if reason := store.refused_reason(path):
                sys.exit(f"{command}: {reason}")
        taken[command]["written_mb"] = round(sum(map(_bytes_in, written)) / 1e6, 1)
        say(f"{command}: {taken[command]}")
    return taken


def least(runs: list[dict[str, dict[str, float]]]) -> dict[str, dict[str, float]]:
    """The least of some runs of `run_all`, each figure by itself."""
    return {
        stage: {key: min(run[stage][key] for run in runs) for key in runs[0][stage]}
        for stage in runs[0]
    }


def _run(command: str, arguments: list[str]) -> dict[str, float]:
    began = time.monotonic()
    process = subprocess.Popen(
        [sys.executable, "-m", "treadlight.cli", command, *arguments], env=os.environ
    )
    _, status, usage = os.wait4(process.pid, 0)
    if status:
        sys.exit(f"{command} exits {os.waitstatus_to_exitcode(status)}.")
    return {
        "wall_s": round(time.monotonic() - began, 2),
        "processor_s": round(usage.ru_utime + usage.ru_stime, 2),
        "peak_gib": round(usage.ru_maxrss / (1 << 20), 2),
    }


def _bytes_in(folder: Path) -> int:
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
