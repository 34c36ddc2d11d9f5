"""Images as corrected intensity: decode, linearise, subtract the dark, divide by exposure."""

from treadlight.images.frames import FrameReader, LinearFrame, read_header

__all__ = ["FrameReader", "LinearFrame", "read_header"]
