"""Map how strongly each LED lights the reference plane, from a card of known albedo.

Writes illumination.zarr. Without `card` frames the maps are the LEDs' relative intensities.
"""

import argparse
from pathlib import Path


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
    from treadlight.calibrate import illumination as core
    from treadlight.commands.common import progress, run_stage
    from treadlight.images import FrameReader

    capture = read_capture(args.capture)
    title = "Illumination maps"

    def work() -> None:
        rig = store.read_rig(args.calibration)
        reader = FrameReader(capture)
        leds = {led.number: led for led in rig.leds}
        fits = {}
        for frame in progress(capture.of_kind("card"), "card"):
            if frame.led not in leds or rig.reference_plane is None:
                continue
            light = reader.read(frame)
            exposed = light.intensity / np.float32(frame.exposure_s or 1.0)
            samples = core.plane_samples(
                core.CardFrame(frame.led, exposed, light.saturated),
                leds[frame.led].position,
                rig.reference_plane,
                rig.camera,
                capture.card_albedo or 1.0,
            )
            fits[frame.led] = core.fit_smooth_map(samples)
        dataset = _dataset(rig, fits)
        store.write_store(store.store_folder(args.out), dataset, title=title, source=capture.id)

    return run_stage(
        args,
        inputs=[args.calibration],
        outputs=[args.out],
        title=title,
        source=capture.id,
        work=work,
    )


def _dataset(rig, fits):
    import numpy as np
    import xarray as xr

    from treadlight import store
    from treadlight.calibrate.illumination import map_step, radiant_intensity_maps
    from treadlight.geometry.light import map_nodes

    if not rig.leds:
        return xr.Dataset()
    rows, columns = map_nodes(rig.camera.size_px, map_step(rig.camera.size_px))
    numbers = np.array([led.number for led in rig.leds])
    residual = np.array([fits[k].residual if k in fits else np.nan for k in numbers], np.float32)
    maps = radiant_intensity_maps(rig.leds, fits, rig.camera.size_px)
    variable = store.variable
    return xr.Dataset(
        {
            "radiant_intensity": variable(
                ("led", "v", "u"), maps, "mm2", "irradiance times squared distance of the LED"
            ),
            "residual": variable(
                ("led",), residual, "1", "relative root mean square of the card over the map"
            ),
        },
        coords={
            "led": variable(("led",), numbers, "1", "LED number"),
            "v": variable(("v",), rows, "pixel", "image row"),
            "u": variable(("u",), columns, "pixel", "image column"),
        },
    )
