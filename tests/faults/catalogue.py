"""All damages that are listed by hand."""

import calibrations
import documents
import images

LISTED = [*images.DAMAGES, *documents.DAMAGES, *calibrations.DAMAGES]
