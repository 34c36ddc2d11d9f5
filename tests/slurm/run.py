"""make test-slurm: a small archive through a real Slurm queue, bit for bit as by a local run.

Starts munge, a controller and a node on this machine, and stops them by their process ids. Ends
with one line of JSON.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from cluster import cluster

ROOT = Path(__file__).resolve().parents[2]
# What the node promises; Slurm counts it, and takes it from no one.
_MEMORY_MB = 64_000
_QUEUE = ("--workflow-profile", "workflow/profiles/slurm", "--slurm-status-command", "squeue")
_SOON = ("--slurm-init-seconds-before-status-checks", "5", "--seconds-between-status-checks", "5")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cores", type=int, default=2)
    cores = parser.parse_args().cores
    with tempfile.TemporaryDirectory(prefix="treadlight-slurm-") as place:
        project = make_project(Path(place) / "project")
        local, local_s = process(project, "local", os.environ, "--cores", str(cores))
        with cluster(cores, _MEMORY_MB) as environment:
            queued, queued_s = process(project, "queued", environment, *_QUEUE, *_SOON)
    names = sorted(local.keys() | queued.keys())
    differing = [name for name in names if local.get(name) != queued.get(name)]
    for name in differing[:20]:
        print(f"differs: {name}", file=sys.stderr)
    figures = {"files": len(names), "differing": len(differing), "cores": cores}
    print(json.dumps(figures | {"local_s": round(local_s), "slurm_s": round(queued_s)}))
    return 1 if differing or not names else 0


def make_project(folder: Path) -> Path:
    """A copy of the workflow beside a tiny archive."""
    folder.mkdir()
    ignore = shutil.ignore_patterns("__pycache__", "*.egg-info")
    for name in ("rules", "schemas", "workflow"):
        shutil.copytree(ROOT / name, folder / name, ignore=ignore)
    shutil.copy(ROOT / "Snakefile", folder)
    (folder / "config").mkdir()
    (folder / "config/config.yaml").write_text("archive: archive\nresults: results\n")
    run(folder, dict(os.environ), "treadlight", "simulate", "archive", "--preset", "tiny")
    return folder


def process(
    project: Path, results: str, environment, *options: str
) -> tuple[dict[str, str], float]:
    """Digests of every product of a run, and the seconds that it took."""
    print(f"{results}: processing", flush=True)
    began = time.monotonic()
    run(project, environment, "snakemake", "--config", f"results={results}", *options)
    took = time.monotonic() - began
    run(project, environment, "treadlight", "verify", results)
    return json.loads((project / results / "products.json").read_text())["files"], took


def run(folder: Path, environment, *command: str) -> None:
    """One program of this environment, with the project's own package."""
    binaries = Path(sys.executable).parent
    done = subprocess.run(
        command,
        cwd=folder,
        env={
            **environment,
            "PYTHONPATH": str(folder / "workflow"),
            "PATH": f"{binaries}{os.pathsep}{environment['PATH']}",
        },
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        sys.exit(
            f"{' '.join(command)} exits {done.returncode}:\n{done.stdout}{done.stderr}"[-6000:]
        )


if __name__ == "__main__":
    sys.exit(main())
