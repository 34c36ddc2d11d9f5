"""The renderer of the demo and the tests; no other stage imports it."""

from treadlight.simulate.archive import Simulation, write_archive
from treadlight.simulate.settings import PRESETS, SimulationSettings, preset

__all__ = ["PRESETS", "Simulation", "SimulationSettings", "preset", "write_archive"]
