"""One browser and one composing process for the room: starting a browser takes seconds of CPU time."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from hil.pages.live import desk
from hil.pages.live.desk import Composer
from hil.pages.sections import theory
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
    one_browser.open("about:blank")
    one_browser.problems.clear()
    one_browser.requests.clear()


class Kept(Composer):
    """A process that composes for one test after another."""

    def close(self) -> None:
        """It goes on, for the next test."""


@pytest.fixture(scope="session")
def one_composer() -> Iterator[Composer]:
    """Each starts for half a second of CPU time; that it ends with its page is looked at where a test starts its own."""
    kept = Kept()
    kept._start()  # here, as it ends with the thread that starts it
    yield kept
    Composer.close(kept)


@pytest.fixture
def composer(one_composer: Composer, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the pages of a test have the process of the room."""
    monkeypatch.setattr(desk, "Composer", lambda: one_composer)
