"""What must hold for a damaged capture: one plain sentence, no traceback, no hang, no harm."""

import contextlib
import io
import re
import shutil
import signal
import traceback
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from damage import Damage, copy_capture

from treadlight import store
from treadlight.archive import read_capture
from treadlight.cli import main
from treadlight.errors import CaptureError
from treadlight.planning.frames import FrameDigests

TIMEOUT_S = 120
# Said every few seconds: on a slow machine more.
_PROGRESS = re.compile(r": \d+ of \d+$")


@dataclass(frozen=True)
class Healthy:
    """A healthy capture of each kind, and the results that its stages need."""

    measurement: Path
    calibration: Path
    results: Path


class Hang(BaseException):
    """It took too long."""


def run_quietly(*arguments: object) -> tuple[int, list[str]]:
    """Exit status and lines of the error output of one command, but how far it was."""
    said = io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        status = main([str(argument) for argument in arguments])
    lines = said.getvalue().splitlines()
    return status, [line for line in lines if not _PROGRESS.search(line)]


def survive(damage: Damage, healthy: Healthy, place: Path) -> str | None:
    """Damage a copy, check it, run the stages that read it; returns what was lost, or None."""

    def hang(*_: object) -> None:
        raise Hang

    signal.signal(signal.SIGALRM, hang)
    signal.alarm(TIMEOUT_S)
    try:
        source = getattr(healthy, damage.kind)
        folder = copy_capture(source, place / source.name)
        damage.harm(folder, np.random.default_rng(list(damage.name.encode())))
        return _judge(damage, healthy, folder, place)
    except Hang:
        return f"hangs for more than {TIMEOUT_S} s"
    except BaseException:
        return traceback.format_exc()
    finally:
        signal.alarm(0)
        shutil.rmtree(place, ignore_errors=True)


def _judge(damage: Damage, healthy: Healthy, folder: Path, place: Path) -> str | None:
    status, told = run_quietly("check", folder)
    if status not in (0, 1) or (damage.verdict is not None and status != damage.verdict):
        return f"check exits {status}: {told}"
    if bool(told) != (status == 1):
        return f"check exits {status} and says {told}"
    if lost := _unplain(told, folder):
        return lost
    planned = _plan(folder, place)
    if planned is not None:
        return _unplain([planned], folder) or (None if status == 1 else "only planning refuses it")
    stages = _measure if damage.kind == "measurement" else _calibrate
    said, doubted = stages(healthy, folder, place / "out")
    if damage.pixels and not doubted:
        return "no stage refuses or warns"
    return _unplain(said, folder)


def _unplain(lines: list[str], folder: Path) -> str | None:
    """What is wrong with sentences that a user reads."""
    for line in lines:
        if not line.isprintable() or "Traceback" in line or "defect" in line:
            return f"not plain: {line}"
        if len(line) > 3000 or not line.endswith((".", ".)")):
            return f"no sentence: {line}"
    if lines and not any(folder.name in line for line in lines):
        return f"names no file: {lines}"
    return None


def _plan(folder: Path, place: Path) -> str | None:
    """Why the capture is left out when the DAG is built."""
    try:
        FrameDigests(place / "memory").check(read_capture(folder))
    except CaptureError as error:
        return str(error)
    return None


def _measure(healthy: Healthy, folder: Path, out: Path) -> tuple[list[str], bool]:
    """Run the stages that read images; sentences, and whether any product is in doubt."""
    capture = read_capture(folder)
    pixels = out / "laser_pixels.zarr"
    commands = [(pixels, ("detect-laser-pixels", folder, "--out", pixels))]
    done = healthy.results / "captures" / healthy.measurement.name
    calibration = healthy.results / "calibrations" / healthy.calibration.name
    for view in capture.views[:2]:
        product = out / f"fov{view:02d}"
        command = ("photometric-stereo", folder, "--view", view, "--calibration",
                   calibration / "calibration.json", "--illumination",
                   calibration / "illumination.zarr", "--surface", done / "surface.zarr",
                   "--out", product)  # fmt: skip
        commands.append((product, command))
    return _run_all(commands)


def _calibrate(healthy: Healthy, folder: Path, out: Path) -> tuple[list[str], bool]:
    camera = out / "camera.json"
    commands = [(camera, ("calibrate-camera", folder, "--out", camera))]
    for part in ("laser-plane", "axis", "leds"):
        product = out / f"{part}.json"
        command = (f"calibrate-{part}", folder, "--camera", camera, "--out", product)
        commands.append((product, command))
    return _run_all(commands)


def _run_all(commands: list[tuple[Path, tuple[object, ...]]]) -> tuple[list[str], bool]:
    said: list[str] = []
    doubted = False
    for product, command in commands:
        status, lines = run_quietly(*command)
        if status != 0:
            said += lines[-1:] or [f"{command[0]} exits {status} and says nothing"]
            doubted = True
            continue
        if product.suffix == ".json":
            content = store.read_json(product)
        else:
            content = dict(store.open_store(product).attrs)
        sentences = [content["refused"]] if "refused" in content else content.get("warnings", [])
        doubted |= bool(sentences)
        if any("defect" in sentence for sentence in sentences):
            said += sentences
    return said, doubted
