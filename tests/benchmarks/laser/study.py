"""The laser line's detector beside four others: on synthetic lines and on the sample archive.

Every scene (lines.py) at every width is drawn once, and all detectors see the same frames. A row
counts as found where a detector's column is within four sigmas of the line; bias and RMS are
over the rows that it found, in pixels. Ours learns the line from every second frame, as it does
from some frames of a capture, and smooths along the rows; the others (rivals.py) take each row
alone. Writes table.csv, sample.csv, rms.png and figures.json; the last line is the JSON.
"""

import argparse
import csv
import json
from collections.abc import Iterator
from pathlib import Path

import matplotlib
import numpy as np
from lines import SCENES, SIGMAS_PX, Frame, Scene, draw_frames, speckle_contrast
from rivals import RIVALS
from sample import Figures, sample_figures

from treadlight.laser import detect_section, learn_line_model, select_path

matplotlib.use("Agg")
import matplotlib.pyplot as plt

OURS, PLAIN = "treadlight", "half maximum"
DETECTORS = (OURS, *RIVALS)
FOUND_SIGMA = 4.0
# What is asked of ours: its RMS over the half-maximum centroid's, its bias, and on the archive.
RMS_SHARE, RMS_SHARE_UNDER_SPECKLE = 0.5, 0.65
BIAS_PX = 0.02
TOP_UM = 125.0
# The figure's left end; on clean lines the Gaussian fit is exact.
SHOWN_FROM_PX = 1e-3

# By detector: bias_px, its standard error, rms_px, share of rows found.
Entry = dict[str, dict[str, float]]
Table = dict[tuple[str, float], Entry]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--shared", type=Path, required=True, help="folder of the shared data")
    parser.add_argument("--out", type=Path, required=True, help="folder to write to")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    grains = sorted({scene.grain_px for scene in SCENES.values()} - {0.0})
    contrast = {f"{grain:g} px": round(speckle_contrast(grain), 3) for grain in grains}
    print(f"Contrast of speckle by the size of its grains: {contrast}\n")
    table = fill_table()
    write_table(table, args.out / "table.csv")
    draw_table(table, args.out / "rms.png")
    sample = sample_figures(args.shared / "captures" / "sample") if args.shared.is_dir() else None
    print()
    if sample is None:
        print(f"The sample archive is left out: there is no {args.shared}.")
    else:
        print("\n".join(sample_lines(sample)))
        write_sample(sample, args.out / "sample.csv")
    short = [*falls_short(table), *sample_falls_short(sample)]
    print("\n" + "\n".join(short or ["All that is asked is met."]))
    figures = {
        "speckle_contrast": contrast,
        "table": table_json(table),
        "sample": sample and sample_json(sample),
        "short": short,
    }
    line = json.dumps(figures, separators=(",", ":"))
    (args.out / "figures.json").write_text(line + "\n")
    print(line)


def fill_table() -> Table:
    """All entries; prints each row of the table when it is known."""
    print("| scene | sigma | " + " | ".join(DETECTORS) + f" | {OURS} / {PLAIN} |")
    print("| --- |" + " --- |" * (len(DETECTORS) + 2))
    print("| | px |" + " bias, RMS px, found |" * len(DETECTORS) + " RMS |", flush=True)
    table = {}
    for name, scene in SCENES.items():
        for sigma in SIGMAS_PX:
            entry = judge(draw_frames(scene, sigma), sigma)
            table[name, sigma] = entry
            cells = [
                f"{e['bias_px']:+.3f}, {e['rms_px']:.3f}, {e['found']:.1%}" for e in entry.values()
            ]
            print(f"| {name} | {sigma:g} | {' | '.join(cells)} | {share(entry):.2f} |", flush=True)
    return table


def judge(frames: list[Frame], sigma: float) -> Entry:
    found = {OURS: treadlight_columns(frames)}
    found |= {
        name: np.stack([rival(frame.intensity, sigma) for frame in frames])
        for name, rival in RIVALS.items()
    }
    truth = np.stack([frame.u for frame in frames])
    return {name: errors(u - truth, sigma) for name, u in found.items()}


def treadlight_columns(frames: list[Frame]) -> np.ndarray:
    """Columns (frames, rows) as the stage finds them, NaN where it chooses none."""
    model = learn_line_model([(f.intensity, f.saturated) for f in frames[::2]])
    columns = []
    for frame in frames:
        found = detect_section(frame.intensity, frame.saturated, model)
        path = select_path(found, model)
        u = np.take_along_axis(found.u, np.maximum(path, 0)[:, None], axis=1)[:, 0]
        columns.append(np.where(path >= 0, u, np.nan))
    return np.stack(columns).astype(float)


