"""Hold results against the truth that rendered captures carry.

Compares every capture of ARCHIVE that has a truth/ folder with its products in RESULTS:
calibrations, profiles, normals, wear. Prints tables, or with --json one object:
{"calibrations": {id: {"camera", "laser_plane", "axis", "reference_plane", "leds"}},
"captures": {id: {"absolute": {class: {...}}, "shape": {class: {...}}, "shape_fit", "detail",
"edges", "extent", "normals": {"profile", "fovNN"}, "r_std": {class: {...}}, "seams"}},
"wear": {tire: {capture: {..., "blocks", "wear_std", "alignment"}}}}. A product that is absent
or refused is {"missing": sentence}. Lengths mm, angles degrees unless a name says otherwise.
"""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from treadlight.commands import common

if TYPE_CHECKING:
    import numpy as np
    import xarray as xr

    from treadlight.archive import Archive, Capture

# Normals of a full-size view are compared at about this many of its pixels.
_MAX_PIXELS = 2_000_000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("results", type=Path, help="folder of results")
    parser.add_argument("archive", type=Path, help="folder of captures")
    parser.add_argument("--json", action="store_true", help="one JSON object instead of tables")


def run(args: argparse.Namespace) -> int:
    from treadlight.archive import find_archive
    from treadlight.errors import ConfigError
    from treadlight.evaluate.text import render

    for folder in (args.results, args.archive):
        if not folder.is_dir():
            raise ConfigError(f"{folder}: is no folder. Name the results, then the archive.")
    report = evaluate_archive(args.results, find_archive(args.archive))
    common.print_report(report, render, args.json)
    return 0


def evaluate_archive(results: Path, archive: "Archive") -> dict[str, Any]:
    """The whole report, in the structure that the command's help text gives."""
    report: dict[str, Any] = {"calibrations": {}, "captures": {}, "wear": {}}
    for name, capture in archive.calibrations.items():
        if _truth(capture, "rig.yaml"):
            product = results / "calibrations" / name / "calibration.json"
            report["calibrations"][name] = _usable(product) or _calibration(
                product, capture, archive
            )
    for name, capture in archive.measurements.items():
        if _truth(capture, "profile.npz"):
            product = results / "captures" / name / "profile.zarr"
            report["captures"][name] = _usable(product) or _profile(product, capture)
    for tire, names in archive.tires.items():
        captures = [archive.measurements[name] for name in names]
        later = [c for c in captures if _truth(c, "wear.npz")]
        if later:
            product = results / "tires" / tire / "wear.zarr"
            missing = _usable(product)
            report["wear"][tire] = {c.id: missing or _wear(product, captures[0], c) for c in later}
    return report


def _truth(capture: "Capture", name: str) -> Path | None:
    path = capture.folder / "truth" / name
    return path if path.is_file() else None


def _usable(product: Path) -> dict[str, Any] | None:
    """Why a product cannot be compared, or None."""
    from treadlight import store
    from treadlight.errors import StoreError

    try:
        if product.suffix != ".json":
            store.open_store(product)
        reason = store.refused_reason(product)
    except StoreError as error:
        return {"missing": str(error)}
    return {"missing": f"Refused: {reason}"} if reason else None


def _calibration(product: Path, capture: "Capture", archive: "Archive") -> dict[str, Any]:
    from treadlight import store
    from treadlight.evaluate.rig import evaluate_rig
    from treadlight.evaluate.truth import read_true_rig

    true = read_true_rig(capture.folder / "truth" / "rig.yaml")
    radii = [
        archive.measurements[name].tire
        for name, chosen in archive.calibration_of.items()
        if chosen == capture.id
    ]
    radius = radii[0].nominal_radius_mm if radii and radii[0] else None
    return evaluate_rig(store.read_rig(product), true, radius)


def _profile(product: Path, capture: "Capture") -> dict[str, Any]:
    import numpy as np

    from treadlight import store
    from treadlight.evaluate.metrics import evaluate_profile, view_changes
    from treadlight.evaluate.truth import read_true_profile

    truth = read_true_profile(capture.folder / "truth" / "profile.npz")
    data = store.open_store(product)
    encoders = np.radians([capture.view(n)[0].encoder_deg or 0.0 for n in capture.views])
    views = _views(product.with_name("photometric.zarr"), capture.views)
    seams = np.concatenate([view_changes(encoders), *(_limits(v) for v in views.values())])
    figures = evaluate_profile(
        truth,
        data.theta.values,
        data.z.values,
        data.r.values,
        data.r_std.values if "r_std" in data else None,
        seams,
    )
    figures["normals"] = _normals(truth, capture, data, encoders, views)
    return figures


