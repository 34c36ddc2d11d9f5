"""Damage to captures: a list written by hand, and a seeded mutator that makes any number more.

Every damage works on a copy whose files may be hard links to the healthy ones: files are always
replaced, never written into.
"""

import csv
import io
import os
import shutil
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import yaml

Harm = Callable[[Path, np.random.Generator], None]


@dataclass(frozen=True)
class Damage:
    """One way to damage a capture.

    Attributes
    ----------
    name : str
    kind : str
        ``measurement`` or ``calibration``: what is damaged.
    harm : (folder, rng) -> None
    verdict : int or None
        What `treadlight check` must exit with; None where either is right.
    pixels : bool
        Whether a stage that reads the images must refuse or warn.
    """

    name: str
    kind: str
    harm: Harm
    verdict: int | None = 1
    pixels: bool = False


LISTED: list[Damage] = []


def listed(kind: str = "measurement", verdict: int | None = 1, pixels: bool = False):
    def add(harm: Harm) -> Harm:
        LISTED.append(Damage(harm.__name__, kind, harm, verdict, pixels))
        return harm

    return add


def copy_capture(source: Path, target: Path) -> Path:
    """A copy that shares its files with the source until they are replaced."""
    shutil.copytree(source, target, copy_function=os.link)
    return target


# Files, rows, images and facts.


def put(path: Path, data: bytes) -> None:
    path.unlink(missing_ok=True)
    path.write_bytes(data)


def table(folder: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO((folder / "frames.csv").read_text())))


def put_table(folder: Path, rows: list[dict[str, str]], **style) -> None:
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n", **style)
    writer.writeheader()
    writer.writerows(rows)
    put(folder / "frames.csv", text.getvalue().encode("utf-8", "surrogateescape"))


def change_rows(folder: Path, change: Callable[[dict[str, str]], object], kind: str = "") -> None:
    rows = table(folder)
    for row in rows:
        if not kind or row["kind"] == kind:
            change(row)
    put_table(folder, rows)


def without_digests(folder: Path) -> None:
    change_rows(folder, lambda row: row.update(sha256=""))


def files_of(folder: Path, kind: str) -> list[Path]:
    return [folder / row["file"] for row in table(folder) if row["kind"] == kind]


def one_of(folder: Path, kind: str, rng: np.random.Generator) -> Path:
    files = files_of(folder, kind)
    return files[rng.integers(len(files))]


def pixels_of(path: Path) -> np.ndarray:
    return cv2.imread(str(path), cv2.IMREAD_UNCHANGED)


def put_pixels(path: Path, pixels: np.ndarray) -> None:
    put(path, cv2.imencode(".png", pixels)[1].tobytes())


def repaint(folder: Path, path: Path, change: Callable[[np.ndarray], np.ndarray]) -> None:
    """Another picture under a row that gives no digest."""
    without_digests(folder)
    put_pixels(path, change(pixels_of(path)))


def change_facts(folder: Path, **changes) -> None:
    """Set facts by dotted name (__ for the dot); None takes one out."""
    facts = yaml.safe_load((folder / "capture.yaml").read_text())
    for name, value in changes.items():
        *path, last = name.split("__")
        node = facts
        for part in path:
            node = node[part]
        if value is None:
            node.pop(last, None)
        else:
            node[last] = value
    put(folder / "capture.yaml", yaml.safe_dump(facts).encode())


def any_kind(folder: Path, rng: np.random.Generator) -> Path:
    return one_of(folder, ("laser", "led")[rng.integers(2)], rng)


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


# frames.csv.


def _text(name: str, change: Callable[[bytes], bytes], verdict: int | None = 1) -> None:
    """A damage of the bytes of frames.csv."""

    def harm(folder, rng):
        path = folder / "frames.csv"
        put(path, change(path.read_bytes()))

    LISTED.append(Damage(f"frames_csv_{name}", "measurement", harm, verdict))


