"""A run that is watched takes changes for slots that have not begun, in their order, and each once; and what its page offers."""

from __future__ import annotations

import pytest

from hil.api.experiment_source import load_experiment
from hil.compose import compose
from hil.compose.changed import changed
from hil.experiment import Experiment
from hil.log.topics import channels_of
from hil.pages.live import Side
from hil.pages.live.about import about, controllers, controllers_of
from hil.pages.live.desk import Desk, Wish
from hil.rig.loop import Loop
from hil.runtime.changes import END, Change
from hil.runtime.clock import PacedClock
from tests.waiting import until

FIRST, SECOND = (Change(path=path, value=1, loop=None) for path in ("a", "b"))


def test_a_change_acts_once_from_its_slot_on_and_none_is_armed_for_a_slot_that_has_begun() -> None:
    side = Side(acts=True)
    due = side.changes
    assert due is not None and Side().changes is None
    assert side.next_slot() == 0 and side.arm(0, FIRST) and side.next_slot() == 0, "several may share a slot"
    assert side.arm(3, SECOND) and side.next_slot() == 3
    assert due(0) == [FIRST] and not side.arm(0, FIRST) and side.next_slot() == 3
    assert due(1) == due(2) == [] and due(3) == [SECOND] and due(4) == []
    assert not side.arm(4, FIRST) and side.next_slot() == 5 and side.arm(5, FIRST) and side.arm(6, SECOND)
    assert due(9) == [FIRST, SECOND] and side.next_slot() == 10


def test_a_run_that_is_stopped_while_it_is_composed_ends_before_its_first_slot() -> None:
    side = Side(PacedClock(), acts=True)
    side.stop()
    due = side.changes
    assert due is not None and [change.path for change in due(0)] == [END]


def test_a_restart_stops_the_run_that_is_there_and_not_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    side, seen = Side(PacedClock(), acts=True), list[bool]()
    desk = Desk([side])
    monkeypatch.setattr(side, "stop", lambda: seen.append(desk.again.is_set()))
    try:
        desk.take(Wish(do="restart", seed=3))
        until(desk.again.is_set, "the restart")
        assert seen == [False] and desk.seed == 3
    finally:
        desk.close()


def test_a_change_that_takes_many_slots_to_compose_is_armed_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """In real time the run goes on meanwhile: on a busy machine no change came ahead of it, and the page waited for ever."""
    side, loop = Side(acts=True), compose(load_experiment("dc-motor-hinf"), certify=False)
    side.begin(loop, channels_of(loop))
    due, asked = side.changes, []
    assert due is not None
    due(0)

    def slowly(before: Loop, k: int, path: str, value: object) -> Loop:
        asked.append(k)
        assert len(asked) < 10
        due(side.next_slot() + 39)
        return changed(before, k, path, value)

    desk = Desk([side])
    try:
        monkeypatch.setattr(desk._composer, "changed", slowly)
        (slot,) = desk._arm([side], "network.ca.law", {"kind": "constant", "age": 1})
        assert slot == asked[-1] > side.next_slot() - 40 and len(asked) <= 3 and due(slot)
    finally:
        desk.close()


def test_a_run_that_a_wish_names_twice_is_changed_once() -> None:
    """A wish has room for thirty thousand numbers of runs, each of which was composed."""
    side, loop = Side(acts=True), compose(load_experiment("dc-motor-hinf"), certify=False)
    side.begin(loop, channels_of(loop))
    desk = Desk([side])
    try:
        number = desk.take(Wish(do="apply", path="reference", value=[1.0], sides=(0, 0, 0)))
        until(lambda: desk.draft.number == number and desk.draft.state == "armed", "the change")
        assert len(desk.draft.claims) == len(side._armed) == 1
    finally:
        desk.close()


def test_a_plant_that_is_a_table_of_lists_may_change_entry_by_entry() -> None:
    side, plant = Side(PacedClock(), acts=True), {"kind": "state-space", "A": [[0.0]], "B": [[1.0, 2.0]], "C": [[1.0]]}
    changes = {"plant": plant | {"saturation": [3.0, 4.0]}, "controller": {"kind": "local", "gain": [[0.1]] * 2}}
    made = load_experiment("dc-motor-h2", reference=[], disturbance=[], limits={}, **changes)
    side.begin(compose(made, certify=False), {})
    assert about([side], "here")["runs"][0]["fields"] == {"plant.saturation.0": 3.0, "plant.saturation.1": 4.0}


def test_a_wall_follows_no_reference_and_shows_none() -> None:
    for name, shown in (("omni-push", False), ("dc-motor-hinf", True)):
        side, loop = Side(PacedClock(), acts=True), compose(load_experiment(name), certify=False)
        side.begin(loop, channels_of(loop))
        assert ("/reference" in {each.topic for each in side.traces}) == shown, name


def test_the_page_waits_for_no_other_experiment(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a page is drawn from loads nothing; the controllers that it offers come behind it."""
    side = Side(PacedClock(), acts=True)
    assert about([side], "here")["runs"] == [{"name": "", "traces": [], "waits": ""}] and controllers_of(side) == {}
    side.begin(compose(load_experiment("dc-motor-hinf"), certify=False), {})
    loaded: list[str] = []

    def load(name: str) -> Experiment:
        loaded.append(name)
        return load_experiment(name)

    monkeypatch.setattr(f"{about.__module__}.load_experiment", load)
    controllers.cache_clear()
    assert about([side], "here")["runs"][0]["name"] == "dc-motor-hinf" and not loaded
    offered = controllers_of(side)
    assert "dc-motor-h2" in offered and "dc-motor-h2" in loaded
    assert not {"dc-motor-h2-fast", "dc-motor-two-nodes", "omni-push"} & set(offered)  # another period, outputs, plant
