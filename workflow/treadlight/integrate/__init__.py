"""Heights on the cylinder from photometric slopes, laser sections and the first surface."""

from treadlight.integrate.case import FirstSurface, LaserSections
from treadlight.integrate.gather import View, ViewNormals
from treadlight.integrate.prior import section_spacing
from treadlight.integrate.profile import Profile, integrate_capture
from treadlight.integrate.quality import FLAGS, quality_flags, quality_report
from treadlight.integrate.sectors import Joined, Sector, sectors_of
from treadlight.integrate.settings import IntegrateSettings

__all__ = [
    "FLAGS",
    "FirstSurface",
    "IntegrateSettings",
    "Joined",
    "LaserSections",
    "Profile",
    "Sector",
    "View",
    "ViewNormals",
    "integrate_capture",
    "quality_flags",
    "quality_report",
    "section_spacing",
    "sectors_of",
]
