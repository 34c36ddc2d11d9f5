"""Pages for people: figures, a tire's report, the archive at a glance."""

from treadlight.report.archive_page import ArchivePage, CaptureLine, TireCard, archive_page
from treadlight.report.figures import (
    Map,
    box_figure,
    map_figure,
    section_figure,
    thumbnail,
    trend_figure,
)
from treadlight.report.reduce import block_size, reduce_map
from treadlight.report.tire_page import CaptureFacts, TirePage, tire_page

__all__ = [
    "ArchivePage",
    "CaptureFacts",
    "CaptureLine",
    "Map",
    "TireCard",
    "TirePage",
    "archive_page",
    "block_size",
    "box_figure",
    "map_figure",
    "reduce_map",
    "section_figure",
    "thumbnail",
    "tire_page",
    "trend_figure",
]
