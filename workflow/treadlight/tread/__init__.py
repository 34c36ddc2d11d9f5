"""Ribs, circumferential grooves and the reference surface through the groove floors."""

from treadlight.tread.reference import GrooveReference, fit_reference
from treadlight.tread.regions import FLOOR, OTHER, OUTSIDE, TOP, Regions, find_regions

__all__ = [
    "FLOOR",
    "OTHER",
    "OUTSIDE",
    "TOP",
    "GrooveReference",
    "Regions",
    "find_regions",
    "fit_reference",
]
