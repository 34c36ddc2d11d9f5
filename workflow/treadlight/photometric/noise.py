"""How noisy a frame is where it is dark, from the frame itself."""

import numpy as np
from scipy.special import gammaincinv

_BLOCK = 8
# A mixed second difference of white noise has 36 times its variance; neighbouring ones share
# pixels, so that a block of them counts as this many independent ones.
_GAIN = 36.0
_INDEPENDENT = _BLOCK**2 / (70 / 36) ** 2
_DARK_SHARE = 0.1
# More pixels of a block than this at the frame's least intensity: black clips them.
_CLIPPED_SHARE = 1 / 16
# Texture and edges reach into some blocks and only add to what is seen there, so low quantiles
# are taken: of the dark blocks, and of all, should no dark one be without.
_QUANTILE_OF_DARK = 0.25
_QUANTILE_OF_ALL = 0.05
# Larger frames are judged by evenly spaced rows of blocks, of about so many pixels: the 6,000 dark
# blocks among them give the quartile's standard deviation to half a percent.
_SAMPLE_PX = 1 << 22


def dark_noise(frame: np.ndarray) -> float:
    """Standard deviation of a frame's intensity where there is little light.

    In blocks of 8 x 8 pixels the variance of the mixed second difference (along rows, then
    columns) is that of the noise plus that of texture and edges; what is smooth cancels. The
    lower quartile over the darkest tenth of the blocks, or the twentieth over all if that is
    less, is the noise's, once the quantile itself is allowed for. Dark is what a block's mean
    says: the darkest pixels would be those that noise made dark. Blocks without any contrast
    (masked) are left out, and those that black clips, as long as there are others: clipped noise
    is less. Never below a 1/sqrt(12) of the smallest step
    between two intensities in the dark, which is what quantisation adds.

    Parameters
    ----------
    frame : (h, w) float32
        Linear intensity; NaN where saturated.

    Returns
    -------
    float
        In the unit of the frame; 0 for a frame without contrast, or smaller than a block.
    """
    bands = _bands(frame)
    second = bands[:, :, :-2] - 2 * bands[:, :, 1:-1] + bands[:, :, 2:]
    mixed = second[:, :-2] - 2 * second[:, 1:-1] + second[:, 2:]
    inner = _blocks(bands[:, 1:-1, 1:-1])
    variance = np.mean(_blocks(mixed) ** 2, axis=(1, 3)) / _GAIN
    level = np.mean(inner, axis=(1, 3))
    known = np.isfinite(variance) & (variance > 0)
    if not known.any():
        return 0.0
    clipped = np.mean(inner == np.nanmin(bands), axis=(1, 3)) > _CLIPPED_SHARE
    known = known & ~clipped if (known & ~clipped).any() else known
    dark = known & (level <= np.quantile(level[known], _DARK_SHARE))
    spread = min(
        _from_quantile(variance[dark], _QUANTILE_OF_DARK),
        _from_quantile(variance[known], _QUANTILE_OF_ALL),
    )
    steps = np.diff(np.unique(inner.transpose(0, 2, 1, 3)[dark]))
    quantisation = float(steps.min()) / np.sqrt(12) if steps.size else 0.0
    return max(spread, quantisation)


def _bands(frame: np.ndarray) -> np.ndarray:
    """Rows (bands, `_BLOCK` + 2, w) of an image (h, w) that blocks and their differences need."""
    every = _BLOCK * max(1, frame.size // _SAMPLE_PX)
    tops = np.arange(0, len(frame) - _BLOCK - 1, every)
    return frame[tops[:, None] + np.arange(_BLOCK + 2)]


def _blocks(bands: np.ndarray) -> np.ndarray:
    """(bands, `_BLOCK`, columns, `_BLOCK`) of bands of rows, less what fills no block."""
    columns = bands.shape[2] // _BLOCK
    return bands[:, :, : columns * _BLOCK].reshape(len(bands), _BLOCK, columns, _BLOCK)


def _from_quantile(variance: np.ndarray, quantile: float) -> float:
    """Standard deviation of noise whose variances in blocks (n,) have this quantile."""
    low = 2 * gammaincinv(_INDEPENDENT / 2, quantile) / _INDEPENDENT
    return float(np.sqrt(np.quantile(variance, quantile) / low))
