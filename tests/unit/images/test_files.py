"""Files that are not whole, or claim what they are not, are known before they are decoded."""

import struct
import zlib
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from PIL import Image

from treadlight.errors import CaptureError
from treadlight.images.files import check_frame, is_whole, read_header


def encoded(extension, dtype=np.uint16):
    image = np.random.default_rng(1).integers(0, 200, (20, 30)).astype(dtype)
    return cv2.imencode(extension, image)[1].tobytes()


@pytest.mark.parametrize(
    ("extension", "dtype"),
    [(".png", np.uint16), (".tiff", np.uint16), (".jpg", np.uint8), (".png", np.uint8)],
)
def test_a_file_is_whole_and_cut_off_it_is_not(extension, dtype):
    data = encoded(extension, dtype)
    assert is_whole(data)
    for share in (0.3, 0.6, 0.95):
        assert not is_whole(data[: int(len(data) * share)])


def test_no_bit_of_a_png_can_change_unseen():
    data = encoded(".png")
    for at in range(8, len(data), 7):
        for bit in (0, 5):
            changed = bytearray(data)
            changed[at] ^= 1 << bit
            assert not is_whole(bytes(changed)), at


def capture(tmp_path, size=(30, 20), white=65535.0):
    encoding = SimpleNamespace(size_px=size, white_level=white)
    return SimpleNamespace(encoding=encoding, path=lambda frame: tmp_path / frame.file)


def refusal(tmp_path, name="a.png", **facts):
    with pytest.raises(CaptureError) as caught:
        check_frame(capture(tmp_path, **facts), SimpleNamespace(file=name))
    return str(caught.value)


def test_size_depth_and_channels_are_held_against_the_manifest(tmp_path):
    path = tmp_path / "a.png"
    cv2.imwrite(str(path), np.zeros((20, 31), np.uint16))
    assert "is 31x20" in refusal(tmp_path)
    cv2.imwrite(str(path), np.zeros((20, 30), np.uint8))
    assert "has 8 bits" in refusal(tmp_path)
    assert check_frame(capture(tmp_path, white=255.0), SimpleNamespace(file="a.png")).bits == 8
    cv2.imwrite(str(path), np.zeros((20, 30, 4), np.uint16))
    assert "has 4 channels" in refusal(tmp_path)
    Image.fromarray(np.arange(600, dtype=np.uint8).reshape(20, 30)).convert("P").save(path)
    assert "indexed colours" in refusal(tmp_path)
    Image.new("1", (30, 20)).save(path)
    assert "1 bits per pixel" in refusal(tmp_path)


def test_an_image_that_claims_too_many_pixels_takes_no_memory(tmp_path):
    def chunk(kind, data):
        checked = kind + data
        return struct.pack(">I", len(data)) + checked + struct.pack(">I", zlib.crc32(checked))

    header = struct.pack(">IIBBBBB", 100_000, 100_000, 16, 0, 0, 0, 0)
    body = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"\0")) + chunk(b"IEND", b"")
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n" + body)
    assert "pixels, which no camera has" in refusal(tmp_path)


def test_a_file_of_a_terabyte_is_refused_unread(tmp_path):
    with (tmp_path / "a.png").open("wb") as stream:
        stream.truncate(1 << 40)
    assert "more than an image of 30x20 takes" in refusal(tmp_path)


def test_16_bit_rgb_is_known_as_such(tmp_path):
    for name in ("a.png", "a.tiff"):
        cv2.imwrite(str(tmp_path / name), np.zeros((20, 30, 3), np.uint16))
        assert read_header(tmp_path / name) == (30, 20, 16)
