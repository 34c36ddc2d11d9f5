"""How fast MAP and algorithm 4 are, beside algorithm 4 written plainly, and NIPS by scipy.

Sixteen near LEDs in the rig's rings, rubber (k_d 0.05, k_s 0.4, alpha 40 of table 5.1) with 2 %
noise, at most five refinements, as many cores as NUMBA_NUM_THREADS says (make bench-speed: two).
All run in one process, one after the other, on the same pixels or on the first of them; each is
compiled before its time is taken. MAP's material is learned once, as once per view in the
pipeline, and timed apart. Then the memory of views of one and of four million pixels, taken chunk
by chunk: the chunk bounds it. The last line is JSON.
"""

import json
import math
import multiprocessing
import resource
import statistics
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from numba import get_num_threads, njit, prange
from scipy.optimize import least_squares

from treadlight.photometric import METHODS, Observations, dps, map_normals, sps
from treadlight.photometric.material import learn_material
from treadlight.threads import use_cores

PIXELS, PLAIN_PIXELS, SCIPY_PIXELS = 1 << 18, 1 << 14, 50
# As many as the stage holds at a time, and views of so many chunks.
CHUNK_PX, CHUNKS = 1 << 16, (16, 64)
REFINEMENTS, TRIALS, ALPHA_MAX = 5, 100, 1024.0
RUNS = 3
# The stage learns the usual misfit once per view; a chunk gets it handed.
MISFIT = 0.02
K_D, K_S, ALPHA = 0.05, 0.4, 40.0


def scene(count: int) -> Observations:
    """A square of tilted facets 400 mm from the LEDs and 600 mm below the camera, row by row."""
    rng = np.random.default_rng(1)
    tilt = rng.uniform(-0.2, 0.2, (count, 2))
    normal = np.column_stack([tilt, np.sqrt(1 - np.sum(tilt**2, axis=1))])
    side = np.linspace(-70, 70, math.isqrt(count))
    y, x = np.meshgrid(side, side, indexing="ij")
    points = np.column_stack([x.ravel(), y.ravel(), np.zeros(count)])
    zenith = np.radians(np.repeat([15, 35], 8))
    azimuth = np.tile(2 * np.pi * np.arange(8) / 8, 2)
    across = np.sin(zenith)
    leds = 400 * np.column_stack(
        [across * np.cos(azimuth), across * np.sin(azimuth), np.cos(zenith)]
    )
    lights = unit(leds[:, None] - points)
    views = unit(np.array([0.0, 0, 600]) - points)
    nl = np.sum(lights * normal, axis=-1)
    nh = np.maximum(np.sum(unit(lights + views) * normal, axis=-1), 0)
    clean = np.where(nl > 0, K_D * nl + K_S * nh**ALPHA, 0)
    noisy = clean * (1 + 0.02 * rng.standard_normal(clean.shape))
    return Observations(
        noisy.astype(np.float32),
        lights.astype(np.float32),
        views.astype(np.float32),
        np.ones(noisy.shape, bool),
        np.full(noisy.shape, 1e-4, np.float32),
    )


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def first(observations: Observations, count: int) -> Observations:
    return Observations(
        *(
            np.ascontiguousarray(values[:, :count])
            for values in (observations.intensity, observations.lights)
        ),
        observations.views[:count],
        np.ascontiguousarray(observations.usable[:, :count]),
        np.ascontiguousarray(observations.noise[:, :count]),
    )


@njit(parallel=True)
def plain_algorithm_4(intensity, lights, views, refinements, trials, out):
    """The dissertation's steps pixel by pixel in double precision, as one would write them down."""
    for k in prange(intensity.shape[1]):
        light, towards = intensity[:, k].copy(), lights[:, k].copy()
        out[k] = plain_pixel(light, towards, views[k], refinements, trials)


