"""Fixtures that all tests share."""

import os
from pathlib import Path

import numpy as np
import pytest

from treadlight.cli import kernel_cache

# Before any test module imports numba.
os.environ.setdefault("NUMBA_CACHE_DIR", str(kernel_cache()))

ROOT = Path(__file__).resolve().parents[1]
SHARED = ROOT.parent / "shared"


def pytest_collection_modifyitems(config, items):
    """Without the shared data its tests are left out, and their number is said; never quietly."""
    # What takes longest starts first, so that no core waits for it at the end.
    items.sort(key=lambda item: item.path.parent.name != "workflow")
    marked = [item for item in items if item.get_closest_marker("shared")]
    if not marked or SHARED.is_dir():
        return
    if os.environ.get("REQUIRE_SHARED") == "1":
        raise pytest.UsageError(
            f"REQUIRE_SHARED=1, but there is no {SHARED.name}/ beside the project."
        )
    items[:] = [item for item in items if item not in marked]
    config.hook.pytest_deselected(items=marked)
    config.stash[_LEFT_OUT] = len(marked)


_LEFT_OUT = pytest.StashKey[int]()


def pytest_terminal_summary(terminalreporter, config):
    count = config.stash.get(_LEFT_OUT, 0)
    if count:
        terminalreporter.write_line(
            f"{count} tests on shared data left out: there is no ../shared."
        )


@pytest.fixture
def rng():
    return np.random.default_rng(20261122)


@pytest.fixture(scope="session")
def sample_archive() -> Path:
    return SHARED / "captures" / "sample"


@pytest.fixture(scope="session")
def shared_real() -> Path:
    return SHARED / "real"
