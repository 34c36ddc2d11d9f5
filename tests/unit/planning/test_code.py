"""The code digest changes with what a stage runs, and with nothing else."""

import shutil
from pathlib import Path

import pytest

import treadlight
from treadlight.planning.code import code_digest

STAGE = "treadlight.commands.triangulate"


@pytest.fixture
def package(tmp_path):
    copy = tmp_path / "treadlight"
    shutil.copytree(
        Path(treadlight.__file__).parent, copy, ignore=shutil.ignore_patterns("__pycache__")
    )
    return copy


def append(path: Path, text: str) -> None:
    path.write_text(path.read_text() + text)


def test_a_comment_or_a_docstring_changes_no_digest(package):
    before = code_digest(STAGE, package)
    module = package / "geometry" / "plane.py"
    append(module, "\n# A remark.\n")
    module.write_text(module.read_text().replace('"""Planes and', '"""All planes and'))
    assert code_digest(STAGE, package) == before


def test_a_statement_in_an_imported_module_changes_the_digest(package):
    before = code_digest(STAGE, package)
    append(package / "geometry" / "plane.py", "\nEXTRA = 1\n")
    assert code_digest(STAGE, package) != before


def test_a_module_of_another_stage_changes_no_digest(package):
    before = code_digest(STAGE, package)
    append(package / "wear" / "alignment.py", "\nEXTRA = 1\n")
    assert code_digest(STAGE, package) == before
    assert code_digest("treadlight.commands.wear", package) != code_digest(
        "treadlight.commands.wear"
    )


def test_a_new_version_of_the_package_alone_changes_no_digest(package):
    before = code_digest(STAGE, package)
    append(package / "__init__.py", '\n__version__ = "9.9.9"\n')
    assert code_digest(STAGE, package) == before


def test_the_place_of_the_package_does_not_count(package):
    assert code_digest(STAGE, package) == code_digest(STAGE)


def test_a_module_that_is_not_there_is_no_silent_constant():
    with pytest.raises(ModuleNotFoundError):
        code_digest("treadlight.commands.nothing")
