"""Heights on the cylinder from photometric slopes, laser sections and the first surface."""

from treadlight.integrate.gather import ViewNormals
from treadlight.integrate.profile import (
    FirstSurface,
    LaserSections,
    Profile,
    integrate_capture,
)
from treadlight.integrate.quality import FLAGS, quality_flags, quality_report
from treadlight.integrate.settings import IntegrateSettings

__all__ = [
    "FLAGS",
    "FirstSurface",
    "IntegrateSettings",
    "LaserSections",
    "Profile",
    "ViewNormals",
    "integrate_capture",
    "quality_flags",
    "quality_report",
]
