"""Pages for people: a tire's report, the archive at a glance."""

from treadlight.report.archive_page import (
    LIGHTS,
    ArchivePage,
    CaptureLine,
    TireCard,
    archive_page,
)
from treadlight.report.charts import (
    Chart,
    Projection,
    RegionTrend,
    box_chart,
    histogram_chart,
    polar_chart,
    projection_chart,
    residual_chart,
    share_chart,
    trend_chart,
)
from treadlight.report.layers import Layer
from treadlight.report.reduce import block_size, reduce_map
from treadlight.report.sentences import Verdict, verdict
from treadlight.report.tables import IrregularWear, RibRunout
from treadlight.report.thumbnail import thumbnail
from treadlight.report.tire_page import CaptureFacts, TirePage, tire_page

__all__ = [
    "LIGHTS",
    "ArchivePage",
    "CaptureFacts",
    "CaptureLine",
    "Chart",
    "IrregularWear",
    "Layer",
    "Projection",
    "RegionTrend",
    "RibRunout",
    "TireCard",
    "TirePage",
    "Verdict",
    "archive_page",
    "block_size",
    "box_chart",
    "histogram_chart",
    "polar_chart",
    "projection_chart",
    "reduce_map",
    "residual_chart",
    "share_chart",
    "thumbnail",
    "tire_page",
    "trend_chart",
    "verdict",
]
