"""Say what a results folder holds, what was refused, what is missing and what is stale.

Stale is what other code made, or what was made from products that have changed since; what a
changed config or new frames would renew, `snakemake --dry-run` tells. Exits 1 while anything is
refused, 0 otherwise.

Example: treadlight status results
"""

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# What is no store.
_FILES = (".json", ".csv", ".html")


@dataclass(frozen=True)
class Outcome:
    """What became of an archive.

    Attributes
    ----------
    state : dict
        archive.json: ``tires``, ``calibration_of``, ``calibrations``, ``refused``, ``warnings``.
    refused : dict of str to str
        Sentence by id of a calibration, capture or tire; also those left out when the archive
        was read.
    missing : list of str
        Products, relative to the results, that are not there.
    warnings : dict of str to list of str
        Sentences by id of a capture.
    """

    state: dict[str, Any]
    refused: dict[str, str]
    missing: list[str]
    warnings: dict[str, list[str]]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("results", type=Path, nargs="?", default=Path("results"))


def run(args: argparse.Namespace) -> int:
    from treadlight.errors import ConfigError

    state = args.results / "archive.json"
    if not state.is_file():
        raise ConfigError(
            f"{state}: is not there. Run snakemake first, or name the folder of its results."
        )
    outcome = read_outcome(args.results, state)
    print("\n".join([*describe(outcome), *describe_stale(find_stale(args.results))]))
    return 1 if outcome.refused else 0


def read_outcome(results: Path, state: Path) -> Outcome:
    """Look through the products that the results contract lists."""
    from treadlight import store

    content = store.read_json(state)
    refused = {str(name): str(why) for name, why in content["refused"].items()}
    missing = []
    for owner, product in contract_products(results, content):
        path = results / product
        root = path if path.suffix in _FILES else path / store.ROOT_METADATA
        if not root.is_file():
            missing.append(product)
        elif reason := store.refused_reason(path):
            refused.setdefault(owner, reason)
    return Outcome(content, refused, missing, _warnings(results, content))


def find_stale(results: Path) -> dict[str, str]:
    """Why a product is not what snakemake would make now, by its path below the results."""
    from functools import cache

    from treadlight import store
    from treadlight.commands import provenance
    from treadlight.commands.names import COMMANDS
    from treadlight.planning.code import code_digest

    code_now = cache(lambda module: code_digest(f"treadlight.commands.{module}"))
    found = {}
    for path in provenance.provenance_files(results):
        content = provenance.read_provenance(path)
        if content is None:
            continue
        name = path.relative_to(results).as_posix().removesuffix(store.PROVENANCE_SUFFIX)
        module = COMMANDS.get(content["command"])
        if told := provenance.changed_input(results, content):
            found[name] = f"{told} has changed since"
        elif module is None or content["code_digest"] not in ("", code_now(module)):
            found[name] = "made by other code"
    return found


def describe_stale(stale: dict[str, str]) -> list[str]:
    """Lines for people."""
    if not stale:
        return []
    return [
        "",
        f"Stale: {len(stale)} products, and what is made from them. Run snakemake to renew them.",
        *(f"  {name}: {why}" for name, why in sorted(stale.items())),
    ]


def _warnings(results: Path, state: dict[str, Any]) -> dict[str, list[str]]:
    """What was told of each capture when the archive was read, and by its stages."""
    from treadlight import store

    found = {}
    for names in state["tires"].values():
        for name in names:
            path = results / "captures" / name / "quality.json"
            quality = store.read_json(path) if path.is_file() else {}
            told = [state["warnings"].get(name), *(quality.get("warnings") or ())]
            found[name] = list(dict.fromkeys(str(sentence) for sentence in told if sentence))
    return found


def contract_products(results: Path, state: dict[str, Any]) -> list[tuple[str, str]]:
    """(id, path below the results) of every product of the contract but the page of the archive."""
    found = []
    for name in calibrations_of(state):
        folder = f"calibrations/{name}"
        found += [(name, f"{folder}/calibration.json"), (name, f"{folder}/illumination.zarr")]
    for names in state["tires"].values():
        for name in names:
            folder = f"captures/{name}"
            found.append((name, f"{folder}/laser.zarr"))
            found += [(name, f"{folder}/photometric.zarr/{v}") for v in _views(results / folder)]
            found += [(name, f"{folder}/profile.zarr"), (name, f"{folder}/quality.json")]
    for tire in state["tires"]:
        names = ("wear.zarr", "trend.csv", "report.html")
        found += [(f"tire {tire}", f"tires/{tire}/{name}") for name in names]
    return found


def _views(folder: Path) -> list[str]:
    """Names of a capture's views; before it was inspected, those that there are."""
    from treadlight import store

    path = folder / "inventory.json"
    inventory = store.read_json(path) if path.is_file() else {}
    if "views" in inventory:
        return [f"fov{view['view']:02d}" for view in inventory["views"]]
    return sorted(view.name for view in (folder / "photometric.zarr").glob("fov*"))


def calibrations_of(state: dict[str, Any]) -> list[str]:
    """Calibrations that the results hold, in order of id."""
    return sorted({*state.get("calibrations", ()), *state["calibration_of"].values()})


def describe(outcome: Outcome) -> list[str]:
    """Lines for people."""
    lines = []
    for tire, names in outcome.state["tires"].items():
        state = _state(f"tire {tire}", outcome)
        lines.append(f"Tire {tire}: {len(names)} captures{state}")
        for name in names:
            calibration = outcome.state["calibration_of"].get(name, "none")
            lines.append(f"  {name} (calibration {calibration}){_state(name, outcome)}")
            lines += [f"    Warning: {warning}" for warning in outcome.warnings.get(name, ())]
    if outcome.refused:
        lines += ["", f"Refused: {len(outcome.refused)}"]
        lines += [f"  {name}: {why}" for name, why in sorted(outcome.refused.items())]
    if outcome.missing:
        lines += ["", f"Missing: {len(outcome.missing)} products. Run snakemake to make them."]
        lines += [f"  {product}" for product in outcome.missing]
    if not outcome.refused and not outcome.missing:
        lines += ["", "Everything is there, nothing is refused."]
    return lines


def _state(name: str, outcome: Outcome) -> str:
    return ", refused" if name in outcome.refused else ""
