"""Surface normals from images under single LEDs; knows no file."""

from treadlight.photometric.dps import dps
from treadlight.photometric.observations import Estimate, Observations
from treadlight.photometric.settings import PhotometrySettings
from treadlight.photometric.sps import sps
from treadlight.photometric.view import View, ViewNormals, solve_view

__all__ = [
    "Estimate",
    "Observations",
    "PhotometrySettings",
    "View",
    "ViewNormals",
    "dps",
    "solve_view",
    "sps",
]
