"""Turn laser pixels into points of the camera's frame by the laser plane.

Every candidate peak is carried along, with the displacement that one standard deviation of
its position makes; which one is the line is settled when the sections are registered.
"""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from treadlight.commands import common

if TYPE_CHECKING:
    import xarray as xr

    from treadlight.geometry import Rig


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("pixels", type=Path, help="laser_pixels.zarr")
    parser.add_argument("--capture", type=Path, required=True, help="folder of the capture")
    parser.add_argument("--calibration", type=Path, required=True, help="calibration.json")
    parser.add_argument("--out", type=Path, required=True, help="laser_points.zarr to write")
    common.add_stage_arguments(parser)


def run(args: argparse.Namespace) -> int:
    from treadlight import store
    from treadlight.archive import read_capture

    capture = read_capture(args.capture)
    out = store.store_folder(args.out)

    def work() -> None:
        pixels = store.open_store(args.pixels)
        rig = store.read_rig(args.calibration)
        dataset = triangulate_sections(pixels, rig, capture.laser_scan)
        store.write_store(out, dataset, title="Laser points", source=capture.id)

    return common.run_stage(
        args,
        inputs=[args.pixels, args.calibration],
        outputs=[out],
        title="Laser points",
        source=capture.id,
        work=work,
    )


def triangulate_sections(pixels: "xr.Dataset", rig: "Rig", scan: str) -> "xr.Dataset":
    """The pixels' dataset with points and deviations in {C}.

    Raises
    ------
    CalibrationError
        There are sections, but the calibration has no laser plane.
    """
    from treadlight.errors import CalibrationError
    from treadlight.laser import triangulate_pixels
    from treadlight.store import variable

    if pixels.sizes["section"] and rig.laser_plane is None:
        raise CalibrationError(
            "The calibration has no laser plane, which the laser sections need. Add frames of"
            " kind 'board' and 'board_laser' to the calibration capture."
        )
    points, deviation = triangulate_pixels(pixels.u.values, pixels.u_std.values, scan, rig)
    dims = ("section", "line", "peak", "component")
    return pixels.load().assign(
        point=variable(dims, points, "mm", "point in the camera frame"),
        deviation=variable(dims, deviation, "mm", "displacement of the point for u + u_std"),
    )
