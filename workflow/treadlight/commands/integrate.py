"""Integrate normals and laser sections into the profile r(theta, z) of a capture.

Writes profile.zarr and quality.json. Views that are refused are left out with a warning; without
views the profile comes from the laser alone, without laser points only its shape is known.
"""

import argparse
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from treadlight.commands import common
from treadlight.spool import Memory, Spool

if TYPE_CHECKING:
    import numpy as np
    import xarray as xr

    from treadlight import integrate, tread
    from treadlight.archive import Capture
    from treadlight.geometry import CylinderGrid, Rig


_READ = ["normal", "normal_cov", "r", "theta", "z", "k_d", "k_s", "alpha", "quality"]
# Of the mantissa: steps of 0.02 um, of 0.1 mrad, and a thousandth of what is known to a hundredth.
_BITS = {"r": 24, "r_std": 8, "normal": 13, "k_d": 10, "k_s": 10, "alpha": 10, "height": 18}


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
        memory = Spool(out.parent)
        profile, report = integrate_products(args, settings, memory)
        store.write_store(out, profile, title="Profile", source=capture.id, memory=memory)
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
    args: argparse.Namespace, settings: "integrate.IntegrateSettings", memory: Memory | Spool
) -> "tuple[xr.Dataset, dict[str, Any]]":
    """profile.zarr, its arrays in `memory`, and the content of quality.json."""
    import numpy as np

    from treadlight import integrate, store, tread
    from treadlight.archive import read_capture

    surface = store.open_store(args.surface)
    laser = store.open_store(args.laser).load()
    rig = store.read_rig(args.calibration)
    grid = store.grid_of(surface)
    sections = laser_sections(laser)
    capture = read_capture(args.capture)
    warnings = [*args.warning, *store.read_json(args.calibration).get("warnings", ())]
    warnings += laser.attrs.get("warnings", ())
    usable, said = usable_views(args.views)
    warnings += said
    if not np.isfinite(sections.r).any():
        warnings.append(
            "There are no laser points: the profile's level and large shape are not measured."
        )
    if not usable:
        warnings.append("There are no normals: the profile comes from the laser alone.")
    views = [stored_view(path, capture, rig) for path in usable]
    width = integrate.width_of_cells(grid, settings.most_cells)
    cells = integrate.solved_grid(grid, width)
    read = common.progress(views, f"{capture.id}: views read", every_s=0)
    coarse = integrate.views_for_cells(read, cells, memory)
    found = integrate.solve_capture(
        _Watched(coarse, f"{capture.id}: views gathered", memory),
        integrate.thinned(sections, width),
        _first_surface(surface, *integrate.sampled(grid, cells)),
        cells,
        settings.held_out_every,
    )
    joined = integrate.Joined(grid.shape, memory.empty)
    # The cells are still held while a band's pixels, which take as much memory each, are laid.
    room = settings.most_cells * 5 // 4 - cells.shape[0] * cells.shape[1]
    bands = list(integrate.bands_of(grid, width, min(room, settings.most_cells // 2)))
    for band in common.progress(bands, f"{capture.id}: bands laid"):
        joined.add(integrate.profile_of(found, views, sections, band.grid, band.core), band)
        memory.release()
    profile = joined.profile(found.proof)
    regions = tread.find_regions(profile.r, grid)
    closure = laser.attrs.get("closure_mm")
    report = integrate.quality_report(profile, regions, rig, closure, warnings)
    return _dataset(profile, surface, regions, grid, memory), report


def _first_surface(
    surface: "xr.Dataset", rows: "np.ndarray", columns: "np.ndarray"
) -> "integrate.FirstSurface":
    import numpy as np

    from treadlight.integrate import FirstSurface
    from treadlight.store import CHUNK

    parts = []
    for first in range(0, surface.sizes["theta"], CHUNK):
        own = rows[(rows >= first) & (rows < first + CHUNK)] - first
        part = surface[["r", "r_std"]].isel(theta=slice(first, first + CHUNK)).load()
        parts.append([part[name].to_numpy()[np.ix_(own, columns)] for name in ("r", "r_std")])
    return FirstSurface(*(np.concatenate(values) for values in zip(*parts, strict=True)))


def usable_views(views: list[Path]) -> tuple[list[Path], list[str]]:
    """Views that are not refused and whose LEDs are those of the others, and warnings."""
    from treadlight import store
    from treadlight.images import doubts

    usable, warnings, patterns, opened = [], [], {}, {}
    for path in views:
        name = store.store_folder(path).name
        if reason := store.refused_reason(path):
            warnings.append(f"{name} is left out: {reason}")
            continue
        view = store.open_store(path)
        warnings += [f"{name}: {sentence}" for sentence in view.attrs.get("warnings", ())]
        usable.append(path)
        numbers = [int(number) for number in view["led"].values]
        patterns[path] = dict(zip(numbers, view["light_pattern"].values, strict=True))
        opened[path] = view

    def misfit(path: Path) -> float:
        return float(opened[path]["residual"].median(skipna=True))

    for path, leds in doubts.views_with_swapped_leds(patterns, misfit).items():
        usable.remove(path)
        warnings.append(
            f"{store.store_folder(path).name} is left out: its frames of LEDs"
            f" {' and '.join(map(str, leds))} look exchanged. Correct led in frames.csv."
        )
    return usable, warnings


def laser_sections(laser: "xr.Dataset") -> "integrate.LaserSections":
    """What a laser.zarr holds."""
    from treadlight.integrate import LaserSections

    return LaserSections(
        laser["r"].to_numpy(),
        laser["theta"].to_numpy(),
        laser["z"].to_numpy(),
        laser["r_std"].to_numpy(),
        laser["encoder"].to_numpy(),
        float(laser.attrs["shared_rows"]),
    )


def camera_centre(capture: "Capture", view: int, rig: "Rig") -> "np.ndarray | None":
    """Centre of the camera in {T} (r, theta, z) when it took a view."""
    import numpy as np

    if rig.axis is None:
        return None
    encoder = np.radians(capture.view(view)[0].encoder_deg or 0.0)
    return np.array([np.linalg.norm(rig.axis.point), -encoder, 0.0])


def view_normals(view: "xr.Dataset", camera: "np.ndarray | None") -> "integrate.ViewNormals":
    """What a photometric.zarr/fovNN, or rows of it, holds, with the centre of its camera."""
    import numpy as np

    from treadlight import integrate

    names, quality = view.quality.attrs["flag_meanings"].split(), view.quality.values
    flags = {name: (quality & (1 << names.index(name))) > 0 for name in integrate.VIEW_FLAGS}
    return integrate.ViewNormals(
        view.normal.values,
        view.normal_cov.values,
        view.r.values,
        view.theta.values,
        view.z.values,
        np.stack([view[name].values for name in ("k_d", "k_s", "alpha")], axis=-1),
        **flags,
        camera=camera,
    )


def stored_view(path: Path, capture: "Capture", rig: "Rig") -> "StoredView":
    """The view of a photometric.zarr/fovNN, with the centre of its camera."""
    from treadlight import store

    number = int(store.store_folder(path).name.removeprefix("fov"))
    return StoredView(store.open_store(path)[_READ], camera_centre(capture, number, rig))


class _Watched(list["integrate.View"]):
    """Views that say how many of them are done, each time that they are gone through.

    After each what lies in `memory` is handed back.
    """

    def __init__(
        self, views: "Iterable[integrate.View]", label: str, memory: Memory | Spool
    ) -> None:
        super().__init__(views)
        self._label, self._memory = label, memory

    def __iter__(self) -> "Iterator[integrate.View]":
        for view in common.progress(super().__iter__(), self._label, len(self), 0):
            yield view
            self._memory.release()


class StoredView:
    """A photometric.zarr/fovNN that is read a part of the image at a time."""

    def __init__(self, view: "xr.Dataset", camera: "np.ndarray | None") -> None:
        self._view, self._camera = view, camera

    def blocks(self, grid: "CylinderGrid") -> "Iterator[integrate.ViewNormals]":
        """Chunks of the image side by side, as far as they see the grid or something beside it."""
        import numpy as np

        from treadlight import integrate
        from treadlight.store import CHUNK

        def parts() -> "Iterator[xr.Dataset]":
            for row, seen in enumerate(integrate.sees(*self._reach, grid)):
                columns = np.flatnonzero(seen)
                if columns.size:
                    v = slice(row * CHUNK, (row + 1) * CHUNK)
                    u = slice(columns[0] * CHUNK, (columns[-1] + 1) * CHUNK)
                    yield self._view.isel(v=v, u=u)

        for part in read_ahead(parts()):
            yield view_normals(part, self._camera)

    @cached_property
    def _reach(self) -> "tuple[float, np.ndarray, np.ndarray]":
        """See `integrate.angles_of_chunks`."""
        from treadlight import integrate
        from treadlight.store import CHUNK

        return integrate.angles_of_chunks(self._view["theta"].to_numpy(), CHUNK)


def read_ahead(parts: "Iterable[xr.Dataset]") -> "Iterator[xr.Dataset]":
    """Lazy datasets, loaded: the next one while the last one is worked on."""
    with ThreadPoolExecutor(1) as pool:
        coming = None
        for part in parts:
            before, coming = coming, pool.submit(part.load)
            if before is not None:
                yield before.result()
        if coming is not None:
            yield coming.result()


def _dataset(
    profile: "integrate.Profile",
    surface: "xr.Dataset",
    regions: "tread.Regions",
    grid: "CylinderGrid",
    memory: Memory | Spool,
) -> "xr.Dataset":
    import numpy as np
    import xarray as xr

    from treadlight import integrate, store, tread
    from treadlight.store import CHUNK, flag_attrs, variable

    reference = tread.fit_reference(profile.r, profile.r_std, grid, regions)
    height = memory.empty(grid.shape, np.float32)
    for first in range(0, len(height), CHUNK):
        rows = slice(first, first + CHUNK)
        height[rows] = reference.height(profile.r[rows], grid.theta[rows], grid.z)
    dims = ("theta", "z")
    variables = {
        "r": variable(dims, profile.r, "mm", "radius from the rig's axis"),
        "r_std": variable(dims, profile.r_std, "mm", "standard uncertainty of r (shape)"),
        "laser_r": variable(
            dims,
            surface.laser_r.values.astype(np.float32, copy=False),
            "mm",
            "radius of the laser sections alone",
        ),
        "normal": variable(
            (*dims, "component"), profile.normal, "1", "unit normal in the basis (r, theta, z)"
        ),
        "k_d": variable(dims, profile.material[0], "1", "diffuse reflectance factor"),
        "k_s": variable(dims, profile.material[1], "1", "specular reflectance factor"),
        "alpha": variable(dims, profile.material[2], "1", "shininess exponent"),
        "height": variable(dims, height, "mm", "height over the groove reference"),
        "quality": variable(
            dims,
            integrate.quality_flags(profile),
            "1",
            "quality flags",
            **flag_attrs(integrate.FLAGS),
        ),
    }
    for name, bits in _BITS.items():
        store.keep_bits_of(variables[name], bits)
        memory.release()
    coordinates = {
        "theta": variable(("theta",), grid.theta, "rad", "angle in the tire frame"),
        "z": variable(("z",), grid.z, "mm", "place along the axis in the tire frame"),
        "component": variable(
            ("component",), np.array(["r", "theta", "z"]), "1", "component of a vector"
        ),
    }
    return xr.Dataset(variables, coordinates, attrs=surface.attrs)
