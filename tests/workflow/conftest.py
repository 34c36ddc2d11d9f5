"""A project of its own with a tiny archive, processed once; tests plan changes against it."""

import fcntl
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Project:
    """A copy of the rules beside an archive, both free to change.

    The package is this one, at one path for all projects or each would compile its kernels again;
    tests that change it name a copy.
    """

    folder: Path
    package: Path = ROOT / "workflow"

    @property
    def archive(self) -> Path:
        return self.folder / "archive"

    @property
    def results(self) -> Path:
        return self.folder / "results"

    @property
    def network_log(self) -> Path:
        """What asked for a network, one line each; no such file where nothing did."""
        return self.folder / "network.log"

    def run(self, *arguments: str, check: bool = True) -> subprocess.CompletedProcess:
        """Run a program in the project's folder, with its package and without network."""
        offline = Path(__file__).parent / "offline"
        environment = os.environ | {
            "PYTHONPATH": f"{offline}{os.pathsep}{self.package}",
            "NETWORK_LOG": str(self.network_log),
        }
        program = str(Path(sys.executable).parent / arguments[0])
        done = subprocess.run(
            [program, *arguments[1:]],
            cwd=self.folder,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert not check or done.returncode == 0, done.stdout + done.stderr
        return done

    def snakemake(self, *arguments: str, check: bool = True) -> subprocess.CompletedProcess:
        return self.run("snakemake", "--cores", "2", *arguments, check=check)

    def planned(self, *arguments: str) -> dict[str, int]:
        """Jobs by rule that a dry run plans, but for `all`."""
        done = self.snakemake("--dry-run", *arguments)
        table = re.search(r"^job +count\n[- ]+\n(.*?)^total", done.stdout, re.M | re.S)
        rows = table.group(1).split("\n") if table else []
        counts = {row.split()[0]: int(row.split()[1]) for row in rows if row.strip()}
        counts.pop("all", None)
        return counts

    def copy(self, folder: Path) -> "Project":
        """The same project elsewhere, times of files kept."""
        shutil.copytree(self.folder, folder, symlinks=True)
        return replace(self, folder=folder)


@pytest.fixture(scope="session")
def made_once(tmp_path_factory, worker_id) -> Project:
    """The tiny archive, processed on two cores by the first worker that asks."""
    shared = tmp_path_factory.getbasetemp()
    if worker_id != "master":
        shared = shared.parent
    project = Project(shared / "processed")
    with (shared / "processed.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (shared / "processed.done").exists():
            _process(project)
            (shared / "processed.done").touch()
    return project


@pytest.fixture(scope="module")
def processed(made_once, tmp_path_factory) -> Project:
    """A copy for one module, whose tests put back what they change."""
    return made_once.copy(tmp_path_factory.mktemp("project") / "p")


def _process(project: Project) -> None:
    project.folder.mkdir()
    for name in ("rules", "schemas", "workflow/report"):
        shutil.copytree(ROOT / name, project.folder / name)
    shutil.copy(ROOT / "Snakefile", project.folder)
    (project.folder / "config").mkdir()
    (project.folder / "config/config.yaml").write_text("archive: archive\nresults: results\n")
    project.run("treadlight", "simulate", "archive", "--preset", "tiny")
    project.snakemake()
