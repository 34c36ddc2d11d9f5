"""Writes what hemisphere.pov must know of the scene, so that no number stands in two places."""

import argparse
from pathlib import Path

import hemisphere


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("layout", choices=("rings", "spread"))
    parser.add_argument("out", type=Path)
    args = parser.parse_args()
    # POV-Ray's axes are left-handed: z points away from the camera.
    lights = ",\n".join(
        f"  <{x:.12f}, {y:.12f}, {-z:.12f}>" for x, y, z in hemisphere.lights(args.layout).tolist()
    )
    args.out.write_text(
        f"#declare COLUMNS = {hemisphere.COLUMNS};\n"
        f"#declare WHOLE = {hemisphere.WHOLE};\n"
        f"#declare RATIO_FIRST = {hemisphere.RATIO_FIRST};\n"
        f"#declare RATIO_STEP = {hemisphere.RATIO_STEP};\n"
        f"#declare LIGHTS = array[16] {{\n{lights}\n}}\n"
    )


if __name__ == "__main__":
    main()
