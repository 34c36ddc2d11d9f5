"""Processes killed at random moments: what is visible stays whole, and the next run mends it."""

import hashlib
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from corruption import victims

from treadlight import store

ROOT = Path(__file__).resolve().parents[2]
# Compiling the kernels alone takes minutes on a busy machine.
_TIMEOUT_S = 1800
_OUTPUTS = {
    "register-to-cylinder": ("--out", "--surface"),
    "integrate": ("--out", "--quality"),
    "wear": ("--out", "--trend"),
    "index": ("--out", "--products"),
}
_SNAKEMAKE = ("snakemake", "--cores", "2", "--rerun-incomplete")


def environment() -> dict[str, str]:
    """This package, at one path for all projects or each would compile its kernels again."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    return os.environ | {"PYTHONPATH": str(ROOT / "workflow"), "PATH": path}


def run(project: Path, *command: str) -> subprocess.CompletedProcess:
    return subprocess.run(
        command,
        cwd=project,
        env=environment(),
        capture_output=True,
        text=True,
        check=False,
        timeout=_TIMEOUT_S,
    )


def digests(results: Path) -> dict[str, str]:
    """SHA-256 of every visible file of the results."""
    return {
        path.relative_to(results).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in victims(results)
    }


def state_of(folder: Path) -> dict[str, tuple]:
    """Digest and times of every file and folder: equal only if nothing was written."""
    found = {}
    for path in [folder, *folder.rglob("*")]:
        stat = path.stat()
        data = hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""
        found[path.as_posix()] = (stat.st_mtime_ns, stat.st_size, data)
    return found


def stage_commands(project: Path) -> list[list[str]]:
    """Every `treadlight` command of a whole run, as Snakemake would start it."""
    done = run(project, *_SNAKEMAKE, "--forceall", "--dry-run", "--printshellcmds")
    lines = re.findall(r"(treadlight [a-z-]+ .*?) 2> ", done.stdout + done.stderr)
    return [shlex.split(line) for line in dict.fromkeys(lines)]


def copy_project(project: Path, target: Path) -> Path:
    """A project that shares the files of archive and results: these are replaced, never changed."""
    shutil.copytree(project, target, copy_function=_link_or_copy, symlinks=True)
    return target


def _link_or_copy(source: str, target: str) -> None:
    # Snakemake writes into the files that it keeps of a run.
    (shutil.copy2 if "/.snakemake/" in source else os.link)(source, target)


def outputs_of(command: list[str], project: Path) -> list[Path]:
    options = _OUTPUTS.get(command[1], ("--out",))
    return [project / command[command.index(option) + 1] for option in options]


def survive_kill(
    command: list[str], project: Path, reference: dict[str, str], rng: np.random.Generator
) -> str | None:
    """Kill a stage once and run it again; returns what was lost, or None."""
    outputs = outputs_of(command, project)
    if rng.integers(2):
        for output in outputs:  # as Snakemake does before it starts a job again
            output.unlink(missing_ok=True)
    started = time.monotonic()
    process = subprocess.Popen(command, cwd=project, env=environment(), stderr=subprocess.DEVNULL)
    deadline = started + rng.uniform(0, 4)
    if rng.integers(2):
        _wait_for_writing(process, outputs)
        deadline = time.monotonic() + rng.uniform(0, 0.05)
    while process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.001)
    process.send_signal(signal.SIGKILL)
    process.wait()
    if lost := _half_written(outputs) or _others_changed(project, outputs, reference):
        return lost
    done = run(project, *command)
    if done.returncode != 0:
        return f"does not run again: {done.stderr}"
    left = [p for p in (project / "results").rglob(".*.writing*") if p.name[0] == "."]
    if left:
        return f"leaves {left[0]}"
    if digests(project / "results") != reference:
        return "gives other bits afterwards"
    return None


def _wait_for_writing(process: subprocess.Popen, outputs: list[Path]) -> None:
    folders = {store.store_folder(output).parent for output in outputs}
    end = time.monotonic() + _TIMEOUT_S
    while process.poll() is None and time.monotonic() < end:
        for folder in folders:
            if any(".writing." in name for name in os.listdir(folder)):
                return
        time.sleep(0.0005)


def _half_written(outputs: list[Path]) -> str | None:
    for output in outputs:
        if not output.is_file():
            continue
        if output.name == store.ROOT_METADATA:
            store.check_content(output.parent)
        elif output.suffix == ".json":
            store.read_json(output)
        elif not output.read_text(encoding="utf-8").endswith("\n"):
            return f"{output} is half written"
    return None


def _others_changed(project: Path, outputs: list[Path], reference: dict[str, str]) -> str | None:
    results = project / "results"
    own = {store.store_folder(output).relative_to(results).as_posix() for output in outputs}
    for name, digest in digests(results).items():
        if not any(name.startswith(product) for product in own) and reference[name] != digest:
            return f"{name} changed, which the stage does not write"
    return None


def survive_snakemake_kills(
    project: Path,
    reference: dict[str, str],
    count: int,
    rng: np.random.Generator,
    say: Callable[[str], None],
) -> str | None:
    """Kill whole runs, unlock and go on, until there were `count` kills; then compare."""
    shutil.rmtree(project / "results")
    killed = 0
    while killed < count:
        with subprocess.Popen(
            _SNAKEMAKE,
            cwd=project,
            env=environment(),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        ) as process:
            try:
                status = process.wait(rng.uniform(4, 14))
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
                killed += 1
                say(f"snakemake killed {killed} of {count}")
            else:
                if status != 0:
                    return f"snakemake exits {status} after {killed} kills"
                if digests(project / "results") != reference:
                    return f"other bits after {killed} kills"
                shutil.rmtree(project / "results")
                continue
        if (done := run(project, "snakemake", "--unlock")).returncode != 0:
            return f"cannot be unlocked: {done.stderr}"
    done = run(project, *_SNAKEMAKE)
    if done.returncode != 0 or "Traceback" in done.stderr:
        return f"does not end after {killed} kills: {done.stderr[-2000:]}"
    return None if digests(project / "results") == reference else f"other bits after {killed} kills"


def survive_two_at_once(command: list[str], project: Path, reference: dict[str, str]) -> str | None:
    """Two processes of one stage at a time; both end, and the product is whole and the same."""
    both = [
        subprocess.Popen(
            command,
            cwd=project,
            env=environment(),
            stderr=subprocess.PIPE,
            text=True,
        )
        for _ in range(2)
    ]
    said = [process.communicate(timeout=_TIMEOUT_S)[1] for process in both]
    if any("Traceback" in text for text in said):
        return said[0] + said[1]
    if all(process.returncode for process in both):
        return f"neither ends well: {said}"
    return None if digests(project / "results") == reference else "gives other bits"


def survive_little_memory(
    command: list[str], project: Path, reference: dict[str, str], mib: int
) -> str | None:
    """A stage in a small address space ends well or in a sentence, and harms nothing."""
    limited = ("bash", "-c", f'ulimit -v {mib * 1024}; exec "$@"', "bash")
    done = run(project, *limited, *command)
    if done.returncode not in (0, 1) or "Traceback" in done.stderr:
        return f"exits {done.returncode} within {mib} MiB: {done.stderr[-2000:]}"
    last = (done.stderr.splitlines() or [""])[-1]
    if done.returncode == 1 and not (last.startswith("treadlight ") and last.endswith(".")):
        return f"fails without a sentence within {mib} MiB: {last}"
    if lost := _half_written(outputs_of(command, project)):
        return lost
    if (done := run(project, *command)).returncode != 0:
        return f"does not run again: {done.stderr}"
    return None if digests(project / "results") == reference else "gives other bits"
