"""A wrong config is one plain sentence that names file, field and remedy."""

import dataclasses
import importlib
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from treadlight.errors import ConfigError
from treadlight.planning.config import complete_config, load_schema

ROOT = Path(__file__).resolve().parents[3]
SCHEMA = load_schema(ROOT / "schemas/config.schema.yaml")
SETTINGS = {
    "register_to_cylinder": ("treadlight.cylinder.settings", "CylinderSettings"),
    "photometry": ("treadlight.photometric.settings", "PhotometrySettings"),
    "integrate": ("treadlight.integrate.settings", "IntegrateSettings"),
    "wear": ("treadlight.wear.settings", "WearSettings"),
}


@pytest.fixture
def archive(tmp_path):
    (tmp_path / "archive").mkdir()
    return {"archive": str(tmp_path / "archive"), "results": str(tmp_path / "results")}


def refusal(config) -> str:
    with pytest.raises(ConfigError) as caught:
        complete_config(config, SCHEMA, "config.yaml")
    return str(caught.value)


def test_defaults_are_filled_in(archive):
    complete = complete_config(archive, SCHEMA, "config.yaml")
    assert complete["include"] == ["*"]
    assert complete["integrate"]["held_out_every"] == 10
    assert archive == {key: archive[key] for key in ("archive", "results")}


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (
            {"integrate": {"held_out_evry": 3}},
            "config.yaml: 'integrate.held_out_evry' is no key of the config."
            " Did you mean 'held_out_every'?",
        ),
        (
            {"integrate": {"held_out_every": "often"}},
            "config.yaml: 'integrate.held_out_every' is 'often'."
            " It must be a whole number, at least 0.",
        ),
        (
            {"integrate": {"held_out_every": -1}},
            "config.yaml: 'integrate.held_out_every' is -1. It must be a whole number, at least 0.",
        ),
        (
            {"include": "t7*"},
            "config.yaml: 'include' is 't7*'. It must be a list.",
        ),
        (
            {"passes": 0},
            "config.yaml: 'passes' is 0. It must be a whole number, at least 1, at most 5.",
        ),
        ({"archive": ""}, "config.yaml: 'archive' is ''. It must be a text that is not empty."),
    ],
)
def test_a_wrong_key_type_or_range_is_named_with_its_remedy(archive, change, sentence):
    assert refusal(archive | change) == sentence


def test_an_archive_that_is_not_there_is_refused(archive, tmp_path):
    archive["archive"] = str(tmp_path / "nowhere")
    assert refusal(archive).startswith(f"config.yaml: 'archive' is '{tmp_path / 'nowhere'}'")


def test_results_inside_the_archive_are_refused(archive):
    archive["results"] = archive["archive"] + "/results"
    assert "inside the archive" in refusal(archive)


def test_a_missing_archive_key_is_named():
    assert refusal({"results": "results"}) == "config.yaml: 'archive' is missing. Give it."


@given(
    st.recursive(
        st.none() | st.booleans() | st.integers() | st.text(max_size=5),
        lambda inner: (
            st.lists(inner, max_size=2)
            | st.dictionaries(st.sampled_from([*SCHEMA["properties"], "x"]), inner, max_size=3)
        ),
        max_leaves=6,
    )
)
def test_any_config_is_completed_or_refused_in_one_sentence(config):
    said = []
    try:
        complete_config(config, SCHEMA, "config.yaml")
    except ConfigError as error:
        said.append(str(error))
    assert [s for s in said if "\n" in s or not s.startswith("config.yaml: ")] == []


@pytest.mark.parametrize("section", SETTINGS)
def test_schema_and_settings_agree_in_keys_and_defaults(section):
    module, name = SETTINGS[section]
    settings = getattr(importlib.import_module(module), name)
    fields = {field.name: field.default for field in dataclasses.fields(settings)}
    properties = SCHEMA["properties"][section]["properties"]
    assert {key: part["default"] for key, part in properties.items()} == fields


def test_every_key_of_the_schema_says_what_it_means():
    def undocumented(schema, path=""):
        for key, part in schema.get("properties", {}).items():
            if "description" not in part:
                yield f"{path}{key}"
            yield from undocumented(part, f"{path}{key}.")

    assert list(undocumented(SCHEMA)) == []


def test_every_key_is_explained_in_the_config_readme():
    text = (ROOT / "config/README.md").read_text()
    sections = SCHEMA["properties"]
    keys = [
        f"{name}.{key}" if part.get("properties") else name
        for name, part in sections.items()
        for key in (part.get("properties") or {name: None})
    ]
    assert [key for key in keys if f"`{key}`" not in text] == []


def test_the_shipped_config_satisfies_its_schema(tmp_path):
    config = yaml.safe_load((ROOT / "config/config.yaml").read_text())
    config["archive"] = str(tmp_path)
    config["results"] = str(tmp_path.parent / "results")
    assert complete_config(config, SCHEMA, "config.yaml")["passes"] >= 1
