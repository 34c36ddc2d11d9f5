"""Bring laser points into the tire's frame, choose the grid, and lay the first surface.

Writes the laser sections (laser.zarr) and r(theta, z) interpolated between them along the
grooves (surface.zarr). A capture without laser frames gets the nominal cylinder.
"""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from treadlight.commands import common
from treadlight.spool import IN_MEMORY, Memory, Spool

if TYPE_CHECKING:
    import numpy as np
    import xarray as xr

    from treadlight.archive import Capture
    from treadlight.cylinder import CylinderSettings, Sections, Surface
    from treadlight.geometry import Axis, CylinderGrid, Rig

# Where the line's width is not known, it is taken as this many pixels.
_LINE_SIGMA_PX = 2.0
# Laser sections this share off the nominal radius are odd, or of another tire: a tread is no
# deeper, and a size's radius is known better.
_ODD_RADIUS = 0.035
_WRONG_RADIUS = 0.1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("points", type=Path, help="laser_points.zarr")
    parser.add_argument("--capture", type=Path, required=True, help="folder of the capture")
    parser.add_argument("--calibration", type=Path, required=True, help="calibration.json")
    parser.add_argument("--out", type=Path, required=True, help="laser.zarr to write")
    parser.add_argument("--surface", type=Path, required=True, help="surface.zarr to write")
    common.add_stage_arguments(parser)


def run(args: argparse.Namespace) -> int:
    from treadlight import store
    from treadlight.archive import read_capture
    from treadlight.cylinder import CylinderSettings

    settings = common.parse_settings(args.settings, CylinderSettings)
    capture = read_capture(args.capture)
    laser_out, surface_out = store.store_folder(args.out), store.store_folder(args.surface)

    def work() -> None:
        points = store.open_store(args.points).load()
        rig = store.read_rig(args.calibration)
        memory = Spool(surface_out.parent)
        laser, surface = register(points, rig, capture, settings, memory)
        memory.release()
        for out, product, title in (
            (laser_out, laser, "Laser sections"),
            (surface_out, surface, "First surface"),
        ):
            store.write_store(out, product, title=title, source=capture.id, memory=memory)

    return common.run_stage(
        args,
        inputs=[args.points, args.calibration],
        outputs=[laser_out, surface_out],
        title="Laser sections and first surface",
        source=capture.id,
        work=work,
    )


def register(
    points: "xr.Dataset",
    rig: "Rig",
    capture: "Capture",
    settings: "CylinderSettings",
    memory: Memory | Spool = IN_MEMORY,
) -> "tuple[xr.Dataset, xr.Dataset]":
    """laser.zarr and surface.zarr, its arrays in `memory`, of one capture.

    Raises
    ------
    CalibrationError
        The calibration has no axis.
    CaptureError
        Nothing in the capture shows the tread.
    """
    import math

    from treadlight import cylinder
    from treadlight.errors import CalibrationError
    from treadlight.tread import find_regions

    if rig.axis is None:
        raise CalibrationError(
            "The calibration has no rotation axis. Add frames of kind 'axis_board' to the"
            " calibration capture."
        )
    assert capture.tire is not None
    radius = capture.tire.nominal_radius_mm
    warnings = [*points.attrs.get("warnings", ()), *_radius_warnings(points, rig.axis, capture)]
    sections = cylinder.register_sections(
        points.point.values,
        points.deviation.values,
        points.path.values,
        points.quality.values,
        points.encoder.values,
        rig.axis,
        radius,
    )
    views = [
        cylinder.view_extent(rig, math.radians(capture.view(pose)[0].encoder_deg or 0.0), radius)
        for pose in capture.views
    ]
    pixel = cylinder.pixel_size_mm(rig, radius)
    grid = cylinder.choose_grid(
        sections, views, settings.step_mm or pixel, radius, capture.tire.tread_width_mm
    )
    line_mm = points.attrs.get("line_sigma_px", _LINE_SIGMA_PX) * pixel
    surface = cylinder.lay_surface(sections, views, grid, line_mm, memory)
    shared = cylinder.shared_rows(sections, line_mm)
    tops = cylinder.on_tops(sections, find_regions(surface.r, grid))
    told = {"closure_mm": cylinder.closure_mm(sections, tops), "shared_rows": shared}
    laser = _laser_dataset(points, sections).assign_attrs(told)
    if warnings:
        laser = laser.assign_attrs(warnings=warnings)
    return laser, _surface_dataset(surface, grid, capture)


