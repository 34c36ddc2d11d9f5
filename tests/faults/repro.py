"""make test-repro: fresh clones in different folders, on one core and on two, agree in every bit.

Each clone renders its own archive, compiles its own kernels and processes it with its own code.
Ends with one line of JSON.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def main() -> int:
    with tempfile.TemporaryDirectory(prefix="treadlight-repro-") as place:
        one = process(Path(place) / "a", cores=1)
        two = process(Path(place) / "another folder" / "of this project", cores=2)
    names = sorted(one.keys() | two.keys())
    differing = [name for name in names if one.get(name) != two.get(name)]
    for name in differing[:20]:
        print(f"differs: {name}", file=sys.stderr)
    print(json.dumps({"files": len(names), "differing": len(differing)}))
    return 1 if differing or not names else 0


def process(clone: Path, cores: int) -> dict[str, str]:
    """Digests of every product that a fresh clone makes."""
    clone.parent.mkdir(parents=True, exist_ok=True)
    _run(ROOT, "git", "clone", "--quiet", "--no-hardlinks", str(ROOT), str(clone))
    environment = {
        "PYTHONPATH": str(clone / "workflow"),
        "XDG_CACHE_HOME": str(clone / "cache"),
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
    }
    print(f"{clone.name}: rendering and processing on {cores} cores", flush=True)
    archive = ["--config", "archive=archive", "results=results"]
    _run(clone, "treadlight", "simulate", "archive", "--preset", "tiny", **environment)
    _run(clone, "snakemake", "--cores", str(cores), *archive, **environment)
    _run(clone, "treadlight", "verify", "results", **environment)
    return json.loads((clone / "results/products.json").read_text())["files"]


def _run(folder: Path, *command: str, **environment: str) -> None:
    done = subprocess.run(
        command,
        cwd=folder,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        sys.exit(f"{' '.join(command)} exits {done.returncode}:\n{done.stderr}")


if __name__ == "__main__":
    sys.exit(main())
