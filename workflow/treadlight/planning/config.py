"""The config held against its schema: every fault is one plain sentence."""

import copy
import difflib
from pathlib import Path
from typing import Any, cast

import jsonschema
import yaml
from jsonschema.exceptions import ValidationError, best_match

from treadlight.errors import ConfigError


def load_schema(path: Path) -> dict[str, Any]:
    """A JSON schema written in YAML."""
    return yaml.safe_load(path.read_text(encoding="utf-8"))


def complete_config(config: dict[str, Any], schema: dict[str, Any], source: str) -> dict[str, Any]:
    """The config with all defaults filled in.

    Parameters
    ----------
    config : as the user wrote it, with what the command line added.
    schema : of the config.
    source : the config file's name, for messages.

    Raises
    ------
    ConfigError
        A key is unknown, of the wrong type or out of range, or the archive is not there.
    """
    error = best_match(jsonschema.Draft202012Validator(schema).iter_errors(config))
    if error is not None:
        raise ConfigError(f"{source}: {_sentence(error)}")
    complete = _with_defaults(copy.deepcopy(config), schema)
    archive = Path(complete["archive"])
    if not archive.is_dir():
        raise ConfigError(
            f"{source}: 'archive' is {str(archive)!r}, which is no folder. Name the folder that"
            " holds the captures, or make the demo archive with 'make demo'."
        )
    _check_results(Path(complete["results"]), archive, source)
    return complete


def _check_results(results: Path, archive: Path, source: str) -> None:
    if results.resolve().is_relative_to(archive.resolve()):
        raise ConfigError(
            f"{source}: 'results' is {str(results)!r}, which lies inside the archive. Captures are"
            " only read: name a folder outside."
        )
    if results.exists() and not results.is_dir():
        raise ConfigError(
            f"{source}: 'results' is {str(results)!r}, which is a file. Name a folder."
        )


def _sentence(error: ValidationError) -> str:
    # The schema of a failed keyword is always a mapping; the library's types allow more.
    part = cast(dict[str, Any], error.schema)
    given = cast(dict[str, Any], error.instance)
    name = ".".join(str(part) for part in error.absolute_path)
    if error.validator == "additionalProperties":
        known = sorted(part["properties"])
        unknown = sorted(set(given) - set(known))[0]
        close = difflib.get_close_matches(unknown, known, n=1)
        remedy = f"Did you mean '{close[0]}'?" if close else f"Known are: {', '.join(known)}."
        return f"'{_join(name, unknown)}' is no key of the config. {remedy}"
    if error.validator == "required":
        missing = next(key for key in part["required"] if key not in given)
        return f"'{_join(name, missing)}' is missing. Give it."
    if not name:
        return "the config must be a mapping of names to values."
    return f"'{name}' is {error.instance!r}. It must be {_requirement(part)}."


def _join(name: str, key: str) -> str:
    return f"{name}.{key}" if name else str(key)


_TYPES = {
    "integer": "a whole number",
    "number": "a number",
    "string": "a text",
    "boolean": "true or false",
    "array": "a list",
    "object": "a mapping",
    "null": "null",
}


def _requirement(schema: dict[str, Any]) -> str:
    if "enum" in schema:
        return "one of " + ", ".join(str(option) for option in schema["enum"])
    types = schema.get("type", "string")
    types = [types] if isinstance(types, str) else types
    text = " or ".join(_TYPES[name] for name in types)
    for key, words in (
        ("minimum", "at least"),
        ("exclusiveMinimum", "above"),
        ("maximum", "at most"),
        ("exclusiveMaximum", "below"),
    ):
        if key in schema:
            text += f", {words} {schema[key]}"
    if "minLength" in schema:
        text += " that is not empty"
    return text


def _with_defaults(config: dict[str, Any], schema: dict[str, Any]) -> dict[str, Any]:
    for key, part in schema.get("properties", {}).items():
        if part.get("type") == "object" and "properties" in part:
            config[key] = _with_defaults(config.get(key) or {}, part)
        elif key not in config and "default" in part:
            config[key] = copy.deepcopy(part["default"])
    return config
