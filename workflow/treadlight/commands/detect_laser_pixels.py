"""Find the laser line in every laser frame of a capture, sub-pixel, up to four peaks per row.

Writes the candidates of each row with standard deviation, width, strength and skew, and which
of them is the line. A capture without laser frames gives a product of no sections.
"""

import argparse
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from treadlight.commands import common

if TYPE_CHECKING:
    import numpy as np
    import xarray as xr

    from treadlight.archive import Capture, Frame
    from treadlight.laser.detection import Candidates, LineModel

# The line's shape is learnt from frames spread over the capture: so many, or with so many lines.
_LEARNT_FRAMES, _LEARNT_LINES = 12, 16_000
# A lit section is seen in more rows than this share; two lines compete in more than that.
_SEEN_SHARE = 0.05
_TWICE_SHARE = 0.5
_RIVAL_STRENGTH = 0.5
_APART_SIGMAS = 4.0
_TOLD = 5
_FIELDS = {
    "u": ("pixel", "sub-pixel position across the line"),
    "u_std": ("pixel", "standard deviation of u"),
    "width": ("pixel", "full width at half maximum over 2.355"),
    "strength": ("1", "smoothed intensity at the peak; 1 is full scale"),
    "skew": ("1", "left minus right half-width over their sum"),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("capture", type=Path, help="folder of the capture")
    parser.add_argument("--out", type=Path, required=True, help="laser_pixels.zarr to write")
    common.add_stage_arguments(parser)


def run(args: argparse.Namespace) -> int:
    from treadlight import store
    from treadlight.archive import read_capture

    capture = read_capture(args.capture)
    out = store.store_folder(args.out)

    def work() -> None:
        dataset = detect_capture(capture, args.threads)
        store.write_store(out, dataset, title="Laser pixels", source=capture.id)

    return common.run_stage(
        args, inputs=[], outputs=[out], title="Laser pixels", source=capture.id, work=work
    )


def detect_capture(capture: "Capture", threads: int, tell_all: bool = False) -> "xr.Dataset":
    """Candidates of every section, in order of encoder; one frame per thread is held.

    Its attribute `warnings`, where there is any, tells which sections are left out and why; of
    many the first ones, or all.
    """
    from treadlight.errors import NoLineError
    from treadlight.images import FrameReader
    from treadlight.laser import detect_section, learn_line_model, select_path

    frames = sorted(capture.of_kind("laser"), key=lambda f: (f.encoder_deg or 0.0, f.pose or 0))
    if not frames:
        return _dataset(capture, [], [], [])
    reader = FrameReader(capture)

    def read(frame: "Frame") -> "tuple[np.ndarray, np.ndarray]":
        image = reader.read(frame)
        if capture.laser_scan == "columns":
            return image.intensity.T, image.saturated.T
        return image.intensity, image.saturated

    lines = capture.encoding.size_px[capture.laser_scan != "columns"]
    step = -(-len(frames) // max(_LEARNT_FRAMES, _LEARNT_LINES // lines))
    try:
        model = learn_line_model([read(frame) for frame in frames[step // 2 :: step]])
    except NoLineError as error:
        if not capture.of_kind("led"):
            raise
        # The views under the LEDs still give the shape.
        return _dataset(capture, [], [], []).assign_attrs(warnings=[str(error)])

    def detect(frame: "Frame") -> "tuple[Any, np.ndarray]":
        found = detect_section(*read(frame), model)
        return found, select_path(found, model)

    with ThreadPoolExecutor(max(1, threads)) as pool:
        results = list(
            common.progress(pool.map(detect, frames), f"{capture.id}: laser sections", len(frames))
        )
    found = [result for result, _ in results]
    paths = [path for _, path in results]
    warnings = []
    for frame, candidates, path in zip(frames, found, paths, strict=True):
        if reason := doubt_of(candidates, path, model):
            path[:] = -1
            warnings.append(f"{frame.file}: {reason}")
    dataset = _dataset(capture, frames, found, paths, model)
    if not warnings:
        return dataset
    return dataset.assign_attrs(warnings=warnings if tell_all else _shortened(warnings))


def doubt_of(candidates: "Candidates", path: "np.ndarray", model: "LineModel") -> str | None:
    """Why a frame's section is left out, or None: it shows no line, or two."""
    import numpy as np

    strength, u = candidates.strength, candidates.u
    seen = np.isfinite(strength[:, 0])
    if np.mean(seen) < _SEEN_SHARE:
        return "shows no laser line, as if the laser was off. Its section is left out."
    with np.errstate(invalid="ignore"):
        rival = strength[:, 1] > _RIVAL_STRENGTH * strength[:, 0]
        apart = np.abs(u[:, 1] - u[:, 0]) > _APART_SIGMAS * model.unblurred_sigma_px
    if np.mean((rival & apart)[seen]) > _TWICE_SHARE:
        return (
            "shows the laser line twice, as by a mirror or a double exposure. Its section is"
            " left out."
        )
    return None


def _shortened(warnings: list[str]) -> list[str]:
    """The first few, and how many more there are."""
    more = len(warnings) - _TOLD
    return warnings if more <= 1 else [*warnings[:_TOLD], f"The same of {more} more laser frames."]


def _dataset(
    capture: "Capture", frames: "list[Frame]", found: list, paths: list, model: Any = None
) -> "xr.Dataset":
    import numpy as np
    import xarray as xr

    from treadlight.laser import FLAGS, PEAKS
    from treadlight.store import flag_attrs, variable

    width, height = capture.encoding.size_px
    lines = height if capture.laser_scan == "rows" else width
    peaks = ("section", "line", "peak")

    def stack(values: list, shape: tuple[int, ...], dtype: type) -> "np.ndarray":
        return np.stack(values) if values else np.empty((0, *shape), dtype)

    variables = {
        name: variable(
            peaks, stack([getattr(f, name) for f in found], (lines, PEAKS), np.float32), *text
        )
        for name, text in _FIELDS.items()
    }
    flags = stack([f.flags for f in found], (lines,), np.uint8)
    variables["quality"] = variable(
        ("section", "line"), flags, "1", "what is known of the row", **flag_attrs(FLAGS)
    )
    variables["path"] = variable(
        ("section", "line"),
        stack(paths, (lines,), np.int8),
        "1",
        "peak that is the line by continuity along the rows, -1 for none",
    )
    encoder = np.radians(np.array([f.encoder_deg for f in frames], float))
    variables["encoder"] = variable(("section",), encoder, "rad", "encoder angle")
    facts = {"scan": capture.laser_scan}
    if model is not None:
        facts |= {"line_sigma_px": model.unblurred_sigma_px, "noise": model.noise}
    return xr.Dataset(variables, attrs=facts)
