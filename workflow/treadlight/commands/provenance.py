"""What the provenance files beside the products tell: from what each was made."""

from pathlib import Path
from typing import Any

from treadlight import store
from treadlight.commands import common
from treadlight.errors import StoreError


def provenance_files(results: Path) -> list[Path]:
    return sorted(
        p for p in results.rglob(f"*{store.PROVENANCE_SUFFIX}") if not is_hidden(results, p)
    )


def read_provenance(path: Path) -> dict[str, Any] | None:
    """Content without its digest, None where the two do not match."""
    try:
        content = store.read_json(path)
        whole = content.pop("digest") == common.provenance_digest(content)
        return content if whole else None
    except (StoreError, LookupError):
        return None


def changed_input(results: Path, content: dict[str, Any]) -> str | None:
    """The first input in a provenance's content that is not there as it was then, if any."""
    for told, digest in content["inputs"].items():
        source = _find(results, told)
        if source is None or digest_of(source) != digest:
            return str(told)
    return None


def digest_of(path: Path) -> str | None:
    """Of a product; None where it cannot be read."""
    try:
        return common.product_digest(path)
    except (OSError, StoreError, LookupError, TypeError):
        return None


def with_followers(results: Path, products: set[str]) -> set[str]:
    """Products (below the results) with all that was made from them, to the archive's page.

    Snakemake makes what is missing only where something that needs it is missing too.
    """
    made_from = {}
    for path in provenance_files(results):
        content = read_provenance(path)
        name = path.relative_to(results).as_posix().removesuffix(store.PROVENANCE_SUFFIX)
        made_from[name] = set(content["inputs"]) if content else set()
    found = products | {"index.html", "products.json"}
    while True:
        more = {
            name
            for name, inputs in made_from.items()
            if name not in found and any(_names(told, one) for told in inputs for one in found)
        }
        if not more:
            return found
        found |= more


def _find(results: Path, told: str) -> Path | None:
    """The product that provenance names by the last parts of its path."""
    parts = told.split("/")
    for first in range(len(parts)):
        inside = "/".join(parts[first:])
        if (results / inside).exists():
            return results / inside
        # A round's products lie one folder deeper than three parts tell.
        deeper = sorted(results.glob(f"*/*/{inside}")) + sorted(results.glob(f"*/{inside}"))
        if len(parts) - first == 3 and len(deeper) == 1:
            return deeper[0]
    return None


def _names(told: str, product: str) -> bool:
    """Whether provenance, which keeps the last parts of a path, means this product."""
    return f"/{product}".endswith(f"/{told}") or f"/{told}".endswith(f"/{product}")


def is_hidden(results: Path, path: Path) -> bool:
    return any(part.startswith(".") for part in path.relative_to(results).parts)
