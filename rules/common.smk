"""What the rules share: the archive, the config, and where products live."""

import functools
import json
import os
import shlex
import sys
import time
from pathlib import Path

from snakemake.exceptions import WorkflowError

from treadlight import store
from treadlight.archive import find_archive
from treadlight.archive.manifest import CALIBRATION_KINDS, MEASUREMENT_KINDS
from treadlight.commands.common import TERMINAL
from treadlight.commands.status import describe, read_outcome
from treadlight.errors import TreadlightError, sentence_of
from treadlight.planning.code import code_digest
from treadlight.planning.config import complete_config, load_schema
from treadlight.planning.frames import FrameDigests, facts_digest

# Jobs find `treadlight` beside the Python that runs Snakemake, activated or not.
shell.prefix(
    f"set -euo pipefail; PATH={shlex.quote(os.path.dirname(sys.executable))}:$PATH; "
)

# Long jobs say how far they are in their log, and here too if there is somebody to read it.
if sys.stderr.isatty():
    os.environ[TERMINAL] = "1"

try:
    config_source = ", ".join(map(str, workflow.configfiles)) or "config"
    CONFIG = complete_config(
        config,
        load_schema(Path(workflow.basedir) / "schemas/config.schema.yaml"),
        config_source,
    )
except TreadlightError as error:
    raise WorkflowError(str(error)) from None

STARTED = time.time()
RESULTS = CONFIG["results"].rstrip("/")
PASSES = CONFIG["passes"]
DIGESTS = FrameDigests(Path(RESULTS) / ".treadlight/frames")
try:
    ARCHIVE = find_archive(
        Path(CONFIG["archive"]),
        CONFIG["include"],
        CONFIG["exclude"],
        CONFIG["calibrations"],
        DIGESTS.check,
    )
except OSError as error:
    raise WorkflowError(sentence_of(error)) from None
if not ARCHIVE.measurements and not ARCHIVE.calibrations and not ARCHIVE.refused:
    raise WorkflowError(
        f"{config_source}: 'archive' is {CONFIG['archive']!r}, where no capture.yaml is found"
        " that 'include' and 'exclude' let through. Name the folder that holds the captures."
    )
# A job's start, and the first one's compiling of the kernels.
_FIXED_MINUTES = 15
CAPTURES = ARCHIVE.measurements | ARCHIVE.calibrations

# Files of `snakemake export` by the format that `treadlight export` knows them by.
EXPORTS = {
    "mesh.ply": "mesh",
    "points.ply": "points",
    "height.x3p": "x3p",
    "height.gwy": "gwy",
    "profile.nc": "netcdf",
    "height.png": "png",
    "areal.csv": "areal",
}


wildcard_constraints:
    capture="|".join(map(re.escape, CAPTURES)) or "none",
    calibration="|".join(map(re.escape, ARCHIVE.calibrations)) or "none",
    tire="|".join(map(re.escape, ARCHIVE.tires)) or "none",
    export="|".join(map(re.escape, EXPORTS)),
    view=r"\d\d+",
    round=r"(pass\d+/)?",


def product(path):
    """Where a product lives; a zarr store is named by its root metadata."""
    name = path.rpartition("/")[2]
    is_store = name.endswith(".zarr") or name.startswith("fov")
    return f"{RESULTS}/{path}/zarr.json" if is_store else f"{RESULTS}/{path}"


def name_of(wildcards):
    return wildcards.get("capture") or wildcards.get("calibration")


def folder_of(wildcards):
    """The capture's folder; it is no input, since its frames' digests are params."""
    return str(CAPTURES[name_of(wildcards)].folder)


@functools.cache
def facts_of_capture(name):
    return facts_digest(CAPTURES[name])


def facts_of(wildcards):
    return facts_of_capture(name_of(wildcards))


def frames_of(*kinds):
    """A function of the wildcards: one digest over the frames of these kinds."""

    def digest(wildcards):
        capture = CAPTURES[name_of(wildcards)]
        return DIGESTS.of_frames(
            capture, [f for f in capture.frames if f.kind in kinds]
        )

    return digest


def frames_of_view(wildcards):
    capture = CAPTURES[wildcards.capture]
    return DIGESTS.of_frames(
        capture, [*capture.view(int(wildcards.view)), *capture.of_kind("dark")]
    )


def calibration_of(wildcards):
    return product(
        f"calibrations/{ARCHIVE.calibration_of[wildcards.capture]}/calibration.json"
    )


def illumination_of(wildcards):
    return product(
        f"calibrations/{ARCHIVE.calibration_of[wildcards.capture]}/illumination.zarr"
    )


