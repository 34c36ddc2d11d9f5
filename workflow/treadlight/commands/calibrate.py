"""Join the parts of a calibration into calibration.json.

The covariance holds camera, laser plane and axis together: what was calibrated with the camera
shares its errors.
"""

import argparse
from pathlib import Path

_PARTS = (
    ("laser_plane", ("A", "B", "C", "D")),
    ("axis", ("direction.x", "direction.y", "direction.z", "point.x", "point.y", "point.z")),
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """CAPTURE, the parts and --out."""
    from treadlight.commands.common import add_stage_arguments

    parser.add_argument("capture", type=Path, help="folder of the calibration capture")
    parser.add_argument("--camera", type=Path, required=True, help="camera.json")
    parser.add_argument("--laser-plane", type=Path, required=True, help="laser_plane.json")
    parser.add_argument("--axis", type=Path, required=True, help="axis.json")
    parser.add_argument("--leds", type=Path, required=True, help="leds.json")
    parser.add_argument("--out", type=Path, required=True, help="calibration.json to write")
    add_stage_arguments(parser)


def run(args: argparse.Namespace) -> int:
    """Read the parts, join their covariances, publish."""
    import numpy as np

    from treadlight import store
    from treadlight.archive import read_capture
    from treadlight.calibrate.uncertainty import joint_covariance
    from treadlight.commands.common import run_stage, with_warnings

    capture = read_capture(args.capture)
    inputs = [args.camera, args.laser_plane, args.axis, args.leds]

    def work() -> None:
        camera, laser_plane, axis, leds = map(store.read_json, inputs)
        parts, order = [], list(camera["covariance"]["order"])
        for (name, rows), content in zip(_PARTS, (laser_plane, axis), strict=True):
            if content[name] is None:
                continue
            order += [f"{name}.{row}" for row in rows]
            own, jacobian = content["covariance"], content["camera_jacobian"]
            parts.append((np.array(own, float), np.array(jacobian, float)))
        matrix = joint_covariance(np.array(camera["covariance"]["matrix"], float), parts)
        content = {
            "camera": camera["camera"],
            "laser_plane": laser_plane["laser_plane"],
            "axis": axis["axis"],
            "reference_plane": camera["reference_plane"],
            "leds": leds["leds"],
            "covariance": {"order": order, "matrix": matrix},
        }
        # The camera's boards serve the other parts too: each sentence once.
        said = [w for part in (camera, laser_plane, axis, leds) for w in part.get("warnings", ())]
        store.write_json(args.out, with_warnings(content, list(dict.fromkeys(said))))

    return run_stage(
        args, inputs=inputs, outputs=[args.out], title="Calibration", source=capture.id, work=work
    )
