"""An archive of very many captures, tiny images of true number, and a workflow that plans it."""

import csv
import io
import json
import os
import re
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

ROOT = Path(__file__).resolve().parents[3]
SIZE_PX = (32, 48)
_COLUMNS = ("file", "kind", "pose", "led", "encoder_deg", "exposure_s", "sha256")
_SNAKEMAKE = "from snakemake.cli import main; main()"
# --touch rests a tenth of a second at each job, which is most of an hour here.
_HASTY = f"from snakemake.executors.touch import Executor; Executor.SLEEPING_TIME = 0; {_SNAKEMAKE}"
_CALIBRATION_FRAMES = {"board": 20, "board_laser": 20, "axis_board": 12}


@dataclass(frozen=True)
class Size:
    """How large the archive is: captures and of each its laser sections, views and LEDs."""

    captures: int = 1000
    sections: int = 200
    views: int = 17
    leds: int = 16
    captures_per_tire: int = 5

    @property
    def images(self) -> int:
        """Of one capture."""
        return self.sections + self.views * self.leds


@dataclass(frozen=True)
class Run:
    """What one call of Snakemake said and took: wall clock, processor time, largest memory."""

    status: int
    output: str
    wall_s: float
    cpu_s: float
    peak_bytes: int

    @property
    def jobs(self) -> dict[str, int]:
        """Planned jobs by rule, but for `all`."""
        table = re.search(r"^job +count\n[- ]+\n(.*?)^total", self.output, re.M | re.S)
        rows = table.group(1).split("\n") if table else []
        counts = {row.split()[0]: int(row.split()[1]) for row in rows if row.strip()}
        counts.pop("all", None)
        return counts


