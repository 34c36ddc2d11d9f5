"""A small project, processed; and an archive of damaged captures beside its healthy ones."""

import re
import shutil
from pathlib import Path

import numpy as np
import yaml
from catalogue import LISTED
from damage import change_facts, copy_capture
from kills import ROOT, digests, run

# Of those that `check` must find, whose capture still has an id of its own.
_OWN_ID = ("fact_capture", "two_", "fact_tire__id", "capture_yaml", "_gigabyte", "terabyte")


def make_project(folder: Path) -> Path:
    """A copy of the workflow with a tiny archive, processed once."""
    folder.mkdir(parents=True)
    for name in ("rules", "schemas", "workflow/report"):
        shutil.copytree(ROOT / name, folder / name)
    shutil.copy(ROOT / "Snakefile", folder)
    (folder / "config").mkdir()
    (folder / "config/config.yaml").write_text("archive: archive\nresults: results\n")
    for command in (
        ("treadlight", "simulate", "archive", "--preset", "tiny"),
        ("snakemake", "--cores", "2"),
    ):
        done = run(folder, *command)
        assert done.returncode == 0, done.stderr
    return folder


def captures_of(project: Path) -> tuple[Path, Path]:
    """A measurement and the calibration."""
    kinds = {}
    for path in sorted((project / "archive").glob("*/capture.yaml")):
        kinds.setdefault(yaml.safe_load(path.read_text())["kind"], path.parent)
    return kinds["measurement"], kinds["calibration"]


def survive_in_snakemake(project: Path, count: int) -> str | None:
    """Process damaged captures beside the healthy ones; returns what was lost, or None."""
    reference = digests(project / "results")
    source, _ = captures_of(project)
    chosen = [d for d in LISTED if d.kind == "measurement" and d.verdict == 1]
    chosen = [d for d in chosen if not d.name.startswith(_OWN_ID) and "terabyte" not in d.name]
    names = {}
    for k, damage in enumerate(chosen[:: max(1, len(chosen) // count)][:count]):
        name = f"bad-{k:02d}"
        folder = copy_capture(source, project / "archive" / name)
        change_facts(folder, capture=name, tire__id=f"tire-{k:02d}")
        damage.harm(folder, np.random.default_rng(k))
        names[name] = damage.name
    done = run(project, "snakemake", "--cores", "2")
    said = done.stdout + done.stderr
    if done.returncode != 0 or "Traceback" in said:
        return f"snakemake exits {done.returncode}: {said[-3000:]}"
    status = run(project, "treadlight", "status", "results")
    if status.returncode != 1:
        return f"status exits {status.returncode}"
    for name, damage_name in names.items():
        # Refused with its sentence, or measured with a warning below its line.
        told = re.search(rf"^  {name}: .+|^  {name} \(.*\n    Warning: .+", status.stdout, re.M)
        if told is None:
            return f"status does not tell of {name} ({damage_name}): {status.stdout}"
    now = digests(project / "results")
    healthy = [name for name in reference if name.startswith(("calibrations", "captures", "tires"))]
    changed = [name for name in healthy if now.get(name) != reference[name]]
    return f"healthy products changed: {changed[:3]}" if changed else None
