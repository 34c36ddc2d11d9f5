"""How fast the integration's linear solve is, beside one pair of cosine transforms of the grid.

The weights are those of a capture's last solve, laid side by side up to the sizes asked; the start
is its first surface. Solved to 1 um in every cell, or as far as single precision goes; up to 4
million cells held against a solution in double precision. A pair of transforms (scipy.fft.dctn and
idctn, single precision, two workers) is all that a Poisson solver of uniform weights takes: the
yardstick. The last line is JSON.
"""

import argparse
import json
import statistics
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import scipy.fft

from treadlight import integrate, store
from treadlight.archive import read_capture
from treadlight.commands import integrate as stage
from treadlight.integrate.case import prepare
from treadlight.integrate.multigrid import Solver, System
from treadlight.integrate.solve import Problem, linear_residual, weighted_system
from treadlight.threads import use_cores

# Of the preconditioned residual, for 1 um. Half of it leaves the worst of 4 million cells as it is.
TOLERANCE_MM = 2e-4
MOST_HELD_AGAINST_DOUBLE = 4_000_000
MOST_ITERATIONS = 1000
RUNS = 3


def system_of(capture: Path, products: Path, calibration: Path) -> tuple[System, np.ndarray]:
    """The system of a capture's last linear solve, and the residual of its first surface."""
    surface, laser = (store.open_store(products / f"{n}.zarr").load() for n in ("surface", "laser"))
    rig, opened = store.read_rig(calibration), read_capture(capture)
    folders = sorted((products / "photometric.zarr").glob("fov??"))
    views = [stage.stored_view(path, opened, rig) for path in folders]
    first = integrate.FirstSurface(surface["r"].to_numpy(), surface["r_std"].to_numpy())
    sections = stage.laser_sections(laser)
    case = prepare(views, sections, first, store.grid_of(surface), None)
    solved = case.solve(case.laser.select(case.closed.on_tread))
    problem: Problem = solved.problem
    shares = solved.solution.share, solved.solution.laser_share
    system, pull = weighted_system(problem, *shares)
    return system, linear_residual(problem, system, pull, case.closed.r, shares[1])


def laid_out(values: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Copies side by side; the pattern of a tread is not asked to go on where two meet."""
    times = [-(-want // have) for want, have in zip(shape, values.shape, strict=True)]
    return np.ascontiguousarray(np.tile(values, times)[: shape[0], : shape[1]])


def enlarged(system: System, residual: np.ndarray, cells: int) -> tuple[System, np.ndarray]:
    side = int(np.sqrt(cells))
    shape = (side, side)
    theta, z, data, rhs = (
        laid_out(a, shape) for a in (system.w_theta, system.w_z, system.data, residual)
    )
    theta[-1], z[:, -1] = 0, 0
    return System(theta, z, data), rhs


def seconds(work: Callable[[], object]) -> float:
    times = []
    for _ in range(RUNS):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def worst_um(system: System, residual: np.ndarray, found: np.ndarray) -> float | None:
    """How far the worst cell is off; None where double precision takes too much memory."""
    if found.size > MOST_HELD_AGAINST_DOUBLE:
        return None
    exact = System(*(w.astype(np.float64) for w in vars(system).values()))
    heights, _ = Solver(exact).solve(residual.astype(np.float64), 1e-9, MOST_ITERATIONS)
    return round(float(np.abs(found - heights).max()) * 1e3, 2)


def measure(system: System, residual: np.ndarray) -> dict[str, float | None]:
    tracemalloc.start()
    given = system.w_theta.nbytes + system.w_z.nbytes + system.data.nbytes + residual.nbytes
    start = time.perf_counter()
    solver = Solver(system)
    setup_s = time.perf_counter() - start
    used = residual.copy()
    start = time.perf_counter()
    found, iterations = solver.solve(used, TOLERANCE_MM, MOST_ITERATIONS)
    solve_s = time.perf_counter() - start
    # The copy of the residual is the benchmark's own.
    peak = tracemalloc.get_traced_memory()[1] + given - used.nbytes
    tracemalloc.stop()
    pair_s = seconds(lambda: scipy.fft.idctn(scipy.fft.dctn(found, workers=2), workers=2))
    return {
        "unknowns": found.size,
        "setup_s": round(setup_s, 2),
        "solve_s": round(solve_s, 2),
        "iterations": iterations,
        "worst_um": worst_um(system, residual, found),
        "ns_per_unknown_and_iteration": round(solve_s / iterations / found.size * 1e9, 1),
        "dct_pair_s": round(pair_s, 3),
        "ratio": round((setup_s + solve_s) / pair_s, 1),
        "bytes_per_unknown": round(peak / found.size, 1),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("capture", type=Path)
    parser.add_argument("products", type=Path, help="captures/<id> of the results")
    parser.add_argument("calibration", type=Path, help="calibration.json")
    parser.add_argument("--mega", type=int, nargs="+", default=[1, 4, 16, 64])
    parser.add_argument("--threads", type=int, default=2)
    args = parser.parse_args()
    use_cores(args.threads)
    system, residual = system_of(args.capture, args.products, args.calibration)
    measure(*enlarged(system, residual, 10_000))
    print("| unknowns | set-up | solve | iterations | worst | DCT pair | ratio | bytes each |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    rows = []
    for mega in args.mega:
        row = measure(*enlarged(system, residual, mega * 1_000_000))
        rows.append(row)
        print(
            f"| {row['unknowns'] / 1e6:.0f} million | {row['setup_s']} s | {row['solve_s']} s"
            f" | {row['iterations']} | {row['worst_um'] or '-'} um | {row['dct_pair_s']} s"
            f" | {row['ratio']}"
            f" | {row['bytes_per_unknown']} |",
            flush=True,
        )
    print(json.dumps({"cores": args.threads, "solves": rows}, separators=(",", ":")))


if __name__ == "__main__":
    main()