def warnings_of(wildcards):
    warning = ARCHIVE.warnings.get(wildcards.capture)
    return ["--warning", warning] if warning else []


def settings(section):
    """One stage's part of the config as JSON, so that no other key reruns the stage."""
    return json.dumps(CONFIG[section], sort_keys=True)


def memory_of(bytes_per_pixel, fixed_mb=700, most_mb=float("inf")):
    """Memory of a job that holds this much per pixel of an image; a failed job gets more."""

    def mem_mb(wildcards, attempt):
        asked = fixed_mb + bytes_per_pixel * megapixels_of(wildcards)
        return attempt * int(min(asked, most_mb))

    return mem_mb


def memory_of_cells(bytes_per_cell):
    """MB for as many cells as are solved together, and for a band of pixels."""
    return 2000 + int(bytes_per_cell * CONFIG["integrate"]["most_cells"] / 1e6)


def runtime_of(seconds_per_megapixel, *kinds):
    """Minutes for a job that works on every frame of these kinds, of its view if it has one."""

    def runtime(wildcards, attempt):
        frames = frame_count(name_of(wildcards), kinds, wildcards.get("view"))
        seconds = seconds_per_megapixel * frames * megapixels_of(wildcards)
        return attempt * (_FIXED_MINUTES + int(seconds / 60))

    return runtime


@functools.cache
def frame_count(name, kinds, view):
    if view:
        return len(CAPTURES[name].view(int(view)))
    return sum(frame.kind in kinds for frame in CAPTURES[name].frames)


def of_largest(resource):
    """A resource of a tire's job: what its largest capture takes."""
    return lambda wildcards, attempt: max(
        resource({"capture": capture}, attempt)
        for capture in ARCHIVE.tires[wildcards.tire]
    )


def megapixels_of(wildcards):
    """Of one image."""
    width, height = CAPTURES[name_of(wildcards)].encoding.size_px
    return width * height / 1e6


def surface_of(wildcards):
    """The surface that a round of photometry stands on: the laser's, then the last round's."""
    number = int(wildcards.round[4:-1]) if wildcards.round else PASSES
    before = f"pass{number - 1}/profile.zarr" if number > 1 else "surface.zarr"
    return product(f"captures/{wildcards.capture}/{before}")


def views_of(wildcards):
    return [
        product(
            f"captures/{wildcards.capture}/{wildcards.round}photometric.zarr/fov{view:02d}"
        )
        for view in ARCHIVE.measurements[wildcards.capture].views
    ]


def of_tire(name):
    """A function of the wildcards: this product of every capture of the tire, in order."""
    return lambda wildcards: [
        product(f"captures/{capture}/{name}")
        for capture in ARCHIVE.tires[wildcards.tire]
    ]


def calibration_files_of_tire(wildcards):
    """What the report draws of every calibration that the tire's captures take."""
    names = {ARCHIVE.calibration_of[c] for c in ARCHIVE.tires[wildcards.tire]}
    return [
        product(f"calibrations/{name}/{part}.json")
        for name in sorted(names)
        for part in ("camera", "laser_plane", "leds")
    ]


def facts_of_tire(name):
    """What the tire's first capture says of it, as JSON: size, outboard side and the like."""
    tire = ARCHIVE.measurements[ARCHIVE.tires[name][0]].tire
    return json.dumps({"size": tire.size, **tire.facts}, sort_keys=True, default=str)


def archive_state():
    """What the archive holds, as JSON: tires, choice of calibration, refused captures."""
    return json.dumps(
        {
            "tires": ARCHIVE.tires,
            "calibration_of": ARCHIVE.calibration_of,
            "calibrations": sorted(ARCHIVE.calibrations),
            "refused": ARCHIVE.refused,
            "warnings": ARCHIVE.warnings,
        },
        sort_keys=True,
    )


def say_result():
    """What was refused and why, and where to look; said at the end of every run."""
    state = Path(RESULTS) / "archive.json"
    if state.is_file():
        print("\n".join(describe(read_outcome(Path(RESULTS), state))), file=sys.stderr)


def say_failure(log):
    """What the failed stages said last, each in its own log."""
    logs = sorted((Path(RESULTS) / "logs").rglob("*.log"))
    recent = [path for path in logs if path.stat().st_mtime >= STARTED]
    said = [
        (path.read_text(errors="replace").splitlines() or [""])[-1] for path in recent
    ]
    print(
        *(line for line in said if line.startswith("treadlight ")),
        f"Something failed: its own log under {RESULTS}/logs says what. Run the same command"
        " again, with --rerun-incomplete, to go on from there.",
        sep="\n",
        file=sys.stderr,
    )
