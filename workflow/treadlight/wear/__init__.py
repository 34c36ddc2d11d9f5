"""Wear between captures of one tire: alignment of the remounted tire, difference, trend."""

from treadlight.wear.alignment import Alignment, align
from treadlight.wear.irregular import (
    WORDS,
    Finding,
    WornTread,
    cupping,
    feathering,
    flat_spot,
    heel_and_toe,
    one_sided,
    shoulder_or_centre,
)
from treadlight.wear.motion import PARAMETERS, Motion
from treadlight.wear.regression import Line, fit_line
from treadlight.wear.settings import WearSettings
from treadlight.wear.surface import Surface, relief_from, wear_block
from treadlight.wear.tally import RegionTally, region_names, tally_rows
from treadlight.wear.trend import (
    KM_PER,
    Stay,
    convert_mileage,
    csv_text,
    fit_rate,
    project,
    trend_rows,
)

__all__ = [
    "KM_PER",
    "PARAMETERS",
    "WORDS",
    "Alignment",
    "Finding",
    "Line",
    "Motion",
    "RegionTally",
    "Stay",
    "Surface",
    "WearSettings",
    "WornTread",
    "align",
    "convert_mileage",
    "csv_text",
    "cupping",
    "feathering",
    "fit_line",
    "fit_rate",
    "flat_spot",
    "heel_and_toe",
    "one_sided",
    "project",
    "region_names",
    "relief_from",
    "shoulder_or_centre",
    "tally_rows",
    "trend_rows",
    "wear_block",
]
