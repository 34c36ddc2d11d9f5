"""Corruption of results: bytes flipped, chunks lost, files exchanged, metadata cut off."""

from pathlib import Path

import numpy as np

from treadlight.commands.verify import find_damage


def victims(results: Path) -> list[Path]:
    """Every file of the results that a person or a stage reads."""
    beside = {"logs", "benchmarks"}
    return sorted(
        path
        for path in results.rglob("*")
        if path.is_file()
        and not any(part.startswith(".") for part in path.relative_to(results).parts)
        and path.relative_to(results).parts[0] not in beside
    )


def inject(results: Path, rng: np.random.Generator) -> str:
    """Damage one file, or exchange two; says what was done."""
    files = victims(results)
    path = files[rng.integers(len(files))]
    kind = ("flip", "lose", "exchange", "cut")[rng.integers(4)]
    data = path.read_bytes()
    if kind == "exchange":
        others = [p for p in files if p.suffix == path.suffix and p.read_bytes() != data]
        other = others[rng.integers(len(others))]
        _put(path, other.read_bytes())
        _put(other, data)
    elif kind == "lose":
        path.unlink()
    elif kind == "cut":
        _put(path, data[: rng.integers(len(data))])
    else:
        changed = bytearray(data)
        changed[rng.integers(len(data))] ^= 1 << rng.integers(8)
        _put(path, bytes(changed))
    return f"{kind} {path.relative_to(results)}"


def _put(path: Path, data: bytes) -> None:
    # The file may be a hard link to that of the healthy results.
    path.unlink()
    path.write_bytes(data)


def is_found(results: Path) -> bool:
    """Whether `treadlight verify` sees it; a lost products.json is told as such."""
    return not (results / "products.json").is_file() or bool(find_damage(results))
