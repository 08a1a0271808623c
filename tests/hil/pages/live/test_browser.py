"""The live page in a real browser, as a person uses it: watched, held, stepped, changed, begun anew; then the log says so."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from hil.log.read import read_run
from hil.session.replay.recorded import changes_of
from hil.session.replay.replay import verify
from tests.hil.pages import chromium
from tests.hil.pages.live.test_live import Page, asked
from tests.waiting import until

pytestmark = pytest.mark.chromium

BADGE = "document.querySelector('.run .badge')?.innerText"
DRAFT = "document.querySelector('.draft')?.innerText"
KEY = "document.body.dispatchEvent(new KeyboardEvent('keydown', {{key: '{}', bubbles: true}}))"
INK = """[...document.querySelectorAll('.scope canvas, .top canvas')].map(c => {
  const d = c.getContext('2d').getImageData(0, 0, c.width, c.height).data;
  let n = 0; for (let i = 3; i < d.length; i += 4) n += d[i] > 0; return n; })"""


def choose(label: str, value: str) -> str:
    return (f"(() => {{ const s = document.querySelector('[aria-label=\"{label}\"]'); s.value = '{value}'; "
            "s.dispatchEvent(new Event('input')); s.dispatchEvent(new Event('change')); return s.value; })()")  # fmt: skip


def shows(browser: chromium.Page, expression: str, part: str) -> None:
    def there() -> bool:
        try:
            return part in str(browser.evaluate(expression))
        except RuntimeError as error:  # a run that begins anew is a new page
            if "navigated" not in str(error):
                raise
            return False

    until(there, f"{part!r} in {expression}")


@pytest.fixture
def page(tmp_path: Path, composer: None) -> Any:
    page = Page(tmp_path, [asked(tmp_path, "dc-motor-hinf", [], ["duration=6000"], paused=True)])  # it ends in no test
    page.begin()
    yield page
    page.end()


def test_a_person_watches_holds_steps_and_makes_the_network_worse(page: Page, browser: chromium.Page) -> None:
    browser.open(page.url)
    shows(browser, BADGE, "stable")
    browser.evaluate(KEY.format("."))
    until(lambda: page.view()["slots"] == 1, "one slot")
    browser.evaluate("(s => { s.value = '20'; s.dispatchEvent(new Event('change')); })(document.getElementById('speed'))")
    browser.evaluate(KEY.format(" "))
    until(lambda: page.view()["slots"] > 60, "the run to go on")
    shows(browser, "document.getElementById('pause').textContent", "Pause")  # the key does what the button shows
    browser.evaluate(KEY.format(" "))
    until(lambda: page.view()["status"] == "paused", "the run to pause")
    held = page.view()["slots"]
    shows(browser, "document.getElementById('status').innerText", "paused")
    assert all(n > 500 for n in browser.evaluate(INK)), "every scope and the device are drawn"

    assert browser.evaluate(choose("Loss, share of packets", "0.8")) == "0.8"
    shows(browser, DRAFT, "not stable")
    shows(browser, "document.querySelector('.run .badge').className", "good")
    browser.evaluate(KEY.format("Enter"))
    shows(browser, DRAFT, f"acts from slot {held}")
    shows(browser, "document.querySelector('.run .badge').className", "bad")
    assert "(limit 1)" in str(browser.evaluate(BADGE))
    browser.evaluate(choose("drag the reference of angle", "1.5"))
    shows(browser, DRAFT, "reference: acts from slot")
    browser.evaluate("document.getElementById('push').click()")
    shows(browser, DRAFT, "disturbance: acts from slot")
    browser.evaluate(choose("Preset", "always late"))  # a law without a matrix: one line, and no button
    assert browser.evaluate("document.querySelector('.heat').offsetHeight") < 40
    assert browser.evaluate("document.getElementById('check-matrix').offsetParent === null")
    browser.evaluate(choose("Preset", "as it was"))
    shows(browser, DRAFT, "stable")
    browser.evaluate("document.querySelector('.heat input').value = '0.9'; document.getElementById('check-matrix').click()")
    shows(browser, DRAFT, "network.ca.law")
    shows(browser, "document.querySelector('.draft').className", "bad")
    page.wish(do="step", slots=3)
    until(lambda: page.view()["slots"] == held + 3, "three slots")
    browser.evaluate("document.getElementById('seed').value = '3'; document.getElementById('restart').click()")
    shows(browser, "window.hilLive?.runs?.[0].about.seed", "3")
    assert browser.problems == []
    assert {url.split("?")[0].split("/")[2] for url in browser.requests} <= {f"127.0.0.1:{page.port}", ","}
    page.end()
    first, second = page.sessions
    run = read_run(Path(first.summary["log"]["path"]))
    assert [(k, path) for k, path, _ in changes_of(run)] == [
        (held, "network.ca.law"), (held, "reference"), (held, "disturbance"), (held + 3, "end")
    ]  # fmt: skip
    assert verify(run).likeness == "same bits" and second.summary["seed"] == 3


def test_the_slider_of_a_reference_follows_the_run_and_not_over_a_hand(page: Page, browser: chromium.Page) -> None:
    """Whoever changes one of two references sends the other as its slider shows it."""
    box = "document.querySelector('[aria-label=\"reference of angle, rad\"]')"
    browser.open(page.url)
    shows(browser, BADGE, "stable")
    page.wish(do="step", slots=30)  # the file steps to 3 rad at 1 s, slot 20
    until(lambda: browser.evaluate(f"{box}.value") == "3", "the slider at the reference")
    browser.evaluate(f"{box}.focus(), {box}.value = 1.25, 0")
    page.wish(do="apply", path="reference", value=[2.0])
    page.settled("armed")
    page.wish(do="step", slots=100)
    until(lambda: browser.evaluate("window.hilLive.runs[0].now.slots") == 130, "the page")
    assert browser.evaluate(f"{box}.value") == "1.25", "what is being typed stays"
    browser.evaluate(f"{box}.blur(), 0")
    until(lambda: browser.evaluate(f"{box}.value") == "2", "the slider at the reference")


def test_the_matrix_is_that_of_the_law_that_acts_whichever_tab_changed_it(page: Page, browser: chromium.Page) -> None:
    heat = "[...document.querySelectorAll('.heat input')].map((box) => box.value).join()"
    browser.open(page.url)
    shows(browser, BADGE, "stable")
    first = browser.evaluate(heat)
    page.wish(do="apply", path="network.ca.law", value={"kind": "markov", "matrix": [[0.25, 0.75], [0.5, 0.5]]})
    page.settled("armed")
    page.wish(do="step", slots=3)
    until(lambda: browser.evaluate(heat) == "0.25,0.75,0.5,0.5", "the matrix of the other tab's law")
    browser.evaluate(choose("Direction", "sc"))
    assert browser.evaluate(heat) != "0.25,0.75,0.5,0.5"
    browser.evaluate(choose("Direction", "ca"))
    assert browser.evaluate(heat) == "0.25,0.75,0.5,0.5"
    number = page.view()["draft"]["number"]
    browser.evaluate("document.getElementById('revert').click()")
    until(lambda: page.view()["draft"]["number"] > number and page.view()["draft"]["state"] == "armed", "the old law")
    page.wish(do="step", slots=3)
    until(lambda: browser.evaluate(heat) == first, "the first matrix")
    assert browser.problems == []


def test_a_trigger_holds_the_picture_and_cursors_measure_it(page: Page, browser: chromium.Page) -> None:
    """Who has no token only looks, on a phone too; who has one arms."""
    browser.size(390, 844)
    browser.colour_scheme("dark")
    browser.open(page.url.split("?")[0])
    shows(browser, BADGE, "stable")
    assert browser.evaluate("['pace', 'act', 'pace-keys', 'act-keys'].every((id) => document.getElementById(id).hidden)")
    assert browser.evaluate("document.documentElement.scrollWidth <= innerWidth"), "nothing is wider than a phone"
    browser.size(1400, 1000)
    browser.open(page.url)
    shows(browser, BADGE, "stable")
    browser.evaluate(choose("Trigger on", "1") + "; " + choose("Level", "1.5"))
    browser.evaluate(KEY.format("t"))
    page.wish(do="step", slots=300)
    until(lambda: page.view()["slots"] == 300, "the step of the reference")
    until(lambda: browser.evaluate("window.hilLive.table.triggered()") is not None, "the trigger")
    assert browser.evaluate("window.hilLive.table.triggered()") == pytest.approx(1.0, abs=0.06), "where the reference steps"
    browser.evaluate("window.hilLive.view.pointer = 0.5; window.hilLive.table.cursor(0); "
                     "window.hilLive.view.pointer = 3.0; window.hilLive.table.cursor(1)")  # fmt: skip
    rows = "[...document.querySelectorAll('.measured tr')].map(r => r.innerText)"
    shows(browser, rows, "2.5")
    reference = next(row for row in browser.evaluate(rows) if row.startswith("reference angle"))
    assert reference.split("\t")[1:] == ["0", "3", "3"]
    assert browser.problems == []


def test_the_mouse_is_the_hand(tmp_path: Path, browser: chromium.Page) -> None:
    """It is pressed on the picture of the wall and drawn into it: the hand leads the device there, and the log runs again."""
    page = Page(tmp_path, [asked(tmp_path, "omni-1khz", [], paused=True)])
    page.begin()
    try:
        browser.open(page.url)
        shows(browser, BADGE, "passive")
        box = "(r => [r.left, r.top + r.height / 2, r.width])(document.querySelector('.top canvas').getBoundingClientRect())"
        x, y, wide = browser.evaluate(box)
        browser.mouse("mousePressed", x + 0.25 * wide, y)
        until(lambda: "reach" in page.view()["draft"]["path"], "the hand")
        pressed = page.view()["draft"]["number"]
        browser.mouse("mouseMoved", x + 0.75 * wide, y)
        until(lambda: page.view()["draft"]["number"] > pressed, "the move")
        until(lambda: page.view()["draft"]["state"] == "armed", "the move in the run")
        browser.mouse("mouseReleased", x + 0.75 * wide, y)
        page.wish(do="step", slots=400)
        until(lambda: page.view()["slots"] == 400, "400 slots")
        until(lambda: browser.evaluate("window.hilLive.runs[0].now.slots") == 400, "the page")
        assert browser.problems == []
    finally:
        page.end()
    run = read_run(Path(page.sessions[0].summary["log"]["path"]))
    said = [value for _, path, value in changes_of(run) if path == "plant.hand.reach_m"]
    assert said[0] == pytest.approx(-0.015, abs=5e-4) and said[-1] == pytest.approx(0.015, abs=5e-4)
    assert run.arrays["/plant/state"]["position"][-1] > 0.001
    assert verify(run).likeness == "same bits"


def test_under_one_hand_the_certified_wall_is_calm_and_that_of_theorem_6_1_gives_energy(
    tmp_path: Path, browser: chromium.Page
) -> None:
    """The energy of the passivity observer stands beside each device in words; the safety ends the second run."""
    hand = ["allow_uncertified=true", "plant.hand={damping_n_s_per_m=2,stiffness_n_per_m=20}"]
    page = Page(tmp_path, [asked(tmp_path, name, [], hand, paused=True) for name in ("omni-push", "omni-theorem61")])
    page.begin()
    try:
        browser.open(page.url)
        shows(browser, BADGE, "passive")
        page.wish(do="apply", path="plant.hand.reach_m", value=0.02)
        page.settled("armed")
        page.wish(do="step", slots=60)
        until(lambda: page.view(side=0)["slots"] == 60, "60 slots")
        words = "window.hilLive.runs.map(r => r.values.textContent)"
        shows(browser, f"{words}[0]", "the wall has given no energy: passive so far")
        shows(browser, f"{words}[1]", "mJ more than damping took: not passive")
        assert "Reference" not in browser.evaluate("[...document.querySelectorAll('legend')].map(each => each.textContent)")
        browser.screenshot(tmp_path / "wall.png")
        assert browser.problems == []
    finally:
        page.end()


FOCUS = """(e => [e.tagName, e.getAttribute('aria-label') || e.innerText || e.labels?.[0]?.innerText || e.title || '',
  getComputedStyle(e).outlineStyle])(document.activeElement)"""


def test_the_keyboard_alone_reaches_every_control_and_applies_a_change(page: Page, browser: chromium.Page) -> None:
    """Each control has a name for a screen reader and an outline where it has the focus; Apply takes it, and gives it back."""

    def press(key: str, number: int, text: str = "") -> None:
        for kind in ("keyDown", "keyUp"):
            reported = {"text": text} if text and kind == "keyDown" else {}
            browser.command("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=number, **reported)

    browser.open(page.url)
    shows(browser, BADGE, "stable")
    seen: list[list[str]] = []
    while not (seen and seen[-1][1].startswith("Loss")):
        press("Tab", 9)
        seen.append(browser.evaluate(FOCUS))
        assert len(seen) < 60 and seen[-1][1] and seen[-1][2] != "none", seen[-1]
    press("ArrowRight", 39)
    until(lambda: page.view()["draft"]["state"] == "ready", "the certificate")
    press("Enter", 13, "\r")
    until(lambda: page.view()["draft"]["state"] == "armed", "the change")
    browser.evaluate("(e => { e.focus(); e.select(); })(document.querySelector('[aria-label^=\"reference of\"]'))")
    browser.command("Input.insertText", text="1.5")
    press("Enter", 13, "\r")
    until(lambda: page.view()["draft"]["path"] == "reference", "a reference that is typed")
    slots = page.view()["slots"]
    browser.evaluate("document.getElementById('pause').focus()")
    press(".", 190, ".")
    until(lambda: page.view()["slots"] == slots + 1, "a step, with the focus on a button")
    freeze = "[...document.querySelectorAll('button')].find(b => b.innerText === 'Freeze')"
    for key, number, text, left in (("Escape", 27, "", "ready"), ("Enter", 13, "\r", "armed")):
        browser.evaluate(f"{freeze}.focus()")
        press("Enter", 13, "\r")
        shows(browser, "document.activeElement.id", "apply")
        press(key, number, text)
        shows(browser, "document.activeElement.innerText", "Freeze")
        until(lambda left=left: page.view()["draft"]["state"] == left, left)
        until(lambda: browser.evaluate("document.getElementById('apply')") is None, "the end of the button")


def test_a_scope_names_an_input_and_its_disturbance_and_counts_no_slot_before_the_first_packet(
    page: Page, browser: chromium.Page
) -> None:
    browser.open(page.url)
    page.wish(do="step", slots=40)
    shows(browser, "document.querySelector('main')?.innerText || document.body.innerText", "superseded")
    shows(browser, "[...document.querySelectorAll('.u-legend')].map(each => each.textContent).join()", "disturbance voltage")
    said = str(browser.evaluate("document.body.innerText"))
    assert "w_voltage" not in said and "none-yet" not in said
