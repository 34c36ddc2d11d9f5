"""Ribs, circumferential grooves and the reference surface through the groove floors."""

from treadlight.tread.reference import GrooveReference, fit_reference
from treadlight.tread.regions import FLOOR, OTHER, OUTSIDE, TOP, Regions, find_regions
from treadlight.tread.runout import RadialHarmonics, radial_harmonics
from treadlight.tread.void import void_ratio

__all__ = [
    "FLOOR",
    "OTHER",
    "OUTSIDE",
    "TOP",
    "GrooveReference",
    "RadialHarmonics",
    "Regions",
    "find_regions",
    "fit_reference",
    "radial_harmonics",
    "void_ratio",
]
