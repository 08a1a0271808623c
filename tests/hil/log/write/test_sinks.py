"""Sinks in memory and events: nothing raises into the loop."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.errors import HilError
from hil.log import decode_event, encode_event, plain
from hil.log.read import Run
from hil.log.write import MemorySink, TeeSink, harmless
from tests.hil.log.recording import TABLE, assert_same_arrays, record

_leaves = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(), st.binary(), st.complex_numbers(),
    st.just(object()),
)
_values = st.recursive(
    _leaves,
    lambda inner: st.one_of(
        st.lists(inner), st.tuples(inner, inner), st.dictionaries(st.one_of(st.text(), st.integers()), inner)
    ),
    max_leaves=20,
)


@settings(max_examples=30, deadline=None)
@given(st.text(), st.text(), st.dictionaries(st.text(), _values))
def test_every_event_carries_strict_json(kind: str, message: str, data: dict[str, Any]) -> None:
    event = decode_event(encode_event(1_500_000_000, kind, message, data=data))
    assert event["t_s"] == 1.5
    assert set(event) == {"slot", "t_s", "kind", "severity", "message", "data"}
    json.dumps(event["data"], allow_nan=False)
    if "\0" not in kind and kind.isprintable():
        assert event["kind"] == kind


def test_an_event_that_is_cut_or_is_none_is_refused() -> None:
    whole = encode_event(0, "kind", "message", slot=7, data={"a": 1})
    assert decode_event(whole)["slot"] == 7 and decode_event(whole + bytes(3))["data"] == {"a": 1}
    for payload in (b"", b"\1" + whole[1:], *(whole[:n] for n in range(4, len(whole))), whole.replace(b"{", b"[")):
        with pytest.raises(HilError, match="is no event: "):
            decode_event(payload)


def test_an_event_with_endless_nesting_is_kept() -> None:
    endless: list[Any] = []
    endless.append(endless)
    assert decode_event(encode_event(0, "a", "b", data={"endless": endless}))["kind"] == "a"


def test_values_that_python_will_not_print_are_kept_in_an_event() -> None:
    class Rude:
        def __str__(self) -> str:
            raise RuntimeError("no")

    data = decode_event(encode_event(0, "a", "b", data={"n": 16**5000, "rude": Rude()}))["data"]
    assert data["n"] == hex(16**5000)
    assert data["rude"] == "<Rude>"


def test_lone_surrogates_in_an_event_are_kept_readable() -> None:
    assert decode_event(encode_event(0, "\ud800", "b", data={}))["kind"] == "\\ud800"


def test_numbers_that_are_not_finite_become_text() -> None:
    assert plain((math.nan, math.inf, -math.inf, 1.0)) == ["nan", "inf", "-inf", 1.0]


def test_sets_and_tables_stand_in_one_order_in_every_process() -> None:
    names = [f"name {i}" for i in range(20)]
    data = {"set": {*names}, "table": dict.fromkeys(reversed(names), 1)}
    assert plain(data)["set"] == sorted(names)
    texts = [encode_event(0, "a", "b", data=dict(items)) for items in ([*data.items()], [*data.items()][::-1])]
    assert texts[0] == texts[1] and b'"name 0":1,"name 1":1,"name 10":1' in texts[0]


def test_a_sink_in_memory_keeps_only_the_topics_that_are_wanted() -> None:
    sink = MemorySink(TABLE, topics={"/plant/state"})
    assert sink.channel("/network/sc") is None
    record(sink, 10)
    run = Run.from_memory(sink)
    assert list(run.arrays) == ["/plant/state"]
    assert len(run.arrays["/plant/state"]) == 10
    assert run.events == []


def test_a_topic_that_does_not_exist_is_refused() -> None:
    with pytest.raises(ValueError, match="topics: '/plant/stat' is not"):
        MemorySink(TABLE, topics={"/plant/stat"})


def test_a_tee_gives_every_record_to_its_sink_and_to_the_observers_of_its_topic() -> None:
    everything, states = MemorySink(TABLE), MemorySink(TABLE, topics={"/plant/state", "/events"})
    observers = {topic: put for topic in states.times if (put := states.channel(topic))}
    assert TeeSink(states, {}).channel("/network/sc") is None
    assert TeeSink(MemorySink(TABLE, topics=[]), observers).channel("/events") is observers["/events"]
    record(TeeSink(everything, observers), 150)
    run, part = Run.from_memory(everything), Run.from_memory(states)
    assert_same_arrays(part.arrays, {"/plant/state": run.arrays["/plant/state"]})
    assert part.events == run.events and len(run.events) == 2


def test_a_view_that_fails_is_taken_off_and_the_log_says_so() -> None:
    asked: list[int] = []

    def broken(t_ns: int, payload: bytes) -> None:
        asked.append(t_ns)
        raise RuntimeError("screen gone")

    log, seen = MemorySink(TABLE), MemorySink(TABLE)
    looks = {"/reference": broken, "/plant/state": seen.channel("/plant/state"), "/events": broken}
    record(TeeSink(log, harmless(looks, log)), 150)
    run = Run.from_memory(log)
    failed = [event for event in run.events if event["kind"] == "view failed"]
    assert [event["message"].removeprefix("a view gets no more records of ") for event in failed] == [
        "/reference: RuntimeError: screen gone", "/events: RuntimeError: screen gone"
    ] and all(event["severity"] == "warning" for event in failed)  # fmt: skip
    assert len(asked) == 2 and len(run.arrays["/reference"]) == len(seen.times["/plant/state"]) == 150


def test_an_empty_run_has_empty_arrays_with_all_fields() -> None:
    run = Run.from_memory(MemorySink(TABLE), experiment_text="x")
    assert all(len(array) == 0 for array in run.arrays.values())
    assert run.arrays["/link/sensor"].dtype.names == ("t_ns", "slot", "late", "data")
    assert run.experiment_text == "x"
