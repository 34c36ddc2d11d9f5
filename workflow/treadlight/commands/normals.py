"""Surface normals of any stack of images, each under one light.

STACK is an .npz file with

  images             (n, h, w) or (n, h, w, 3): linear intensity, one image per light; of RGB the
                     mean counts. Integer images are saturated at their type's largest value.
  light_directions   (n, 3): from the surface to the light (any length); or, for near lights,
  light_positions    (n, 3) with points (h, w, 3), in the same unit: the inverse square is undone
  light_intensities  (n,) or (n, 3), optional: images are divided by it
  mask               (h, w), optional: pixels to solve
  view               (h, w, 3), optional: from the surface to the camera; else (0, 0, 1)
  normals            (h, w, 3), optional: truth, from which angular errors are printed

Axes: x right, y up, z towards the camera. OUT is an .npz file with normals (h, w, 3) in the same
axes, k_d, k_s, alpha, residual, leds_used and flags (h, w); NaN where there is no normal.
"""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

    from treadlight.photometric import Observations


def add_arguments(parser: argparse.ArgumentParser) -> None:
    # The layout of STACK above is a table: argparse must not fill its lines.
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("stack", type=Path, metavar="STACK", help="the .npz file described above")
    parser.add_argument(
        "--method",
        metavar="NAME",
        default="map",
        help="an estimator; a name that is none lists them (default: %(default)s)",
    )
    parser.add_argument("--out", type=Path, required=True, help="the .npz file to write")


def run(args: argparse.Namespace) -> int:
    import numpy as np

    from treadlight.errors import ConfigError
    from treadlight.photometric import METHODS

    # Not argparse's choices: the list would load numba, for --help too.
    if args.method not in METHODS:
        raise ConfigError(f"No method '{args.method}'. Choose one of {', '.join(METHODS)}.")
    stack = _load(args.stack)
    mask = _mask(args.stack, stack)
    observations = _observations(args.stack, stack, mask)
    estimate = METHODS[args.method](observations)

    def image(values: "np.ndarray", empty: float) -> "np.ndarray":
        full = np.full((*mask.shape, *values.shape[1:]), empty, values.dtype)
        full[mask] = values
        return full

    found: dict[str, Any] = {"normals": image(estimate.normal, np.nan)}
    for name in ("k_d", "k_s", "alpha", "residual"):
        found[name] = image(getattr(estimate, name), np.nan)
    for name in ("leds_used", "flags"):
        found[name] = image(getattr(estimate, name), 0)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(args.out, **found)
    share = np.isfinite(estimate.k_d).mean() if mask.any() else 0.0
    print(f"{args.method}: normals at {share:.1%} of {mask.sum()} pixels")
    if "normals" in stack:
        error = _angles(estimate.normal, stack["normals"][mask])
        print(f"angular error: mean {error.mean():.3f}, median {np.median(error):.3f} degree")
    return 0


def _load(path: Path) -> "dict[str, np.ndarray]":
    import zipfile

    import numpy as np

    from treadlight.errors import ConfigError

    try:
        with np.load(path) as data:
            return {name: data[name] for name in data.files}
    except (OSError, ValueError, AttributeError, zipfile.BadZipFile) as error:
        raise ConfigError(f"{path}: is no readable .npz file ({error}).") from None


def _shaped(path: Path, stack: "dict[str, np.ndarray]", name: str, *shapes: tuple) -> "np.ndarray":
    """An array of the stack, if it has one of the shapes.

    Raises
    ------
    ConfigError
        It is missing or has another shape.
    """
    from treadlight.errors import ConfigError

    if name not in stack:
        raise ConfigError(f"{path}: '{name}' is missing. See treadlight normals --help.")
    if stack[name].shape not in shapes:
        wanted = " or ".join(str(shape) for shape in shapes)
        raise ConfigError(f"{path}: '{name}' is {stack[name].shape}. It must be {wanted}.")
    return stack[name]


def _mask(path: Path, stack: "dict[str, np.ndarray]") -> "np.ndarray":
    import numpy as np

    from treadlight.errors import ConfigError

    images = stack.get("images")
    if images is None or images.ndim not in (3, 4) or (images.ndim == 4 and images.shape[3] != 3):
        raise ConfigError(f"{path}: 'images' must be (n, h, w) or (n, h, w, 3).")
    size = images.shape[1:3]
    if "mask" not in stack:
        return np.ones(size, bool)
    return _shaped(path, stack, "mask", size).astype(bool)


def _observations(path: Path, stack: "dict[str, np.ndarray]", mask: "np.ndarray") -> "Observations":
    import numpy as np

    from treadlight.photometric import Observations
    from treadlight.photometric.noise import dark_noise

    images = _intensities(path, stack)
    size = mask.shape
    noise = np.array([dark_noise(image) for image in images], np.float32)
    intensity = images[:, mask]
    views = np.broadcast_to(np.array([0.0, 0.0, 1.0]), (*size, 3))
    if "view" in stack:
        views = _shaped(path, stack, "view", (*size, 3))
    lights, squared = _lights(path, stack, mask)
    return Observations(
        intensity=intensity * squared,
        lights=lights,
        views=_unit(views[mask]),
        usable=np.isfinite(intensity),
        noise=np.broadcast_to(noise[:, None], intensity.shape) * squared,
    )


def _intensities(path: Path, stack: "dict[str, np.ndarray]") -> "np.ndarray":
    """(n, h, w) float32, divided by the lights' intensities; NaN where saturated."""
    import numpy as np

    images = stack["images"]
    full = np.iinfo(images.dtype).max if np.issubdtype(images.dtype, np.integer) else np.inf
    images = np.where(images >= full, np.nan, images).astype(np.float32)
    n = len(images)
    images = images.reshape(*images.shape[:3], -1)
    if "light_intensities" in stack:
        strength = _shaped(path, stack, "light_intensities", (n,), (n, 3))
        images = images / strength.reshape(n, 1, 1, -1).astype(np.float32)
    return images.mean(axis=3, dtype=np.float32)


def _lights(
    path: Path, stack: "dict[str, np.ndarray]", mask: "np.ndarray"
) -> "tuple[np.ndarray, np.ndarray]":
    """Unit vectors (n, pixels, 3) to the lights, and what undoes the inverse square."""
    import numpy as np

    n, pixels = len(stack["images"]), int(mask.sum())
    if "light_positions" not in stack:
        directions = _unit(_shaped(path, stack, "light_directions", (n, 3)))
        return np.repeat(directions[:, None], pixels, axis=1), np.ones((n, 1), np.float32)
    positions = _shaped(path, stack, "light_positions", (n, 3))
    points = _shaped(path, stack, "points", (*mask.shape, 3))[mask]
    vectors = (positions[:, None] - points[None]).astype(np.float64)
    squared = np.sum(vectors**2, axis=2)
    # Relative to the mean: without the lights' absolute power the unit is free.
    return _unit(vectors), (squared / np.nanmean(squared)).astype(np.float32)


def _unit(vectors: "np.ndarray") -> "np.ndarray":
    import numpy as np

    return (vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)).astype(np.float32)


def _angles(found: "np.ndarray", truth: "np.ndarray") -> "np.ndarray":
    """Angles in degrees where both are known."""
    import numpy as np

    cosine = np.sum(found.astype(np.float64) * truth, axis=1)
    cosine = cosine[np.isfinite(cosine)]
    return np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
