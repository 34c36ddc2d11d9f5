"""A sector of a tire at full size: one view of 16 LED frames and 12 sections, from the simulator.

The rig is the simulator's own, so that no calibration capture need be rendered and solved first:
calibration.json and illumination.zarr hold what is true.
"""

import csv
import shutil
from pathlib import Path

import cv2
import numpy as np
import xarray as xr
import yaml

from treadlight import store
from treadlight.archive import Capture, read_capture
from treadlight.archive.manifest import Encoding
from treadlight.calibrate.beams import Beam, radiant_intensity_maps
from treadlight.calibrate.illumination import map_step
from treadlight.geometry.light import map_nodes
from treadlight.simulate import Simulation, SimulationSettings, sensor
from treadlight.simulate.plan import GAIN_PER_S
from treadlight.simulate.render import REFERENCE_DISTANCE_MM
from treadlight.simulate.rig import BEAM_COS_POWER

# The dissertation's camera, and its sections 1.8 degrees apart.
SETTINGS = SimulationSettings(
    size_px=(5120, 7680), sector_deg=21.6, sections=12, views=1, mileages=(100.0,)
)


def render(folder: Path, say) -> Path:
    """The capture's folder; it is rendered only where it is not there yet."""
    simulation = Simulation(SETTINGS)
    name = simulation.ids[1]
    if not (folder / name / "capture.yaml").is_file():
        folder.mkdir(parents=True, exist_ok=True)
        simulation.write(name, folder, say)
    return folder / name
