"""Every method on stacks whose normals are known, through `treadlight normals`."""

import argparse
import json
import tempfile
from pathlib import Path

import hemisphere
import numpy as np

from treadlight import cli
from treadlight.photometric import METHODS


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("stacks", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--threads", type=int, default=2)
    args = parser.parse_args()
    found = {path.parent.name: of_stack(path, args.threads) for path in args.stacks}
    args.out.write_text(json.dumps(found, indent=1))


def of_stack(path: Path, threads: int) -> dict[str, dict[str, float]]:
    """Mean and median angular error, and the share of pixels with a normal, per method."""
    with np.load(path) as stack:
        truth, mask = stack["normals"], stack["mask"]
    result = {}
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "normals.npz"
        for name in METHODS:
            options = ["--method", name, "--out", str(out), "--threads", str(threads)]
            cli.main(["normals", str(path), *options])
            with np.load(out) as found:
                error = hemisphere.angles(found["normals"][mask], truth[mask])
            result[name] = {
                "mean_deg": round(float(np.nanmean(error)), 3),
                "median_deg": round(float(np.nanmedian(error)), 3),
                "share": round(float(np.isfinite(error).mean()), 4),
            }
    return result


if __name__ == "__main__":
    main()
