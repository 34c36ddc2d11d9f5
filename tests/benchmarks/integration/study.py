"""make bench-integration: ways to integrate slopes, on the sample archive and on DiLiGenT's cat.

Sample: the same slopes and laser points for every method, errors on block tops and on floors of
circumferential grooves in cells that a view sees. Cat: normals of a scanner to depth, with every
twentieth column of the true depth (0.1 mm of noise) where a method takes points. Draws the
sections of figure 7.9. Ends with one line of JSON.
"""

import argparse
import json
from collections.abc import Callable
from pathlib import Path

import baselines
import matplotlib
import numpy as np

from treadlight import integrate, store
from treadlight.archive import read_capture
from treadlight.commands import integrate as stage
from treadlight.evaluate.budget import budget_row
from treadlight.evaluate.surface import interpolate
from treadlight.evaluate.truth import Profile, read_true_profile
from treadlight.geometry import CylinderGrid
from treadlight.integrate import prior
from treadlight.integrate.edges import Edges, merge_views
from treadlight.integrate.gather import view_field
from treadlight.integrate.laser import LaserCells, laser_cells
from treadlight.integrate.solve import Problem
from treadlight.integrate.solve import integrate as solve_robustly

matplotlib.use("Agg")
import matplotlib.pyplot as plt

