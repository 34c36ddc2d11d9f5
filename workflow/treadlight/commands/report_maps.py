"""What a tire's report draws and counts from the stores: maps, worn tops, runout."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from treadlight.commands.wear import surface_of

if TYPE_CHECKING:
    import numpy as np
    import xarray as xr

    from treadlight.report import Layer, RibRunout
    from treadlight.wear import WornTread

# All captures' maps together; a page of 25 MB holds these with the library that draws them.
_PAGE_CELLS = 1_400_000
# More along theta and z cannot be told apart on a screen.
_MOST_CELLS = (1400, 500)
_WORN_STEP_MM = 1.0
_POLAR_DEG = 2.0
_RUNOUT_ORDERS = 10


def mileage_of(profile: "xr.Dataset") -> str:
    """Mileage with its unit; empty if it is not known."""
    if "mileage" not in profile.attrs:
        return ""
    return f"{float(profile.attrs['mileage']):g} {profile.attrs['mileage_unit']}"


def title_of(profile: "xr.Dataset") -> str:
    return f"{profile.attrs['source']}, {mileage_of(profile)}"


def layers_of(profiles: "list[xr.Dataset]", wear: "xr.Dataset") -> "list[Layer]":
    """Maps of the usable captures; in the first one's frame where there is wear."""
    if "wear" not in wear:
        return [_own_layer(profile, len(profiles)) for profile in profiles]
    first = profiles[0]
    found = [_own_layer(first, len(profiles))]
    for number, profile in enumerate(profiles[1:], 1):

        def height(rows: slice, number: int = number) -> "np.ndarray":
            base = first["r"].isel(theta=rows) - first["height"].isel(theta=rows)
            return (wear["r"].isel(capture=number, theta=rows) - base).to_numpy()

        def column(name: str, number: int = number) -> "Callable[[slice], np.ndarray]":
            return lambda rows: wear[name].isel(capture=number, theta=rows).to_numpy()

        found.append(
            _layer(
                title_of(profile),
                first,
                len(profiles),
                height,
                column("wear"),
                column("wear_std"),
            )
        )
    return found


def _own_layer(profile: "xr.Dataset", captures: int) -> "Layer":
    def height(rows: slice) -> "np.ndarray":
        return profile["height"].isel(theta=rows).to_numpy()

    return _layer(title_of(profile), profile, captures, height, None, None)


def _layer(
    title: str,
    frame: "xr.Dataset",
    captures: int,
    height: "Callable[[slice], np.ndarray]",
    wear: "Callable[[slice], np.ndarray] | None",
    wear_std: "Callable[[slice], np.ndarray] | None",
) -> "Layer":
    from treadlight.report import Layer, block_size, reduce_map

    shape = frame.sizes["theta"], frame.sizes["z"]
    limit = _limit(shape, captures)
    tall, wide = block_size(shape, limit)
    theta, theta_step = _centres(frame["theta"].to_numpy(), tall)
    z, z_step = _centres(frame["z"].to_numpy(), wide)
    degrees = 57.29577951308232
    return Layer(
        title,
        reduce_map(height, shape, limit),
        None if wear is None else reduce_map(wear, shape, limit),
        None if wear_std is None else reduce_map(wear_std, shape, limit),
        (theta * degrees, theta_step * degrees),
        (z, z_step),
        _base(frame, shape, limit),
        surface_of(frame).grid.periodic,
    )


def _limit(shape: tuple[int, int], captures: int) -> tuple[int, int]:
    """Most cells along theta and z, so that all captures' maps fit the page."""
    rows, columns = (min(a, b) for a, b in zip(shape, _MOST_CELLS, strict=True))
    shrink = min(1.0, (_PAGE_CELLS / captures / (rows * columns)) ** 0.5)
    return max(1, int(rows * shrink)), max(1, int(columns * shrink))


def _centres(centres: "np.ndarray", cells: int) -> tuple[float, float]:
    """Centre of the first block of cells, and the step from block to block."""
    step = float(centres[-1] - centres[0]) / (len(centres) - 1)
    return float(centres[0]) + 0.5 * (cells - 1) * step, cells * step


def _base(frame: "xr.Dataset", shape: tuple[int, int], limit: tuple[int, int]) -> "np.ndarray":
    """Mean radius that heights stand on, per column; for the view in three dimensions only."""
    import numpy as np

    from treadlight.report import reduce_map

    def read(rows: slice) -> "np.ndarray":
        return (frame["r"].isel(theta=rows) - frame["height"].isel(theta=rows)).to_numpy()

    base = reduce_map(read, shape, limit)
    known = np.isfinite(base)
    count = known.sum(axis=0)
    mean = np.where(known, base, 0).sum(axis=0) / np.maximum(count, 1)
    seen = np.flatnonzero(count)
    if not len(seen):
        return np.full(base.shape[1], float(frame.attrs["nominal_radius_mm"]))
    return np.interp(np.arange(base.shape[1]), seen, mean[seen])


def _row_means(cells: "np.ndarray") -> "np.ndarray":
    """Mean of what is known of each row; NaN of nothing."""
    import numpy as np

    known = np.isfinite(cells)
    total = np.where(known, cells, 0).sum(axis=1)
    return np.where(known.any(axis=1), total / np.maximum(known.sum(axis=1), 1), np.nan)


@dataclass(frozen=True)
class Worn:
    """Tops of one later capture: their wear, and the mean uncertainty of its cells."""

    title: str
    tread: "WornTread"
    wear_std: "np.ndarray"


