"""Integrate normals and laser sections into the profile r(theta, z) of a capture.

Writes profile.zarr and quality.json. Views that are refused are left out with a warning; without
views the profile comes from the laser alone, without laser points only its shape is known.
"""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from treadlight.commands import common

if TYPE_CHECKING:
    from collections.abc import Iterator

    import numpy as np
    import xarray as xr

    from treadlight import integrate, tread
    from treadlight.archive import Capture
    from treadlight.geometry import CylinderGrid, Rig


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("capture", type=Path, help="folder of the measurement capture")
    parser.add_argument("--calibration", type=Path, required=True, help="calibration.json")
    parser.add_argument("--surface", type=Path, required=True, help="surface.zarr")
    parser.add_argument("--laser", type=Path, required=True, help="laser.zarr")
    parser.add_argument("--views", type=Path, nargs="*", default=[], help="photometric.zarr/fovNN")
    parser.add_argument("--out", type=Path, required=True, help="profile.zarr to write")
    parser.add_argument("--quality", type=Path, required=True, help="quality.json to write")
    parser.add_argument(
        "--warning", action="append", default=[], help="a sentence for quality.json"
    )
    common.add_stage_arguments(parser)


def run(args: argparse.Namespace) -> int:
    from treadlight import store
    from treadlight.archive import read_capture
    from treadlight.integrate import IntegrateSettings

    settings = common.parse_settings(args.settings, IntegrateSettings)
    capture = read_capture(args.capture)
    out = store.store_folder(args.out)

    def work() -> None:
        profile, report = integrate_products(args, settings)
        store.write_store(out, profile, title="Profile", source=capture.id)
        store.write_json(args.quality, report)

    return common.run_stage(
        args,
        inputs=[args.calibration, args.surface, args.laser],
        outputs=[out, args.quality],
        title="Profile",
        source=capture.id,
        work=work,
    )


def integrate_products(
    args: argparse.Namespace, settings: "integrate.IntegrateSettings"
) -> "tuple[xr.Dataset, dict[str, Any]]":
    """profile.zarr and the content of quality.json."""
    import numpy as np

    from treadlight import integrate, store, tread
    from treadlight.archive import read_capture
    from treadlight.geometry import CylinderGrid

    surface = store.open_store(args.surface).load()
    laser = store.open_store(args.laser).load()
    rig = store.read_rig(args.calibration)
    grid = CylinderGrid(
        surface.theta.values, surface.z.values, float(surface.attrs["nominal_radius_mm"])
    )
    capture = read_capture(args.capture)
    warnings = list(args.warning)
    usable = []
    for view in args.views:
        reason = store.refused_reason(view)
        if reason:
            warnings.append(f"{store.store_folder(view).name} is left out: {reason}")
        else:
            usable.append((view, _camera(view, capture, rig)))
    sections = integrate.LaserSections(
        laser.r.values,
        laser.theta.values,
        laser.z.values,
        laser.r_std.values,
        laser.encoder.values,
        float(laser.attrs["shared_rows"]),
    )
    if not np.isfinite(sections.r).any():
        warnings.append(
            "There are no laser points: the profile's level and large shape are not measured."
        )
    if not usable:
        warnings.append("There are no normals: the profile comes from the laser alone.")
    profile = integrate.integrate_capture(
        common.progress(_read_views(usable), f"{capture.id}: views gathered", len(usable), 0),
        sections,
        integrate.FirstSurface(surface.r.values, surface.r_std.values),
        grid,
        settings.held_out_every,
    )
    regions = tread.find_regions(profile.r, grid)
    closure = laser.attrs.get("closure_mm")
    report = integrate.quality_report(profile, regions, rig, closure, warnings)
    return _dataset(profile, surface, regions, grid), report


def _camera(view: Path, capture: "Capture", rig: "Rig") -> "np.ndarray | None":
    """Centre of the camera in {T} (r, theta, z), from the number in the view's name."""
    import numpy as np

    from treadlight import store

    number = int(store.store_folder(view).name.removeprefix("fov"))
    if rig.axis is None:
        return None
    encoder = np.radians(capture.view(number)[0].encoder_deg or 0.0)
    return np.array([np.linalg.norm(rig.axis.point), -encoder, 0.0])


def _read_views(
    paths: "list[tuple[Path, np.ndarray | None]]",
) -> "Iterator[integrate.ViewNormals]":
    """The views with their cameras, one in memory at a time."""
    import numpy as np

    from treadlight import store
    from treadlight.integrate import ViewNormals

    for path, camera in paths:
        view = store.open_store(path).load()
        names = view.quality.attrs["flag_meanings"].split()
        flags = {name: (view.quality.values >> bit) & 1 > 0 for bit, name in enumerate(names)}
        yield ViewNormals(
            view.normal.values,
            view.normal_cov.values,
            view.r.values,
            view.theta.values,
            view.z.values,
            np.stack([view[name].values for name in ("k_d", "k_s", "alpha")], axis=-1),
            flags["shadowed"],
            flags["saturated"],
            flags["poor_fit"],
            camera,
        )


def _dataset(
    profile: "integrate.Profile",
    surface: "xr.Dataset",
    regions: "tread.Regions",
    grid: "CylinderGrid",
) -> "xr.Dataset":
    import numpy as np
    import xarray as xr

    from treadlight import integrate, tread
    from treadlight.store import flag_attrs, variable

    reference = tread.fit_reference(profile.r, profile.r_std, grid, regions)
    height = reference.height(profile.r, grid.theta, grid.z)
    dims = ("theta", "z")

    def single(values: "np.ndarray", units: str, long_name: str) -> "xr.Variable":
        return variable(dims, values.astype(np.float32), units, long_name)

    variables = {
        "r": variable(dims, profile.r, "mm", "radius from the rig's axis"),
        "r_std": single(profile.r_std, "mm", "standard uncertainty of r (shape)"),
        "laser_r": single(surface.laser_r.values, "mm", "radius of the laser sections alone"),
        "normal": variable(
            (*dims, "component"), profile.normal, "1", "unit normal in the basis (r, theta, z)"
        ),
        "k_d": single(profile.material[0], "1", "diffuse reflectance factor"),
        "k_s": single(profile.material[1], "1", "specular reflectance factor"),
        "alpha": single(profile.material[2], "1", "shininess exponent"),
        "height": single(height, "mm", "height over the groove reference"),
        "quality": variable(
            dims,
            integrate.quality_flags(profile),
            "1",
            "quality flags",
            **flag_attrs(integrate.FLAGS),
        ),
    }
    coordinates = {
        "theta": variable(("theta",), grid.theta, "rad", "angle in the tire frame"),
        "z": variable(("z",), grid.z, "mm", "place along the axis in the tire frame"),
        "component": variable(
            ("component",), np.array(["r", "theta", "z"]), "1", "component of a vector"
        ),
    }
    return xr.Dataset(variables, coordinates, attrs=surface.attrs)