_CAT_EVERY, _CAT_NOISE_MM, _CAT_SLOPE_STD = 20, 0.1, 0.02
# Normals that hardly face the camera are those of an outline.
_LEAST_FACING = 0.1
_METHODS = ("laser alone", "poisson", "constrained", "bilateral", "treadlight")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("results", type=Path, help="of the sample archive")
    parser.add_argument("shared", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    archive = args.shared / "captures" / "sample"
    name = min(path.name for path in archive.iterdir() if path.name.startswith("t"))
    heights, grid, truth = _sample(args.results, archive / name)
    table = {
        method: _figures(r, grid, truth, heights["seen"])
        for method, r in heights.items()
        if method in _METHODS
    }
    cat = _cat(args.shared / "real" / "diligent-cat16" / "cat16.npz")
    _draw(heights, grid, truth, args.out / "figure-7.9.png")
    print(f"{name}, um: median / rms on tops, on floors; edges found")
    for method, row in table.items():
        print(
            f"  {method:12}",
            "{top:.0f} / {top_rms:.0f}, {floor:.0f} / {floor_rms:.0f}; {edges:.1%}".format(**row),
        )
    print("cat, mm: median and rms of the absolute depth error")
    for method, row in cat.items():
        print(f"  {method:12} {row['median_mm']:.3f}, {row['rms_mm']:.3f}")
    print(json.dumps({"sample": table, "cat": cat}))
    return 0


def _sample(results: Path, folder: Path) -> tuple[dict[str, np.ndarray], CylinderGrid, Profile]:
    """Heights (n, m) by method, mm, and under "seen" the cells that a view sees."""
    products = results / "captures" / folder.name
    capture = read_capture(folder)
    calibration = store.read_json(results / "archive.json")["calibration_of"][folder.name]
    rig = store.read_rig(results / "calibrations" / calibration / "calibration.json")
    surface = store.open_store(products / "surface.zarr").load()
    grid = store.grid_of(surface)
    first = integrate.FirstSurface(surface["r"].to_numpy(), surface["r_std"].to_numpy())
    sections = stage.laser_sections(store.open_store(products / "laser.zarr").load())
    views = [
        stage.view_normals(
            store.open_store(products / "photometric.zarr" / f"fov{n:02d}").load(),
            stage.camera_centre(capture, n, rig),
        )
        for n in capture.views
    ]
    fields = [field for field in (view_field([view], grid) for view in views) if field is not None]
    slope = merge_views(fields, grid).slope
    laser = laser_cells(sections.r, sections.theta, sections.z, sections.r_std, slope, grid)
    sides = (grid.step_theta * grid.nominal_radius_mm, grid.step_z)
    heights = _baselines(slope, sides, laser)
    heights["laser alone"] = first.r
    heights["treadlight"] = integrate.integrate_capture(iter(views), sections, first, grid, 10).r
    heights["seen"] = np.isfinite(slope).all(axis=0)
    return heights, grid, read_true_profile(folder / "truth" / "profile.npz")


def _baselines(
    slope: np.ndarray, sides: tuple[float, float], laser: LaserCells
) -> dict[str, np.ndarray]:
    edges = baselines.edges_of(slope, sides, baselines.SLOPE_STD)
    found: dict[str, Callable[[], np.ndarray]] = {
        "poisson": lambda: baselines.poisson(edges, laser),
        "constrained": lambda: baselines.constrained(edges, laser),
        "bilateral": lambda: baselines.bilateral(edges, laser, slope, sides),
    }
    known = np.isfinite(slope).all(axis=0)
    return {method: np.where(known, solve(), np.nan) for method, solve in found.items()}


def _figures(
    r: np.ndarray, grid: CylinderGrid, truth: Profile, seen: np.ndarray
) -> dict[str, float]:
    row = budget_row(truth, grid.theta, grid.z, np.where(seen, r, np.nan), seen.mean(axis=1) > 0.2)
    top, floor = row["seen"]["top"], row["seen"]["floor"]
    return {
        "top": 1e3 * top["median_abs_mm"],
        "top_rms": 1e3 * top["rms_mm"],
        "floor": 1e3 * floor["median_abs_mm"],
        "floor_rms": 1e3 * floor["rms_mm"],
        "edges": row["edges"],
    }


def _cat(path: Path) -> dict[str, dict[str, float]]:
    """Perspective: heights are -Z0 ln(Z / Z0), whose slopes are n_x / (n d) along the ray d."""
    data = np.load(path)
    camera, (top, left) = data["camera_matrix"], data["crop_origin_rc"]
    distance = float(np.nanmedian(data["depth_mm"][data["mask"]]))
    side = distance / camera[0, 0]
    # Of the camera: y down, z away.
    normal = data["normals"].astype(float) * (1, -1, -1)
    row, column = np.indices(data["mask"].shape)
    ray = [(column + left - camera[0, 2]) / camera[0, 0], (row + top - camera[1, 2]) / camera[1, 1]]
    facing = normal[..., 0] * ray[0] + normal[..., 1] * ray[1] + normal[..., 2]
    mask = data["mask"] & np.isfinite(data["depth_mm"]) & (facing < -_LEAST_FACING)
    depth = -distance * np.log(np.where(mask, data["depth_mm"], distance) / distance)
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = np.where(mask, np.stack([normal[..., 1], normal[..., 0]]) / facing, np.nan)
    row, column = np.nonzero(mask & (np.arange(mask.shape[1]) % _CAT_EVERY == 0))
    noise = _CAT_NOISE_MM * np.random.default_rng(1).standard_normal(len(row))
    std = np.full(len(row), _CAT_NOISE_MM)
    laser = LaserCells(row, column, depth[row, column] + noise, std, column)
    found = _baselines(slope, (side, side), laser)
    found["treadlight"] = _robust(slope, side, laser, mask)
    misses = {k: np.abs(v - depth)[mask & np.isfinite(v)] for k, v in found.items()}
    return {
        method: {"median_mm": float(np.median(m)), "rms_mm": float(np.sqrt(np.mean(m**2)))}
        for method, m in misses.items()
    }


def _robust(slope: np.ndarray, side: float, laser: LaserCells, mask: np.ndarray) -> np.ndarray:
    """Graduated reweighting from the points' interpolation, as in the pipeline."""
    edges: Edges = baselines.edges_of(slope, (side, side), _CAT_SLOPE_STD)
    points = np.full(mask.shape, np.nan)
    points[laser.row, laser.column] = laser.value
    start = prior.complete(points)
    noise = _CAT_SLOPE_STD * side
    problem = Problem(edges, laser, start, np.full(mask.shape, 1e-9))
    r = solve_robustly(problem, start, _CAT_NOISE_MM, noise).r
    return np.where(mask & np.isfinite(slope).all(axis=0), r, np.nan)


def _draw(heights: dict[str, np.ndarray], grid: CylinderGrid, truth: Profile, out: Path) -> None:
    """Integration alone swells, held by the laser it does not (figure 7.9): one row, one column."""
    true = interpolate(truth, truth.r, grid.theta, grid.z)
    seen = heights["seen"]
    row = int(np.argmax(seen.sum(axis=1)))
    column = int(np.argmax((seen & np.isfinite(true)).sum(axis=0)))
    figure, axes = plt.subplots(2, 1, figsize=(11, 7), constrained_layout=True)
    arc = grid.nominal_radius_mm * (grid.theta - grid.theta[0])
    for axis, x, pick, label in (
        (axes[0], grid.z, lambda r: r[row], "z (mm)"),
        (axes[1], arc, lambda r: r[:, column], "along the tread (mm)"),
    ):
        axis.plot(x, pick(true), color="black", linewidth=2.5, label="truth")
        for method, colour in zip(
            _METHODS[1:], ("#d55e00", "#e69f00", "#56b4e9", "#0072b2"), strict=True
        ):
            axis.plot(x, pick(heights[method]), color=colour, linewidth=1, label=method)
        axis.set(xlabel=label, ylabel="r (mm)")
    axes[0].legend(loc="lower center", ncols=5)
    figure.savefig(out, dpi=110)


if __name__ == "__main__":
    raise SystemExit(main())