@njit
def plain_pixel(light, lights, view, refinements, trials):
    leds = len(light)
    halves = np.empty((leds, 3))
    for m in range(leds):
        half = lights[m] + view
        halves[m] = half / np.linalg.norm(half)
    nl, nh = np.ones(leds), np.ones(leds)
    gloss = np.empty(leds)
    result = np.zeros(6)
    for refinement in range(refinements + 1):
        for m in range(leds):
            gloss[m] = max(light[m] - result[3] * nl[m], 0.0) if nl[m] > 0 else 0.0
        top = gloss.max()
        gloss /= top
        scaled, alpha = plain_algorithm_3(gloss, halves, trials)
        length = np.linalg.norm(scaled)
        normal = scaled / length
        k_s = top * length**alpha
        darkest = -1
        for m in range(leds):
            nl[m], nh[m] = np.dot(lights[m], normal), np.dot(halves[m], normal)
            if nl[m] > 0.1 and (darkest < 0 or nh[m] < nh[darkest]):
                darkest = m
        left = light[darkest] - k_s * max(nh[darkest], 0.0) ** alpha
        moved = np.linalg.norm(normal - result[:3])
        result[:3] = normal
        result[3], result[4], result[5] = max(left / nl[darkest], 0.0), k_s, alpha
        if refinement > 0 and moved < math.radians(0.001):
            break
    return result


@njit
def plain_algorithm_3(gloss, halves, trials):
    """N and alpha of the least cost of eq. 5.23 among all trial values."""
    leds = len(gloss)
    matrix = np.zeros((3, 3))
    for m in range(leds):
        for i in range(3):
            for j in range(3):
                matrix[i, j] += gloss[m] ** 2 * halves[m, i] * halves[m, j]
    inverse = np.linalg.inv(matrix)
    least, alpha, best = np.inf, 1.0, np.zeros(3)
    powers = np.empty(leds)
    for trial in range(trials):
        value = ALPHA_MAX ** (trial / (trials - 1))
        right = np.zeros(3)
        for m in range(leds):
            powers[m] = gloss[m] ** (1 + 1 / value)
            for i in range(3):
                right[i] += gloss[m] * halves[m, i] * powers[m]
        scaled = inverse @ right
        cost = 0.0
        for m in range(leds):
            model = halves[m, 0] * scaled[0] + halves[m, 1] * scaled[1] + halves[m, 2] * scaled[2]
            cost += (powers[m] - gloss[m] * model) ** 2
        if cost < least:
            least, alpha, best = cost, value, scaled
    return best, alpha


def plain(observations: Observations) -> np.ndarray:
    """Normal, k_d, k_s and alpha (n, 6) by `plain_algorithm_4`."""
    out = np.empty((observations.intensity.shape[1], 6))
    plain_algorithm_4(
        observations.intensity.astype(np.float64),
        observations.lights.astype(np.float64),
        observations.views.astype(np.float64),
        REFINEMENTS,
        TRIALS,
        out,
    )
    return out


def scipy_nips(observations: Observations) -> np.ndarray:
    """Normals (n, 3) of the full model's least squares, pixel by pixel, from those of `dps`."""
    start = dps(observations).normal.astype(np.float64)
    normals = np.empty_like(start)
    for k in range(len(start)):
        light = observations.intensity[:, k].astype(np.float64)
        lights = observations.lights[:, k].astype(np.float64)
        halves = unit(lights + observations.views[k])
        top = light.max()

        def misfit(
            x: np.ndarray,
            light: np.ndarray = light,
            lights: np.ndarray = lights,
            halves: np.ndarray = halves,
        ) -> np.ndarray:
            normal = direction(x)
            nl, nh = lights @ normal, np.maximum(halves @ normal, 1e-9)
            return np.where(nl > 0, x[2] * nl + x[3] * nh ** np.exp(x[4]), 0) - light

        low, high = [-np.inf, -np.inf, 0, 0, 0], [np.inf] * 4 + [math.log(ALPHA_MAX)]
        angles = [math.atan2(start[k, 0], start[k, 2]), math.asin(start[k, 1])]
        guess = [*angles, 0.5 * top, 0.5 * top, math.log(10)]
        normals[k] = direction(least_squares(misfit, guess, bounds=(low, high)).x)
    return normals


