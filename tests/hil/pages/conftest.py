"""One browser for the room: starting one takes a second of CPU time."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from hil.compose.changed import changed
from hil.pages.live import desk
from hil.pages.live.desk import Composer
from hil.pages.sections import theory
from hil.rig.loop import Loop
from tests.hil.pages import chromium


@pytest.fixture
def short_theory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Theory of the first slots, without more runs: it is looked at in its own tests and in the whole pages."""
    monkeypatch.setattr(theory, "MOST_SLOTS", 40)
    monkeypatch.setattr(theory, "RUNS", 0)


@pytest.fixture(scope="session")
def one_browser() -> Iterator[chromium.Page]:
    with chromium.Page() as browser:
        yield browser


@pytest.fixture
def browser(one_browser: chromium.Page) -> Iterator[chromium.Page]:
    """The browser of the room, as if it were new."""
    one_browser.size(1400, 1000)
    one_browser.colour_scheme("light")
    yield one_browser
    if any(url.startswith("http") for url in one_browser.requests):  # it asks a server that ends
        one_browser.open("about:blank")
    one_browser.problems.clear()
    one_browser.requests.clear()


class Here(Composer):
    """Composes in the process of the test: one of its own starts for half a second of CPU time; some tests start it."""

    def changed(self, loop: Loop, k: int, path: str, value: object) -> Loop:
        return changed(loop, k, path, value)


@pytest.fixture
def composer(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the pages of a test compose in its process."""
    monkeypatch.setattr(desk, "Composer", Here)