def _views(folder: Path, numbers: tuple[int, ...]) -> "dict[int, xr.Dataset]":
    from treadlight import store

    paths = {number: folder / f"fov{number:02d}" for number in numbers}
    return {n: store.open_store(path) for n, path in paths.items() if _usable(path) is None}


def _limits(view: "xr.Dataset") -> "np.ndarray":
    """The angles at which a view's normals begin and end, rad: nearly all rows reach them."""
    import numpy as np

    from treadlight.geometry.axis import wrap_angle

    step = _stride(view)
    known = np.isfinite(view["normal"].values[::step, ::step, 0])
    if not known.any():
        return np.empty(0)
    theta = view["theta"].values[::step, ::step]
    centre = np.median(theta[known])
    away = np.where(known, wrap_angle(theta - centre), np.nan)
    lines = away[known.any(axis=1)] if _along_rows(away) else away[:, known.any(axis=0)].T
    return centre + np.array(
        [np.median(np.nanmin(lines, axis=1)), np.median(np.nanmax(lines, axis=1))]
    )


def _along_rows(away: "np.ndarray") -> bool:
    """Whether theta varies along the image's rows rather than its columns."""
    import numpy as np

    return bool(
        np.nanmedian(np.abs(np.diff(away, axis=1))) > np.nanmedian(np.abs(np.diff(away, axis=0)))
    )


def _stride(view: "xr.Dataset") -> int:
    pixels = view.sizes["v"] * view.sizes["u"]
    return max(1, round((pixels / _MAX_PIXELS) ** 0.5))


def _normals(
    truth: Any,
    capture: "Capture",
    profile: "xr.Dataset",
    encoders: "np.ndarray",
    views: "dict[int, xr.Dataset]",
) -> dict[str, Any]:
    import numpy as np

    from treadlight.evaluate.metrics import nearest_view, normal_figures, towards_camera
    from treadlight.evaluate.surface import interpolate
    from treadlight.evaluate.truth import read_true_rig

    rig = read_true_rig(capture.folder / "truth" / "rig.yaml")
    assert rig.axis is not None
    distance = float(np.linalg.norm(rig.axis.point))
    theta, z = profile["theta"].values, profile["z"].values
    cell_mm = float(z[-1] - z[0]) / (len(z) - 1)
    found: dict[str, Any] = {}
    if "normal" in profile:
        around, along = np.meshgrid(theta, z, indexing="ij")
        encoder = nearest_view(theta, encoders)[:, None]
        true_r = interpolate(truth, truth.r, theta, z)
        view = towards_camera(around, along, true_r, encoder, distance)
        normal = profile["normal"].values
        found["profile"] = normal_figures(truth, around, along, normal, view, cell_mm)
    for number, data in views.items():
        step = _stride(data)
        at = {n: data[n].values[::step, ::step].astype(float) for n in ("theta", "z", "r")}
        encoder_deg = capture.view(number)[0].encoder_deg or 0.0
        view = towards_camera(at["theta"], at["z"], at["r"], np.radians(encoder_deg), distance)
        found[f"fov{number:02d}"] = normal_figures(
            truth, at["theta"], at["z"], data["normal"].values[::step, ::step], view, cell_mm
        )
    return found


def _wear(product: Path, first: "Capture", later: "Capture") -> dict[str, Any]:
    import numpy as np
    import yaml

    from treadlight import store
    from treadlight.evaluate.remount import (
        alignment_figures,
        evaluate_wear,
        read_mounting,
        true_alignment,
    )
    from treadlight.evaluate.truth import read_true_profile, read_true_wear

    data = store.open_store(product)
    names = [str(name) for name in np.atleast_1d(data["capture"].values)]
    if later.id not in names or names[0] != first.id:
        return {"missing": f"{product}: does not hold {later.id} against {first.id}."}
    one = data.isel(capture=names.index(later.id))
    truth = _truth(first, "profile.npz")
    figures = evaluate_wear(
        read_true_wear(later.folder / "truth" / "wear.npz"),
        read_true_profile(truth) if truth else None,
        data["theta"].values,
        data["z"].values,
        one["wear"].values,
        one["wear_std"].values if "wear_std" in data else None,
    )
    mountings = [
        read_mounting(yaml.safe_load(path.read_text(encoding="utf-8"))) if path else None
        for path in (_truth(first, "rig.yaml"), _truth(later, "rig.yaml"))
    ]
    if "alignment" in data and mountings[0] and mountings[1]:
        assert first.tire is not None
        true = true_alignment(mountings[0], mountings[1])
        radius = first.tire.nominal_radius_mm
        figures["alignment"] = alignment_figures(one["alignment"].values, true, radius)
    return figures
