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
    from treadlight.calibrate.balls import find_balls
    from treadlight.calibrate.leds import calibrate_leds
    from treadlight.commands.common import run_stage
    from treadlight.images import FrameReader

    capture = read_capture(args.capture)

    def work() -> None:
        rig = store.read_rig(args.camera)
        frames, balls = capture.of_kind("balls"), capture.balls
        if not frames or balls is None:
            store.write_json(args.out, {"leds": None})
            return
        if rig.reference_plane is None:
            print(
                "LEDs: left out, the balls' height needs a frame of kind 'reference_board'.",
                file=sys.stderr,
            )
            store.write_json(args.out, {"leds": None})
            return
        frames = tuple(sorted(frames, key=lambda frame: frame.led or 0))
        reader = FrameReader(capture)
        found = find_balls(
            _Frames(reader, frames),
            rig.camera,
            rig.reference_plane,
            balls.count,
            balls.diameter_mm,
            balls.centre_height_mm,
        )
        if len(found.centres) < balls.count:
            print(f"LEDs: {len(found.centres)} of {balls.count} balls found.", file=sys.stderr)
        numbers = [frame.led or 0 for frame in frames]
        fit = calibrate_leds(rig.camera, found, numbers)
        _say_rejected(fit, numbers)
        intensities = _intensities(capture, rig, fit.leds)
        content = {
            "leds": _content(fit.leds, intensities),
            "balls": [{"ball": k, "centre": centre} for k, centre in enumerate(fit.centres)],
            "rays": _rays(fit, found.highlights, numbers),
        }
        store.write_json(args.out, content)

    return run_stage(
        args,
        inputs=[args.camera],
        outputs=[args.out],
        title="LED calibration",
        source=capture.id,
        work=work,
    )


class _Frames(Sequence):
    """Frames that are decoded when asked for: one image is held at a time."""

    def __init__(self, reader, frames):
        self.reader, self.frames = reader, frames

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, index):
        return self.reader.read(self.frames[index])


def _intensities(capture, rig, leds):
    """Relative intensity of each LED: from the card, or from what the balls lie on."""
    import numpy as np

    from treadlight.calibrate.beams import solve_beams
    from treadlight.calibrate.illumination import MIN_BLOCKS, relative_intensities
    from treadlight.commands.calibrate_illumination import samples_of

    positions = {led.number: led.position for led in leds}
    card = {frame.led for frame in capture.of_kind("card")}
    # One kind for all: card and ground differ in albedo.
    kind = "card" if set(positions) <= card else "balls"
    found = samples_of(capture, kind, rig, positions)
    samples = [found[number] for number in positions]
    if kind == "balls" or min(len(s.values) for s in samples) < MIN_BLOCKS:
        return relative_intensities(samples)
    places = np.stack(list(positions.values()))
    beams = solve_beams(samples, places, rig.reference_plane, rig.camera).beams
    intensities = np.array([beam.intensity for beam in beams])
    return intensities / intensities.mean()


def _say_rejected(fit, numbers) -> None:
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
        print(f"LEDs: left out, too few balls show them: {missing}.", file=sys.stderr)


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
