"""A digest of the code that a stage runs, so that a change reruns that stage and no other."""

import ast
import hashlib
import importlib.metadata
import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path

PACKAGE = "treadlight"
_ROOT = Path(__file__).resolve().parents[1]


def code_digest(module: str, root: Path = _ROOT) -> str:
    """SHA-256 over a module, what it imports from the package, and third-party versions.

    Comments, docstrings and layout do not count: the syntax trees are hashed. Scripts for the
    browser that lie in a package count with it, as they stand.

    Parameters
    ----------
    module : str
        Dotted name, ``treadlight...``.
    root : Path
        The package's folder.

    Raises
    ------
    ModuleNotFoundError
        There is no such module.
    """
    seen: set[Path] = set()
    versions: set[str] = set()
    waiting = _files_of(module, root)
    if not (root / "/".join(module.split(".")[1:])).with_suffix(".py").is_file():
        raise ModuleNotFoundError(f"There is no module {module}.")
    while waiting:
        path = waiting.pop()
        if path in seen:
            continue
        seen.add(path)
        for name in _parsed(path)[1]:
            if name.partition(".")[0] == PACKAGE:
                waiting.extend(_files_of(name, root))
            else:
                versions.add(_version(name.partition(".")[0]))
    digest = hashlib.sha256()
    for path in sorted(seen):
        digest.update(f"{path.relative_to(root).as_posix()}\0{_parsed(path)[0]}\0".encode())
    for script in sorted(s for path in seen for s in _scripts_beside(path)):
        digest.update(f"{script.relative_to(root).as_posix()}\0".encode() + script.read_bytes())
    digest.update("\n".join(sorted(versions)).encode())
    return digest.hexdigest()


def _files_of(module: str, root: Path) -> list[Path]:
    """Files that importing a dotted name of the package runs, its root package left out.

    The name may end in an attribute of a module: the parts that are files count. The root
    holds the version alone, which must not rerun everything.
    """
    files = []
    folder = root
    for part in module.split(".")[1:]:
        if (folder / part / "__init__.py").is_file():
            folder = folder / part
            files.append(folder / "__init__.py")
        elif (folder / f"{part}.py").is_file():
            files.append(folder / f"{part}.py")
            break
        else:
            break
    return files


def _scripts_beside(path: Path) -> Iterable[Path]:
    return path.parent.glob("*.js") if path.name == "__init__.py" else ()


def _parsed(path: Path) -> tuple[str, tuple[str, ...]]:
    return _parse(path, path.stat().st_mtime_ns)


@cache
def _parse(path: Path, mtime_ns: int) -> tuple[str, tuple[str, ...]]:
    """The dump of a file's syntax tree without docstrings, and the names that it imports."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    names: list[str] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names.extend(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            # `from package import sub` may name a module: both readings are followed.
            names.extend(f"{node.module}.{alias.name}" for alias in node.names)
        if isinstance(node, ast.Module | ast.FunctionDef | ast.ClassDef):
            _drop_docstring(node)
    return ast.dump(tree), tuple(names)


def _drop_docstring(node: ast.Module | ast.FunctionDef | ast.ClassDef) -> None:
    first = node.body[0] if node.body else None
    if (
        isinstance(first, ast.Expr)
        and isinstance(first.value, ast.Constant)
        and isinstance(first.value.value, str)
    ):
        node.body = node.body[1:]


@cache
def _distributions() -> dict[str, list[str]]:
    return dict(importlib.metadata.packages_distributions())


@cache
def _version(name: str) -> str:
    """Distribution and version behind a third-party import; empty for the standard library."""
    if name in sys.stdlib_module_names:
        return ""
    found = sorted(set(_distributions().get(name, [])))
    return " ".join(f"{each} {importlib.metadata.version(each)}" for each in found)
