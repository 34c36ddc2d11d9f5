"""Hash every file of the results again, and say from what each product was made.

Holds files against products.json, stores against their own digests, and every product and its
inputs against its provenance. Each damage is one sentence on the error output, and the exit
status is then 1. With --remove what is damaged is deleted, so that snakemake makes it anew.

Example: treadlight verify results
"""

import argparse
import hashlib
import json
import shutil
import sys
from pathlib import Path

from treadlight import store
from treadlight.commands.provenance import (
    changed_input,
    digest_of,
    is_hidden,
    provenance_files,
    read_provenance,
    with_followers,
)

# Beside the products, and never read by a stage.
_BESIDE = ("logs", "benchmarks")
_DIGITS = 12


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("results", type=Path, nargs="?", default=Path("results"))
    parser.add_argument(
        "--remove", action="store_true", help="delete damaged products; then run snakemake again"
    )


def run(args: argparse.Namespace) -> int:
    from treadlight.errors import ConfigError, plain

    if not (args.results / "products.json").is_file():
        raise ConfigError(
            f"{args.results / 'products.json'}: is not there. Run snakemake first, or name the"
            " folder of its results."
        )
    damaged = find_damage(args.results)
    for line in describe_provenance(args.results):
        print(plain(line))
    for product, reason in sorted(damaged.items()):
        print(plain(f"{args.results / product}: {reason}"), file=sys.stderr)
    removed = with_followers(args.results, set(damaged)) if args.remove and damaged else set()
    for product in removed:
        remove_product(args.results / product)
    if not damaged:
        print("Every file is as it was made.")
    elif args.remove:
        print(
            f"Removed {len(removed)} products, damaged or made from damaged ones. Run snakemake"
            " again: it makes them anew."
        )
    else:
        print(
            f"Damaged: {len(damaged)} products. Run 'treadlight verify --remove {args.results}',"
            " then snakemake again: it makes them anew."
        )
    return 1 if damaged else 0


def find_damage(results: Path) -> dict[str, str]:
    """What is wrong with each damaged product, by its path below the results."""
    found: dict[str, str] = {}
    for check in (_listed_files, _stores, _provenance):
        for product, reason in check(results).items():
            found.setdefault(product, reason)
    return found


def _listed_files(results: Path) -> dict[str, str]:
    """Files that are not as products.json says, and files that it does not know."""
    from treadlight.commands.status import contract_products, read_outcome
    from treadlight.errors import StoreError

    path = results / "products.json"
    try:
        content = store.read_json(path)
        files, refused = content["files"], content["refused"]
        store.write_json(copy := path.with_name(".products.json.verified"), content)
        same = copy.read_bytes() == path.read_bytes()
        copy.unlink()
        if not same or not isinstance(files, dict):
            raise StoreError("changed")
    except (StoreError, LookupError):
        return {"products.json": "is damaged."}
    found: dict[str, str] = {}
    for name, digest in files.items():
        product = _product_of(name)
        if not (results / name).is_file():
            found.setdefault(product, f"lacks {name}.")
        elif _sha256(results / name) != digest:
            found.setdefault(product, f"{name} differs from its digest in products.json.")
    try:
        outcome = read_outcome(results, results / "archive.json")
        if not found and outcome.refused != refused:
            found["products.json"] = "tells of other refusals than the products do."
        for _, product in contract_products(results, outcome.state):
            for file in _visible_files(results / product):
                name = file.relative_to(results).as_posix()
                if name not in files:
                    found.setdefault(product, f"holds {name}, which products.json does not list.")
    except (StoreError, LookupError, AttributeError, TypeError) as error:
        # Told of the damaged product itself where one is known.
        if not found:
            found["archive.json"] = f"does not fit the products ({error})."
    return found


def _stores(results: Path) -> dict[str, str]:
    """Stores that do not match their own digest, those between the stages too."""
    from treadlight.errors import StoreError

    found = {}
    for folder in _store_folders(results):
        try:
            store.check_content(folder)
        except (StoreError, OSError, ValueError, LookupError):
            found[folder.relative_to(results).as_posix()] = "does not match its own digest."
    return found


def _provenance(results: Path) -> dict[str, str]:
    """Products that are not what their provenance tells of, and provenance that is damaged."""
    found: dict[str, str] = {}
    for path in provenance_files(results):
        product = path.with_name(path.name.removesuffix(store.PROVENANCE_SUFFIX))
        name = product.relative_to(results).as_posix()
        content = read_provenance(path)
        if content is None:
            found[name] = f"has a damaged {path.name}."
        elif not content["product"].endswith(f"{product.parent.name}/{product.name}"):
            found[name] = f"has the provenance of {content['product']}."
        elif digest_of(product) != content["product_digest"]:
            found[name] = "is not what its provenance tells of."
        elif told := changed_input(results, content):
            found[name] = f"was made from another state of {told}."
    for folder in _store_folders(results):
        if not folder.with_name(folder.name + store.PROVENANCE_SUFFIX).is_file():
            name = folder.relative_to(results).as_posix()
            found.setdefault(name, "has no provenance.")
    for path in sorted(results.rglob("*")):
        if _is_single_product(results, path) and not _has_provenance(path):
            found.setdefault(path.relative_to(results).as_posix(), "has no provenance.")
    return found


def describe_provenance(results: Path) -> list[str]:
    """One line per product: the command, code, config and inputs that made it."""
    lines = []
    for path in provenance_files(results):
        content = read_provenance(path)
        if content is None:
            continue
        name = path.relative_to(results).as_posix().removesuffix(store.PROVENANCE_SUFFIX)
        inputs = ", ".join(f"{k} {str(v)[:_DIGITS]}" for k, v in content["inputs"].items())
        lines.append(
            f"{name}: by {content['command']} of treadlight {content['treadlight']}, code"
            f" {content['code_digest'][:_DIGITS] or 'unknown'}, config"
            f" {json.dumps(content['config'], sort_keys=True)}, from {inputs or 'the capture'}"
        )
    return lines


def remove_product(path: Path) -> None:
    """Delete a store or file with its provenance."""

    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
    store.provenance_of(path).unlink(missing_ok=True)


def _product_of(name: str) -> str:
    """The product that a file belongs to: its store's folder, or itself."""
    parts = name.split("/")
    for k, part in enumerate(parts):
        if part == "photometric.zarr" and len(parts) > k + 2:
            return "/".join(parts[: k + 2])
        if part.endswith(".zarr") and len(parts) > k + 1:
            return "/".join(parts[: k + 1])
    return name


def _store_folders(results: Path) -> list[Path]:
    stores = [path for path in results.rglob("*.zarr") if path.name != "photometric.zarr"]
    views = results.rglob("photometric.zarr/fov*")
    found = [*stores, *(view for view in views if view.is_dir())]
    return sorted(path for path in found if not is_hidden(results, path))


def _is_single_product(results: Path, path: Path) -> bool:
    """Whether a path is a product of one file."""
    parts = path.relative_to(results).parts
    return (
        len(parts) > 2
        and path.suffix in (".json", ".csv", ".html")
        and not path.name.endswith(store.PROVENANCE_SUFFIX)
        and not any(part.endswith(".zarr") for part in parts)
        and parts[0] not in _BESIDE
        and not is_hidden(results, path)
    )


def _has_provenance(path: Path) -> bool:
    return path.with_name(path.name + store.PROVENANCE_SUFFIX).is_file()


def _visible_files(path: Path) -> list[Path]:
    if not path.is_dir():
        return []
    files = (file for file in sorted(path.rglob("*")) if file.is_file())
    return [file for file in files if not is_hidden(path, file)]


def _sha256(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