_text("with_a_byte_order_mark", lambda data: b"\xef\xbb\xbf" + data, 0)
_text("with_windows_line_ends", lambda data: data.replace(b"\n", b"\r\n"), 0)
_text("with_semicolons", lambda data: data.replace(b",", b";"))
_text("with_tabs", lambda data: data.replace(b",", b"\t"))
_text("empty", lambda data: b"")
_text("header_alone", lambda data: data.splitlines(keepends=True)[0])
_text("cut_within_a_row", lambda data: data[:-40])
_text("in_utf_16", lambda data: data.decode().encode("utf-16"))
_text("of_random_bytes", lambda data: bytes(range(256)) * 20)
_text("with_a_null", lambda data: data.replace(b"laser", b"las\0er", 1))
_text("with_an_open_quote", lambda data: data + b'"')
_text("without_the_column_kind", lambda data: data.replace(b"kind", b"what", 1))
_text("without_the_column_encoder", lambda data: data.replace(b"encoder_deg", b"angle", 1))
_text("with_a_column_twice", lambda data: data.replace(b"exposure_s", b"pose", 1))
_text("with_a_longer_row", lambda data: data + b"a,b,c,d,e,f,g,h,i\n")
_text("of_70_megabytes", lambda data: data + b"#" * (70 << 20))
_text("with_rows_twice", lambda data: data + data.splitlines(keepends=True)[1])
_text("in_latin_1", lambda data: data + "ä.png,laser,99,,1,,\n".encode("latin-1"))
_text("backwards", lambda data: b"".join(_backwards(data)), 0)


def _backwards(data: bytes) -> list[bytes]:
    header, *rows = data.splitlines(keepends=True)
    return [header, *reversed(rows)]


@listed(verdict=0)
def frames_csv_with_another_column(folder, rng):
    change_rows(folder, lambda row: row.update(note="seen, twice\nby me"))


@listed(verdict=0)
def frames_csv_with_angles_of_other_turns(folder, rng):
    change_rows(
        folder, lambda row: row.update(encoder_deg=str(float(row["encoder_deg"]) - 720.0)), "laser"
    )


@listed()
def frames_csv_missing(folder, rng):
    (folder / "frames.csv").unlink()


def _cell(column: str, value: str, kind: str = "laser") -> None:
    def harm(folder, rng):
        rows = table(folder)
        chosen = [row for row in rows if row["kind"] == kind]
        chosen[rng.integers(len(chosen))][column] = value
        put_table(folder, rows)

    name = "".join(c if c.isalnum() else "_" for c in value[:20])
    LISTED.append(Damage(f"frames_csv_{column}_{kind}_{name}", "measurement", harm))


for _value in ("nan", "inf", "-inf", "36000.1", "-1e5", "1e308", "1e999", "12,5", "1_0", "0x10"):
    _cell("encoder_deg", _value)
for _value in ("nan", "1e308", "-1", "0", "1e-300", "fast"):
    _cell("exposure_s", _value, "led")
for _value in ("../t1-00200/dark.png", "/etc/passwd", "laser\\000.png", "laser/000.png\nx", ".",
               "laser", "", "x" * 4096, "$(touch pwned).png", "; rm -rf .", "\x1b[31m.png",
               "~/.ssh/id_rsa", "nul\u2028line.png"):  # fmt: skip
    _cell("file", _value)
for _value in ("-1", "1e9", "99999999999", "1.5", "\u0663", "0"):
    _cell("pose", _value)
for _value in ("16", "-1", "4097", "x", ""):
    _cell("led", _value, "led")
_cell("kind", "lazer")
_cell("kind", "<script>alert(1)</script>")
_cell("kind", "board")
_cell("sha256", "0123")
_cell("sha256", "g" * 64)


