"""Camera, planes, lights, the rotation axis and the tire frame {T}; knows no file, no image."""

from treadlight.geometry.axis import Axis
from treadlight.geometry.camera import Camera
from treadlight.geometry.grid import CylinderGrid
from treadlight.geometry.light import Illumination, Vignetting
from treadlight.geometry.plane import Plane
from treadlight.geometry.rig import Led, Rig

__all__ = ["Axis", "Camera", "CylinderGrid", "Illumination", "Led", "Plane", "Rig", "Vignetting"]
