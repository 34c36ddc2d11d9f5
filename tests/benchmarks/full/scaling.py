"""Part of make bench-speed: what a pixel costs in every stage, from 0.6 to 39 Mpixel an image.

The sector of make bench-full with images of 1, 4, 16 and 64 times as many pixels (rendered once
and kept), every stage run as its command. What a stage takes before it sees a pixel (imports,
kernels from the cache, learning the material from as many pixels of any view) is measured with
images of 0.04 Mpixel, and taken off. Processor seconds, on one core, the least of some runs. Ends
with one line of JSON.
"""

import argparse
import json
import sys
from pathlib import Path

import numpy as np
import sector
import stages

# Width and height, px, from what tells the start-up to the dissertation's camera.
_SIZES = ((160, 240), (640, 960), (1280, 1920), (2560, 3840), sector.FULL)
_RUNS = (3, 3, 2, 1, 1)
_CONSTANT_WITHIN = 0.15


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("build/bench-full"))
    args = parser.parse_args()
    runs = [
        least(args.out if size == sector.FULL else args.out / f"{size[0]}x{size[1]}", size, count)
        for size, count in zip(_SIZES, _RUNS, strict=True)
    ]
    found = {stage: costs(stage, runs) for stage in runs[0]}
    print(f"{'':22}" + "".join(f"{np.prod(size) / 1e6:14.1f}" for size in _SIZES[1:]) + " Mpixel")
    for stage, row in found.items():
        cells = (f"{ns:8.1f} {mb:5.0f}" for ns, mb in zip(row["ns"], row["peak_mb"], strict=True))
        print(f"{stage:22}{''.join(cells)}  exponent {row['exponent']:.2f}")
    print("ns of one core for each pixel of the camera, and largest memory in MB")
    print(json.dumps({"stages": found, "missed": [s for s in found if not steady(found[s]["ns"])]}))
    return 0


def least(folder: Path, size: tuple[int, int], count: int) -> dict[str, dict[str, float]]:
    """The least of some runs of every stage."""
    made = sector.make(folder, size, say)
    return stages.least([stages.run_all(made, folder / "results", 1, say) for _ in range(count)])


def costs(stage: str, runs: list[dict[str, dict[str, float]]]) -> dict[str, object]:
    """What a pixel costs at each size, the exponent of the cost over the pixels, and the rest."""
    pixels = np.array([np.prod(size) for size in _SIZES])
    taken = np.array([run[stage]["processor_s"] for run in runs])
    # The start-up's images have pixels as well.
    each = (taken[1:] - taken[0]) / (pixels[1:] - pixels[0])
    # A stage that takes no time beside the start-up's scatter has none.
    told = each > 0
    exponent = 0.0
    if told.sum() > 1:
        exponent = np.polyfit(np.log(pixels[1:][told]), np.log((each * pixels[1:])[told]), 1)[0]
    return {
        "ns": [round(1e9 * float(cost), 1) for cost in each],
        "exponent": round(float(exponent), 3),
        "start_up_s": float(taken[0]),
        "peak_mb": [round(run[stage]["peak_gib"] * 1024) for run in runs[1:]],
        "written_mb": [run[stage]["written_mb"] for run in runs[1:]],
    }


def steady(ns: list[float]) -> bool:
    return max(ns) <= (1 + _CONSTANT_WITHIN) * min(ns)


def say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
