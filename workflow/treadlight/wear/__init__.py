"""Wear between captures of one tire: alignment of the remounted tire, difference, trend."""

from treadlight.wear.alignment import Alignment, align
from treadlight.wear.motion import PARAMETERS, Motion
from treadlight.wear.settings import WearSettings
from treadlight.wear.surface import Surface, relief_from, wear_block
from treadlight.wear.tally import RegionTally, region_names, tally_rows
from treadlight.wear.trend import Stay, convert_mileage, csv_text, trend_rows

__all__ = [
    "PARAMETERS",
    "Alignment",
    "Motion",
    "RegionTally",
    "Stay",
    "Surface",
    "WearSettings",
    "align",
    "convert_mileage",
    "csv_text",
    "region_names",
    "relief_from",
    "tally_rows",
    "trend_rows",
    "wear_block",
]