def errors(error: np.ndarray, sigma: float) -> dict[str, float]:
    """Of one detector, from its errors (frames, rows)."""
    near = np.where(np.abs(error) <= FOUND_SIGMA * sigma, error, np.nan)
    # Rows of one frame share grains; frames share nothing.
    by_frame = np.nanmean(near, axis=1)
    return {
        "bias_px": float(np.nanmean(near)),
        "bias_se_px": float(np.std(by_frame, ddof=1) / np.sqrt(len(by_frame))),
        "rms_px": float(np.sqrt(np.nanmean(near**2))),
        "found": float(np.isfinite(near).mean()),
    }


def share(entry: Entry) -> float:
    return entry[OURS]["rms_px"] / entry[PLAIN]["rms_px"]


def rms_limit(scene: Scene) -> float:
    return RMS_SHARE_UNDER_SPECKLE if scene.grain_px else RMS_SHARE


def falls_short(table: Table) -> Iterator[str]:
    """A sentence for each thing asked of a row that it does not show."""
    for (name, sigma), entry in table.items():
        scene, ours = SCENES[name], entry[OURS]
        if share(entry) > rms_limit(scene):
            yield (
                f"SHORT: {name}, sigma {sigma:g}: RMS {share(entry):.2f} of the half-maximum"
                f" centroid's, asked {rms_limit(scene):g}"
            )
        if not scene.ghost and abs(ours["bias_px"]) > BIAS_PX:
            yield (
                f"SHORT: {name}, sigma {sigma:g}: bias {ours['bias_px']:+.3f} px (standard error"
                f" {ours['bias_se_px']:.3f}), asked {BIAS_PX:g}"
            )


def sample_falls_short(sample: dict[str, dict[str, Figures]] | None) -> Iterator[str]:
    for name, found in (sample or {}).items():
        error = found[OURS]["median_abs_um"]
        if error > TOP_UM:
            yield f"SHORT: {name}: median |error| on tops {error:.0f} um, asked {TOP_UM:g}"


def sample_lines(sample: dict[str, dict[str, Figures]]) -> Iterator[str]:
    yield "| capture, block tops | detector | median abs um | bias um | p95 um | rows found |"
    yield "| --- |" + " --- |" * 5
    for name, found in sample.items():
        for detector, e in found.items():
            yield (
                f"| {name} | {detector} | {e['median_abs_um']:.1f} | {e['bias_um']:+.1f}"
                f" | {e['p95_um']:.0f} | {e['rows_found']:.1%} |"
            )


def write_table(table: Table, path: Path) -> None:
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(
            ["scene", "sigma_px", "detector", "bias_px", "bias_se_px", "rms_px", "found"]
        )
        for (name, sigma), entry in table.items():
            for detector, found in entry.items():
                values = [f"{value:.5f}" for value in found.values()]
                writer.writerow([name, f"{sigma:g}", detector, *values])


def write_sample(sample: dict[str, dict[str, Figures]], path: Path) -> None:
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        first = next(iter(sample.values()))[OURS]
        writer.writerow(["capture", "detector", *first])
        for name, found in sample.items():
            for detector, figures in found.items():
                writer.writerow([name, detector, *(f"{v:.5g}" for v in figures.values())])


def draw_table(table: Table, path: Path) -> None:
    figure, axes = plt.subplots(
        1, len(SIGMAS_PX), figsize=(4.5 * len(SIGMAS_PX), 6), sharex=True, sharey=True
    )
    places = np.arange(len(SCENES))
    for axis, sigma in zip(axes, SIGMAS_PX, strict=True):
        for detector in DETECTORS:
            rms = [max(table[name, sigma][detector]["rms_px"], SHOWN_FROM_PX) for name in SCENES]
            ours = detector == OURS
            axis.plot(
                rms, places, "o" if ours else "x", label=detector, color="k" if ours else None
            )
        asked = [
            rms_limit(scene) * table[name, sigma][PLAIN]["rms_px"] for name, scene in SCENES.items()
        ]
        axis.plot(asked, places, "|", color="0.5", markersize=14, label=f"asked of {OURS}")
        axis.set_xscale("log")
        axis.set_xlabel("RMS error, px")
        axis.set_title(f"line of sigma {sigma:g} px")
        axis.grid(axis="y", color="0.9")
    axes[0].set_yticks(places, list(SCENES))
    axes[0].invert_yaxis()
    axes[-1].legend()
    figure.suptitle("Laser line detectors on the same synthetic frames")
    figure.tight_layout()
    figure.savefig(path, dpi=110, metadata={"Software": None})


def table_json(table: Table) -> dict:
    """By row of the table: [bias_px, rms_px, found] of each detector."""
    return {
        f"{name}, sigma {sigma:g}": {
            "rms_share": round(share(entry), 3),
            **{
                detector: [round(e[figure], 4) for figure in ("bias_px", "rms_px", "found")]
                for detector, e in entry.items()
            },
        }
        for (name, sigma), entry in table.items()
    }


def sample_json(sample: dict[str, dict[str, Figures]]) -> dict:
    return {
        name: {
            detector: {key: round(value, 4) for key, value in figures.items()}
            for detector, figures in found.items()
        }
        for name, found in sample.items()
    }


if __name__ == "__main__":
    main()
