"""Calibrations that lack what they need, or show what they should not."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from damage import (
    Damage,
    change_facts,
    change_rows,
    files_of,
    listing,
    of_fact,
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
    DAMAGES.append(of_fact(_name, _value, 1, "calibration"))
