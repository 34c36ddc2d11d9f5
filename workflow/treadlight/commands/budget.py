"""Say what limits the accuracy of results, on rendered captures that carry their truth.

Computes every profile of ARCHIVE anew from the products in RESULTS, with one source of its errors
after the other switched to truth: the calibration, the laser points, the normals, and the last
two together, which leaves what the integration and the sampling add. Rows of the tread that no
view sees are told apart. Prints tables, or with --json one object: {"captures": {id: {source:
{"all": {class: {...}}, "seen": {class: {...}}, "edges"}}}, "wear": {tire: {capture: {source:
{"mean_error_mm", "block_rms_mm"}}}}}; lengths mm.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from treadlight.commands import common
from treadlight.commands import integrate as stage

if TYPE_CHECKING:
    import xarray as xr

    from treadlight import integrate
    from treadlight.archive import Archive, Capture
    from treadlight.evaluate.truth import Profile
    from treadlight.geometry import CylinderGrid, Rig
    from treadlight.wear import Surface

# A row is seen when this share of its cells has a normal.
_SEEN_SHARE = 0.3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("archive", type=Path, help="folder of captures")
    parser.add_argument("--results", type=Path, default=Path("results"), help="folder of results")
    parser.add_argument("--json", action="store_true", help="one JSON object instead of tables")


def run(args: argparse.Namespace) -> int:
    from treadlight.archive import find_archive
    from treadlight.errors import ConfigError
    from treadlight.evaluate.text import render_budget

    for folder in (args.results, args.archive):
        if not folder.is_dir():
            raise ConfigError(f"{folder}: is no folder. Name the archive, and --results.")
    report = budget_of(args.results, find_archive(args.archive))
    common.print_report(report, render_budget, args.json)
    return 0


def budget_of(results: Path, archive: "Archive") -> dict[str, Any]:
    """The whole report, in the structure that the command's help text gives."""
    from treadlight.evaluate.truth import read_true_profile

    report: dict[str, Any] = {"captures": {}, "wear": {}}
    for tire, names in archive.tires.items():
        captures = [archive.measurements[name] for name in names]
        captures = [c for c in captures if _is_comparable(results, c)]
        surfaces = {}
        for capture in captures:
            truth = read_true_profile(capture.folder / "truth" / "profile.npz")
            calibration = results / "calibrations" / archive.calibration_of[capture.id]
            case = _Case(results / "captures" / capture.id, calibration, capture, truth)
            report["captures"][capture.id], surfaces[capture.id] = case.budget()
        if len(captures) > 1:
            report["wear"][tire] = _wear(captures, surfaces)
    return report


def _is_comparable(results: Path, capture: "Capture") -> bool:
    from treadlight import store
    from treadlight.errors import StoreError

    product = results / "captures" / capture.id / "profile.zarr"
    if not (capture.folder / "truth" / "profile.npz").is_file():
        return False
    try:
        store.open_store(product)
        reason = store.refused_reason(product)
    except StoreError as error:
        reason = str(error)
    if reason:
        print(f"Left out: {reason}", file=sys.stderr)
    return not reason


