"""Images as corrected intensity: decode, linearise, subtract the dark, divide by exposure."""

from treadlight.images.files import check_frame, read_header
from treadlight.images.frames import FrameReader, LinearFrame

__all__ = ["FrameReader", "LinearFrame", "check_frame", "read_header"]
