"""Damaged frames.csv and capture.yaml, and captures beside each other."""

import os
import shutil
from collections.abc import Callable
from pathlib import Path

from damage import (
    Damage,
    change_facts,
    change_rows,
    copy_capture,
    listing,
    of_fact,
    one_of,
    put,
    put_table,
    table,
)

DAMAGES: list[Damage] = []
listed = listing(DAMAGES)

# frames.csv.


def _text(name: str, change: Callable[[bytes], bytes], verdict: int | None = 1) -> None:
    """A damage of the bytes of frames.csv."""

    def harm(folder, rng):
        path = folder / "frames.csv"
        put(path, change(path.read_bytes()))

    DAMAGES.append(Damage(f"frames_csv_{name}", "measurement", harm, verdict))


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
    DAMAGES.append(Damage(f"frames_csv_{column}_{kind}_{name}", "measurement", harm))


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
    DAMAGES.append(Damage(f"image_named_{shown}", "measurement", harm, verdict))


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

    DAMAGES.append(Damage(f"capture_yaml_{name}", "measurement", harm, verdict))


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
        DAMAGES.append(of_fact(_name, _value))


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
