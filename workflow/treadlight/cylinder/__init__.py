"""Laser sections in the tire frame, the profile's grid, and the first surface r(theta, z)."""

from treadlight.cylinder.extent import Extent, choose_grid, pixel_size_mm, view_extent
from treadlight.cylinder.registration import (
    FLAGS,
    Sections,
    closure_mm,
    on_tops,
    register_sections,
)
from treadlight.cylinder.settings import CylinderSettings
from treadlight.cylinder.smoothing import shared_rows
from treadlight.cylinder.surface import (
    SURFACE_FLAGS,
    Surface,
    first_surface,
    lay_surface,
    nominal_surface,
)

__all__ = [
    "FLAGS",
    "SURFACE_FLAGS",
    "CylinderSettings",
    "Extent",
    "Sections",
    "Surface",
    "choose_grid",
    "closure_mm",
    "first_surface",
    "lay_surface",
    "nominal_surface",
    "on_tops",
    "pixel_size_mm",
    "register_sections",
    "shared_rows",
    "view_extent",
]
