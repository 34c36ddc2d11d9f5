"""The laser line in the image, sub-pixel, and the points where its rays meet the laser plane."""

from treadlight.laser.detection import FLAGS, Candidates, LineModel, detect_section
from treadlight.laser.line_model import learn_line_model
from treadlight.laser.path import select_path
from treadlight.laser.peak_kernels import PEAKS
from treadlight.laser.triangulation import triangulate_pixels

__all__ = [
    "FLAGS",
    "PEAKS",
    "Candidates",
    "LineModel",
    "detect_section",
    "learn_line_model",
    "select_path",
    "triangulate_pixels",
]
