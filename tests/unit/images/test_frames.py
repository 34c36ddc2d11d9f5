import hashlib
from datetime import UTC, datetime

import cv2
import numpy as np
import pytest
from PIL import Image

from treadlight.archive import Capture, Encoding, Frame
from treadlight.errors import CaptureError
from treadlight.images import FrameReader, read_header

H, W = 6, 8


@pytest.fixture
def make(tmp_path):
    """A capture of images given as arrays by file name, and its reader."""

    def build(images, kinds, curve="linear", black=0.0, white=65535.0, channel="red", sha256=None):
        for name, image in images.items():
            assert cv2.imwrite(str(tmp_path / name), image)
        frames = tuple(
            Frame(name, kind, 0, None, None, None, (sha256 or {}).get(name))
            for name, kind in kinds.items()
        )
        capture = Capture(
            folder=tmp_path,
            id="c",
            kind="measurement",
            rig="bench",
            captured_at=datetime(2020, 1, 1, tzinfo=UTC),
            encoding=Encoding((W, H), curve, black, white),
            laser_scan="rows",
            laser_channel=channel,
            leds=4,
            facts={},
            frames=frames,
        )
        return FrameReader(capture), frames

    return build


def mono(value, dtype=np.uint16):
    return np.full((H, W), value, dtype)


def rgb(red, green, blue, dtype=np.uint8):
    return np.dstack([mono(blue, dtype), mono(green, dtype), mono(red, dtype)])


def srgb_to_linear(counts):
    """IEC 61966-2-1."""
    c = counts / 255
    return c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4


def test_full_scale_is_one_in_8_and_16_bits(make):
    images = {"a.png": mono(255, np.uint8), "b.png": mono(65535), "c.png": mono(32768)}
    reader, frames = make(images, dict.fromkeys(images, "led"))
    found = [reader.read(frame).intensity for frame in frames]
    assert [f[0, 0] for f in found] == pytest.approx([1.0, 1.0, 32768 / 65535])
    assert all(f.dtype == np.float32 and f.shape == (H, W) for f in found)


def test_the_black_level_is_taken_off(make):
    reader, (frame,) = make({"a.png": mono(1640)}, {"a.png": "led"}, black=640.0)
    assert reader.read(frame).intensity == pytest.approx(1000 / 65535)


def test_noise_below_black_stays_negative(make):
    """Clipping at zero would bias every dark pixel upwards."""
    reader, (frame,) = make({"a.png": mono(600)}, {"a.png": "led"}, black=640.0)
    assert reader.read(frame).intensity == pytest.approx(-40 / 65535)


def test_a_dark_frame_replaces_the_black_level(make):
    images = {"a.png": mono(5000), "d.png": mono(1000), "e.png": mono(2000)}
    kinds = {"a.png": "led", "d.png": "dark", "e.png": "dark"}
    reader, frames = make(images, kinds, black=640.0)
    assert reader.read(frames[0]).intensity == pytest.approx((5000 - 1500) / 65535)


def test_a_mono_dark_frame_applies_to_every_channel(make):
    images = {"a.png": rgb(100, 60, 20), "d.png": mono(10, np.uint8)}
    for channel, value in {"red": 90, "green": 50, "blue": 10, "mono": 50}.items():
        reader, frames = make(
            images, {"a.png": "laser", "d.png": "dark"}, white=255.0, channel=channel
        )
        assert reader.read(frames[0]).intensity == pytest.approx(value / 255)


def test_light_is_the_mean_of_channels_each_less_its_own_pixel_of_the_dark_frame(make):
    rng = np.random.default_rng(5)
    images = {
        name: rng.integers(0, 65536, (H, W, 3)).astype(np.uint16) for name in ("a.png", "d.png")
    }
    reader, (frame, _) = make(images, {"a.png": "led", "d.png": "dark"}, white=60000.0)
    into = np.empty((H, W), np.float32)
    found = reader.read(frame, out=into)
    assert found.intensity is into
    np.testing.assert_array_equal(found.saturated, (images["a.png"] >= 60000).any(axis=2))
    light = (images["a.png"].astype(float) - images["d.png"]).mean(axis=2) / 65535
    np.testing.assert_allclose(into, light, atol=1e-6)


