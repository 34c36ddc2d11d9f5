"""Calibrate the LED positions from their highlights on chrome balls.

Writes leds.json: the entry `leds` of a calibration (null without `balls` frames or without a
reference plane), the `balls` that were found, and of every highlight its `rays` entry: LED, ball,
pixel, how far the reflected ray passes the LED, and whether it had a say in the LED's position.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """CAPTURE, --camera and --out."""
    from treadlight.commands.common import add_stage_arguments

    parser.add_argument("capture", type=Path, help="folder of the calibration capture")
    parser.add_argument("--camera", type=Path, required=True, help="camera.json")
    parser.add_argument("--out", type=Path, required=True, help="leds.json to write")
    add_stage_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Find balls and highlights, place the LEDs, publish."""
    from treadlight import store
    from treadlight.archive import read_capture
    from treadlight.commands.common import run_stage, with_warnings
    from treadlight.errors import CalibrationError

    capture = read_capture(args.capture)

    def work() -> None:
        rig = store.read_rig(args.camera)
        if not capture.of_kind("balls") or capture.balls is None:
            store.write_json(args.out, {"leds": None})
            return
        if rig.reference_plane is None:
            print(
                "LEDs: left out, the balls' height needs a frame of kind 'reference_board'.",
                file=sys.stderr,
            )
            store.write_json(args.out, {"leds": None})
            return
        warnings: list[str] = []
        try:
            content = _calibrated(capture, rig, warnings)
        except CalibrationError as error:
            # The laser's sections can do without LEDs.
            content = {"leds": None}
            warnings.append(f"There are no LED positions. {error}")
        store.write_json(args.out, with_warnings(content, warnings))

    return run_stage(
        args,
        inputs=[args.camera],
        outputs=[args.out],
        title="LED calibration",
        source=capture.id,
        work=work,
    )


def _calibrated(capture, rig, warnings: list[str]) -> dict:
    """Content of leds.json.

    Raises
    ------
    CalibrationError
        What the frames show does not place the LEDs.
    """
    from treadlight.calibrate.balls import find_balls
    from treadlight.calibrate.leds import calibrate_leds
    from treadlight.commands.common import read_or_warn
    from treadlight.errors import CalibrationError
    from treadlight.images import FrameReader, doubts

    reader, balls = FrameReader(capture), capture.balls
    looks = {
        frame.file: doubts.look_at(light)
        for frame in capture.of_kind("balls")
        if (light := read_or_warn(reader, frame, warnings)) is not None
    }
    odd = doubts.unlit_frames(looks)
    warnings += odd.values()
    frames = [f for f in capture.of_kind("balls") if f.file in looks and f.file not in odd]
    frames.sort(key=lambda frame: frame.led or 0)
    if not frames:
        raise CalibrationError("No frame of kind 'balls' can be used. Take them again.")
    found = find_balls(
        _Frames(reader, frames),
        rig.camera,
        rig.reference_plane,
        balls.count,
        balls.diameter_mm,
        balls.centre_height_mm,
    )
    if len(found.centres) < balls.count:
        warnings.append(
            f"balls frames: {len(found.centres)} of {balls.count} balls were found. Check that all"
            " lie in the field of view, or correct balls.count."
        )
    numbers = [frame.led or 0 for frame in frames]
    fit = calibrate_leds(rig.camera, found, numbers)
    _say_rejected(fit, numbers, warnings)
    swapped = _swapped(capture, reader, rig, fit.leds)
    if swapped:
        raise CalibrationError(
            f"balls and card frames disagree on LEDs {' and '.join(map(str, swapped))}, as if"
            " exchanged. Correct led of these rows in frames.csv."
        )
    intensities = _intensities(capture, rig, fit.leds, warnings)
    return {
        "leds": _content(fit.leds, intensities),
        "balls": [{"ball": k, "centre": centre} for k, centre in enumerate(fit.centres)],
        "rays": _rays(fit, found.highlights, numbers),
    }


def _swapped(capture, reader, rig, leds) -> list[int]:
    """LEDs whose light on the card falls as another's would, by their positions."""
    import numpy as np

    from treadlight.commands.common import read_or_warn
    from treadlight.images import doubts

    seen = {
        frame.led: doubts.light_pattern(light.intensity)
        for frame in capture.of_kind("card")
        if (light := read_or_warn(reader, frame, [])) is not None
    }
    u, v = doubts.pattern_centres(rig.camera.size_px)
    pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    points = rig.reference_plane.intersect(rig.camera.rays(pixels))
    told = {}
    for led in leds:
        ray = led.position - points
        light = np.abs(ray @ rig.reference_plane.normal) / np.linalg.norm(ray, axis=1) ** 3
        told[led.number] = np.log(light).reshape(len(v), len(u))
    return sorted({led for pair in doubts.swapped_leds(told, seen) for led in pair})


class _Frames(Sequence):
    """Frames that are decoded when asked for: one image is held at a time."""

    def __init__(self, reader, frames):
        self.reader, self.frames = reader, frames

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, index):
        return self.reader.read(self.frames[index])


def _intensities(capture, rig, leds, warnings):
    """Relative intensity of each LED: from the card, or from what the balls lie on."""
    import numpy as np

    from treadlight.calibrate.beams import solve_beams
    from treadlight.calibrate.illumination import MIN_BLOCKS, relative_intensities
    from treadlight.commands.calibrate_illumination import samples_of

    positions = {led.number: led.position for led in leds}
    card = {frame.led for frame in capture.of_kind("card")}
    # One kind for all: card and ground differ in albedo.
    kind = "card" if set(positions) <= card else "balls"
    found = samples_of(capture, kind, rig, positions, warnings)
    samples = [found[number] for number in positions]
    if kind == "balls" or min(len(s.values) for s in samples) < MIN_BLOCKS:
        return relative_intensities(samples)
    places = np.stack(list(positions.values()))
    beams = solve_beams(samples, places, rig.reference_plane, rig.camera).beams
    intensities = np.array([beam.intensity for beam in beams])
    return intensities / intensities.mean()


def _say_rejected(fit, numbers, warnings: list[str]) -> None:
    import numpy as np

    rejected = [
        f"LED {led.number} on ball {ball}"
        for led in fit.leds
        for ball in np.flatnonzero(np.isfinite(led.distances_mm) & ~led.used)
    ]
    if rejected:
        print(f"LEDs: rays that disagree, rejected: {', '.join(rejected)}.", file=sys.stderr)
    missing = sorted(set(numbers) - {led.number for led in fit.leds})
    if missing:
        listed = ", ".join(map(str, missing))
        warnings.append(f"LEDs {listed} are left out: too few balls show their highlight.")


def _content(leds, intensities) -> list[dict]:
    return [
        {
            "led": led.number,
            "position": led.position,
            "intensity": float(intensity),
            "residual_mm": {
                "mean": float(led.distances_mm[led.used].mean()),
                "max": float(led.distances_mm[led.used].max()),
            },
            "balls": int(led.used.sum()),
        }
        for led, intensity in zip(leds, intensities, strict=True)
    ]


def _rays(fit, highlights, numbers) -> list[dict]:
    """One entry per LED and ball that shows it."""
    import numpy as np

    return [
        {
            "led": led.number,
            "ball": int(ball),
            "pixel": highlights[ball, numbers.index(led.number)],
            "distance_mm": float(led.distances_mm[ball]),
            "used": bool(led.used[ball]),
        }
        for led in fit.leds
        for ball in np.flatnonzero(np.isfinite(led.distances_mm))
    ]
