"""One browser for the room: starting one takes seconds of CPU time."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.hil.pages import chromium


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