def test_a_colour_dark_frame_is_taken_off_channel_by_channel(make):
    images = {"a.png": rgb(100, 60, 20), "d.png": rgb(1, 2, 3)}
    kinds = {"a.png": "laser", "d.png": "dark"}
    reader, frames = make(images, kinds, white=255.0, channel="green")
    assert reader.read(frames[0]).intensity == pytest.approx(58 / 255)


def test_led_frames_count_as_the_mean_and_laser_frames_as_one_channel(make):
    images = {"a.png": rgb(90, 60, 30), "b.png": rgb(90, 60, 30)}
    for channel, value in {"red": 90, "green": 60, "blue": 30, "mono": 60}.items():
        kinds = {"a.png": "led", "b.png": "laser"}
        reader, (led, laser) = make(images, kinds, white=255.0, channel=channel)
        assert reader.read(led).intensity == pytest.approx(60 / 255)
        assert reader.read(laser).intensity == pytest.approx(value / 255)


def test_board_laser_frames_count_as_the_laser_channel(make):
    reader, (frame,) = make({"a.png": rgb(90, 60, 30)}, {"a.png": "board_laser"}, white=255.0)
    assert reader.read(frame).intensity == pytest.approx(90 / 255)


def test_mono_images_are_read_whatever_the_laser_channel(make):
    reader, (frame,) = make({"a.png": mono(300)}, {"a.png": "laser"}, channel="blue")
    assert reader.read(frame).intensity == pytest.approx(300 / 65535)


@pytest.mark.parametrize("value", [0, 5, 10, 11, 128, 255])
def test_srgb_is_undone(make, value):
    reader, (frame,) = make({"a.png": mono(value, np.uint8)}, {"a.png": "led"}, "srgb", white=255.0)
    assert reader.read(frame).intensity == pytest.approx(srgb_to_linear(value), rel=1e-5, abs=1e-8)


def test_srgb_is_undone_before_channels_are_averaged_and_black_is_taken_off(make):
    reader, (frame,) = make(
        {"a.png": rgb(200, 100, 50)}, {"a.png": "led"}, "srgb", black=20.0, white=255.0
    )
    expected = np.mean([srgb_to_linear(c) for c in (200, 100, 50)]) - srgb_to_linear(20)
    assert reader.read(frame).intensity == pytest.approx(expected, rel=1e-5)


def test_a_colour_dark_frame_is_taken_off_a_mono_frame_channel_by_channel(make):
    images = {"a.png": mono(200, np.uint8), "d.png": rgb(10, 20, 30)}
    reader, frames = make(images, {"a.png": "led", "d.png": "dark"}, white=255.0)
    assert reader.read(frames[0]).intensity == pytest.approx(180 / 255)


def test_srgb_dark_frames_are_averaged_as_light(make):
    images = {
        "a.png": mono(200, np.uint8),
        "d.png": mono(10, np.uint8),
        "e.png": mono(90, np.uint8),
    }
    kinds = {"a.png": "led", "d.png": "dark", "e.png": "dark"}
    reader, frames = make(images, kinds, "srgb", white=255.0)
    dark = (srgb_to_linear(10) + srgb_to_linear(90)) / 2
    assert reader.read(frames[0]).intensity == pytest.approx(srgb_to_linear(200) - dark, rel=1e-5)


def test_saturation_is_tested_on_stored_counts(make):
    image = mono(1000)
    image[2, 3], image[4, 5] = 64000, 63999
    images = {"a.png": image, "d.png": mono(900)}
    kinds = {"a.png": "led", "d.png": "dark"}
    reader, frames = make(images, kinds, black=640.0, white=64000.0)
    saturated = reader.read(frames[0]).saturated
    assert saturated[2, 3]
    assert saturated.sum() == 1


