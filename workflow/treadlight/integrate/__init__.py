"""Heights on the cylinder from photometric slopes, laser sections and the first surface."""

from treadlight.integrate.bands import Band, Joined, bands_of
from treadlight.integrate.binning import views_for_cells
from treadlight.integrate.case import FirstSurface, Found, LaserSections
from treadlight.integrate.cells import sampled, solved_grid, thinned, width_of_cells
from treadlight.integrate.gather import FLAGS as VIEW_FLAGS
from treadlight.integrate.gather import View, ViewNormals
from treadlight.integrate.profile import (
    Profile,
    integrate_capture,
    profile_of,
    solve_capture,
)
from treadlight.integrate.quality import FLAGS, quality_flags, quality_report
from treadlight.integrate.settings import IntegrateSettings
from treadlight.integrate.sight import ASIDE_MM, angles_of_chunks, sees

__all__ = [
    "ASIDE_MM",
    "FLAGS",
    "VIEW_FLAGS",
    "Band",
    "FirstSurface",
    "Found",
    "IntegrateSettings",
    "Joined",
    "LaserSections",
    "Profile",
    "View",
    "ViewNormals",
    "angles_of_chunks",
    "bands_of",
    "integrate_capture",
    "profile_of",
    "quality_flags",
    "quality_report",
    "sampled",
    "sees",
    "solve_capture",
    "solved_grid",
    "thinned",
    "views_for_cells",
    "width_of_cells",
]
