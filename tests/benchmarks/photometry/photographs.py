"""The project's ball and corner code on photographs that others calibrated.

Light directions from mirror balls, against those stored beside them; reprojection error of
checkerboards.
"""

import argparse
import json
from pathlib import Path

import cv2
import numpy as np

from treadlight.calibrate.balls import find_highlight
from treadlight.calibrate.camera import calibrate_camera
from treadlight.calibrate.corners import find_corners, object_points
from treadlight.calibrate.leds import reflected_lines
from treadlight.geometry import Camera
from treadlight.images import LinearFrame

# So far that a pixel is a millimetre on the ball and rays are parallel.
_FAR_MM = 1e6
_GAMMA = 2.2
_INNER_CORNERS, _SQUARE_MM = (9, 6), 25.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("real", type=Path, help="the folder with light-probes and checkerboards")
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    probes = sorted((args.real / "light-probes").glob("LightProbe-*"))
    found = {
        "light_directions_deg": {probe.name: of_probe(probe) for probe in probes},
        "checkerboards": {
            side: of_boards(sorted((args.real / "checkerboards").glob(f"{side}*.jpg")))
            for side in ("left", "right")
        },
    }
    args.out.write_text(json.dumps(found, indent=1))


def of_probe(folder: Path) -> list[float]:
    """Degrees between each light's direction and the stored one."""
    x, y, radius = np.loadtxt(folder / "circle_data.txt")
    stored = np.loadtxt(folder / "light_directions.txt").T
    return [
        round(direction_error(path, (x, y), radius, direction), 3)
        for path, direction in zip(sorted(folder.glob("Image_*.JPG")), stored, strict=True)
    ]


def direction_error(
    path: Path, middle: tuple[float, float], radius: float, direction: np.ndarray
) -> float:
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    height, width = image.shape
    # The stored circle counts rows upwards.
    centre_px = (middle[0], height - 1 - middle[1])
    matrix = np.array([[_FAR_MM, 0, centre_px[0]], [0, _FAR_MM, centre_px[1]], [0, 0, 1]])
    camera = Camera(matrix, np.zeros(5), (width, height))
    centre = np.array([0.0, 0.0, _FAR_MM])
    frame = LinearFrame((image.astype(np.float32) / 255) ** _GAMMA, image == 255)
    pixel = find_highlight(frame, camera, centre, radius)
    _, mirrored = reflected_lines(camera, pixel[None], centre[None], radius)
    # {C} has y down and z away from the camera.
    cosine = (mirrored[0] * [1, -1, -1]) @ direction / np.linalg.norm(direction)
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))


def of_boards(files: list[Path]) -> dict[str, float]:
    """Reprojection error of a camera calibrated from boards, px, and its focal length, px."""
    board = object_points(_INNER_CORNERS, _SQUARE_MM)
    pairs = []
    for path in files:
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) / np.float32(255)
        corners = find_corners(image, _INNER_CORNERS)
        if corners is not None:
            pairs.append((corners, board))
    found = calibrate_camera(pairs, image.shape[::-1])
    return {
        "rms_px": round(found.rms_px, 3),
        "focal_px": round(float(found.camera.matrix[0, 0]), 1),
        "boards_used": found.poses,
        "boards": len(files),
    }


if __name__ == "__main__":
    main()