def worn_treads(profiles: "list[xr.Dataset]", wear: "xr.Dataset") -> list[Worn]:
    """Wear of the rib tops of every later capture, on cells of about a millimetre."""
    from treadlight.wear import relief_from

    if "wear" not in wear or len(profiles) < 2:
        return []
    first = profiles[0]
    surface = surface_of(first)
    regions = relief_from(surface).regions.on_columns(surface.grid.z)
    return [
        _worn(first, wear, regions, number, title_of(profile))
        for number, profile in enumerate(profiles[1:], 1)
    ]


def _worn(first: "xr.Dataset", wear: "xr.Dataset", regions: Any, number: int, title: str) -> Worn:
    import numpy as np

    from treadlight.report import block_size, reduce_map
    from treadlight.tread import FLOOR, TOP
    from treadlight.wear import WornTread

    grid = surface_of(first).grid
    radius = grid.nominal_radius_mm
    shape = grid.shape
    arc = shape[0] * grid.step_theta * radius
    limit = (
        max(1, int(arc / _WORN_STEP_MM)),
        max(1, int(shape[1] * grid.step_z / _WORN_STEP_MM)),
    )

    def classes(rows: slice) -> "np.ndarray":
        return regions.classify(first["r"].isel(theta=rows).to_numpy(), grid.theta[rows])

    def cells(name: str, kind: int) -> "Callable[[slice], np.ndarray]":
        def read(rows: slice) -> "np.ndarray":
            values = wear[name].isel(capture=number, theta=rows).to_numpy()
            return np.where(classes(rows) == kind, values, np.nan)

        return read

    def slots(rows: slice) -> "np.ndarray":
        known = np.isfinite(first["r"].isel(theta=rows).to_numpy())
        return np.where(known, classes(rows) != TOP, np.nan)

    tall, wide = block_size(shape, limit)
    lost = reduce_map(cells("wear", TOP), shape, limit)
    floor = reduce_map(cells("wear", FLOOR), shape, limit)
    theta, step = _centres(grid.theta, tall)
    middle = np.minimum(np.arange(lost.shape[1]) * wide + wide // 2, shape[1] - 1)
    tread = WornTread(
        lost,
        reduce_map(slots, shape, limit) > 0.5,
        theta + step * np.arange(len(lost)),
        regions.rib_of_column[middle],
        _row_means(floor),
        wide * grid.step_z,
        radius,
        grid.periodic,
    )
    return Worn(title, tread, reduce_map(cells("wear_std", TOP), shape, limit))


def around_the_turn(
    worn: Worn,
) -> "tuple[str, np.ndarray, dict[str, tuple[np.ndarray, np.ndarray]]]":
    """Mean wear of each rib per 2 degrees, and whether it is detected; of `polar_chart`."""
    import numpy as np

    theta = np.degrees(worn.tread.theta)
    tile = np.floor((theta - theta[0]) / _POLAR_DEG).astype(int)
    count = tile[-1] + 1
    middle = theta[0] + (np.arange(count) + 0.5) * _POLAR_DEG
    ribs = {}
    for rib in range(1, int(worn.tread.rib.max(initial=0)) + 1):
        columns = worn.tread.rib == rib
        wear, std = (
            _tile_means(values[:, columns], tile, count)
            for values in (worn.tread.wear, worn.wear_std)
        )
        with np.errstate(invalid="ignore"):
            ribs[f"rib-{rib}"] = (wear, wear >= 2 * std)
    return worn.title, middle, ribs


def _tile_means(cells: "np.ndarray", tile: "np.ndarray", count: int) -> "np.ndarray":
    import numpy as np

    known = np.isfinite(cells)
    number = np.bincount(tile, known.sum(axis=1), minlength=count)
    total = np.bincount(tile, np.where(known, cells, 0).sum(axis=1), minlength=count)
    return np.where(number > 0, total / np.maximum(number, 1), np.nan)


def runout_and_void(
    profiles: "list[xr.Dataset]",
) -> "tuple[list[RibRunout], list[tuple[str, float, float]]]":
    """Radial harmonics of every rib and the void ratio of each capture, in its own frame."""
    from treadlight.report import RibRunout
    from treadlight.tread import radial_harmonics, void_ratio
    from treadlight.wear import relief_from

    runout, void = [], []
    for profile in profiles:
        relief = relief_from(surface_of(profile))
        grid, regions = relief.grid, relief.regions
        share, std = void_ratio(relief.r, grid.theta, regions)
        void.append((title_of(profile), share, std))
        for rib in range(1, len(regions.ribs) + 1):
            radius = _top_radius(relief.r, grid.theta, regions, rib)
            found = radial_harmonics(grid.theta, radius, _RUNOUT_ORDERS)
            if found is not None:
                runout.append(
                    RibRunout(
                        title_of(profile),
                        f"rib-{rib}",
                        found.amplitude_mm,
                        found.std_mm,
                        found.peak_to_peak_mm,
                    )
                )
    return runout, void


def _top_radius(r: "np.ndarray", theta: "np.ndarray", regions: Any, rib: int) -> "np.ndarray":
    """Mean radius of a rib's tops over its own level, per row; NaN where a fifth is not known."""
    import numpy as np

    from treadlight.tread import TOP

    columns = regions.rib_of_column == rib
    top = (regions.classify(r, theta) == TOP)[:, columns]
    level = (r - regions.crown)[:, columns]
    count = top.sum(axis=1)
    mean = np.where(top, level, 0).sum(axis=1) / np.maximum(count, 1)
    return np.where(5 * count >= columns.sum(), mean, np.nan)
