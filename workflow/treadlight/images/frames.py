"""From stored counts to corrected intensity, as capture-format.md defines it."""

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from treadlight.archive import Capture, Frame
from treadlight.compiling import kernel
from treadlight.errors import CaptureError
from treadlight.images.files import Header, check_length, is_whole, parse_header

_CHANNELS = {"blue": 0, "green": 1, "red": 2}


@dataclass(frozen=True)
class LinearFrame:
    """One image as light.

    Attributes
    ----------
    intensity : (h, w) float32
        Linear, dark subtracted; 1 is full scale of the stored type, before any division by
        exposure.
    saturated : (h, w) bool
        Stored counts at or above the white level, in any channel that counts.
    """

    intensity: np.ndarray
    saturated: np.ndarray


class FrameReader:
    """Reads the frames of one capture; holds the capture's mean dark frame."""

    def __init__(self, capture: Capture, subtract_dark: bool = True):
        self.capture = capture
        self._dark = _mean(
            self._linear(self._decode(frame)) for frame in capture.of_kind("dark") if subtract_dark
        )

    def read(self, frame: Frame, out: np.ndarray | None = None) -> LinearFrame:
        """The frame as light: `laser.channel` for laser frames, the mean of channels else.

        Its intensity lies in `out` (h, w) float32 if that is given.

        Raises
        ------
        CaptureError
            The file is damaged or differs from what the manifest says.
        """
        counts = self._decode(frame)
        channels = self._select(counts, frame)
        height, width = channels.shape[:2]
        intensity = np.empty((height, width), np.float32) if out is None else out
        saturated = np.empty((height, width), np.bool_)
        black = self._black(frame, np.iinfo(counts.dtype).max)
        if black.shape[2] > channels.shape[2]:
            black = black.mean(axis=2, keepdims=True)
        light = _light_of(counts.dtype, self.capture.encoding.curve)
        _to_light(channels, light, black, self.capture.encoding.white_level, intensity, saturated)
        return LinearFrame(intensity, saturated)

    def _decode(self, frame: Frame) -> np.ndarray:
        path = self.capture.path(frame)
        try:
            check_length(self.capture, path)
            data = path.read_bytes()
        except FileNotFoundError:
            raise CaptureError(
                f"{path}: cannot be read (it is not there). Restore the image or drop its row."
            ) from None
        if frame.sha256 and hashlib.sha256(data).hexdigest() != frame.sha256:
            raise CaptureError(
                f"{path}: its content differs from sha256 in frames.csv. Restore the image, or"
                " correct the digest if the change was meant."
            )
        # What the header claims comes first: a decoder may take memory for all of it.
        header = parse_header(path, data)
        if header is not None and not self._is_as_told(header):
            width, height = self.capture.encoding.size_px
            raise CaptureError(
                f"{path}: is {header.width}x{header.height} {header.dtype}. capture.yaml says"
                f" camera.size_px: [{width}, {height}], with 8 or 16 bits; correct the one that is"
                " wrong."
            )
        image = _pixels(data) if header is not None and is_whole(data) else None
        width, height = self.capture.encoding.size_px
        if image is None or image.shape[:2] != (height, width):
            raise CaptureError(f"{path}: cannot be decoded. Restore the image or drop its row.")
        return image if image.ndim == 3 else image[:, :, None]

    def _is_as_told(self, header: Header) -> bool:
        size = (header.width, header.height) == self.capture.encoding.size_px
        return size and header.bits in (8, 16) and not header.is_float

    def _select(self, counts: np.ndarray, frame: Frame) -> np.ndarray:
        """The channels that count for this kind of frame, (h, w, 1 or 3)."""
        if counts.shape[2] < 3:
            return counts[:, :, :1]
        if frame.kind in ("laser", "board_laser") and self.capture.laser_channel != "mono":
            index = _CHANNELS[self.capture.laser_channel]
            return counts[:, :, index : index + 1]
        return counts[:, :, :3]

    def _black(self, frame: Frame, full_scale: int) -> np.ndarray:
        if self._dark is not None:
            return self._select(self._dark, frame)
        black = np.full((1, 1, 1), self.capture.encoding.black_level / full_scale, np.float32)
        return _to_linear(black, self.capture.encoding.curve)

    def _linear(self, counts: np.ndarray) -> np.ndarray:
        """Counts as linear light: 1 is full scale of the stored type."""
        return _light_of(counts.dtype, self.capture.encoding.curve)[counts]


@cache
def _light_of(dtype: np.dtype, curve: str) -> np.ndarray:
    """Linear light of every count, float32."""
    most = np.iinfo(dtype).max
    return _to_linear(np.arange(most + 1, dtype=np.float32) * np.float32(1 / most), curve)


@kernel
def _to_light(counts, light, black, white, intensity, saturated):
    """Means (h, w) of the light of channels (h, w, c) less their `black`, which may be of all.

    Once through: a table instead of a power for each pixel.
    """
    height, width, channels = counts.shape
    tall, wide, deep = black.shape[0] > 1, black.shape[1] > 1, black.shape[2] > 1
    for i in range(height):
        intensity[i], saturated[i] = 0, False
        for c in range(channels):
            dark = black[i if tall else 0, :, c if deep else 0]
            for j in range(width):
                count = counts[i, j, c]
                intensity[i, j] += light[count] - (dark[j] if wide else dark[0])
                saturated[i, j] |= count >= white
        if channels > 1:
            for j in range(width):
                intensity[i, j] /= np.float32(channels)


def _pixels(data: bytes) -> np.ndarray | None:
    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        if error.code == cv2.Error.STS_NO_MEM:
            raise MemoryError from None
        return None


def _mean(frames: Iterable[np.ndarray]) -> np.ndarray | None:
    """Mean (h, w, 1 or 3) float32 of frames, of which one is held at a time; None of none.

    A mono frame applies to every channel: it stays one, unless another frame has three.
    """
    total: np.ndarray | None = None
    count = 0
    for frame in frames:
        light = frame if frame.shape[2] >= 3 else frame[:, :, :1]
        total = light.astype(np.float64) if total is None else total + light
        count += 1
    return None if total is None else np.asarray(total / count, np.float32)


def _to_linear(value: np.ndarray, curve: str) -> np.ndarray:
    """Undo the sRGB transfer curve (IEC 61966-2-1); linear values pass."""
    if curve == "linear":
        return value
    low = value / np.float32(12.92)
    high = ((np.maximum(value, 0) + np.float32(0.055)) / np.float32(1.055)) ** np.float32(2.4)
    return np.where(value <= 0.04045, low, high).astype(np.float32)
