"""The exchange over a link ends whatever arrives, and a link is warm and empty before slot 0. Time is a number here.

What is done once before a session answers as a session does, leaves no trace, and hides no fault of a control law.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from hil.compose import compose
from hil.experiment import load_experiment
from hil.log.read import Run
from hil.log.topics import channels_of
from hil.log.write import MemorySink
from hil.rig.loop import Loop
from hil.runtime.nodes import session_wire
from hil.runtime.nodes.controller_node import ControlNode
from hil.runtime.nodes.rig import Rig
from hil.runtime.real.exchange import (
    MOST_FRAMES,
    REHEARSALS,
    WARM_UP_SLOTS,
    Handshake,
    LinkExchange,
    LocalLink,
    WarmUpExchange,
    WarmUpRig,
    warm_up_controller,
)
from hil.runtime.slot import Slot
from hil.runtime.virtual import simulate
from transport.links.contract import MemoryLink
from transport.packets import ControlPacket, SensorPacket, decode, encode_control, encode_sensor
from transport.wire import HELLO, echo

MS = 1_000_000
WIRE = session_wire(bytes(16), 1000)


class Bench(MemoryLink):
    """A link that counts, on a clock that moves only while a caller waits or takes a frame."""

    def __init__(self, taking_ns: int = 1000) -> None:
        super().__init__()
        self.t_ns, self.taking_ns = 0, taking_ns
        self.inbox: deque[tuple[int, bytes]] = deque()
        self.asked: list[SensorPacket] = []
        self.taken = 0
        self.on_question: Callable[[], None] = lambda: None
        self.endless: bytes | None = None

    def now(self) -> int:
        return self.t_ns

    def send(self, packet: bytes) -> None:
        question = decode(packet)
        assert isinstance(question, SensorPacket)
        self.asked.append(question)
        self.said = packet
        self.on_question()

    def arrive(self, after_ns: int, data: bytes) -> None:
        self.inbox.append((self.t_ns + after_ns, data))

    def receive(self, timeout_s: float) -> bytes | None:
        assert timeout_s >= 0
        limit = self.t_ns + round(timeout_s * 1e9)
        if self.inbox and self.inbox[0][0] <= limit:
            at, data = self.inbox.popleft()
            self.t_ns = max(self.t_ns, at) + self.taking_ns
        elif self.endless is not None:
            data, self.t_ns = self.endless, self.t_ns + self.taking_ns
        else:
            self.t_ns = limit
            return None
        self.taken += 1
        return data


class Ear:
    """Takes what comes: the answer is called b'answer'."""

    def __init__(self) -> None:
        self.received: list[bytes] = []
        self.late: list[bytes] = []

    def on_frame(self, data: bytes) -> bool:
        self.received.append(data)
        return data == b"answer"

    def take(self, data: bytes, when: str) -> None:
        assert when == "late"
        self.late.append(data)


def exchange(link: Bench, ear: Ear, stopped: Callable[[], bool] = lambda: False) -> LinkExchange:
    return LinkExchange(link, ear, 30 * MS, stopped, link.now)


def question() -> list[bytes]:
    return [encode_sensor(SensorPacket(0, 0, 0, (1.0,)))]


@pytest.mark.parametrize("taking_ns", [0, 1000, 7 * MS])
def test_flood_never_holds_the_rig_beyond_the_deadline_or_the_most_frames(taking_ns: int) -> None:
    link, ear = Bench(taking_ns), Ear()
    link.endless = b"junk"
    one = exchange(link, ear)
    one.ask(0, question())
    one.answer(0, ear.on_frame)
    assert link.taken <= MOST_FRAMES
    assert link.t_ns <= 30 * MS + taking_ns  # the frame that was being taken at the deadline
    assert one.waited_ns == link.t_ns


def test_stop_is_seen_between_two_frames() -> None:
    link, ear = Bench(), Ear()
    link.endless = b"junk"
    one = exchange(link, ear, lambda: link.taken >= 5)
    one.answer(0, ear.on_frame)
    assert link.taken == 5


def test_answer_in_time_is_found_behind_other_frames_and_one_after_the_deadline_is_never_received() -> None:
    link, ear = Bench(), Ear()
    one = exchange(link, ear)
    one.ask(0, question())
    for _ in range(20):
        link.arrive(MS, b"junk")
    link.arrive(10 * MS, b"answer")
    one.answer(0, ear.on_frame)
    assert ear.received[-1] == b"answer" and len(ear.received) == 21 and not ear.late
    assert one.round_trip_us == pytest.approx(10_001)

    link, ear = Bench(taking_ns=2 * MS), Ear()
    one = exchange(link, ear)
    one.ask(0, question())
    link.arrive(29 * MS, b"answer")  # taken 1 ms after the deadline
    one.answer(0, ear.on_frame)
    assert ear.received == [] and ear.late == [b"answer"]


def hello(link: Bench | None = None) -> bytes:
    """The answer to the question that a link was asked last."""
    echoed = echo([link.said]) if link is not None else 0
    return encode_control(ControlPacket(HELLO, -1, 0, 0, 0, ((0.0,),), echoed))


def test_controller_is_asked_once_then_rehearsed_and_the_link_is_empty_before_slot_0() -> None:
    link = Bench()
    link.on_question = lambda: link.arrive(MS, hello(link))
    greeting = Handshake(link, 15.0, lambda: False, link.now, WIRE).greet()
    assert greeting.answered
    assert len(link.asked) == greeting.questions == 1 + REHEARSALS
    assert {q.seq for q in link.asked} == {HELLO}
    assert not link.inbox and link.taken == 1 + REHEARSALS


def test_controller_that_joins_late_and_then_answers_everything_leaves_an_empty_link() -> None:
    link = Bench()

    def answer_from_the_fourth_on() -> None:
        if len(link.asked) == 4:
            for _ in range(4):
                link.arrive(60 * MS, hello(link))
        elif len(link.asked) > 4:
            link.arrive(MS, hello(link))

    link.on_question = answer_from_the_fourth_on
    greeting = Handshake(link, 15.0, lambda: False, link.now, WIRE).greet()
    assert greeting.answered and not link.inbox


def test_nothing_lies_between_the_last_rehearsal_and_slot_0() -> None:
    """Questions from before the controller was there have no answer: the link was left alone for 0.1 s, twice."""
    link, done = Bench(), []

    def answer_from_the_fourth_on() -> None:
        done.append("asked")
        if len(link.asked) >= 4:
            link.arrive(MS, hello(link))

    def pause() -> None:
        done.append("paused")
        link.t_ns += MS

    link.on_question = answer_from_the_fourth_on
    greeter = Handshake(link, 15.0, lambda: False, link.now, WIRE, lambda: done.append("meanwhile"), pause)
    assert greeter.greet().answered
    assert done == ["asked"] * 4 + ["asked", "meanwhile", "paused"] * REHEARSALS
    begin = (2 + 4 + 8) * MS  # three questions without an answer
    assert link.t_ns < begin + (2 * REHEARSALS + 3) * MS


@pytest.mark.parametrize("answers", [True, False])
def test_frames_of_others_delay_the_beginning_by_no_more_than_the_limit_and_are_counted(answers: bool) -> None:
    """Ten foreign frames a second made a session of 1 s last 46 s."""
    link = Bench()
    for i in range(1000):
        link.arrive(i * 50 * MS, bytes(8))
    if answers:
        link.on_question = lambda: link.inbox.appendleft((link.t_ns + MS, hello(link)))
    greeting = Handshake(link, 15.0, lambda: False, link.now, WIRE).greet()
    assert greeting.answered == answers
    assert link.t_ns <= (1_000 * MS if answers else 15_001 * MS)
    assert greeting.foreign > 0


def test_a_process_that_repeats_the_answer_for_ever_does_not_hold_the_session() -> None:
    link = Bench(taking_ns=MS)
    link.on_question = lambda: setattr(link, "endless", link.endless or hello(link))
    greeting = Handshake(link, 15.0, lambda: False, link.now, WIRE).greet()
    assert greeting.answered and link.t_ns < 400 * MS and greeting.foreign > 0


def test_greeting_needs_the_echo_of_the_question() -> None:
    link, wire = Bench(), session_wire(b"n" * 16)
    link.on_question = lambda: link.arrive(MS, hello())
    assert not Handshake(link, 1.0, lambda: False, link.now, wire).greet().answered
    link = Bench()
    link.on_question = lambda: link.arrive(MS, hello(link))
    assert Handshake(link, 1.0, lambda: False, link.now, wire).greet().answered


def test_local_controller_answers_in_the_rigs_process_as_in_virtual_time() -> None:
    loop, wire = compose(load_experiment("dc-motor-hinf", ["duration=3"])), session_wire(b"l" * 16)
    sink = MemorySink(channels_of(loop))
    rig = Rig(loop, 3, sink, channels_of(loop), lambda: None, wire)
    with LocalLink(ControlNode(loop)) as link:
        clock = iter(range(10**9))
        greeting = Handshake(link, 1.0, lambda: False, lambda: next(clock), wire).greet()
        assert greeting.answered and greeting.questions == 1 + REHEARSALS and greeting.foreign == 0
        slot = Slot(rig, LinkExchange(link, rig.answers, 30 * MS, lambda: False, lambda: next(clock)))
        for k in range(loop.experiment.slots):
            slot.run(k * loop.experiment.period_ns)
    ours, virtual = Run.from_memory(sink).arrays, simulate(loop, 3).arrays
    for topic in ("/plant/state", "/actuator/applied"):
        assert (ours[topic] == virtual[topic]).all()
    assert rig.outcome()["late"] == 0


def test_the_deadline_runs_from_the_moment_the_question_left() -> None:
    """The rig woke up 25 ms late: its controller has its 30 ms all the same, and not a nanosecond more."""
    for after_ms, received in ((29, True), (31, False)):
        link, ear = Bench(), Ear()
        link.t_ns = 25 * MS
        talk = exchange(link, ear)
        talk.ask(0, question())
        link.arrive(after_ms * MS, b"answer")
        talk.answer(0, ear.on_frame)
        assert (b"answer" in ear.received) is received


@pytest.fixture(scope="module")
def loop() -> Loop:
    return compose(load_experiment("dc-motor-hinf"), certify=False)


def test_every_rehearsed_slot_is_answered_with_the_echo_of_the_session(loop: Loop) -> None:
    rig = Rig(loop, 0, MemorySink(channels_of(loop), ()), channels_of(loop), lambda: None, session_wire(bytes(16), 1000))
    slot = Slot(rig, WarmUpExchange(loop))
    for k in range(10):
        slot.run(k * loop.experiment.period_ns)
    assert rig.outcome()["late"] == rig.outcome()["foreign"] == 0
    rehearsed = WarmUpRig(loop, session_wire(bytes(16), 1000)).warm_up()
    for _ in range(3):
        rehearsed.run()


class Law:
    """A control law that counts its slots, and fails or dawdles in one of them."""

    def __init__(self, loop: Loop, fails_in: int = -1) -> None:
        self.asked, self._running, self._fails_in = [], loop.start_controller(), fails_in
        self.selection = loop.selection

    def start(self, model: object) -> Law:
        return self

    def rows(self, k: int, *known: Any) -> Any:
        self.asked.append(k)
        if k == self._fails_in:
            raise ZeroDivisionError("of the law")
        return self._running.rows(k, *known)


def test_a_control_law_runs_before_the_session_and_may_fail_there(loop: Loop) -> None:
    for law in (Law(loop), Law(loop, fails_in=7)):
        warm_up_controller(replace(loop, controller=law))
        assert law.asked[-1] == (7 if law._fails_in == 7 else WARM_UP_SLOTS - 1)


def test_a_part_that_failed_is_not_asked_again_before_the_session(loop: Loop) -> None:
    for law, last in ((Law(loop), WARM_UP_SLOTS - 1), (Law(loop, fails_in=7), 7)):
        WarmUpRig(replace(loop, controller=law), session_wire(bytes(16), 1000), local=True).warm_up()
        assert law.asked[-1] == last


def test_a_slow_control_law_does_not_hold_the_session(loop: Loop, monkeypatch: pytest.MonkeyPatch) -> None:
    law, clock = Law(loop), SimpleNamespace(t_ns=0)

    def now() -> int:
        clock.t_ns += 100_000_000
        return clock.t_ns

    monkeypatch.setattr("hil.runtime.real.exchange.monotonic_ns", now)
    warm_up_controller(replace(loop, controller=law))
    assert 1 <= len(law.asked) <= 5