class _Case:
    """One capture's products, and its profile under every switch."""

    def __init__(
        self, products: Path, calibration: Path, capture: "Capture", truth: "Profile"
    ) -> None:
        from treadlight import store
        from treadlight.evaluate.truth import read_true_rig

        self.products, self.calibration = products, calibration
        self.capture, self.truth = capture, truth
        self.rig = store.read_rig(calibration / "calibration.json")
        self.true_rig = read_true_rig(capture.folder / "truth" / "rig.yaml")
        self.surface = store.open_store(products / "surface.zarr").load()
        self.laser = store.open_store(products / "laser.zarr").load()
        folders = {n: products / "photometric.zarr" / f"fov{n:02d}" for n in capture.views}
        usable, _ = stage.usable_views(list(folders.values()))
        self.views = {
            n: store.open_store(path).load() for n, path in folders.items() if path in usable
        }

    def budget(self) -> "tuple[dict[str, Any], dict[str, Surface]]":
        """Figures by source, and the surfaces that they are of."""
        from treadlight.evaluate.budget import SOURCES, budget_row
        from treadlight.wear import Surface

        rows, surfaces = {}, {}
        for source in common.progress(list(SOURCES), f"{self.capture.id}: sources"):
            profile, grid = self._profile(source)
            seen = profile.photometric.mean(axis=1) > _SEEN_SHARE
            rows[source] = budget_row(self.truth, grid.theta, grid.z, profile.r, seen)
            surfaces[source] = Surface.of_arrays(profile.r, profile.r_std, grid)
        return rows, surfaces

    def _profile(self, source: str) -> "tuple[integrate.Profile, CylinderGrid]":
        from treadlight import integrate, store
        from treadlight.evaluate.budget import smooth_normals, true_points, without_error

        surface, laser, views, rig = self.surface, self.laser, self.views, self.rig
        if source == "calibration":
            rig = self.true_rig
            laser, surface = self._registered(rig)
            views = {n: self._solved(n, rig) for n in self.views}
        grid = store.grid_of(surface)
        first = integrate.FirstSurface(surface["r"].to_numpy(), surface["r_std"].to_numpy())
        sections = stage.laser_sections(laser)
        normals = [
            stage.view_normals(view, stage.camera_centre(self.capture, n, rig))
            for n, view in views.items()
        ]
        if source in ("laser", "both"):
            r = true_points(self.truth, sections.r, sections.theta, sections.z)
            sections = replace(sections, r=r)
        instead = normals
        if source in ("photometry", "both"):
            smooth = smooth_normals(self.truth, grid.step_z)
            instead = [
                replace(v, normal=without_error(self.truth, smooth, v.normal, v.theta, v.z))
                for v in normals
            ]
        return integrate.integrate_capture(normals, sections, first, grid, 0, instead), grid

    def _registered(self, rig: "Rig") -> "tuple[xr.Dataset, xr.Dataset]":
        """laser.zarr and surface.zarr as this rig gives them."""
        from treadlight import store
        from treadlight.commands.register_to_cylinder import register
        from treadlight.commands.triangulate import triangulate_sections
        from treadlight.cylinder import CylinderSettings

        pixels = store.open_store(self.products / "laser_pixels.zarr")
        points = triangulate_sections(pixels, rig, self.capture.laser_scan)
        settings = common.recorded_settings(self.products / "laser.zarr")
        return register(points, rig, self.capture, CylinderSettings(**settings))

    def _solved(self, number: int, rig: "Rig") -> "xr.Dataset":
        """photometric.zarr/fovNN as this rig gives it, on the measured surface."""
        from treadlight import store
        from treadlight.commands import photometric_stereo as photometry
        from treadlight.photometric.settings import PhotometrySettings
        from treadlight.photometric.view import solve_view

        name = f"fov{number:02d}"
        settings = common.recorded_settings(self.products / "photometric.zarr" / name)
        illumination = self.calibration / "illumination.zarr"
        view, _ = photometry.read_view(self.capture, number, rig, illumination)
        grid = store.grid_of(self.surface)
        r, r_std = (self.surface[n].to_numpy() for n in ("r", "r_std"))
        found = solve_view(view, grid, r, r_std, PhotometrySettings(**settings))
        return photometry.dataset_of(found)


def _wear(
    captures: "list[Capture]", surfaces: "dict[str, dict[str, Surface]]"
) -> dict[str, dict[str, Any]]:
    from treadlight.evaluate.remount import evaluate_wear
    from treadlight.evaluate.truth import read_true_profile, read_true_wear
    from treadlight.wear import align, relief_from, wear_block

    first = captures[0]
    first_truth = read_true_profile(first.folder / "truth" / "profile.npz")
    found: dict[str, dict[str, Any]] = {}
    for later in captures[1:]:
        path = later.folder / "truth" / "wear.npz"
        if not path.is_file():
            continue
        truth, found[later.id] = read_true_wear(path), {}
        for source, surface in surfaces[first.id].items():
            other = surfaces[later.id][source]
            alignment = align(relief_from(surface), relief_from(other))
            _, wear, _ = wear_block(surface, other, alignment, 0, surface.grid.shape[0])
            figures = evaluate_wear(truth, first_truth, surface.grid.theta, surface.grid.z, wear)
            found[later.id][source] = {
                "mean_error_mm": figures["mean_error_mm"],
                "block_rms_mm": figures["blocks"]["rms_mm"],
            }
    return found
