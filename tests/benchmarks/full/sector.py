"""A sector of a tire: one view of 16 LED frames and 12 sections, from the simulator.

The rig is the simulator's own, so that no calibration capture need be rendered and solved first:
calibration.json and illumination.zarr hold what is true.
"""

import csv
import multiprocessing
import shutil
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import xarray as xr
import yaml

from treadlight import store
from treadlight.calibrate.beams import Beam, radiant_intensity_maps
from treadlight.calibrate.illumination import map_step
from treadlight.geometry.light import map_nodes
from treadlight.simulate import Simulation, SimulationSettings, sensor
from treadlight.simulate.plan import GAIN_PER_S
from treadlight.simulate.render import REFERENCE_DISTANCE_MM
from treadlight.simulate.rig import BEAM_COS_POWER

# Width and height of the dissertation's camera, px.
FULL = (5120, 7680)


@dataclass(frozen=True)
class Sector:
    """What the stages read; `sections` is the same capture's laser frames alone, as 8-bit RGB."""

    capture: Path
    sections: Path
    calibration: Path
    illumination: Path


def make(folder: Path, size_px: tuple[int, int], say: Callable[[str], None]) -> Sector:
    """A sector with images of this size; it is rendered only where it is not there yet."""
    # By a process of its own: the stages' largest memory begins at that of what starts them.
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(_make, folder, size_px, say).result()


def _make(folder: Path, size_px: tuple[int, int], say: Callable[[str], None]) -> Sector:
    simulation = Simulation(_settings(size_px))
    capture = _render(simulation, folder / "archive", say)
    return Sector(capture, _with_8_bits(capture, folder), *_write_calibration(simulation, folder))


def _settings(size_px: tuple[int, int]) -> SimulationSettings:
    """The dissertation's sections are 1.8 degrees apart."""
    return SimulationSettings(
        size_px=size_px, sector_deg=21.6, sections=12, views=1, mileages=(100.0,)
    )


def _render(simulation: Simulation, folder: Path, say: Callable[[str], None]) -> Path:
    name = simulation.ids[1]
    if not (folder / name / "capture.yaml").is_file():
        folder.mkdir(parents=True, exist_ok=True)
        simulation.write(name, folder, say)
    return folder / name


def _write_calibration(simulation: Simulation, folder: Path) -> tuple[Path, Path]:
    """calibration.json and illumination.zarr of the simulated rig, made from what is true of it."""
    sim = simulation.sim
    camera, plane = sim.camera, sim.reference_plane
    content = {
        "camera": {
            "matrix": camera.matrix,
            "distortion": camera.distortion,
            "size_px": list(camera.size_px),
        },
        "laser_plane": {"coefficients": [*sim.laser_plane.normal, sim.laser_plane.offset]},
        "axis": {"direction": sim.axis.direction, "point": sim.axis.point},
        "reference_plane": {"coefficients": [*plane.normal, plane.offset]},
        "leds": [
            {"led": led.number, "position": led.position, "intensity": led.intensity}
            for led in sim.rig.leds
        ],
        "covariance": {"order": [], "matrix": []},
    }
    store.write_json(folder / "calibration.json", content)
    # A light of 1 fills the sensor from its black level on.
    full = GAIN_PER_S * (sensor.WHITE_LEVEL - sensor.BLACK_LEVEL) / np.iinfo(np.uint16).max
    beams = {
        led.number: Beam(full * led.intensity * REFERENCE_DISTANCE_MM**2, axis, BEAM_COS_POWER)
        for led, axis in zip(sim.rig.leds, sim.beams, strict=True)
    }
    flat = dict.fromkeys(beams, lambda pixels: np.ones(len(pixels)))
    maps = radiant_intensity_maps(sim.rig.leds, beams, flat, plane, camera)
    rows, columns = map_nodes(camera.size_px, map_step(camera.size_px))
    text = "irradiance times squared distance of the LED"
    dataset = xr.Dataset(
        {
            "radiant_intensity": store.variable(("led", "v", "u"), maps, "mm2", text),
            "vignetting": store.variable(("coefficient",), np.zeros(3), "1", "none"),
        },
        coords={
            "led": store.variable(("led",), np.array([*beams]), "1", "LED number"),
            "v": store.variable(("v",), rows, "pixel", "image row"),
            "u": store.variable(("u",), columns, "pixel", "image column"),
        },
    )
    out = folder / "illumination.zarr"
    store.write_store(out, dataset, title="Illumination maps", source=simulation.ids[1])
    return folder / "calibration.json", out


def _with_8_bits(capture: Path, folder: Path) -> Path:
    """The same sections as 8-bit RGB and no views, as the dissertation's camera stores them."""
    out = folder / "sections-8-bit"
    if (out / "capture.yaml").is_file():
        return out
    shutil.rmtree(out, ignore_errors=True)
    (out / "laser").mkdir(parents=True)
    rows = list(csv.DictReader((capture / "frames.csv").read_text().splitlines()))
    kept = [row | {"sha256": ""} for row in rows if row["kind"] in ("laser", "dark")]
    for row in kept:
        counts = cv2.imread(str(capture / row["file"]), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(out / row["file"]), (counts >> 8).astype(np.uint8))
    with (out / "frames.csv").open("w", newline="") as stream:
        table = csv.DictWriter(stream, list(rows[0]))
        table.writeheader()
        table.writerows(kept)
    facts = yaml.safe_load((capture / "capture.yaml").read_text())
    facts["camera"] |= {"black_level": 0, "white_level": 255}
    facts["capture"] = out.name
    (out / "capture.yaml").write_text(yaml.safe_dump(facts, sort_keys=False))
    return out