def test_one_saturated_channel_is_enough_but_only_channels_that_count(make):
    images = {"a.png": rgb(255, 10, 10), "b.png": rgb(10, 255, 10)}
    reader, (led, laser) = make(images, {"a.png": "led", "b.png": "laser"}, white=255.0)
    assert reader.read(led).saturated.all()
    assert not reader.read(laser).saturated.any()


@pytest.mark.parametrize("extension", ["png", "tiff"])
def test_stored_counts_survive_16_bit_formats(make, rng, extension):
    image = rng.integers(0, 65535, (H, W)).astype(np.uint16)
    name = f"a.{extension}"
    reader, (frame,) = make({name: image}, {name: "led"})
    assert reader.read(frame).intensity * 65535 == pytest.approx(image, abs=0.01)


def test_an_image_turned_by_its_exif_tag_is_read_as_stored(make, tmp_path):
    picture = Image.fromarray(np.tile(np.arange(W, dtype=np.uint8) * 30, (H, 1)))
    exif = Image.Exif()
    exif[0x0112] = 6
    reader, (frame,) = make({}, {"a.jpg": "led"}, white=255.0)
    picture.save(tmp_path / "a.jpg", quality=100, exif=exif)
    assert reader.read(frame).intensity.shape == (H, W)


@pytest.mark.parametrize("keep", [0, 10, 60])
def test_a_truncated_image_is_refused_with_its_name(make, tmp_path, keep):
    reader, (frame,) = make({"a.png": mono(5)}, {"a.png": "led"})
    (tmp_path / "a.png").write_bytes((tmp_path / "a.png").read_bytes()[:keep])
    with pytest.raises(CaptureError, match=r"a\.png: cannot be decoded\. Restore the image"):
        reader.read(frame)


def test_an_image_that_vanished_is_refused(make, tmp_path):
    reader, (frame,) = make({"a.png": mono(5)}, {"a.png": "led"})
    (tmp_path / "a.png").unlink()
    with pytest.raises(CaptureError, match=r"a\.png: cannot be read"):
        reader.read(frame)


def test_an_image_of_another_size_or_depth_is_refused(make, tmp_path):
    images = {"a.png": np.zeros((H, W + 1), np.uint8), "b.tiff": np.zeros((H, W), np.float32)}
    reader, frames = make(images, dict.fromkeys(images, "led"))
    with pytest.raises(CaptureError, match=r"is 9x6 uint8\. .*size_px: \[8, 6\]"):
        reader.read(frames[0])
    with pytest.raises(CaptureError, match="float32"):
        reader.read(frames[1])


def test_an_image_that_changed_under_its_digest_is_refused(make, tmp_path):
    reader, frames = make({"a.png": mono(5)}, {"a.png": "led"}, sha256={"a.png": "0" * 64})
    with pytest.raises(CaptureError, match="differs from sha256"):
        reader.read(frames[0])
    good = hashlib.sha256((tmp_path / "a.png").read_bytes()).hexdigest()
    reader, frames = make({"a.png": mono(5)}, {"a.png": "led"}, sha256={"a.png": good})
    assert reader.read(frames[0]).intensity == pytest.approx(5 / 65535)


@pytest.mark.parametrize(
    ("name", "image", "bits"),
    [
        ("a.png", mono(7), 16),
        ("b.png", rgb(1, 2, 3), 8),
        ("c.tiff", mono(7), 16),
        ("d.jpg", mono(7, np.uint8), 8),
    ],
)
def test_headers_tell_size_and_depth(tmp_path, name, image, bits):
    cv2.imwrite(str(tmp_path / name), image)
    assert read_header(tmp_path / name) == (W, H, bits)


@pytest.mark.parametrize(
    "data", [b"", b"not an image", b"\x89PNG\r\n\x1a\n", b"GIF89a\x01\x00\x01\x00"]
)
def test_a_header_of_something_else_is_refused(tmp_path, data):
    path = tmp_path / "a.png"
    path.write_bytes(data)
    with pytest.raises(CaptureError, match="is no readable PNG, TIFF or JPEG"):
        read_header(path)
