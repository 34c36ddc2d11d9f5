"""A small picture of a height map; the same array gives the same bytes."""

import io

import numpy as np
from PIL import Image

from treadlight.report.layers import upper_limit

_NO_DATA = "#d9d9d9"


def thumbnail(height: np.ndarray) -> bytes:
    """A PNG of a map without axes: theta to the right, z up, grey where nothing is known.

    Parameters
    ----------
    height : (n, m) float
        Along theta and z; NaN = no data.
    """
    import matplotlib

    level = np.clip(height.T / upper_limit([height], 99.5), 0, 1)[::-1]
    picture = matplotlib.colormaps["viridis"].with_extremes(bad=_NO_DATA)(
        np.ma.masked_invalid(level), bytes=True
    )
    buffer = io.BytesIO()
    Image.fromarray(picture[..., :3]).save(buffer, "PNG")
    return buffer.getvalue()