class Crowd:
    """The archive, its results, and the working folder that Snakemake plans them in."""

    def __init__(self, folder: Path, size: Size):
        self.folder, self.size = folder, size
        self.archive, self.results = folder / "archive", folder / "results"

    def write(self) -> None:
        """Every capture anew, and no results."""
        shutil.rmtree(self.folder, ignore_errors=True)
        self.archive.mkdir(parents=True)
        (self.folder / "config.yaml").write_text("archive: archive\nresults: results\n")
        self._write_calibration()
        for number in range(self.size.captures):
            self.add(number)

    def name(self, number: int) -> str:
        return f"c{number:04d}"

    @property
    def names(self) -> list[str]:
        return [self.name(number) for number in range(self.size.captures)]

    def inventories(self) -> list[str]:
        """The first product of each measurement, by its target's name."""
        return [f"results/captures/{name}/inventory.json" for name in self.names]

    def block(self, number: int) -> str:
        """Make the first job of a capture fail: a folder lies where its provenance goes."""
        name = self.name(number)
        (self.results / f"captures/{name}/inventory.json.provenance.json").mkdir(parents=True)
        return name

    def uninspected(self) -> list[str]:
        """Captures without an inventory."""
        return [
            name
            for name, path in zip(self.names, self.inventories(), strict=True)
            if not (self.folder / path).is_file()
        ]

    def add(self, number: int) -> None:
        """One measurement; its images are one file under many names, and no other capture's."""
        size = self.size
        tire, mileage = divmod(number, size.captures_per_tire)
        facts = {
            **_facts("measurement", self.name(number), size.leds),
            "tire": {
                "id": f"t{tire:03d}",
                "size": "215/70R16",
                "nominal_radius_mm": 355.0,
                "tread_width_mm": 215.0,
            },
            "mileage": {"value": 100 * (mileage + 1), "unit": "mi"},
        }
        rows = [
            {"kind": "laser", "pose": k, "encoder_deg": round(k * 360 / size.sections, 3)}
            for k in range(size.sections)
        ]
        rows += [
            {"kind": "led", "pose": v, "led": k, "encoder_deg": round(v * 360 / size.views, 3)}
            for v in range(size.views)
            for k in range(size.leds)
        ]
        self._write_capture(facts, rows, seed=number)

    def _write_calibration(self) -> None:
        board = {"inner_corners": [9, 6], "square_mm": 15.0}
        facts = {
            **_facts("calibration", "rig-1", self.size.leds),
            "board": board,
            "axis_board": board,
            "balls": {"count": 15, "diameter_mm": 12.7, "centre_height_mm": 6.35},
            "card": {"albedo": 0.18},
        }
        rows: list[dict] = [{"kind": "reference_board"}]
        for kind, count in _CALIBRATION_FRAMES.items():
            rows += [{"kind": kind, "pose": k, "encoder_deg": k} for k in range(count)]
        for kind in ("balls", "card"):
            rows += [{"kind": kind, "led": k} for k in range(self.size.leds)]
        self._write_capture(facts, rows, seed=self.size.captures)

    def _write_capture(self, facts: dict, rows: list[dict], seed: int) -> None:
        folder = self.archive / facts["capture"]
        counts = np.random.default_rng(seed).integers(0, 4096, (SIZE_PX[1], SIZE_PX[0]), np.uint16)
        image = cv2.imencode(".png", counts)[1].tobytes()
        for kind in {row["kind"] for row in rows}:
            (folder / kind).mkdir(parents=True)
        first = None
        table = io.StringIO()
        writer = csv.DictWriter(table, _COLUMNS, restval="", lineterminator="\n")
        writer.writeheader()
        for k, row in enumerate(rows):
            path = folder / row["kind"] / f"{k:03d}.png"
            if first is None:
                first = path
                path.write_bytes(image)
            else:
                os.link(first, path)
            writer.writerow({"file": path.relative_to(folder).as_posix(), **row})
        (folder / "frames.csv").write_text(table.getvalue())
        # JSON is YAML.
        (folder / "capture.yaml").write_text(json.dumps(facts, indent=1))

    def snakemake(self, *arguments: str, program: str = _SNAKEMAKE) -> Run:
        """One call, with this Python's package; what it said is kept whole."""
        command = [sys.executable, "-c", program, "--cores", "2"]
        command += ["--snakefile", str(ROOT / "Snakefile"), "--directory", str(self.folder)]
        command += [*arguments, "--configfile", str(self.folder / "config.yaml")]
        environment = os.environ | {"PYTHONPATH": str(ROOT / "workflow")}
        with (self.folder / "said.txt").open("w+") as said:
            began = time.monotonic()
            process = subprocess.Popen(
                command, cwd=self.folder, env=environment, stdout=said, stderr=said
            )
            _, status, usage = os.wait4(process.pid, 0)
            wall = time.monotonic() - began
            said.seek(0)
            text = said.read()
        return Run(
            os.waitstatus_to_exitcode(status),
            text,
            wall,
            usage.ru_utime + usage.ru_stime,
            usage.ru_maxrss << 10,
        )

    def pretend(self) -> Run:
        """Make every product, hollow, and tell Snakemake that all is done."""
        for line in self.snakemake("--summary").output.splitlines():
            name = line.partition("\t")[0]
            if name.startswith(self.results.name + "/"):
                path = self.folder / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.touch()
        empty = {"tires": {}, "calibration_of": {}, "refused": {}, "warnings": {}}
        (self.results / "archive.json").write_text(json.dumps(empty))
        return self.snakemake("--touch", "--forceall", program=_HASTY)


def jobs_of_one_more(size: Size) -> dict[str, int]:
    """What one capture more of a new tire must plan, and no more: its own, its tire's, the page."""
    stages = ("inspect_capture", "detect_laser_pixels", "triangulate", "register_to_cylinder")
    after = ("integrate", "wear", "report", "list_archive", "index")
    return {"photometric_stereo": size.views} | dict.fromkeys(stages + after, 1)


def _facts(kind: str, name: str, leds: int) -> dict:
    return {
        "format": "tread-capture/1",
        "kind": kind,
        "capture": name,
        "captured_at": "2026-02-01T10:00:00Z" if kind == "measurement" else "2026-01-05T08:00:00Z",
        "rig": "rig-1",
        "camera": {
            "size_px": list(SIZE_PX),
            "encoding": "linear",
            "black_level": 0,
            "white_level": 4095,
        },
        "laser": {"scan": "rows", "channel": "red"},
        "leds": leds,
    }
