"""The pages of a small tire in the system's Chromium, without network."""

import shutil
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

_ROOT = Path(__file__).resolve().parents[2]
_BROWSERS = ("chromium", "chromium-browser", "google-chrome")
# WebGL without a graphics card.
_FLAGS = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


@pytest.fixture(scope="session")
def chromium():
    from playwright.sync_api import sync_playwright

    path = next(filter(None, map(shutil.which, _BROWSERS)))
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=_FLAGS)
        yield browser
        browser.close()


@pytest.fixture(scope="session")
def screenshots():
    folder = _ROOT / "build/browser"
    folder.mkdir(parents=True, exist_ok=True)
    return folder


@dataclass
class Watched:
    """Opens files of the results in windows of some width, once each; notes what goes wrong."""

    browser: Any
    results: Path
    pages: dict[tuple[str, int], Any] = field(default_factory=dict)
    troubles: list[str] = field(default_factory=list)

    def __call__(self, path: str, width: int) -> Any:
        if (path, width) not in self.pages:
            self.pages[path, width] = self._open(path, width)
        return self.pages[path, width]

    def _open(self, path: str, width: int) -> Any:
        page = self.browser.new_context(
            viewport={"width": width, "height": 900}, offline=True
        ).new_page()
        page.on("console", lambda m: self.troubles.append(m.text) if m.type == "error" else None)
        page.on("pageerror", lambda error: self.troubles.append(str(error)))
        page.on("requestfailed", lambda request: self.troubles.append(request.url))
        page.goto((self.results / path).as_uri())
        return page


@pytest.fixture(scope="session")
def watched(chromium, worn_tire):
    return Watched(chromium, worn_tire)


@pytest.fixture
def open_page(watched):
    """See `Watched`; after each test nothing has gone wrong."""
    watched.troubles.clear()
    yield watched
    assert watched.troubles == []