def _radius_warnings(points: "xr.Dataset", axis: "Axis", capture: "Capture") -> list[str]:
    """Hold the radius at which the laser's line lies against the nominal one.

    Raises
    ------
    CaptureError
        They are too far apart for one tire.
    """
    import numpy as np

    from treadlight.errors import CaptureError

    assert capture.tire is not None
    path = points.path.values
    chosen = np.take_along_axis(points.point.values, np.maximum(path, 0)[..., None, None], 2)
    _, _, r = axis.to_tire(chosen[:, :, 0], points.encoder.values[:, None])
    r = r[(path >= 0) & np.isfinite(r)]
    nominal = capture.tire.nominal_radius_mm
    if not len(r):
        return []
    measured = float(np.median(r))
    said = (
        f"{capture.folder / 'capture.yaml'}: tire.nominal_radius_mm is {nominal:g}, but the laser"
        f" sections lie at {measured:.1f} mm. Correct it, or the calibration of the axis."
    )
    if abs(measured - nominal) > _WRONG_RADIUS * nominal:
        raise CaptureError(said)
    return [said] if abs(measured - nominal) > _ODD_RADIUS * nominal else []


def _laser_dataset(points: "xr.Dataset", sections: "Sections") -> "xr.Dataset":
    import numpy as np
    import xarray as xr

    from treadlight.cylinder import FLAGS
    from treadlight.store import flag_attrs, variable

    dims = ("section", "line")
    chosen = sections.chosen

    def pick(name: str) -> "np.ndarray":
        values = points[name].values
        taken = np.take_along_axis(values, np.maximum(chosen, 0)[..., None], -1)[..., 0]
        return np.where(chosen >= 0, taken, np.nan).astype(np.float32)

    texts = {
        "u": ("pixel", "sub-pixel position across the line"),
        "u_std": ("pixel", "standard deviation of u"),
        "width": ("pixel", "full width at half maximum over 2.355"),
        "strength": ("1", "smoothed intensity at the line; 1 is full scale"),
    }
    variables: dict[str, Any] = {n: variable(dims, pick(n), *text) for n, text in texts.items()}
    variables |= {
        "r": variable(dims, sections.r, "mm", "radius from the rig's axis"),
        "theta": variable(dims, sections.theta, "rad", "angle in the tire frame"),
        "z": variable(dims, sections.z, "mm", "place along the axis in the tire frame"),
        "r_std": variable(dims, sections.r_std, "mm", "standard deviation of r"),
        "encoder": variable(("section",), sections.encoder, "rad", "encoder angle"),
        "quality": variable(
            dims, sections.quality, "1", "what is known of the point", **flag_attrs(FLAGS)
        ),
    }
    return xr.Dataset(variables)


def _surface_dataset(surface: "Surface", grid: "CylinderGrid", capture: "Capture") -> "xr.Dataset":
    import xarray as xr

    from treadlight.cylinder import SURFACE_FLAGS
    from treadlight.store import flag_attrs, variable

    assert capture.tire is not None
    dims = ("theta", "z")
    return xr.Dataset(
        {
            "r": variable(dims, surface.r, "mm", "radius from the rig's axis"),
            "r_std": variable(dims, surface.r_std, "mm", "standard uncertainty of r"),
            "laser_r": variable(dims, surface.laser_r, "mm", "radius of the laser sections alone"),
            "quality": variable(
                dims, surface.quality, "1", "origin of the cell", **flag_attrs(SURFACE_FLAGS)
            ),
        },
        coords={
            "theta": variable(("theta",), grid.theta, "rad", "angle in the tire frame"),
            "z": variable(("z",), grid.z, "mm", "place along the axis in the tire frame"),
        },
        attrs={
            "tire": capture.tire.id,
            "mileage": capture.mileage,
            "mileage_unit": capture.mileage_unit,
            "captured_at": capture.captured_at.isoformat(),
            "nominal_radius_mm": grid.nominal_radius_mm,
            "rig": capture.rig,
        },
    )
