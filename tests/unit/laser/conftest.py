"""Synthetic laser lines whose position is known."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter


@pytest.fixture
def stripes():
    """Draw a speckled Gaussian stripe per row at given columns; returns (intensity, saturated)."""

    def draw(u, *, width=96, sigma=2.0, peak=0.5, speckle=0.3, noise=1e-3, clip=None, rng):
        u = np.asarray(u, float)
        x = np.arange(width)
        peak = np.broadcast_to(np.asarray(peak, float), u.shape)[:, None]
        with np.errstate(invalid="ignore"):
            image = peak * np.exp(-0.5 * ((x - u[:, None]) / sigma) ** 2)
        image = np.nan_to_num(image)
        if speckle:
            grain = gaussian_filter(rng.standard_normal(image.shape), 0.6)
            image *= np.maximum(0, 1 + speckle * grain / grain.std())
        image += noise * rng.standard_normal(image.shape)
        saturated = np.zeros(image.shape, bool)
        if clip is not None:
            saturated = image >= clip
            image = np.minimum(image, clip)
        return image.astype(np.float32), saturated

    return draw
