"""Heights on the cylinder from photometric slopes, laser sections and the first surface."""

from treadlight.integrate.bands import Band, Joined, bands_of
from treadlight.integrate.case import FirstSurface, Found, LaserSections
from treadlight.integrate.cells import sampled, solved_grid, thinned, width_of_cells
from treadlight.integrate.gather import View, ViewNormals
from treadlight.integrate.profile import (
    Profile,
    integrate_capture,
    profile_of,
    solve_capture,
)
from treadlight.integrate.quality import FLAGS, quality_flags, quality_report
from treadlight.integrate.settings import IntegrateSettings

__all__ = [
    "FLAGS",
    "Band",
    "FirstSurface",
    "Found",
    "IntegrateSettings",
    "Joined",
    "LaserSections",
    "Profile",
    "View",
    "ViewNormals",
    "bands_of",
    "integrate_capture",
    "profile_of",
    "quality_flags",
    "quality_report",
    "sampled",
    "solve_capture",
    "solved_grid",
    "thinned",
    "width_of_cells",
]
