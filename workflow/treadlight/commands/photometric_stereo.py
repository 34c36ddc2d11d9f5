"""Surface normals of one field of view by specular photometric stereo.

Each pixel's scene point is where its viewing ray meets the current surface; light and view
vectors, irradiance and cast shadows follow from it. Writes normals, k_d, k_s, alpha, residual,
LEDs used, the scene point and flags per pixel (photometric.zarr/fovNN).
"""

import argparse
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

from treadlight.commands import common
from treadlight.spool import IN_MEMORY, Memory, Spool

if TYPE_CHECKING:
    import numpy as np
    import xarray as xr

    from treadlight.archive import Capture, Frame
    from treadlight.geometry import Rig
    from treadlight.photometric.view import View, ViewNormals

_LONG_NAMES = {
    "k_d": "diffuse reflectance factor",
    "k_s": "specular reflectance factor",
    "alpha": "shininess exponent",
    "residual": "mean relative rerendering error",
    "leds_used": "LEDs that the fit used",
    "r": "radius of the assumed scene point",
    "theta": "angle of the assumed scene point",
    "z": "axial place of the assumed scene point",
}
_UNITS = {"r": "mm", "theta": "rad", "z": "mm"}
# Of the mantissa: steps of 0.1 mrad, of 0.5 um, and a thousandth of what is known to a hundredth.
_BITS = {
    "normal": 13,
    "normal_cov": 8,
    "k_d": 10,
    "k_s": 10,
    "alpha": 10,
    "residual": 8,
    "r": 19,
    "theta": 20,
    "z": 18,
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("capture", type=Path, help="folder of the measurement capture")
    parser.add_argument("--view", type=int, required=True, help="field-of-view number")
    parser.add_argument("--calibration", type=Path, required=True, help="calibration.json")
    parser.add_argument("--illumination", type=Path, required=True, help="illumination.zarr")
    parser.add_argument(
        "--surface", type=Path, required=True, help="surface.zarr or profile.zarr: r(theta, z)"
    )
    parser.add_argument("--out", type=Path, required=True, help="photometric.zarr/fovNN")
    common.add_stage_arguments(parser)


def run(args: argparse.Namespace) -> int:
    from treadlight import store
    from treadlight.archive import read_capture
    from treadlight.photometric.settings import PhotometrySettings
    from treadlight.photometric.view import needed_rows, solve_view

    settings = common.parse_settings(args.settings, PhotometrySettings)
    capture = read_capture(args.capture)
    title = f"Surface normals of view {args.view}"
    out = store.store_folder(args.out)

    def work() -> None:
        rig = store.read_rig(args.calibration)
        memory = Spool(out.parent)
        view, warnings = read_view(capture, args.view, rig, args.illumination, memory, args.threads)
        surface = store.open_store(args.surface)
        grid = store.grid_of(surface)
        # A whole turn at full size is gigabytes: only what the view needs is read.
        rows = needed_rows(view, grid)
        place = capture.views.index(args.view) + 1
        common.say(
            f"{capture.id}: view {place} of {len(capture.views)}, {len(view.leds)} images read"
        )
        part = store.load_rows(surface[["r", "r_std"]], rows)
        found = solve_view(
            view,
            grid.part(rows),
            part["r"].to_numpy(),
            part["r_std"].to_numpy(),
            settings,
            memory,
        )
        dataset = _with_light(dataset_of(found, memory), view, warnings, memory)
        store.write_store(out, dataset, title=title, source=capture.id, memory=memory)

    return common.run_stage(
        args,
        inputs=[args.calibration, args.illumination, args.surface],
        outputs=[out],
        title=title,
        source=capture.id,
        work=work,
    )


def read_view(
    capture: "Capture",
    number: int,
    rig: "Rig",
    illumination: Path,
    memory: Memory | Spool = IN_MEMORY,
    threads: int = 1,
) -> "tuple[View, list[str]]":
    """The frames of a view whose LEDs are calibrated, as light, with the rig that took them.

    The frames lie in `memory`; `threads` of them are decoded at once. The second is why frames are
    left out: damaged, dark, blinded or moved, a sentence each.

    Raises
    ------
    CalibrationError
        The rotation axis or the LEDs are not calibrated.
    CaptureError
        There is no such view, or too few of its frames can be used.
    """
    import math

    import numpy as np

    from treadlight import store
    from treadlight.errors import CalibrationError, CaptureError
    from treadlight.photometric.noise import dark_noise
    from treadlight.photometric.observations import MIN_LEDS
    from treadlight.photometric.view import View

    if rig.axis is None:
        raise CalibrationError(
            f"{capture.id}: the calibration has no rotation axis, which normals need. Add"
            " axis_board frames to the calibration capture."
        )
    if not rig.leds:
        raise CalibrationError(
            f"{capture.id}: the calibration has no LED positions, which normals need. Add balls"
            " frames to the calibration capture."
        )
    if rig.reference_plane is None:
        raise CalibrationError(
            f"{capture.id}: the calibration has no reference plane, which the illumination needs."
            " Add a reference_board frame to the calibration capture."
        )
    light = store.read_illumination(illumination, rig)
    index = {led.number: k for k, led in enumerate(light.leds)}
    wanted = [f for f in capture.view(number) if f.led in index]
    frames, intensity, left_out = read_frames(capture, wanted, memory, threads)
    if len(frames) < MIN_LEDS:
        raise CaptureError(
            f"{capture.id}, view {number}: {len(frames)} of its LED frames have a calibrated LED."
            f" Specular photometric stereo needs {MIN_LEDS}; add frames or calibrate more LEDs."
            + "".join(f" {sentence}" for sentence in left_out.values())
        )

    def noise_of(frame: np.ndarray) -> float:
        found = dark_noise(frame)
        memory.release()
        return found

    with ThreadPoolExecutor(max(1, threads)) as pool:
        noise = np.array([*pool.map(noise_of, intensity)])
    view = View(
        intensity=intensity,
        noise=noise,
        leds=tuple(index[f.led] for f in frames if f.led is not None),
        light=light,
        camera=rig.camera,
        axis=rig.axis,
        encoder=math.radians(frames[0].encoder_deg or 0.0),
    )
    return view, list(left_out.values())


def read_frames(
    capture: "Capture", frames: "list[Frame]", memory: Memory | Spool, threads: int = 1
) -> "tuple[list[Frame], np.ndarray, dict[str, str]]":
    """Frames of a view that show what they should, as light, each decoded once.

    Returns
    -------
    kept : list of Frame
    intensity : (n_kept, h, w) float32
        Over exposure, in `memory`; NaN where saturated.
    left_out : dict of str to str
        Why the others are damaged, dark, blinded or moved, by file.
    """
    import numpy as np

    from treadlight.errors import CaptureError
    from treadlight.images import FrameReader, doubts

    reader = FrameReader(capture)
    width, height = capture.encoding.size_px
    intensity = memory.empty((len(frames), height, width), np.float32)
    known = [f.exposure_s for f in frames if f.exposure_s]
    # An exposure that is not known makes all of the view count as equal.
    exposures = known if len(known) == len(frames) else [1.0] * len(frames)

    def look(m: int) -> "doubts.Look | str":
        try:
            linear = reader.read(frames[m], out=intensity[m])
        except CaptureError as error:
            return str(error)
        seen = doubts.look_at(linear)
        intensity[m] /= np.float32(exposures[m])
        intensity[m][linear.saturated] = np.nan
        memory.release()
        return seen

    with ThreadPoolExecutor(max(1, threads)) as pool:
        seen = dict(zip([f.file for f in frames], pool.map(look, range(len(frames))), strict=True))
    left_out = {file: reason for file, reason in seen.items() if isinstance(reason, str)}
    looks = {file: found for file, found in seen.items() if not isinstance(found, str)}
    left_out |= doubts.doubts_of_view(looks, capture.laser_scan)
    kept = [m for m, frame in enumerate(frames) if frame.file not in left_out]
    for place, m in enumerate(kept):
        if place != m:
            intensity[place] = intensity[m]
    return [frames[m] for m in kept], intensity[: len(kept)], left_out


def _with_light(
    dataset: "xr.Dataset", view: "View", warnings: list[str], memory: Memory | Spool
) -> "xr.Dataset":
    """Add what the views of a capture are compared by, and what was left out of this one."""
    import numpy as np

    from treadlight import store
    from treadlight.images import doubts

    numbers = np.array([view.light.leds[k].number for k in view.leds])
    patterns = []
    for frame in view.intensity:
        patterns.append(doubts.light_pattern(frame))
        memory.release()
    dims, text = ("led", "row", "column"), "logarithm of the light in blocks of the image"
    dataset = dataset.assign(
        {"light_pattern": store.variable(dims, np.stack(patterns), "1", text)}
    ).assign_coords({"led": store.variable(("led",), numbers, "1", "LED number")})
    return dataset.assign_attrs(warnings=warnings) if warnings else dataset


def dataset_of(found: "ViewNormals", memory: Memory | Spool = IN_MEMORY) -> "xr.Dataset":
    """photometric.zarr/fovNN of the results contract; the maps, in `memory`, are rounded."""
    import numpy as np
    import xarray as xr

    from treadlight import store
    from treadlight.photometric.observations import FLAGS

    pixel = ("v", "u")
    variables = {
        "normal": store.variable(
            (*pixel, "component"), found.normal, "1", "unit normal in the basis (r, theta, z)"
        ),
        "normal_cov": store.variable(
            (*pixel, "tilt"),
            found.normal_cov,
            "rad2",
            "var(n_theta), cov(n_theta, n_z), var(n_z) of the normal",
        ),
        "quality": store.variable(
            pixel, found.quality, "1", "quality flags", **store.flag_attrs(FLAGS)
        ),
    }
    for name, long_name in _LONG_NAMES.items():
        values = getattr(found, name)
        variables[name] = store.variable(pixel, values, _UNITS.get(name, "1"), long_name)
    for name, bits in _BITS.items():
        store.keep_bits_of(variables[name], bits)
        memory.release()
    height, width = found.quality.shape
    coordinates = {
        "v": store.variable(("v",), np.arange(height), "pixel", "image row"),
        "u": store.variable(("u",), np.arange(width), "pixel", "image column"),
        "component": store.variable(
            ("component",), np.array(["r", "theta", "z"]), "1", "component of a vector"
        ),
        "tilt": store.variable(
            ("tilt",), np.array(["tt", "tz", "zz"]), "1", "entry of the covariance"
        ),
    }
    return xr.Dataset(variables, coordinates)
