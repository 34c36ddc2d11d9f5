"""Surface normals from images under single LEDs; knows no file."""

from treadlight.photometric.dps import dps, dps_l1
from treadlight.photometric.map import map_normals
from treadlight.photometric.methods import METHODS
from treadlight.photometric.nips import nips
from treadlight.photometric.observations import Estimate, Observations
from treadlight.photometric.settings import PhotometrySettings
from treadlight.photometric.sps import sps
from treadlight.photometric.view import View, ViewNormals, observe_view, solve_view

__all__ = [
    "METHODS",
    "Estimate",
    "Observations",
    "PhotometrySettings",
    "View",
    "ViewNormals",
    "dps",
    "dps_l1",
    "map_normals",
    "nips",
    "observe_view",
    "solve_view",
    "sps",
]
