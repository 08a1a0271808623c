"""The pictures of README and guide, in Chromium: ``python -m tests.pictures FOLDER README.png``.

A report; and the live page, where what they show is done as the guide says it: a worse network, Apply, Push; one hand at two
walls; a phone that watches.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Final

import hil
from tests.hil.pages import chromium
from tests.hil.pages.live.test_live import Page, asked
from tests.waiting import until

COLOURS: Final = 256
WALLS: Final = ["allow_uncertified=true", "plant.hand={damping_n_s_per_m=2,stiffness_n_per_m=20}"]
LATE: Final = {"kind": "constant", "age": 1}


@contextmanager
def runs(names: tuple[str, ...], sets: list[str]) -> Iterator[Page]:
    """Give runs that are held at slot 0, with their page."""
    with tempfile.TemporaryDirectory() as folder:
        page = Page(Path(folder), [asked(Path(folder), name, [], sets, paused=True) for name in names])
        page.begin()
        try:
            yield page
        finally:
            page.end()


def step(page: Page, slots: int, side: int = 0) -> None:
    """Let every run go on for so many slots."""
    before = page.view(side=side)["slots"]
    page.wish(do="step", slots=slots)
    until(lambda: page.view(side=side)["slots"] == before + slots, "the slots")


def take(browser: chromium.Page, file: Path, height: int) -> None:
    """Write the upper part of what the browser shows, with few colours so that the file is small."""
    from PIL import Image

    browser.screenshot(file)
    image = Image.open(BytesIO(file.read_bytes())).convert("RGB")
    image = image.crop((0, 0, image.width, min(height, image.height)))
    image.quantize(COLOURS, dither=Image.Dither.NONE).save(file, optimize=True)


def shown(browser: chromium.Page, slots: int) -> None:
    """Wait until the page shows the newest slot."""
    until(lambda: browser.evaluate("window.hilLive?.runs?.[0]?.now?.slots") == slots, "the page")
    until(lambda: "?" not in str(browser.evaluate("document.querySelector('.run .badge')?.innerText")), "the certificate")
    browser.evaluate("new Promise(go => setTimeout(go, 600))")


def report(file: Path) -> None:
    """Write the upper part of a run's page."""
    with tempfile.TemporaryDirectory() as folder, chromium.Page(width=1400, height=900) as browser:
        page, *_ = hil.report(hil.run("dc-motor-hinf"), output=Path(folder) / "page.html")
        browser.open(page.as_uri())
        until(lambda: browser.evaluate("document.querySelectorAll('canvas').length") > 2, "the plots")
        browser.evaluate("new Promise(go => setTimeout(go, 600))")
        take(browser, file, 1330)


def main(folder: str, readme: str) -> int:
    """Write the pictures of the live page into a folder, and the one of a report."""
    to = Path(folder)
    report(Path(readme))
    with (
        runs(("dc-motor-local-fast", "dc-motor-hinf-fast"), ["allow_uncertified=true"]) as page,
        chromium.Page(width=1400, height=900) as browser, chromium.Page(width=390, height=800, dark=True) as phone,
    ):  # fmt: skip
        browser.open(page.url)
        phone.open(page.url.split("?")[0])
        step(page, 200)
        page.wish(do="apply", path="network.ca.law", value=LATE)
        page.settled("armed")
        page.wish(do="apply", path="disturbance", value={"value": [0.2], "samples": 2})
        page.settled("armed")
        step(page, 400)
        for each, name, height in ((browser, "live.png", 900), (phone, "live-phone.png", 800)):
            shown(each, page.view()["slots"])
            take(each, to / name, height)
    with runs(("omni-push", "omni-theorem61"), WALLS) as page, chromium.Page(width=1400, height=900) as browser:
        browser.open(page.url)
        page.wish(do="apply", path="plant.hand.reach_m", value=0.02)
        page.settled("armed")
        page.wish(do="step", slots=60)
        until(lambda: page.view()["slots"] == 60, "the slots")
        shown(browser, 60)
        take(browser, to / "live-walls.png", 900)
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
