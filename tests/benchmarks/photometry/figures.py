"""Figures 5.5 and 5.6 of the dissertation, with every method."""

import argparse
from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt

LOBES = {"povray": "POV-Ray (Blinn-Phong)", "ggx": "microfacets (GGX)"}
_SMALLEST_DEG = 0.01


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    kinds = parser.add_subparsers(dest="kind", required=True)
    curves = kinds.add_parser("curves", help="mean angular error against k_d / k_s")
    curves.add_argument("errors", type=Path, nargs="+", help="of one layout and alpha")
    maps = kinds.add_parser("maps", help="both errors pixel by pixel at k_d / k_s = 0.1")
    maps.add_argument("maps", type=Path)
    for sub in (curves, maps):
        sub.add_argument("--title", required=True)
        sub.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    if args.kind == "curves":
        draw_curves([read_errors(path) for path in args.errors], args.title, args.out)
    else:
        with np.load(args.maps) as data:
            draw_maps(dict(data), args.title, args.out)


def read_errors(path: Path) -> np.ndarray:
    """The rows that study.py wrote, as a structured array."""
    return np.genfromtxt(path, delimiter=",", names=True, dtype=None, encoding="utf-8")


def draw_curves(tables: list[np.ndarray], title: str, out: Path) -> None:
    figure, axes = plt.subplots(
        1, len(tables), figsize=(5.5 * len(tables), 4), sharey=True, squeeze=False
    )
    for axis, table in zip(axes[0], tables, strict=True):
        for name in dict.fromkeys(table["method"]):
            rows = table[table["method"] == name]
            error = np.maximum(rows["mean_deg"], _SMALLEST_DEG)
            axis.loglog(rows["ratio"], error, marker=".", label=name)
        # The dissertation's claim: SPS is best to the left of it.
        axis.axvline(0.3, color="0.7", linestyle=":")
        axis.set_title(LOBES[table["lobe"][0]])
        axis.set_xlabel("$k_d / k_s$")
    axes[0, 0].set_ylabel("mean angular error, degree")
    axes[0, -1].legend()
    save(figure, title, out)


def draw_maps(maps: dict[str, np.ndarray], title: str, out: Path) -> None:
    names = [key.partition(" ")[2] for key in maps if key.startswith("angle")]
    figure, axes = plt.subplots(2, 1 + len(names), figsize=(2.1 * (1 + len(names)), 4.4))
    axes[0, 0].imshow(maps["image"], cmap="gray")
    axes[0, 0].set_title("9th light")
    rows = (("angle", "angular error, degree", 30), ("residual", "rerendering error", 1))
    for row, (kind, label, largest) in enumerate(rows):
        for column, name in enumerate(names, start=1):
            shown = axes[row, column].imshow(
                maps[f"{kind} {name}"], vmin=0, vmax=largest, cmap="viridis"
            )
            axes[row, column].set_title(name if row == 0 else "")
        figure.colorbar(shown, ax=axes[row].tolist(), label=label, extend="max", shrink=0.9)
    for axis in axes.flat:
        axis.set_axis_off()
    save(figure, title, out, tight=False)


def save(figure: plt.Figure, title: str, out: Path, *, tight: bool = True) -> None:
    figure.suptitle(title)
    if tight:
        figure.tight_layout()
    figure.savefig(out, dpi=110, metadata={"Software": None})


if __name__ == "__main__":
    main()
