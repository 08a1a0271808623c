"""A run in real time that is changed while it goes on, by a script and on the page: the same changes at the same slots."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.compose import compose
from hil.compose.changed import changed
from hil.errors import ExperimentError
from hil.experiment import Experiment, load_experiment
from hil.log.read import read_run
from hil.log.topics import channels_of
from hil.pages.live import Side
from hil.pages.live.script import Scripted
from hil.pages.live.watch import RequestedRun as Watched
from hil.runtime.changes import Change
from hil.session import Session, run_session
from hil.session.replay.recorded import ChangeRequest, changes_of
from hil.session.replay.replay import verify
from tests.hil.pages.live.test_live import Page
from tests.waiting import children_of, until

pytestmark = pytest.mark.realtime

SETS = ["duration=20", "limits.watchdog_slots=1000", "allow_uncertified=true"]
ASKED: list[ChangeRequest] = [
    (0, "reference", [1.0]),
    (12, "network.ca.law", {"kind": "constant", "age": 1}),
    (14, "disturbance", {"value": [0.2], "samples": 5}),
    (16, "fault", {"kind": "corrupt", "for": 0.2, "link": "sc"}),
    (20, "reference", [0.5]),
    (40, "end", None),
]


def in_time(session: Callable[[int], Session]) -> Session:
    """Return a session in which no change came behind its slot, as one does that gets no processor for 0.1 s."""
    for number in range(10):
        found = session(number)
        if not any(event["kind"] == "change late" for event in found.run.events):
            return found
    raise AssertionError("in each of ten sessions a change came behind its slot")


@pytest.mark.parametrize("link", [f"can:hil:ch{os.getpid()}", "local:"], ids=["can-hil", "local"])
def test_a_script_changes_a_run_in_real_time_at_the_slots_of_virtual_time(tmp_path: Path, link: str) -> None:
    experiment = load_experiment("dc-motor-hinf", SETS)
    real = in_time(lambda number: run_session(
        experiment, clock="real", link=link, path=tmp_path / f"r{number}.mcap", onlooker=Scripted(ASKED, real=True)
    ))  # fmt: skip
    virtual = run_session(experiment, path=tmp_path / "v.mcap", onlooker=Scripted(ASKED))
    assert changes_of(real.run) == ASKED == changes_of(virtual.run) and real.summary["slots"] == 40
    late = real.summary["timing"]["first_late_slot"]
    end = 40 if late is None else late
    for topic, fields in (
        ("/plant/state", ("angle", "speed")), ("/actuator/applied", ("voltage", "d", "row", "w_voltage")),
        ("/reference", ("angle",)),
    ):  # fmt: skip
        for name in fields:
            np.testing.assert_array_equal(real.run.arrays[topic][name][:end], virtual.run.arrays[topic][name][:end])
    for side in ("/network/sc", "/network/ca"):
        a, b = (run.arrays[side][run.arrays[side]["mode"] >= 0] for run in (real.run, virtual.run))
        np.testing.assert_array_equal(a["mode"], b["mode"])
    if late is None:
        assert verify(real.run).likeness == "same bits"


@pytest.mark.parametrize(
    ("path", "value", "why"),
    [
        ("controller", {"kind": "h2"}, "controller: does not change in real time: the controller is a process of its own"),
        ("plant.gain", 150.0, "plant.gain: does not change in real time: the plant tabulates other equations"),
        ("limits.input", [1.0], "limits.input: does not change in real time"),
    ],
)
def test_what_does_not_change_in_real_time_is_refused_before_anything_runs(
    tmp_path: Path, path: str, value: Any, why: str
) -> None:  # fmt: skip
    with pytest.raises(ExperimentError) as refused:
        run_session(
            load_experiment("dc-motor-hinf"), clock="real", path=tmp_path / "a.mcap",
            onlooker=Scripted([(5, path, value)], real=True),
        )  # fmt: skip
    assert why in str(refused.value) and "what does: reference, disturbance" in str(refused.value)
    assert not (tmp_path / "a.mcap").exists()


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Page]:
    def path(experiment: Experiment) -> Path:
        return tmp_path / f"{experiment.seed}.mcap"

    def load(seed: int | None) -> Experiment:
        return load_experiment("dc-motor-hinf", ["duration=600", "limits.watchdog_slots=4"], seed=seed)

    page = Page(tmp_path, [Watched(load=partial(load), path=path, clock="real", link=f"can:hil:pg{os.getpid()}")])
    page.begin("running")
    yield page
    page.end()


def test_the_controller_is_killed_and_restarted_from_the_page_and_the_loop_goes_into_its_safe_state(page: Page) -> None:
    until(lambda: page.view()["slots"] > 5, "the run")
    status, answer = page.wish(do="pause")
    assert status == 400 and "paces a run in real time" in answer["error"]
    assert page.wish(do="check", path="controller", value={"kind": "h2"})[0] == 200
    assert "the controller is a process of its own" in page.settled("refused")["message"]
    assert page.wish(do="check", path="network.ca.law", value={"kind": "constant", "age": 1})[0] == 200
    assert page.settled("ready")["claims"][0]["state"] == "certified"
    applied(page, "reference", [1.0])
    before = controllers()
    applied(page, "fault", {"kind": "controller-restart", "for": 1.0})  # 20 slots: five times what the watchdog allows
    until(lambda: len(now := controllers()) == 1 and now != before, "another process")
    until(lambda: any(event["kind"] == "safety" for event in events(page)), "the safe state")
    page.wish(do="restart", seed=7)
    until(lambda: page.view(words=1)["run"] == 2 and page.view()["slots"] > 5, "the run that begins anew")
    page.end()
    first, second = page.sessions
    run = read_run(Path(first.summary["log"]["path"]))
    assert [path for _, path, _ in changes_of(run)][:2] == ["reference", "fault"]
    assert first.status == 3 and second.summary["seed"] == 7 and second.summary["clock"] == "real"


def applied(page: Page, path: str, value: Any) -> None:
    """Change a run until the change is in the log: one that comes behind its slot changes nothing, and is asked for again."""

    def known() -> bool:
        return path in changes(page)

    def late() -> int:
        return sum(event["kind"] == "change late" for event in events(page))

    while not known():
        before = late()
        assert page.wish(do="apply", path=path, value=value)[0] == 200
        page.settled("armed")
        until(lambda before=before: known() or late() > before, "the change in the log, or that it came late")  # type: ignore[misc]


def events(page: Page) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = page.view(since=0)["events"]
    return found


def changes(page: Page) -> list[str]:
    return [event["data"]["path"] for event in events(page) if event["kind"] == "change"]


def controllers() -> list[int]:
    return children_of(os.getpid(), "hil.runtime.real.controller_process")


class Slow(Scripted):
    """Says what changes when its slot is over."""

    def changes(self, k: int) -> Sequence[Change]:
        found = super().changes(k)
        if found and found[0].path != "end":
            time.sleep(1.0)
        return found


def test_a_change_that_comes_behind_its_slot_changes_nothing_and_the_log_says_so(tmp_path: Path) -> None:
    asked: list[ChangeRequest] = [(10, "reference", [2.0]), (60, "end", None)]
    onlooker = Slow(asked, real=True)
    session = run_session(
        load_experiment("dc-motor-hinf", SETS), clock="real", link="local:", path=tmp_path / "a.mcap", onlooker=onlooker
    )  # fmt: skip
    run = session.run
    late = [event for event in run.events if event["kind"] == "change late"]
    assert "reference: came in slot" in late[0]["message"] and "behind its slot 10" in late[0]["message"] and len(late) == 1
    assert [path for _, path, _ in changes_of(run)] == ["end"] and 2.0 not in run.arrays["/reference"]["angle"]


def test_what_comes_next_is_composed_upon_what_runs() -> None:
    side, loop = Side(acts=True), compose(load_experiment("dc-motor-hinf"))
    side.begin(loop, channels_of(loop))
    after = changed(loop, 10, "reference", [2.0])
    assert side.arm(10, Change(path="reference", value=[2.0], loop=after)) and side.loop is after
    upon = changed(after, 11, "reference", [3.0])
    assert side.arm(11, Change(path="reference", value=[3.0], loop=upon))
    side._note({"kind": "change late", "slot": 12, "data": {"era": 0, "path": "reference"}})
    assert side.loop is loop and not side.arm(20, Change(path="reference", value=[3.0], loop=upon))
    again = changed(loop, 20, "reference", [4.0])
    assert side.arm(20, Change(path="reference", value=[4.0], loop=again, era=1))
    side._note({"kind": "change late", "slot": 12, "data": {"era": 0, "path": "reference"}})
    assert side.loop is again
    side._note({"kind": "change", "slot": 20, "data": {"path": "reference", "value": [4.0]}})
    assert side.loop is again and side.arm(30, Change(path="end", value=None, loop=None)), "who ends a run knows enough"
