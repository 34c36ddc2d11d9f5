"""Calibrate the camera from checkerboards, and the reference plane.

Writes camera.json: the entries `camera` and `reference_plane` of a calibration, the residuals of
all corners found, and the covariance of the intrinsics.
"""

import argparse
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """CAPTURE and --out."""
    from treadlight.commands.common import add_stage_arguments

    parser.add_argument("capture", type=Path, help="folder of the calibration capture")
    parser.add_argument("--out", type=Path, required=True, help="camera.json to write")
    add_stage_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Read the boards, calibrate, publish."""
    from treadlight import store
    from treadlight.archive import read_capture
    from treadlight.calibrate import camera as core
    from treadlight.calibrate.corners import find_corners, object_points
    from treadlight.commands.common import progress, read_or_warn, run_stage, with_warnings
    from treadlight.errors import CalibrationError
    from treadlight.images import FrameReader

    capture = read_capture(args.capture)

    def work() -> None:
        if not capture.of_kind("board") or capture.board is None:
            raise CalibrationError(
                f"{capture.folder / 'frames.csv'}: has no frames of kind 'board', without which"
                " there is no camera. Add checkerboard images in several poses."
            )
        reader = FrameReader(capture)
        # Boards taken for other purposes show the same lens: each further view counts.
        kinds = {"board": capture.board, "reference_board": capture.board}
        if capture.axis_board:
            kinds["axis_board"] = capture.axis_board
        frames = [(f, shown) for kind, shown in kinds.items() for f in capture.of_kind(kind)]
        pairs, bare = [], []
        warnings: list[str] = []
        for frame, shown in progress(frames, "boards"):
            light = read_or_warn(reader, frame, warnings)
            if light is None:
                continue
            corners = find_corners(light.intensity, shown.inner_corners)
            if corners is None:
                bare.append(frame.file)
            else:
                pairs.append((corners, object_points(shown.inner_corners, shown.square_mm)))
        if bare:
            warnings.append(
                f"{len(bare)} of {len(frames)} board frames show no whole checkerboard and are left"
                f" out: {', '.join(bare)}."
            )
        found = core.calibrate_camera(pairs, capture.encoding.size_px)
        plane = None
        board = object_points(capture.board.inner_corners, capture.board.square_mm)
        for frame in capture.of_kind("reference_board"):
            corners = find_corners(reader.read(frame).intensity, capture.board.inner_corners)
            if corners is None:
                raise CalibrationError(
                    f"{capture.path(frame)}: shows no checkerboard of {capture.board.inner_corners}"
                    " inner corners. Take the reference board again, or drop its row."
                )
            plane = core.board_pose(found.camera, corners, board).plane
        content = _content(found, plane, _residuals_px(found.camera, pairs))
        store.write_json(args.out, with_warnings(content, warnings))

    return run_stage(
        args,
        inputs=[],
        outputs=[args.out],
        title="Camera calibration",
        source=capture.id,
        work=work,
    )


def _residuals_px(camera, pairs):
    """Corners less where the camera puts them, each board in its best pose, (n, 2) float64."""
    import numpy as np

    from treadlight.calibrate.camera import board_pose

    found = []
    for corners, board in pairs:
        pose = board_pose(camera, corners, board)
        points = np.atleast_2d(board) @ pose.rotation.T + pose.translation
        found.append(corners - camera.project(points))
    return np.round(np.concatenate(found), 4)


def _content(found, plane, residuals_px) -> dict:
    from treadlight.calibrate.camera import PARAMETERS

    camera = found.camera
    return {
        "camera": {
            "matrix": camera.matrix,
            "distortion": camera.distortion,
            "size_px": camera.size_px,
            "reprojection_rms_px": found.rms_px,
            "poses": found.poses,
        },
        "reference_plane": (
            None if plane is None else {"coefficients": [*plane.normal, plane.offset]}
        ),
        "residuals_px": residuals_px,
        "covariance": {
            "order": [f"camera.{name}" for name in PARAMETERS],
            "matrix": found.covariance,
        },
    }