def _renamed(name: str, verdict: int) -> None:
    """An image whose own name is odd."""

    def harm(folder, rng):
        rows = table(folder)
        row = next(row for row in rows if row["kind"] == "laser")
        target = os.fsencode(folder) + b"/" + os.fsencode(name)
        os.rename(folder / row["file"], target)
        row["file"] = name
        put_table(folder, rows)

    shown = "".join(c if c.isalnum() else "_" for c in name[:20])
    LISTED.append(Damage(f"image_named_{shown}", "measurement", harm, verdict))


_renamed("a b'\"$(touch pwned);&|<>{x}*.png", 0)
_renamed("reifen-ä-轮胎.png", 0)
_renamed("-rf.png", 0)
_renamed("new\nline.png", 1)
_renamed("not-utf8-\udcff.png", 1)
_renamed("bell\x07.png", 1)


@listed()
def image_is_a_link_that_leaves_the_folder(folder, rng):
    path = one_of(folder, "laser", rng)
    outside = folder.with_name(folder.name + "-outside.png")
    shutil.copy(path, outside)
    path.unlink()
    path.symlink_to(outside)


@listed()
def image_is_a_link_to_itself(folder, rng):
    path = one_of(folder, "laser", rng)
    path.unlink()
    path.symlink_to(path.name)


@listed()
def images_lie_in_a_linked_folder(folder, rng):
    outside = folder.with_name(folder.name + "-laser")
    (folder / "laser").rename(outside)
    (folder / "laser").symlink_to(outside)


# capture.yaml.


def _yaml(name: str, change: Callable[[bytes], bytes], verdict: int | None = 1) -> None:
    def harm(folder, rng):
        path = folder / "capture.yaml"
        put(path, change(path.read_bytes()))

    LISTED.append(Damage(f"capture_yaml_{name}", "measurement", harm, verdict))


def _bomb(data: bytes) -> bytes:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, 9)]
    return data + "\n".join(lines).encode() + b"\n"


