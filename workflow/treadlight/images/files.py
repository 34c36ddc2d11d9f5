"""Image files before any pixel is decoded: what they claim, and whether they are whole."""

import io
import struct
import warnings
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from treadlight.archive import Capture, Frame
from treadlight.archive.manifest import MAX_PIXELS
from treadlight.errors import CaptureError

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
# Bytes that a pixel takes at most (three channels of 16 bits, badly packed), and a file beside
# its pixels (thumbnails, profiles).
_MAX_BYTES_PER_PIXEL = 8
_MAX_EXTRA_BYTES = 16 << 20
# Pillow's modes of mono and RGB images.
_CHANNELS = {"L": 1, "I;16": 1, "I;16B": 1, "I;16L": 1, "I": 1, "F": 1, "RGB": 3}
_OTHER_MODES = {"1": "1 bit per pixel", "P": "indexed colours", "LA": "2 channels"}


@dataclass(frozen=True)
class Header:
    """What an image file claims: size in pixels, bits per channel, what a count is, channels.

    `channels` is None where the pixels are neither mono nor RGB; `layout` says what they are.
    """

    width: int
    height: int
    bits: int
    is_float: bool
    channels: int | None
    layout: str

    @property
    def dtype(self) -> str:
        return f"{'float' if self.is_float else 'uint'}{self.bits}"


def read_header(path: Path) -> tuple[int, int, int]:
    """Width, height and bits per channel of an image, without decoding its pixels.

    Raises
    ------
    CaptureError
        The file is no PNG, TIFF or JPEG.
    """
    header = _header_of(path)
    return header.width, header.height, header.bits


def parse_header(path: Path, data: bytes | None = None) -> Header | None:
    """What a file, or `data` read from it, claims to be; None if it is no PNG, TIFF or JPEG.

    Raises
    ------
    CaptureError
        It claims more pixels than any camera has.
    OSError, MemoryError
        The machine could not read it.
    """
    from PIL import Image, UnidentifiedImageError

    Image.MAX_IMAGE_PIXELS = MAX_PIXELS
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of tags that nobody here reads
            source = path if data is None else io.BytesIO(data)
            with Image.open(source, formats=("PNG", "TIFF", "JPEG")) as image:
                return _describe(image)
    except (MemoryError, PermissionError, FileNotFoundError, IsADirectoryError):
        raise
    except Image.DecompressionBombError:
        raise CaptureError(
            f"{path}: claims more than {2 * MAX_PIXELS} pixels, which no camera has. Put the"
            " image there or drop its row."
        ) from None
    except UnidentifiedImageError:
        return None
    except OSError as error:
        if error.errno is not None:
            raise
        return None
    except Exception:  # Pillow's parsers raise whatever a mangled tag leads to
        return None


def check_frame(capture: Capture, frame: Frame) -> Header:
    """Hold an image file's size and header against the manifest; no pixel is decoded.

    Raises
    ------
    CaptureError
        The file is too large, no image, or differs from what capture.yaml says.
    """
    path = capture.path(frame)
    check_length(capture, path)
    header = _header_of(path)
    wanted = list(capture.encoding.size_px)
    if [header.width, header.height] != wanted:
        raise CaptureError(
            f"{path}: is {header.width}x{header.height}. capture.yaml says camera.size_px:"
            f" {wanted}; correct the one that is wrong."
        )
    if header.channels is None:
        raise CaptureError(f"{path}: has {header.layout}. Store it as mono or RGB.")
    if header.is_float or header.bits not in (8, 16):
        raise CaptureError(f"{path}: is of type {header.dtype}. Store it with 8 or 16 bits.")
    if capture.encoding.white_level >= 2**header.bits:
        raise CaptureError(
            f"{path}: has {header.bits} bits. capture.yaml says camera.white_level:"
            f" {capture.encoding.white_level:g}, which it never reaches; correct the one that is"
            " wrong."
        )
    return header


def check_length(capture: Capture, path: Path) -> None:
    """Refuse a file that is empty or longer than any image of the capture's size can be."""
    width, height = capture.encoding.size_px
    length = path.stat().st_size
    if length > _MAX_BYTES_PER_PIXEL * width * height + _MAX_EXTRA_BYTES:
        raise CaptureError(
            f"{path}: has {length} bytes, more than an image of {width}x{height} takes. Put the"
            " right image there or drop its row."
        )


def is_whole(data: bytes) -> bool:
    """Whether a PNG, TIFF or JPEG is there to its end, and a PNG as it was written.

    Decoders fill what is missing with grey and say nothing.
    """
    if data.startswith(_PNG_SIGNATURE):
        return _png_is_whole(data)
    if data.startswith(b"\xff\xd8"):
        # Neither marker can stand within the compressed pixels: start of scan, end of image.
        return data.rfind(b"\xff\xd9") > data.rfind(b"\xff\xda")
    return _tiff_is_whole(data)


def _header_of(path: Path) -> Header:
    header = parse_header(path)
    if header is None:
        raise CaptureError(
            f"{path}: is no readable PNG, TIFF or JPEG. Put the image there or drop its row."
        )
    return header


def _describe(image: Any) -> Header:
    mode, bits = image.mode, 8
    if mode.startswith("I;16"):
        bits = 16
    elif mode in ("I", "F"):
        bits = 32
    if image.format == "TIFF":
        stored = image.tag_v2.get(258, (bits,))
        bits = int(stored[0] if isinstance(stored, tuple) else stored)
    elif image.format == "PNG":
        # Pillow opens 16 bits of RGB as 8, and some mono ones as 32: what is stored counts.
        image.fp.seek(24)
        bits = image.fp.read(1)[0]
    layout = _OTHER_MODES.get(mode, f"{len(image.getbands())} channels")
    if bits < 8:
        return Header(image.width, image.height, bits, False, None, f"{bits} bits per pixel")
    return Header(image.width, image.height, bits, mode == "F", _CHANNELS.get(mode), layout)


def _png_is_whole(data: bytes) -> bool:
    at = len(_PNG_SIGNATURE)
    while at + 12 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        end = at + 8 + length
        if end + 4 > len(data):
            return False
        if zlib.crc32(memoryview(data)[at + 4 : end]) != struct.unpack_from(">I", data, end)[0]:
            return False
        if kind == b"IEND":
            return True
        at = end + 4
    return False


def _tiff_is_whole(data: bytes) -> bool:
    from PIL.TiffImagePlugin import TiffImageFile

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with TiffImageFile(io.BytesIO(data)) as image:
                tags = image.tag_v2
        offsets, lengths = ((273, 279), (324, 325))[324 in tags]
        strips = zip(tags[offsets], tags[lengths], strict=True)
        return all(start + length <= len(data) for start, length in strips)
    except MemoryError:
        raise
    except Exception:  # Pillow's parsers raise whatever a mangled tag leads to
        return False
