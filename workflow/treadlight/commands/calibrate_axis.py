"""Calibrate the rotation axis from a checkerboard that turns with the hub.

Writes axis.json: the entry `axis` of a calibration (null without `axis_board` frames), its
covariance with the camera held, and how it depends on the camera.
"""

import argparse
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """CAPTURE, --camera and --out."""
    from treadlight.commands.common import add_stage_arguments

    parser.add_argument("capture", type=Path, help="folder of the calibration capture")
    parser.add_argument("--camera", type=Path, required=True, help="camera.json")
    parser.add_argument("--out", type=Path, required=True, help="axis.json to write")
    add_stage_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Find the boards, fit the axis, publish."""
    import numpy as np

    from treadlight import store
    from treadlight.archive import read_capture
    from treadlight.calibrate.axis import calibrate_axis
    from treadlight.calibrate.corners import find_corners
    from treadlight.calibrate.uncertainty import camera_jacobian
    from treadlight.commands.common import progress, read_or_warn, run_stage, with_warnings
    from treadlight.errors import CalibrationError
    from treadlight.images import FrameReader

    capture = read_capture(args.capture)

    def work() -> None:
        rig = store.read_rig(args.camera)
        camera, covariance = rig.camera, np.asarray(rig.covariance)
        frames, board = capture.of_kind("axis_board"), capture.axis_board
        if not frames or board is None:
            store.write_json(args.out, {"axis": None})
            return
        reader = FrameReader(capture)
        corners, angles = [], []
        warnings: list[str] = []
        for frame in progress(frames, "axis boards"):
            light = read_or_warn(reader, frame, warnings)
            found = None if light is None else find_corners(light.intensity, board.inner_corners)
            if found is not None:
                corners.append(found)
                angles.append(np.radians(frame.encoder_deg or 0.0))
        encoder = np.array(angles)

        def calibrate(camera):
            return calibrate_axis(camera, corners, encoder, board.inner_corners, board.square_mm)

        def parameters(camera):
            axis = calibrate(camera).axis
            return np.concatenate([axis.direction, axis.point])

        try:
            with np.errstate(invalid="ignore"):
                result = calibrate(camera)
                jacobian = camera_jacobian(camera, covariance, parameters)
        except np.linalg.LinAlgError:
            raise CalibrationError(
                "axis_board frames: the boards do not turn about one axis by the encoder's angles."
                " Check that the board turns with the hub, and encoder_deg."
            ) from None
        store.write_json(args.out, with_warnings(_content(result, jacobian), warnings))

    return run_stage(
        args,
        inputs=[args.camera],
        outputs=[args.out],
        title="Axis calibration",
        source=capture.id,
        work=work,
    )


def _content(result, jacobian) -> dict:
    return {
        "axis": {
            "direction": result.axis.direction,
            "point": result.axis.point,
            "residual_px": {"rms": result.rms_px},
            "residual_mm": {"rms": result.rms_mm},
        },
        "covariance": result.covariance,
        "camera_jacobian": jacobian,
    }