_yaml("empty", lambda data: b"")
_yaml("a_list", lambda data: b"- a\n- b\n")
_yaml("with_a_key_twice", lambda data: data + b"rig: other\n")
_yaml("with_a_nested_key_twice", lambda data: data.replace(b"{scan", b"{scan: rows, scan", 1))
_yaml("that_explodes", _bomb)
_yaml("that_contains_itself", lambda data: data + b"x: &x [*x]\n")
_yaml("that_builds_objects", lambda data: data + b"x: !!python/object/apply:os.system [id]\n")
_yaml("that_builds_dates", lambda data: data + b"x: !!timestamp nothing\n")
_yaml("of_100_megabytes", lambda data: data + b"x: " + b"y" * (100 << 20))
_yaml("nested_deeply", lambda data: data + b"x: " + b"[" * 5000)
_yaml("cut_off", lambda data: data[: len(data) // 2])
_yaml("in_latin_1", lambda data: data + "note: Prüfstand\n".encode("latin-1"))
_yaml("of_random_bytes", lambda data: bytes(range(256)))
_yaml("with_an_alias", lambda data: data + b"a: &a {x: 1}\nb: *a\n", 0)
_yaml(
    "with_a_script_as_size",
    lambda data: data.replace(b"215/70R16", b"<script>alert(1)</script>"),
    0,
)


@listed()
def capture_yaml_missing(folder, rng):
    (folder / "capture.yaml").unlink()


@listed()
def capture_yaml_is_a_pipe(folder, rng):
    (folder / "capture.yaml").unlink()
    os.mkfifo(folder / "capture.yaml")


@listed()
def capture_yaml_is_a_link_that_leaves_the_folder(folder, rng):
    outside = folder.with_name(folder.name + ".yaml")
    shutil.copy(folder / "capture.yaml", outside)
    (folder / "capture.yaml").unlink()
    (folder / "capture.yaml").symlink_to(outside)


@listed()
def capture_yaml_is_a_folder(folder, rng):
    (folder / "capture.yaml").unlink()
    (folder / "capture.yaml").mkdir()


def _fact(name: str, value, verdict: int | None = 1, kind: str = "measurement") -> None:
    def harm(folder, rng):
        change_facts(folder, **{name: value})

    shown = "".join(c if c.isalnum() else "_" for c in str(value)[:20])
    LISTED.append(Damage(f"fact_{name}_{shown}", kind, harm, verdict))


for _name, _values in {
    "format": ("tread-capture/2", 1, None),
    "kind": ("sample", ["measurement"], None),
    "capture": ("../x", "a b", ".x", "x" * 65, 7, "<script>", None),
    "captured_at": ("yesterday", 2020, [], None),
    "rig": ("", 5, {}, None),
    "camera": ("wide", [], None),
    "camera__size_px": ([100_000, 100_000], [128], "128x192", [0, 192], [192, 128], [65535, 65535]),
    "camera__encoding": ("gamma", 1),
    "camera__black_level": (-1, "low", 65535),
    "camera__white_level": (float("nan"), float("inf"), 0, True),
    "laser__scan": ("diagonal", None),
    "laser__channel": ("infrared", 0),
    "leds": (-1, 4, 1e9, "many", True),
    "tire": ("t1", None),
    "tire__id": ("<script>alert(1)</script>", "a/b", "..", 1),
    "tire__nominal_radius_mm": (200.0, 1e308, -1, "big"),
    "tire__tread_width_mm": (float("nan"), 0),
    "tire__rolling_direction": ("forwards",),
    "mileage__value": (-1, float("inf"), "many"),
    "mileage__unit": ("leagues", None),
}.items():
    for _value in _values:
        _fact(_name, _value)


def _with_sibling(folder: Path, **changes) -> None:
    other = copy_capture(folder, folder.with_name("a-other"))
    change_facts(other, **changes)
    # The older one of two holds: a third settles which is the usual.
    change_facts(copy_capture(other, folder.with_name("a-third")), capture="third")


@listed()
def two_captures_of_one_id(folder, rng):
    _with_sibling(folder)


@listed()
def two_tires_of_one_id(folder, rng):
    _with_sibling(folder, capture="other", tire__size="205/55R16", tire__nominal_radius_mm=316.0)


@listed()
def tire_of_the_wrong_radius(folder, rng):
    change_facts(folder, tire__nominal_radius_mm=300.0)


# Calibrations.


def drop_rows(folder: Path, drop: Callable[[dict[str, str]], bool]) -> None:
    put_table(folder, [row for row in table(folder) if not drop(row)])


@listed("calibration")
def three_boards(folder, rng):
    drop_rows(
        folder,
        lambda row: (
            row["kind"] == "axis_board"
            or (row["kind"].startswith("board") and int(row["pose"]) > 1)
        ),
    )


@listed("calibration")
def boards_in_one_plane(folder, rng):
    for kind in ("board", "axis_board"):
        first, *others = files_of(folder, kind)
        for path in others:
            repaint(folder, path, lambda image, first=first: pixels_of(first))
    drop_rows(folder, lambda row: row["kind"] == "reference_board")


@listed("calibration")
def one_ball_visible(folder, rng):
    files = files_of(folder, "balls")
    brightest = np.max([pixels_of(path) for path in files], axis=0)
    v, u = np.unravel_index(np.argmax(brightest), brightest.shape)
    window = (slice(max(v - 12, 0), v + 12), slice(max(u - 12, 0), u + 12))

    def hide(image):
        bare = np.full_like(image, np.median(image))
        bare[window] = image[window]
        return bare

    for path in files:
        repaint(folder, path, hide)


@listed("calibration")
def no_axis_frames(folder, rng):
    drop_rows(folder, lambda row: row["kind"] == "axis_board")


@listed("calibration")
def no_boards(folder, rng):
    drop_rows(folder, lambda row: row["kind"] in ("board", "board_laser"))


@listed("calibration")
def axis_boards_at_one_angle(folder, rng):
    change_rows(folder, lambda row: row.update(encoder_deg="5"), "axis_board")


@listed("calibration")
def balls_of_one_led_twice(folder, rng):
    rows = table(folder)
    ball = next(row for row in rows if row["kind"] == "balls")
    put_table(folder, [*rows, {**ball, "pose": "1"}])


@listed("calibration")
def balls_all_black(folder, rng):
    for path in files_of(folder, "balls"):
        repaint(folder, path, np.zeros_like)


@listed("calibration")
def one_led_dead_on_the_balls(folder, rng):
    repaint(folder, one_of(folder, "balls", rng), np.zeros_like)


@listed("calibration", verdict=None)
def one_led_dead_on_the_card(folder, rng):
    repaint(folder, one_of(folder, "card", rng), np.zeros_like)


@listed("calibration")
def card_leds_swapped(folder, rng):
    rows = table(folder)
    card = [row for row in rows if row["kind"] == "card"]
    card[0]["led"], card[7]["led"] = card[7]["led"], card[0]["led"]
    put_table(folder, rows)


@listed("calibration")
def board_truncated(folder, rng):
    without_digests(folder)
    path = one_of(folder, "board", rng)
    put(path, path.read_bytes()[:2000])


@listed("calibration")
def board_all_black(folder, rng):
    repaint(folder, one_of(folder, "board", rng), np.zeros_like)


@listed("calibration")
def reference_board_all_black(folder, rng):
    repaint(folder, one_of(folder, "reference_board", rng), np.zeros_like)


@listed("calibration")
def boards_of_other_corners(folder, rng):
    change_facts(folder, board__inner_corners=[11, 8])


@listed("calibration")
def laser_off_on_the_boards(folder, rng):
    dark = pixels_of(files_of(folder, "dark")[0])
    for path in files_of(folder, "board_laser"):
        repaint(folder, path, lambda image: np.dstack([dark] * 3))


for _name, _value in {
    "board__inner_corners": [2, 2],
    "board__square_mm": "15 mm",
    "balls__count": 0,
    "balls__diameter_mm": None,
    "card__albedo": 7,
    "axis_board": None,
}.items():
    _fact(_name, _value, 1, "calibration")


# The mutator.

_NASTY = ("", "nan", "-1", "1e308", "../x", "/etc/passwd", "\0", "'", '"', "\n", ",", ";", "[", "{",
          "&a", "*a", "!!python/name:os.system", "true", "null", "0", "9" * 400, "<script>", "é",
          "${HOME}", "`id`", "%s%n", "-", ": ", "# ", "\t", "|", ">", "\u0661", "\u202e",
          "a" * 5000)  # fmt: skip


def mutated(seed: int) -> Damage:
    """Damage number `seed` of the mutator: one to three random changes of a measurement."""
    rng = np.random.default_rng([20261124, seed])
    chosen = [_MUTATIONS[k] for k in rng.integers(len(_MUTATIONS), size=rng.integers(1, 4))]

    def harm(folder: Path, rng: np.random.Generator) -> None:
        for mutation in chosen:
            try:
                mutation(folder, rng)
            # An earlier change may have left nothing for this one to change.
            except (OSError, ValueError, IndexError, KeyError, TypeError, cv2.error, csv.Error):
                continue

    name = "+".join(mutation.__name__.strip("_") for mutation in chosen)
    return Damage(f"mutation_{seed}:{name}", "measurement", harm, None)


def _flip_bytes(path: Path, rng: np.random.Generator) -> None:
    data = bytearray(path.read_bytes())
    for at in rng.integers(len(data), size=rng.integers(1, 6)):
        data[at] = rng.integers(256)
    put(path, bytes(data))


def _cut_bytes(path: Path, rng: np.random.Generator) -> None:
    data = path.read_bytes()
    start, stop = np.sort(rng.integers(len(data) + 1, size=2))
    put(path, data[:start] + data[stop:])


def _insert_nasty(path: Path, rng: np.random.Generator) -> None:
    data, word = path.read_bytes(), _NASTY[rng.integers(len(_NASTY))]
    at = rng.integers(len(data) + 1)
    put(path, data[:at] + word.encode() + data[at:])


def _document(folder: Path, rng: np.random.Generator) -> Path:
    return folder / ("capture.yaml", "frames.csv")[rng.integers(2)]


def flip_bytes_of_a_document(folder, rng):
    _flip_bytes(_document(folder, rng), rng)


def cut_bytes_of_a_document(folder, rng):
    _cut_bytes(_document(folder, rng), rng)


def insert_into_a_document(folder, rng):
    _insert_nasty(_document(folder, rng), rng)


def flip_bytes_of_an_image(folder, rng):
    _flip_bytes(any_kind(folder, rng), rng)


def flip_bytes_of_an_image_without_digest(folder, rng):
    without_digests(folder)
    _flip_bytes(any_kind(folder, rng), rng)


def cut_bytes_of_an_image(folder, rng):
    without_digests(folder)
    _cut_bytes(any_kind(folder, rng), rng)


def exchange_two_images(folder, rng):
    a, b = any_kind(folder, rng), any_kind(folder, rng)
    one, two = a.read_bytes(), b.read_bytes()
    put(a, two)
    put(b, one)


def change_a_cell(folder, rng):
    rows = table(folder)
    row = rows[rng.integers(len(rows))]
    row[list(row)[rng.integers(len(row))]] = _NASTY[rng.integers(len(_NASTY))]
    put_table(folder, rows)


def change_a_fact(folder, rng):
    facts = yaml.safe_load((folder / "capture.yaml").read_text())
    node, name = facts, list(facts)[rng.integers(len(facts))]
    if isinstance(facts[name], dict) and rng.integers(2):
        node = facts[name]
        name = list(node)[rng.integers(len(node))]
    values = (None, [], {}, -1, 1e308, float("nan"), True, "x", [[1]], 10**30)
    node[name] = values[rng.integers(len(values))]
    put(folder / "capture.yaml", yaml.safe_dump(facts).encode())


def drop_a_line(folder, rng):
    path = _document(folder, rng)
    lines = path.read_bytes().splitlines(keepends=True)
    del lines[rng.integers(len(lines))]
    put(path, b"".join(lines))


def repeat_a_line(folder, rng):
    path = _document(folder, rng)
    lines = path.read_bytes().splitlines(keepends=True)
    lines.insert(int(rng.integers(len(lines))), lines[rng.integers(len(lines))])
    put(path, b"".join(lines))


def repaint_an_image(folder, rng):
    noise = rng.integers(65536, size=(2, 2), dtype=np.uint16)

    def change(image):
        paints = (
            np.zeros_like,
            lambda i: np.full_like(i, 65535),
            lambda i: np.rot90(i),
            lambda i: i[::-1],
            lambda i: np.roll(i, 40, axis=1),
            lambda i: cv2.resize(noise, i.shape[1::-1]),
            lambda i: i.astype(np.uint8),
            lambda i: np.dstack([i] * 3) if i.ndim == 2 else i[:, :, 0],
            lambda i: np.repeat(i, 3, axis=1),
        )
        return paints[rng.integers(len(paints))](image)

    repaint(folder, any_kind(folder, rng), change)


_MUTATIONS = (
    flip_bytes_of_a_document,
    cut_bytes_of_a_document,
    insert_into_a_document,
    flip_bytes_of_an_image,
    flip_bytes_of_an_image_without_digest,
    cut_bytes_of_an_image,
    exchange_two_images,
    change_a_cell,
    change_a_fact,
    drop_a_line,
    repeat_a_line,
    repaint_an_image,
)
