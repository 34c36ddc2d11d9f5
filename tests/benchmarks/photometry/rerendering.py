"""Rerendering error of every method on one view of a capture, as in figure 7.8."""

import argparse
import json
from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from treadlight import store
from treadlight.archive import read_capture
from treadlight.commands import photometric_stereo as command
from treadlight.photometric import METHODS, Observations, View, observe_view
from treadlight.photometric.view import needed_rows
from treadlight.threads import use_cores

# The scale of the figure ends here.
_LARGEST = 0.6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--calibration", type=Path, required=True)
    parser.add_argument("--illumination", type=Path, required=True)
    parser.add_argument("--surface", type=Path, required=True)
    parser.add_argument("--figure", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--threads", type=int, default=2)
    args = parser.parse_args()
    use_cores(args.threads)
    capture = read_capture(args.capture)
    # Of all views the middle one.
    number = sorted(capture.views)[len(capture.views) // 2]
    rig = store.read_rig(args.calibration)
    view, _ = command.read_view(capture, number, rig, args.illumination)
    observations = observe(view, args.surface)
    maps = {
        name: method(observations).residual.reshape(view.intensity.shape[1:])
        for name, method in METHODS.items()
    }
    draw(
        view,
        maps,
        f"{capture.id}, view {number}: rerendering error, each at most 100 %",
        args.figure,
    )
    found = {
        "capture": capture.id,
        "view": number,
        "methods": {name: figures(residual) for name, residual in maps.items()},
    }
    args.out.write_text(json.dumps(found, indent=1))


def observe(view: View, surface: Path) -> Observations:
    """What the stage gives its method of every pixel of a view."""
    found = store.open_store(surface)
    grid = store.grid_of(found)
    rows = needed_rows(view, grid)
    part = store.load_rows(found[["r", "r_std"]], rows)
    return observe_view(view, grid.part(rows), part["r"].to_numpy(), part["r_std"].to_numpy())


def figures(residual: np.ndarray) -> dict[str, float]:
    """Mean and median over the pixels that have a normal, and their share.

    A lobe fitted to its foot alone can rerender its peak as bright as it likes: one such pixel
    outweighs all others. `mean_capped` counts no pixel for more than a black rerendering, 100 %.
    """
    known = residual[np.isfinite(residual)]
    return {
        "mean": float(f"{known.mean():.4g}"),
        "mean_capped": round(float(np.minimum(known, 1).mean()), 4),
        "median": round(float(np.median(known)), 4),
        "share": round(known.size / residual.size, 4),
    }


def draw(view: View, maps: dict[str, np.ndarray], title: str, out: Path) -> None:
    count = 1 + len(maps)
    figure, axes = plt.subplots(1, count, figsize=(1.9 * count, 3.4))
    image = view.intensity[0]
    axes[0].imshow(image, cmap="gray", vmax=np.nanpercentile(image, 99.5))
    axes[0].set_title("1st LED")
    for axis, (name, residual) in zip(axes[1:], maps.items(), strict=True):
        shown = axis.imshow(residual, vmin=0, vmax=_LARGEST, cmap="viridis")
        axis.set_title(f"{name}: {figures(residual)['mean_capped']:.1%}")
    for axis in axes:
        axis.set_axis_off()
    figure.colorbar(shown, ax=axes.tolist(), extend="max", shrink=0.8)
    figure.suptitle(title)
    figure.savefig(out, dpi=110, metadata={"Software": None})


if __name__ == "__main__":
    main()
