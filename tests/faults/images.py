"""Damaged image files, and images that show what they should not."""

import os
import struct
import zlib

import numpy as np
from damage import (
    Damage,
    any_kind,
    files_of,
    listing,
    one_of,
    pixels_of,
    put,
    put_table,
    repaint,
    table,
    without_digests,
)

DAMAGES: list[Damage] = []
listed = listing(DAMAGES)

# Image files.


@listed()
def image_missing(folder, rng):
    any_kind(folder, rng).unlink()


@listed()
def image_empty(folder, rng):
    put(any_kind(folder, rng), b"")


@listed(pixels=True)
def image_truncated(folder, rng):
    path = any_kind(folder, rng)
    put(path, path.read_bytes()[: path.stat().st_size // 2])


@listed(pixels=True)
def image_truncated_without_digest(folder, rng):
    without_digests(folder)
    path = any_kind(folder, rng)
    put(path, path.read_bytes()[: path.stat().st_size * 2 // 3])


@listed(pixels=True)
def image_bit_flipped(folder, rng):
    path = any_kind(folder, rng)
    data = bytearray(path.read_bytes())
    data[rng.integers(len(data) // 2, len(data))] ^= 1 << rng.integers(8)
    put(path, bytes(data))


@listed(pixels=True)
def image_bit_flipped_without_digest(folder, rng):
    without_digests(folder)
    image_bit_flipped(folder, rng)


@listed()
def image_of_another_size(folder, rng):
    repaint(folder, any_kind(folder, rng), lambda image: image[:-3])


@listed()
def image_of_8_bits(folder, rng):
    repaint(folder, any_kind(folder, rng), lambda image: (image >> 8).astype(np.uint8))


@listed()
def image_with_an_alpha_channel(folder, rng):
    def add(image):
        gray = image if image.ndim == 2 else image[:, :, 0]
        return np.dstack([gray] * 4)

    repaint(folder, any_kind(folder, rng), add)


@listed()
def text_named_png(folder, rng):
    without_digests(folder)
    put(any_kind(folder, rng), b"this is no image\n" * 20)


@listed(pixels=True)
def digest_of_another_image(folder, rng):
    rows = table(folder)
    rows[0]["sha256"] = rows[1]["sha256"]
    put_table(folder, rows)


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


@listed()
def image_that_claims_100000_by_100000_pixels(folder, rng):
    without_digests(folder)
    header = struct.pack(">IIBBBBB", 100_000, 100_000, 16, 0, 0, 0, 0)
    body = _chunk(b"IHDR", header) + _chunk(b"IDAT", zlib.compress(b"\0" * 1000))
    put(any_kind(folder, rng), b"\x89PNG\r\n\x1a\n" + body + _chunk(b"IEND", b""))


@listed()
def image_of_a_terabyte_of_nothing(folder, rng):
    without_digests(folder)
    path = any_kind(folder, rng)
    put(path, path.read_bytes())
    os.truncate(path, 1 << 40)


@listed()
def image_is_a_pipe(folder, rng):
    path = any_kind(folder, rng)
    path.unlink()
    os.mkfifo(path)


# What images show.


@listed(pixels=True)
def laser_frame_all_black(folder, rng):
    repaint(folder, one_of(folder, "laser", rng), np.zeros_like)


@listed(pixels=True)
def laser_frame_all_saturated(folder, rng):
    repaint(folder, one_of(folder, "laser", rng), lambda image: np.full_like(image, 65535))


@listed(pixels=True)
def led_frame_all_black(folder, rng):
    repaint(folder, files_of(folder, "led")[3], np.zeros_like)


@listed(pixels=True)
def led_frame_all_saturated(folder, rng):
    repaint(folder, files_of(folder, "led")[3], lambda image: np.full_like(image, 65535))


@listed(pixels=True)
def laser_off_in_one_frame(folder, rng):
    dark = pixels_of(files_of(folder, "dark")[0])
    repaint(folder, one_of(folder, "laser", rng), lambda image: np.dstack([dark] * 3))


@listed(pixels=True)
def laser_off_in_all_frames(folder, rng):
    dark = pixels_of(files_of(folder, "dark")[0])
    for path in files_of(folder, "laser"):
        repaint(folder, path, lambda image: np.dstack([dark] * 3))


def _twice(image):
    return np.maximum(image, np.roll(image, image.shape[1] // 6, axis=1))


@listed(pixels=True)
def laser_seen_twice_in_one_frame(folder, rng):
    repaint(folder, one_of(folder, "laser", rng), _twice)


@listed(pixels=True)
def laser_seen_twice_in_all_frames(folder, rng):
    for path in files_of(folder, "laser"):
        repaint(folder, path, _twice)


@listed(pixels=True)
def led_dead_in_one_view(folder, rng):
    dark = pixels_of(files_of(folder, "dark")[0])
    repaint(folder, files_of(folder, "led")[rng.integers(16)], lambda image: dark)


@listed(pixels=True)
def led_dead_in_all_views(folder, rng):
    dark, led = pixels_of(files_of(folder, "dark")[0]), rng.integers(16)
    for path in files_of(folder, "led")[led::16]:
        repaint(folder, path, lambda image: dark)


@listed()
def leds_swapped_in_one_view(folder, rng):
    a, b = rng.choice(16, 2, replace=False)
    rows = table(folder)
    rows[a]["led"], rows[b]["led"] = rows[b]["led"], rows[a]["led"]
    put_table(folder, rows)


@listed(pixels=True)
def led_frame_at_another_angle(folder, rng):
    led, files = rng.integers(16), files_of(folder, "led")
    repaint(folder, files[led], lambda image: pixels_of(files[16 + led]))


@listed()
def dark_frame_lit(folder, rng):
    repaint(folder, files_of(folder, "dark")[0], lambda image: np.full_like(image, 40_000))
