"""Every method on the hemisphere at every ratio k_d / k_s, for one lobe, layout and alpha.

Writes a row per ratio and method, and the maps of figure 5.5 at the ratio 0.1.
"""

import argparse
import csv
from pathlib import Path

import cv2
import hemisphere
import numpy as np

from treadlight.photometric import METHODS, Estimate
from treadlight.threads import use_cores

# Normals further from the view have no light on their highlight in any layout.
LARGEST_TILT_DEG = 60
MAPPED_RATIO = 0.1
COLUMNS = ("lobe", "layout", "alpha", "ratio", "method", "mean_deg", "median_deg", "share")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("lobe", choices=("povray", "ggx"))
    parser.add_argument("layout", choices=("rings", "spread"))
    parser.add_argument("alpha", type=float)
    parser.add_argument("--pictures", type=Path, nargs="*", help="POV-Ray's, one per ratio")
    parser.add_argument("--errors", type=Path, required=True)
    parser.add_argument("--maps", type=Path, required=True)
    parser.add_argument("--threads", type=int, default=2)
    args = parser.parse_args()
    use_cores(args.threads)
    truth, inside = hemisphere.normals()
    light = hemisphere.lights(args.layout)
    tilt = np.degrees(np.arccos(truth[:, 2]))
    rows, maps = [], {}
    for k, ratio in enumerate(hemisphere.ratios()):
        if args.lobe == "povray":
            intensity = rendered(args.pictures[k], inside, truth, light, ratio, args.alpha)
        else:
            intensity = hemisphere.quantised(hemisphere.microfacet(truth, light, ratio, args.alpha))
        observations = hemisphere.observe(intensity, light)
        found = {name: method(observations) for name, method in METHODS.items()}
        for name, estimate in found.items():
            error = hemisphere.angles(estimate.normal, truth)[tilt <= LARGEST_TILT_DEG]
            rows.append([args.lobe, args.layout, args.alpha, ratio, name, *figures(error)])
        if np.isclose(ratio, MAPPED_RATIO):
            maps = mapped(intensity, found, truth, inside)
    with args.errors.open("w", newline="") as file:
        csv.writer(file).writerows([COLUMNS, *rows])
    np.savez_compressed(args.maps, **maps)


def rendered(
    path: Path,
    inside: np.ndarray,
    truth: np.ndarray,
    light: np.ndarray,
    ratio: float,
    alpha: float,
) -> np.ndarray:
    """Intensities (16, n) of a picture, after a look whether POV-Ray rendered eq. 5.1.

    Raises
    ------
    ValueError
        It is off by more than rounding, or off on average: clipped, another gamma, an n.l on
        the gloss, light from elsewhere.
    """
    picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    intensity = hemisphere.tiles(picture)[:, inside]
    formula = hemisphere.blinn_phong(truth, light, ratio, alpha)
    largest, mean = hemisphere.departure(intensity, formula)
    if largest > 1 or abs(mean) > 0.1:
        raise ValueError(
            f"{path} is up to {largest:.1f}, on average {mean:.2f} steps of 16 bits from eq. 5.1;"
            " rounding alone gives 0.5 and 0."
        )
    return intensity


def figures(error: np.ndarray) -> list[str]:
    """Mean and median of the errors that are known, degrees, and the share of these."""
    known = error[np.isfinite(error)]
    if not known.size:
        return ["nan", "nan", "0"]
    return [f"{known.mean():.4f}", f"{np.median(known):.4f}", f"{known.size / error.size:.4f}"]


def mapped(
    intensity: np.ndarray, found: dict[str, Estimate], truth: np.ndarray, inside: np.ndarray
) -> dict[str, np.ndarray]:
    """Images (100, 100): the ninth light's, and per method the two errors."""

    def image(values: np.ndarray) -> np.ndarray:
        full = np.full(inside.shape, np.nan, np.float32)
        full[inside] = values
        return full

    maps = {"image": image(intensity[8])}
    for name, estimate in found.items():
        maps[f"angle {name}"] = image(hemisphere.angles(estimate.normal, truth))
        maps[f"residual {name}"] = image(estimate.residual)
    return maps


if __name__ == "__main__":
    main()
