"""The questions of a log to a process that ends, is behind, or answers twice, on a clock that only waiting moves."""

from __future__ import annotations

from collections import deque
from types import SimpleNamespace

import pytest

from hil.log.read import read_run
from hil.log.run import Run
from hil.session.replay import over_link
from hil.session.replay.over_link import LESS, UNRECORDED_S, ask_process
from tests.process_replay import DATA
from transport.links import Closing, LinkCounters
from transport.packets import encode_control

PATIENCE_S = 15.0
SLOTS = 40


@pytest.fixture(scope="module")
def run() -> Run:
    return read_run(DATA / "foreign_controller.mcap")


class Program(Closing):
    """A link to a program that answers as recorded, and from a slot on otherwise.

    Args:
        run: the log.
        at: the slot.
        times: how often it answers from then on.
        behind: how many slots it is behind its questions from then on.
    """

    def __init__(self, run: Run, at: int = SLOTS, times: int = 1, behind: int = 0) -> None:
        self.uri, self.counters = "program:", LinkCounters()
        self.answers = over_link._answers_of(run)
        self.at, self.times, self.behind = at, times, behind
        self.queue: deque[bytes] = deque()
        self.now_ns, self.k, self.longest, self.waits = 0, -1, 0, list[float]()

    def send(self, packet: bytes) -> None:
        self.k += 1
        odd = self.k >= self.at
        answer = self.answers.get(self.k - self.behind * odd)
        if answer is not None:
            self.queue.extend([encode_control(answer)] * (self.times if odd else 1))
        self.longest = max(self.longest, len(self.queue))

    def receive(self, timeout_s: float) -> bytes | None:
        if self.queue:
            return self.queue.popleft()
        self.waits.append(timeout_s)
        self.now_ns += round(timeout_s * 1e9)
        return None

    def close(self) -> None:
        pass


def asked(run: Run, program: Program, monkeypatch: pytest.MonkeyPatch) -> over_link.AnswerComparison:
    monkeypatch.setattr(over_link, "opened", lambda uri, role: program)
    monkeypatch.setattr(over_link, "monotonic_ns", lambda: program.now_ns)
    greeting = SimpleNamespace(greet=lambda: SimpleNamespace(answered=True))
    monkeypatch.setattr(over_link, "Handshake", lambda *given: greeting)
    return ask_process(run, "program:", patience_s=PATIENCE_S)


def test_what_is_asked_is_answered_as_it_was(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    found = asked(run, program := Program(run), monkeypatch)
    assert (found.compared, found.different) == (SLOTS, 0) and not program.waits


def test_a_process_that_ends_costs_two_patiences_and_all_its_answers(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    found = asked(run, program := Program(run, at=10, times=0), monkeypatch)
    assert (found.compared, found.different) == (SLOTS, 30)
    assert {each.field for each in found.differences} == {"answer"} and found.differences[0].slot == 10
    assert sum(program.waits) <= PATIENCE_S / (1 - LESS) + 30 * UNRECORDED_S and min(program.waits) == UNRECORDED_S


def test_a_process_that_is_behind_has_all_the_patience_again(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    asked(run, program := Program(run, at=10, behind=2), monkeypatch)
    assert min(program.waits) == PATIENCE_S


def test_a_second_answer_to_a_slot_is_a_difference(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    found = asked(run, Program(run, at=SLOTS - 2, times=2), monkeypatch)
    assert [str(each) for each in found.differences] == [f"slot {SLOTS - 2}: answers = 1 recorded, more now"]


def test_slots_whose_answers_were_not_recorded_are_asked_one_by_one(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """A thousand at once flooded the queue of the process, which then missed what was compared."""
    kept = over_link._answers_of(run)
    program = Program(run)
    monkeypatch.setattr(over_link, "_answers_of", lambda run: {k: answer for k, answer in kept.items() if k >= 30})
    found = asked(run, program, monkeypatch)
    assert (found.compared, found.different) == (10, 0) and program.longest == 1
