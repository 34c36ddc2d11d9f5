"""Wear of a tire over its mileages, every capture in the first one's frame.

Reads the profiles in the order given (by mileage, then date), finds how the tire sat on the rig
each time, and writes the wear maps (wear.zarr) and the numbers per rib and groove (trend.csv).
"""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from treadlight.commands import common

if TYPE_CHECKING:
    import numpy as np
    import xarray as xr

    from treadlight.wear import Alignment, Stay, Surface, WearSettings

TITLE = "Wear of a tire"
# Whole shards of the store, so that each is written once.
_ROWS = 1024


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("tire", help="id of the tire")
    parser.add_argument("profiles", nargs="+", type=Path, help="profile.zarr, by mileage and date")
    parser.add_argument("--out", type=Path, required=True, help="wear.zarr")
    parser.add_argument("--trend", type=Path, required=True, help="trend.csv")
    common.add_stage_arguments(parser)


def run(args: argparse.Namespace) -> int:
    from treadlight import store
    from treadlight.wear import WearSettings, csv_text

    settings = common.parse_settings(args.settings, WearSettings)
    usable = [path for path in args.profiles if store.refused_reason(path) is None]

    def work() -> None:
        _work(args, usable, settings)

    # A refused capture leaves the tire's others their wear; refused is the tire without any.
    status = common.run_stage(
        args,
        inputs=usable or args.profiles,
        outputs=[args.out],
        title=TITLE,
        source=args.tire,
        work=work,
    )
    if store.refused_reason(args.out):
        store.write_text(args.trend, csv_text([]))
    common.write_provenance(args, usable or args.profiles, [args.trend])
    return status


def _work(args: argparse.Namespace, paths: "list[Path]", settings: "WearSettings") -> None:
    import sys

    import dask

    from treadlight import store
    from treadlight.wear import csv_text, trend_rows

    folder = store.store_folder(args.out)
    profiles = [store.open_store(path) for path in paths]
    surfaces = [surface_of(profile) for profile in profiles]
    first, alignments = _align(profiles, surfaces)
    warnings = _warnings(profiles, alignments, len(args.profiles) - len(paths))
    if first.reference.reason:
        warnings.append(first.reference.reason)
    for warning in warnings:
        print(f"Warning: {warning}", file=sys.stderr)
    dataset = _dataset(profiles, surfaces, alignments, warnings)
    # One block at a time: its kernels use all cores, and memory holds no second one.
    with dask.config.set(scheduler="synchronous"):
        store.write_store(folder, dataset, title=TITLE, source=args.tire)
    stays = _stays(store.open_store(folder), surfaces[0], first, alignments)
    unit = profiles[0].attrs["mileage_unit"]
    rows = trend_rows(args.tire, unit, stays, first.reference, settings)
    store.write_text(args.trend, csv_text(rows))


def surface_of(profile: "xr.Dataset") -> "Surface":
    """A profile, read block by block."""
    import numpy as np

    from treadlight.geometry import CylinderGrid
    from treadlight.wear import Surface

    grid = CylinderGrid(
        np.asarray(profile["theta"], float),
        np.asarray(profile["z"], float),
        float(profile.attrs["nominal_radius_mm"]),
    )

    def read(start: int, stop: int) -> "tuple[np.ndarray, np.ndarray]":
        rows = profile[["r", "r_std"]].isel(theta=slice(start, stop))
        return rows["r"].to_numpy(), rows["r_std"].to_numpy()

    return Surface(grid, read)


def _align(
    profiles: "list[xr.Dataset]", surfaces: "list[Surface]"
) -> "tuple[Any, list[Alignment]]":
    from treadlight.wear import Alignment, align, relief_from

    first = relief_from(surfaces[0])
    alignments = [Alignment.identity()]
    for surface in common.progress(surfaces[1:], "captures aligned", every_s=0):
        alignments.append(align(first, relief_from(surface)))
    return first, alignments


def _warnings(
    profiles: "list[xr.Dataset]", alignments: "list[Alignment]", refused: int
) -> list[str]:
    found = [
        f"{profile.attrs['source']}: {alignment.reason} It has no wear."
        for profile, alignment in zip(profiles, alignments, strict=True)
        if alignment.reason
    ]
    if refused:
        found.append(f"Captures of this tire that were refused and are not in here: {refused}.")
    return found


