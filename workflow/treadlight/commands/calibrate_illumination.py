"""Map how strongly each LED lights the reference plane, from a card of known albedo.

Writes illumination.zarr: maps of the LEDs alone, the shape of their beams, and apart from them
what the camera's lens leaves of the light. Without `card` frames the maps are the LEDs' relative
intensities.
"""

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    import xarray as xr

    from treadlight.archive import Capture
    from treadlight.calibrate.beams import Beams
    from treadlight.calibrate.illumination import PlaneSamples
    from treadlight.geometry import Rig


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """CAPTURE, --calibration and --out."""
    from treadlight.commands.common import add_stage_arguments

    parser.add_argument("capture", type=Path, help="folder of the calibration capture")
    parser.add_argument("--calibration", type=Path, required=True, help="calibration.json")
    parser.add_argument("--out", type=Path, required=True, help="illumination.zarr to write")
    add_stage_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Read the card, fit the maps, publish."""
    import numpy as np

    from treadlight import store
    from treadlight.archive import read_capture
    from treadlight.calibrate import beams as core
    from treadlight.calibrate.illumination import MIN_BLOCKS
    from treadlight.commands.common import run_stage

    capture = read_capture(args.capture)
    title = "Illumination maps"

    def work() -> None:
        rig = store.read_rig(args.calibration)
        positions = {led.number: led.position for led in rig.leds}
        warnings: list[str] = []
        samples = samples_of(capture, "card", rig, positions, warnings)
        for number in [k for k, s in samples.items() if len(s.values) < MIN_BLOCKS]:
            del samples[number]
            warnings.append(
                f"card frame of LED {number}: shows too little of the card, unclipped and lit. Its"
                " light is taken as even; take the frame again."
            )
        light = None
        if samples and rig.reference_plane is not None:
            places = np.stack([positions[number] for number in samples])
            light = core.solve_beams([*samples.values()], places, rig.reference_plane, rig.camera)
            if not np.isfinite(light.corner_std):
                warnings.append(
                    f"The lens's vignetting cannot be told from the LEDs' beams by {len(samples)}"
                    " card frames and stays in the beams. Take the card under more LEDs, or over"
                    " more of the image."
                )
        for warning in warnings:
            print(f"Warning: {warning}", file=sys.stderr)
        dataset = _dataset(rig, samples, light)
        if warnings:
            dataset = dataset.assign_attrs(warnings=warnings)
        store.write_store(store.store_folder(args.out), dataset, title=title, source=capture.id)

    return run_stage(
        args,
        inputs=[args.calibration],
        outputs=[args.out],
        title=title,
        source=capture.id,
        work=work,
    )


def samples_of(
    capture: "Capture",
    kind: str,
    rig: "Rig",
    positions: "dict[int, np.ndarray]",
    warnings: list[str],
) -> "dict[int, PlaneSamples]":
    """What frames of a kind show of each LED whose position is known, by LED number.

    Damaged frames are left out and told among the warnings.
    """
    import numpy as np

    from treadlight.calibrate.illumination import CardFrame, plane_samples
    from treadlight.commands.common import progress, read_or_warn
    from treadlight.images import FrameReader

    if rig.reference_plane is None:
        return {}
    reader, samples = FrameReader(capture), {}
    for frame in progress(capture.of_kind(kind), kind):
        if frame.led is None or frame.led not in positions:
            continue
        light = read_or_warn(reader, frame, warnings)
        if light is None:
            continue
        exposed = light.intensity / np.float32(frame.exposure_s or 1.0)
        samples[frame.led] = plane_samples(
            CardFrame(frame.led, exposed, light.saturated),
            positions[frame.led],
            rig.reference_plane,
            rig.camera,
            capture.card_albedo or 1.0,
        )
    return samples


def _dataset(rig: "Rig", samples: "dict[int, PlaneSamples]", light: "Beams | None") -> "xr.Dataset":
    import numpy as np
    import xarray as xr

    from treadlight import store
    from treadlight.calibrate import beams as core
    from treadlight.calibrate.illumination import map_step
    from treadlight.geometry import Vignetting
    from treadlight.geometry.light import map_nodes

    if not rig.leds or rig.reference_plane is None:
        return xr.Dataset()
    plane, camera = rig.reference_plane, rig.camera
    lens = light.vignetting if light else Vignetting()
    beams = dict(zip(samples, light.beams, strict=True)) if light else {}
    corrections = {
        led.number: core.fit_correction(
            samples[led.number], beams[led.number], lens, led.position, plane, camera
        )
        for led in rig.leds
        if led.number in beams
    }
    maps = core.radiant_intensity_maps(rig.leds, beams, corrections, plane, camera)
    rows, columns = map_nodes(camera.size_px, map_step(camera.size_px))
    numbers = np.array([led.number for led in rig.leds])

    def of_beams(value, empty):
        found = [value(k) if k in beams else empty for k in numbers]
        return np.array(found, np.float32)

    variable = store.variable
    return xr.Dataset(
        {
            "radiant_intensity": variable(
                ("led", "v", "u"), maps, "mm2", "irradiance times squared distance of the LED"
            ),
            "vignetting": variable(
                ("coefficient",),
                np.array([lens.linear, lens.quadratic, lens.reach]),
                "1",
                "what the lens leaves of the light: 1 + linear q + quadratic q^2, q = tan^2 of"
                " the angle off the optical axis, constant from q = reach on",
            ),
            "beam_intensity": variable(
                ("led",),
                of_beams(lambda k: beams[k].intensity, np.nan),
                "mm2",
                "radiant intensity on the beam's axis",
            ),
            "beam_power": variable(
                ("led",),
                of_beams(lambda k: beams[k].power, np.nan),
                "1",
                "power of the cosine of the angle off the beam's axis",
            ),
            "beam_axis": variable(
                ("led", "component"),
                of_beams(lambda k: beams[k].axis, np.full(3, np.nan)),
                "1",
                "unit vector in the camera's frame",
            ),
            "residual": variable(
                ("led",),
                of_beams(lambda k: corrections[k].residual, np.nan),
                "1",
                "relative root mean square of the card over the map",
            ),
        },
        coords={
            "led": variable(("led",), numbers, "1", "LED number"),
            "v": variable(("v",), rows, "pixel", "image row"),
            "u": variable(("u",), columns, "pixel", "image column"),
            "component": variable(
                ("component",), np.array(["x", "y", "z"]), "1", "component of a vector"
            ),
            "coefficient": variable(
                ("coefficient",),
                np.array(["linear", "quadratic", "reach"]),
                "1",
                "coefficient of the vignetting",
            ),
        },
    )