def direction(x: np.ndarray) -> np.ndarray:
    return np.array(
        [math.sin(x[0]) * math.cos(x[1]), math.sin(x[1]), math.cos(x[0]) * math.cos(x[1])]
    )


def rate(work: Callable[[Observations], object], observations: Observations, runs: int) -> float:
    """Pixels per second, the median of some runs."""
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        work(observations)
        times.append(time.perf_counter() - start)
    return observations.intensity.shape[1] / statistics.median(times)


def cpu_us(work: Callable[[Observations], object], observations: Observations) -> float:
    """Processor time per pixel: what cores would do that others did not use too."""
    before = time.process_time()
    work(observations)
    return (time.process_time() - before) / observations.intensity.shape[1] * 1e6


def peak_mb(chunks: int) -> float:
    """Most memory of a process that solves a view of so many chunks, one after the other."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(_solve_chunks, chunks).result()


def _solve_chunks(chunks: int) -> float:
    use_cores(get_num_threads())
    one = scene(CHUNK_PX)
    material = learn_material(one)
    for _ in range(chunks):
        map_normals(one, material=material)
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> None:
    use_cores(get_num_threads())
    whole = scene(PIXELS)
    few, fewest = first(whole, PLAIN_PIXELS), first(whole, SCIPY_PIXELS)
    learn_material(fewest)
    before = time.perf_counter()
    material = learn_material(few)
    learning_s = time.perf_counter() - before

    def default(observations: Observations) -> object:
        return map_normals(observations, material=material)

    def algorithm_4(observations: Observations) -> object:
        return sps(observations, max_refinements=REFINEMENTS, misfit=MISFIT)

    fast = {"map": default, "sps": algorithm_4}
    others = {name: method for name, method in METHODS.items() if name not in fast}
    for work in (*fast.values(), plain, *others.values()):
        work(fewest)
    angle = np.degrees(
        2 * np.arcsin(np.linalg.norm(sps(few).normal - plain(few)[:, :3], axis=1) / 2)
    )
    rates = {name: rate(method, whole, RUNS) for name, method in fast.items()}
    rates |= {name: rate(method, few, RUNS) for name, method in others.items()}
    plainly = rate(plain, few, 1)
    by_scipy = rate(scipy_nips, fewest, 1)
    figures = {
        "cores": get_num_threads(),
        "mpixel_per_s": {name: round(value / 1e6, 4) for name, value in rates.items()},
        "plain_algorithm_4_mpixel_per_s": round(plainly / 1e6, 4),
        "scipy_nips_mpixel_per_s": round(by_scipy / 1e6, 7),
        "cpu_us_per_pixel": {name: round(cpu_us(work, whole), 2) for name, work in fast.items()},
        "map_learning_s": round(learning_s, 2),
        "map_peak_mb": {
            f"{chunks * CHUNK_PX >> 20} Mpixel": round(peak_mb(chunks), 1) for chunks in CHUNKS
        },
        "sps_over_plain": round(rates["sps"] / plainly, 1),
        "sps_over_scipy_nips": round(rates["sps"] / by_scipy, 1),
        "sps_against_plain_median_deg": round(float(np.median(angle)), 4),
    }
    print("| method | Mpixel/s |\n| --- | --- |")
    for name, value in figures["mpixel_per_s"].items():
        print(f"| {name} | {value:.3f} |")
    print(f"| algorithm 4, plain | {plainly / 1e6:.4f} |\n| nips by scipy | {by_scipy / 1e6:.6f} |")
    print(json.dumps(figures, separators=(",", ":")))


if __name__ == "__main__":
    main()