def _dataset(
    profiles: "list[xr.Dataset]",
    surfaces: "list[Surface]",
    alignments: "list[Alignment]",
    warnings: list[str],
) -> "xr.Dataset":
    """wear.zarr of the results contract; its maps are computed when they are written."""
    import numpy as np
    import xarray as xr

    from treadlight.store import variable
    from treadlight.wear import PARAMETERS

    maps = _lazy_maps(surfaces, alignments)
    dims = ("capture", "theta", "z")
    names = {
        "r": "radius after alignment",
        "wear": "radial loss since the first capture",
        "wear_std": "standard uncertainty of wear",
    }
    unit = profiles[0].attrs["mileage_unit"]
    grid = surfaces[0].grid
    motions = np.array([a.motion.values for a in alignments])
    # Of numpy's texts, zarr 3 has specified only those of variable length.
    text = np.dtypes.StringDType()
    parameter = variable(("parameter",), np.array(PARAMETERS, text), "1", "parameter of the motion")
    captures = np.array([p.attrs["source"] for p in profiles], text)
    attrs = profiles[0].attrs
    return xr.Dataset(
        {
            **{
                name: variable(dims, maps[k], "mm", long_name)
                for k, (name, long_name) in enumerate(names.items())
            },
            "alignment": variable(
                ("capture", "parameter"),
                motions,
                "1",
                "motion into the first capture's frame; rad and mm as the parameters' names say",
            ),
        },
        coords={
            "capture": variable(("capture",), captures, "1", "capture"),
            "mileage": variable(("capture",), _mileages(profiles), unit, "mileage"),
            "theta": variable(("theta",), grid.theta, "rad", "angle about the axis"),
            "z": variable(("z",), grid.z, "mm", "position along the axis"),
            "parameter": parameter,
        },
        attrs={
            "tire": attrs["tire"],
            "mileage_unit": unit,
            "nominal_radius_mm": grid.nominal_radius_mm,
            "warnings": warnings,
        },
    )


def _mileages(profiles: "list[xr.Dataset]") -> "np.ndarray":
    import numpy as np

    from treadlight.wear import convert_mileage

    unit = profiles[0].attrs["mileage_unit"]
    return np.array(
        [
            convert_mileage(float(p.attrs["mileage"]), p.attrs["mileage_unit"], unit)
            for p in profiles
        ]
    )


def _lazy_maps(surfaces: "list[Surface]", alignments: "list[Alignment]") -> "list[Any]":
    """r, wear and wear_std, (capture, theta, z) each, as dask arrays of whole shards."""
    import dask
    import dask.array as da
    import numpy as np

    first = surfaces[0]
    rows, columns = first.grid.shape
    blocks = []
    for start in range(0, rows, _ROWS):
        stop = min(start + _ROWS, rows)
        shape = (3, len(surfaces), stop - start, columns)
        block = dask.delayed(_block, pure=False)(surfaces, alignments, start, stop)
        blocks.append(da.from_delayed(block, shape, np.float32))
    whole = da.concatenate(blocks, axis=2)
    return [whole[k] for k in range(3)]


def _block(
    surfaces: "list[Surface]", alignments: "list[Alignment]", start: int, stop: int
) -> "np.ndarray":
    import numpy as np

    from treadlight.wear import wear_block

    r, _ = surfaces[0].read(start, stop)
    nil = np.where(np.isfinite(r), 0, np.nan)
    parts = [(r, nil, nil)]
    for surface, alignment in zip(surfaces[1:], alignments[1:], strict=True):
        parts.append(wear_block(surfaces[0], surface, alignment, start, stop))
    return np.stack([np.stack(maps) for maps in zip(*parts, strict=True)]).astype(np.float32)


def _stays(
    wear: "xr.Dataset", surface: "Surface", first: Any, alignments: "list[Alignment]"
) -> "list[Stay]":
    from treadlight.wear import RegionTally, Stay, region_names, tally_rows

    regions = first.regions.on_columns(surface.grid.z)
    names = region_names(regions)
    tallies = [{name: RegionTally() for name in names} for _ in alignments]
    for start in range(0, surface.grid.shape[0], _ROWS):
        rows = slice(start, start + _ROWS)
        theta = surface.grid.theta[rows]
        r_first, r_std = surface.read(start, min(start + _ROWS, surface.grid.shape[0]))
        classes = regions.classify(r_first, theta)
        for k, tally in enumerate(tallies):
            part = wear[["r", "wear", "wear_std"]].isel(capture=k, theta=rows)
            r, loss, std = (part[name].to_numpy() for name in ("r", "wear", "wear_std"))
            tally_rows(tally, r, loss, std, r_std, classes, theta, regions, first.reference)
    return [
        Stay(str(name), float(mileage), alignment, tally)
        for name, mileage, alignment, tally in zip(
            wear["capture"].to_numpy(),
            wear["mileage"].to_numpy(),
            alignments,
            tallies,
            strict=True,
        )
    ]
