"""make bench-full: a sector at full size through the stages, and what a whole capture would take.

One view of 16 LED frames and 12 sections of 5120x7680 pixels, rendered once and kept. Every stage
runs as its command does under Snakemake, on two cores; its time, processor time and largest memory
are those of its process, the least of two runs: in the first one kernels may be compiled, which the
views of a capture after the first find in the cache. The whole capture (200 sections, 17 views) is
extrapolated: sections and views by their number, registration and integration by the cells of the
grid. Ends with one line of JSON.
"""

import argparse
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import sector
import stages

from treadlight import integrate, store
from treadlight.archive import read_capture

_SECTIONS, _VIEWS = 200, 17
_RUNS = 2
# Of the integration's memory, by the demo and the sample (0.7 and 1.2 million cells).
_BYTES_OF_A_CELL = 350
_ASKED = {
    "view_s": 60,
    "view_gib": 3,
    "section_s": 1.5,
    "whole_minutes": 30,
    "whole_gib": 8,
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("build/bench-full"))
    parser.add_argument("--cores", type=int, default=2)
    args = parser.parse_args()
    made = sector.make(args.out, sector.FULL, say)
    runs = [stages.run_all(made, args.out / "results", args.cores, say) for _ in range(_RUNS)]
    taken = stages.least(runs)
    sections = len(read_capture(made.sections).of_kind("laser"))
    cells = cells_of(args.out / "results/surface.zarr")
    found = summary(taken, section_s(made.sections), sections, cells, args.cores)
    print(json.dumps(found))
    return 0


def section_s(capture: Path, runs: int = 5) -> float:
    """Decoding one section and finding its line, on one core: the median of a few."""
    from treadlight.images import FrameReader
    from treadlight.laser import detect_section, learn_line_model, select_path

    facts = read_capture(capture)
    reader, frames = FrameReader(facts), facts.of_kind("laser")
    image = reader.read(frames[0])
    model = learn_line_model([(image.intensity, image.saturated)])
    times = []
    for frame in frames[:runs]:
        began = time.process_time()
        image = reader.read(frame)
        found = detect_section(image.intensity, image.saturated, model)
        select_path(found, model)
        times.append(time.process_time() - began)
    return float(np.median(times))


def cells_of(surface: Path) -> tuple[int, int, float]:
    """Pixels of the sector's grid, cells that are solved, how many times as many a turn has."""
    data = store.open_store(surface)
    grid = store.grid_of(data)
    most = integrate.IntegrateSettings().most_cells
    cells = integrate.solved_grid(grid, integrate.width_of_cells(grid, most))
    turns = 2 * np.pi / (grid.step_theta * grid.shape[0])
    return data["r"].size, cells.shape[0] * cells.shape[1], turns


def summary(
    taken: dict, section: float, sections: int, cells: tuple[int, int, float], cores: int
) -> dict[str, Any]:
    """The figures, and the whole capture's by extrapolation."""
    count, solved, turns = cells
    scale = {
        # The line is learned from as many sections of any capture.
        "detect-laser-pixels": 1.0,
        "triangulate": _SECTIONS / sections,
        "register-to-cylinder": turns,
        "photometric-stereo": _VIEWS,
        "integrate": turns,
    }
    whole_s = sum(scale[name] * stage["wall_s"] for name, stage in taken.items())
    whole_s += (_SECTIONS - sections) * section / cores
    # Triangulating a dozen sections takes hardly more than the process itself.
    process = taken["triangulate"]["peak_gib"]
    whole_gib = max(
        process + turns * (taken["register-to-cylinder"]["peak_gib"] - process),
        # Pixels are laid in bands; the cells of the turn are solved at once.
        taken["integrate"]["peak_gib"] + (turns - 1) * solved * _BYTES_OF_A_CELL / (1 << 30),
        *(stage["peak_gib"] for stage in taken.values()),
    )
    view = taken["photometric-stereo"]
    figures = {
        "view_s": view["wall_s"],
        "view_gib": view["peak_gib"],
        "section_s": round(section, 2),
        "whole_minutes": round(whole_s / 60, 1),
        "whole_gib": round(whole_gib, 1),
    }
    missed = [name for name, limit in _ASKED.items() if figures[name] > limit]
    grid = {"sector_pixels": count, "sector_cells": solved, "turns": round(turns, 2)}
    return {"stages": taken, **grid, **figures, "whole": "extrapolated", "missed": missed}


def say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
