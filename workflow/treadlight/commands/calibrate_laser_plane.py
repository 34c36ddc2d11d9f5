"""Calibrate the laser plane from its line on checkerboards in many poses.

Writes laser_plane.json: the entry `laser_plane` of a calibration (null without `board_laser`
frames), the histogram of its residuals, its covariance with the camera held, and how it depends
on the camera.
"""

import argparse
from pathlib import Path

_HISTOGRAM_BINS = 40


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """CAPTURE, --camera and --out."""
    from treadlight.commands.common import add_stage_arguments

    parser.add_argument("capture", type=Path, help="folder of the calibration capture")
    parser.add_argument("--camera", type=Path, required=True, help="camera.json")
    parser.add_argument("--out", type=Path, required=True, help="laser_plane.json to write")
    add_stage_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Find the boards and the line on each, fit the plane, publish."""
    import numpy as np

    from treadlight import store
    from treadlight.archive import read_capture
    from treadlight.calibrate import camera as boards
    from treadlight.calibrate import laser_plane as core
    from treadlight.calibrate.corners import find_corners, object_points
    from treadlight.calibrate.uncertainty import camera_jacobian
    from treadlight.commands.common import progress, read_or_warn, run_stage, with_warnings
    from treadlight.errors import CalibrationError
    from treadlight.images import FrameReader

    capture = read_capture(args.capture)

    def work() -> None:
        rig = store.read_rig(args.camera)
        laser_frames = {f.pose: f for f in capture.of_kind("board_laser")}
        if not laser_frames or capture.board is None:
            store.write_json(args.out, {"laser_plane": None})
            return
        reader = FrameReader(capture)
        inner, square = capture.board.inner_corners, capture.board.square_mm
        board = object_points(inner, square)
        observed = []
        warnings: list[str] = []
        for frame in progress(capture.of_kind("board"), "laser lines"):
            if frame.pose not in laser_frames:
                continue
            light = read_or_warn(reader, frame, warnings)
            line = read_or_warn(reader, laser_frames[frame.pose], warnings)
            corners = None if light is None else find_corners(light.intensity, inner)
            if corners is None or line is None:
                continue
            intensity = line.intensity
            pose = boards.board_pose(rig.camera, corners, board)
            pixels = core.board_line_points(
                intensity, pose, rig.camera, inner, square, capture.laser_scan
            )
            observed.append((corners, pixels))

        def points_of(camera):
            planes = [boards.board_pose(camera, corners, board).plane for corners, _ in observed]
            return [
                plane.intersect(camera.rays(pixels))
                for plane, (_, pixels) in zip(planes, observed, strict=True)
            ]

        def coefficients(camera):
            plane = core.fit_laser_plane(points_of(camera)).plane
            return np.array([*plane.normal, plane.offset])

        try:
            found = core.fit_laser_plane(points_of(rig.camera))
            jacobian = camera_jacobian(rig.camera, np.asarray(rig.covariance), coefficients)
            content = _content(found, jacobian)
        except CalibrationError as error:
            # Views under the LEDs can do without it.
            content = {"laser_plane": None}
            warnings.append(f"There is no laser plane. {error}")
        store.write_json(args.out, with_warnings(content, warnings))

    return run_stage(
        args,
        inputs=[args.camera],
        outputs=[args.out],
        title="Laser plane calibration",
        source=capture.id,
        work=work,
    )


def _content(found, jacobian) -> dict:
    import numpy as np

    distances = found.distances_mm
    counts, edges = np.histogram(distances, bins=_HISTOGRAM_BINS)
    return {
        "laser_plane": {
            "coefficients": [*found.plane.normal, found.plane.offset],
            "residual_mm": {
                "mean": float(np.mean(distances)),
                "rms": float(np.sqrt(np.mean(distances**2))),
                "p95": float(np.percentile(distances, 95)),
            },
            "poses": found.poses,
            "points": len(distances),
        },
        "histogram_mm": {"edges": edges, "counts": counts},
        "covariance": found.covariance,
        "camera_jacobian": jacobian,
    }
