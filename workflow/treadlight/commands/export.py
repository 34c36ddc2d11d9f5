"""Write a profile for other programs: mesh, point cloud, X3P, Gwyddion, NetCDF, picture, numbers.

FORMAT says what, and OUT where:

  mesh     PLY triangles, mm, x at theta = 0, z the axis; open3d, MeshLab, CloudCompare
  points   PLY points of the same with normals
  x3p      height over (theta arc, z), m; ISO 25178-72
  gwy      the same as a Gwyddion channel
  netcdf   every variable of the profile on its own grid; CF, NetCDF 4
  png      height as 16-bit grey; a text in the file says how grey becomes mm
  areal    ISO 25178-2 parameters of rib patches, one row each

Examples:

  treadlight export x3p results/captures/t7-00100/profile.zarr t7.x3p
  treadlight export mesh results/captures/t7-00100/profile.zarr t7.ply --step-mm 1
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from treadlight.commands import common

if TYPE_CHECKING:
    import numpy as np
    import xarray as xr

    from treadlight.export import ExportSettings
    from treadlight.geometry import CylinderGrid

# What a program that reads such files can still open.
_MOST_CELLS = 20_000_000
# About this many cells are read at once.
_CELLS_AT_ONCE = 4_000_000
_AREAL = ("sa_um", "sq_um", "sz_um", "ssk", "sku", "sdq", "sdr_percent", "sal_mm", "str")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("format", metavar="FORMAT", choices=tuple(_WRITERS), help="see above")
    parser.add_argument("profile", metavar="PROFILE", type=Path, help="profile.zarr of a capture")
    parser.add_argument("out", metavar="OUT", type=Path, help="file to write")
    parser.add_argument(
        "--step-mm", type=float, help="cells of at least this size (default: as measured)"
    )
    common.add_stage_arguments(parser)


def run(args: argparse.Namespace) -> int:
    from treadlight import store
    from treadlight.errors import StoreError
    from treadlight.export import ExportSettings

    settings = common.parse_settings(args.settings, ExportSettings)
    if args.step_mm is not None:
        settings = replace(settings, step_mm=args.step_mm)
    if reason := store.refused_reason(args.profile):
        raise StoreError(f"{args.profile}: was refused, so there is nothing to export: {reason}")
    data = store.open_store(args.profile)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    # Only a file that is whole gets the name; some writers go by the suffix.
    temporary = args.out.with_name(f".writing-{args.out.name}")
    try:
        _WRITERS[args.format](data, settings, temporary)
        temporary.replace(args.out)
    finally:
        temporary.unlink(missing_ok=True)
    common.write_provenance(args, [args.profile], [args.out])
    return 0


@dataclass(frozen=True)
class _Exported:
    """r and height (n, m) mm on the cells of an export."""

    r: "np.ndarray"
    height: "np.ndarray"
    grid: "CylinderGrid"

    @property
    def steps_mm(self) -> tuple[float, float]:
        return self.grid.step_theta * self.grid.nominal_radius_mm, self.grid.step_z


def _read(data: "xr.Dataset", settings: "ExportSettings") -> _Exported:
    from treadlight.commands.wear import surface_of
    from treadlight.errors import ConfigError
    from treadlight.export import block_sides, coarser_grid

    grid = surface_of(data).grid
    sides = block_sides(grid, settings.step_mm)
    small = coarser_grid(grid, sides)
    cells = small.shape[0] * small.shape[1]
    if cells > _MOST_CELLS:
        raise ConfigError(
            f"The export would have {cells / 1e6:.0f} million cells, more than other programs"
            f" open ({_MOST_CELLS / 1e6:.0f}). Set export.step_mm or --step-mm, such as 0.3."
        )
    r, height = (_coarse(data[name], sides) for name in ("r", "height"))
    return _Exported(r, height, small)


def _coarse(variable: "xr.DataArray", sides: tuple[int, int]) -> "np.ndarray":
    """A map on coarser cells, read slab by slab."""
    import numpy as np

    from treadlight.export import coarser

    rows, columns = variable.shape
    slab = max(1, _CELLS_AT_ONCE // (sides[0] * columns)) * sides[0]
    starts = range(0, rows, slab)
    return np.concatenate([coarser(variable[k : k + slab].to_numpy(), sides) for k in starts])


def _write_mesh(data: "xr.Dataset", settings: "ExportSettings", out: Path) -> None:
    import open3d

    points, corners = _triangulated(data, settings)
    mesh = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(points), open3d.utility.Vector3iVector(corners)
    )
    _saved(open3d.io.write_triangle_mesh(out, mesh), out)


def _write_points(data: "xr.Dataset", settings: "ExportSettings", out: Path) -> None:
    import open3d

    points, corners = _triangulated(data, settings)
    mesh = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(points), open3d.utility.Vector3iVector(corners)
    )
    mesh.compute_vertex_normals()
    cloud = open3d.geometry.PointCloud(mesh.vertices)
    cloud.normals = mesh.vertex_normals
    _saved(open3d.io.write_point_cloud(out, cloud), out)


def _triangulated(
    data: "xr.Dataset", settings: "ExportSettings"
) -> "tuple[np.ndarray, np.ndarray]":
    import numpy as np

    from treadlight.export import to_cartesian, triangles

    cells = _read(data, settings)
    whole_turn = cells.grid.periodic
    vertices, corners = triangles(np.isfinite(cells.r), whole_turn)
    points = to_cartesian(cells.r, cells.grid.theta, cells.grid.z).reshape(-1, 3)[vertices]
    return points, corners


def _saved(done: bool, out: Path) -> None:
    from treadlight.errors import StoreError

    if not done:
        raise StoreError(f"{out}: could not be written. Look at the disk's space and rights.")


def _write_x3p(data: "xr.Dataset", settings: "ExportSettings", out: Path) -> None:
    from datetime import datetime

    import x3pio

    import treadlight

    cells = _read(data, settings)
    along, across = (1e-3 * step for step in cells.steps_mm)
    metadata = x3pio.Metadata(
        # The measurement's date, not today's: the same profile gives the same file.
        date=datetime.fromisoformat(str(data.attrs["captured_at"])),
        creator="Treadlight",
        instrument=x3pio.Instrument(
            "Treadlight", str(data.attrs.get("rig", "unknown")), "unknown", treadlight.__version__
        ),
        probing_system=x3pio.ProbingSystem(
            x3pio.ProbingType.NON_CONTACTING, "laser sections and specular photometric stereo"
        ),
        comment=_comment(data),
    )
    x3pio.write(
        out,
        1e-3 * cells.height.T,
        x_scale=along,
        y_scale=across,
        metadata=metadata,
        # The first revision is the one that every reader knows.
        revision=x3pio.Revision.ISO5436_2000,
    )


def _comment(data: "xr.Dataset") -> str:
    return (
        f"Capture {data.attrs['source']}: height over the groove reference; x along the tread at"
        f" the nominal radius of {float(data.attrs['nominal_radius_mm']):g} mm, y along the axis."
    )


def _write_gwy(data: "xr.Dataset", settings: "ExportSettings", out: Path) -> None:
    import numpy as np
    from gwyfile.objects import GwyContainer, GwyDataField, GwySIUnit

    cells = _read(data, settings)
    # Gwyddion's rows run downwards and its fields are whole: a mask says what is missing.
    height = cells.height.T[::-1]
    known = np.isfinite(height)
    rows, columns = height.shape
    size = {
        "xreal": 1e-3 * columns * cells.steps_mm[0],
        "yreal": 1e-3 * rows * cells.steps_mm[1],
        "si_unit_xy": GwySIUnit(unitstr="m"),
    }
    field = GwyDataField(
        1e-3 * np.where(known, height, 0.0), **size, si_unit_z=GwySIUnit(unitstr="m")
    )
    content = GwyContainer()
    content["/0/data"] = field
    content["/0/data/title"] = f"{data.attrs['source']} height"
    content["/0/meta"] = _gwy_texts({"capture": str(data.attrs["source"]), "about": _comment(data)})
    if not known.all():
        content["/0/mask"] = GwyDataField((~known).astype(float), **size)
    content.tofile(str(out))


def _gwy_texts(texts: dict[str, str]) -> Any:
    from gwyfile.objects import GwyContainer

    container = GwyContainer()
    for name, text in texts.items():
        container[name] = text
    return container


def _write_netcdf(data: "xr.Dataset", settings: "ExportSettings", out: Path) -> None:
    import dask
    import numpy as np
    import xarray as xr

    # NetCDF has no texts of any length in a dimension but as objects.
    texts = [name for name, v in data.variables.items() if v.dtype.kind not in "biufc"]
    content = data.assign_coords({name: data[name].astype(object) for name in texts})
    content = content.chunk({"theta": max(1, _CELLS_AT_ONCE // data.sizes["z"])})
    for variable in content.variables.values():
        variable.encoding.clear()
    encoding = {
        name: {"zlib": True, "complevel": 4, "shuffle": True, "_FillValue": np.nan}
        for name, v in content.data_vars.items()
        if v.dtype.kind == "f"
    }
    # One thread, one variable after the other by name: the same profile gives the same file.
    axes = {name: content[name] for name in sorted(map(str, content.coords))}
    with dask.config.set(scheduler="synchronous"):
        xr.Dataset(coords=axes, attrs=content.attrs).to_netcdf(out, engine="netcdf4")
        for name in sorted(map(str, content.data_vars)):
            kept = {name: encoding[name]} if name in encoding else {}
            content[[name]].to_netcdf(out, mode="a", engine="netcdf4", encoding=kept)


def _write_png(data: "xr.Dataset", settings: "ExportSettings", out: Path) -> None:
    from PIL import Image
    from PIL.PngImagePlugin import PngInfo

    from treadlight.export import height_picture

    cells = _read(data, settings)
    picture, low, step = height_picture(cells.height)
    along, across = cells.steps_mm
    texts = PngInfo()
    texts.add_text("Description", _comment(data))
    texts.add_text("height_mm", f"{low!r} + (value - 1) * {step!r}; 0 = missing")
    texts.add_text(
        "pixel_mm", f"{along!r} along the tread, {across!r} along the axis; z grows upwards"
    )
    Image.fromarray(picture).save(out, "PNG", pnginfo=texts)


def _write_areal(data: "xr.Dataset", settings: "ExportSettings", out: Path) -> None:
    import numpy as np

    from treadlight import store
    from treadlight.commands.wear import surface_of
    from treadlight.export import areal_parameters, rib_patches, scale_limited
    from treadlight.wear import relief_from

    cells = _read(data, settings)
    regions = relief_from(surface_of(data)).regions.on_columns(cells.grid.z)
    filters = settings.s_filter_mm, settings.l_filter_mm
    lines = [
        "capture,rib,theta_deg,z_mm,side_mm,known_share,s_filter_mm,l_filter_mm," + ",".join(_AREAL)
    ]
    for patch in common.progress(
        list(rib_patches(cells.r, cells.height, cells.grid, regions)), "patches"
    ):
        found = areal_parameters(
            scale_limited(patch.height, cells.steps_mm, *filters), cells.steps_mm
        )
        if found is None:
            continue
        place = [np.degrees(patch.theta_rad), patch.z_mm]
        place += [len(patch.height) * cells.steps_mm[0], patch.share]
        lengths = [1e3 * found.sa, 1e3 * found.sq, 1e3 * found.sz]
        shape = [found.ssk, found.sku, found.sdq, 100 * found.sdr, found.sal, found.str_]
        numbers = [*place, *filters, *lengths, *shape]
        texts = [f"{value:.6g}" if np.isfinite(value) else "" for value in numbers]
        lines.append(",".join([str(data.attrs["source"]), f"rib-{patch.rib}", *texts]))
    store.write_text(out, "\n".join(lines) + "\n")


_WRITERS: "dict[str, Callable[[xr.Dataset, ExportSettings, Path], None]]" = {
    "mesh": _write_mesh,
    "points": _write_points,
    "x3p": _write_x3p,
    "gwy": _write_gwy,
    "netcdf": _write_netcdf,
    "png": _write_png,
    "areal": _write_areal,
}
