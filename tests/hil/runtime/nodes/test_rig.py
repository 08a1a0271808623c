"""The rig against the thesis's equations, and against controllers that misbehave."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import msgspec
import numpy as np
import pytest

from hil.compose import compose
from hil.experiment import load_experiment
from hil.log.read import Run
from hil.log.topics import channels_of
from hil.log.write import MemorySink
from hil.rig.loop import Loop
from hil.runtime.clock import Kernel
from hil.runtime.nodes import session_wire
from hil.runtime.nodes.actuator_node import HOLD, NONE_YET, OK, SAFE, row_index
from hil.runtime.nodes.answer_matcher import LOGGED
from hil.runtime.nodes.rig import Rig
from hil.runtime.slot import Slot
from hil.runtime.virtual import simulate
from transport.packets import ControlPacket, encode_control
from transport.wire import echo


@pytest.fixture(scope="module")
def loop() -> Loop:
    return compose(load_experiment("dc-motor-hinf"))


@pytest.mark.parametrize("name", ["dc-motor-hinf", "dc-motor-h2", "dc-motor-ours-two-samples"])
def test_loop_follows_the_recursion_of_the_thesis_on_the_drawn_delays(name: str) -> None:
    """(7.8)-(7.13) written once more in deviation coordinates, on the modes that the rig drew."""
    loop = compose(load_experiment(name))
    run = simulate(loop, 5)
    A, B, C = loop.model.A, loop.model.B, loop.model.C
    K = loop.controller.table(loop.model)[:, :, 0, :]
    draws = {}
    for side in ("sc", "ca"):
        d = run.arrays[f"/network/{side}"]
        d = d[d["mode"] >= 0]
        draws[side] = dict(zip(d["slot"].tolist(), d["mode"].tolist()))
    r, w = run.arrays["/reference"]["angle"], run.arrays["/actuator/applied"]["w_voltage"]
    x, ys, packets = np.zeros(2), [], []
    states = run.arrays["/plant/state"]
    for k in range(len(states)):
        assert states["angle"][k] == pytest.approx(x[0], abs=2e-5)  # float32 on the wire
        ys.append((C @ x)[0])
        tau, d = draws["sc"][k], draws["ca"][k]
        errors = np.array([ys[max(k - tau - i, 0)] - r[k] for i in range(loop.samples)])
        packets.append(K[tau] @ errors if k >= tau else np.zeros(2))
        g = k - d
        u = packets[g][d if loop.selection == "applied" else draws["ca"][g]] if g >= 0 else 0.0
        x = A @ x + B[:, 0] * (u + w[k])


class Script:
    """A controller that is a function of the slot: one frame, several, or none."""

    def __init__(self, loop: Loop, answer: Callable[[int], bytes | list[bytes] | None]) -> None:
        self.period_ns, self._answer = loop.experiment.period_ns, answer

    def ask(self, t_ns: int, frames: Sequence[bytes]) -> None:
        assert frames

    def answer(self, t_ns: int, on_frame: Callable[[bytes], bool]) -> None:
        answer = self._answer(t_ns // self.period_ns)
        for data in [answer] if isinstance(answer, bytes) else answer or []:
            on_frame(data)


def drive(loop: Loop, answer: Callable[[int], bytes | None], slots: int) -> MemorySink:
    """Run a rig whose controller is a function of the slot."""
    sink = MemorySink(channels_of(loop))
    kernel = Kernel()
    rig = Rig(loop, 0, sink, channels_of(loop), kernel.stop)
    kernel.run(loop.experiment.period_ns, slots, Slot(rig, Script(loop, answer)).run)
    return sink


def answer(k: int, rows: tuple[tuple[float, ...], ...] = ((0.1,), (0.1,))) -> bytes:
    return encode_control(ControlPacket(k, k * 50_000_000, k * 50_000_000, 0, 1, rows))


def statuses(loop: Loop, sink: MemorySink) -> list[int]:
    return Run.from_memory(sink).arrays["/actuator/applied"]["status"].tolist()


def kinds(sink: MemorySink) -> list[str]:
    return [e["kind"] for e in Run.from_memory(sink).events]


def test_controller_that_dies_is_followed_by_hold_then_the_latched_safe_state(loop: Loop) -> None:
    sink = drive(loop, lambda k: answer(k) if k < 20 else None, 60)
    got = statuses(loop, sink)
    assert OK in got[:20] and HOLD in got[20:25] and got[-1] == SAFE
    assert got.index(SAFE) - 20 <= 1 + 3 + 1  # d_max + watchdog slots


def test_controller_that_comes_back_after_a_trip_stays_locked_out(loop: Loop) -> None:
    sink = drive(loop, lambda k: answer(k) if k < 5 or k > 12 else None, 60)
    got = statuses(loop, sink)
    assert got[-1] == SAFE and OK not in got[13:]


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_rows_that_are_not_finite_are_refused_and_count_as_missing(loop: Loop, value: float) -> None:
    sink = drive(loop, lambda k: answer(k, ((0.1,), (value,))), 40)
    assert kinds(sink)[:2] == ["control refused", "safety"]
    assert OK not in statuses(loop, sink)


@pytest.mark.parametrize("rows", [((0.1,),), ((0.1,), (0.1,), (0.1,)), ((0.1, 0.1), (0.1, 0.1)), ()])
def test_packets_of_another_shape_are_refused(loop: Loop, rows: tuple[tuple[float, ...], ...]) -> None:
    assert "control refused" in kinds(drive(loop, lambda k: answer(k, rows), 10))


def test_command_beyond_its_limit_leads_to_zero_input(loop: Loop) -> None:
    sink = drive(loop, lambda k: answer(k, ((7.0,), (7.0,))), 40)
    applied = Run.from_memory(sink).arrays["/actuator/applied"]
    assert np.abs(applied["voltage"]).max() == 0.0
    assert "beyond its limit 5" in next(e["message"] for e in Run.from_memory(sink).events if e["kind"] == "safety")


def test_late_answer_is_lost_and_logged_never_another_delay(loop: Loop) -> None:
    sink = drive(loop, lambda k: answer(k - 1) if k == 10 else answer(k), 20)
    run = Run.from_memory(sink)
    frames = run.arrays["/link/control"]
    assert frames["slot"][frames["late"] == 1].tolist() == [9]
    assert 10 not in frames["slot"][frames["late"] == 0].tolist()
    assert [e["slot"] for e in run.events if e["kind"] == "late"] == [10]


def test_garbage_from_the_link_is_counted_and_changes_nothing(loop: Loop) -> None:
    rng = np.random.default_rng(0)
    sink = MemorySink(channels_of(loop))
    rig = Rig(loop, 0, sink, channels_of(loop), lambda: None)
    rig.sense(0)
    for _ in range(300):
        assert rig.on_frame(rng.bytes(int(rng.integers(0, 80)))) is False
    assert rig.answers.malformed == 300
    rig.on_frame(answer(0))
    rig.actuate(0)
    assert rig.outcome()["refused"] == 0


def control(k: int, u: float = 0.0) -> bytes:
    return encode_control(ControlPacket(k, 0, 0, 0, 1, ((u,), (u,))))


def test_second_controller_that_says_otherwise_is_reported_once(loop: Loop) -> None:
    # A copy of what was applied says nothing; what came to the same question from another sender does.
    sink = drive(loop, lambda k: [control(k - 1), control(k)] if k else control(0), 4)
    assert "second controller" not in kinds(sink)
    sink = drive(loop, lambda k: [control(k - 1, 0.5), control(k)] if k else control(0), 4)
    assert kinds(sink).count("second controller") == 1


def test_answer_to_a_slot_that_was_not_asked_is_never_applied_and_is_reported(loop: Loop) -> None:
    sink = drive(loop, lambda k: [control(k + 1, 2.0), control(k)], 30)
    assert kinds(sink).count("second controller") == 1
    assert np.abs(Run.from_memory(sink).arrays["/actuator/applied"]["voltage"]).max() == 0.0


def test_what_is_thrown_away_is_counted_by_what_it_is_and_the_log_keeps_little_of_it(loop: Loop) -> None:
    sink = MemorySink(channels_of(loop))
    rig = Rig(loop, 0, sink, channels_of(loop), lambda: None)
    frames = {0: [], 1: [control(0), control(0), b"junk", *[control(0, 0.1 * i) for i in range(100)], control(1)]}
    slot = Slot(rig, Script(loop, lambda k: frames[k]))
    for k in range(2):
        slot.run(k * loop.experiment.period_ns)
    outcome = rig.outcome()
    # The first answer to slot 0 is late; all others were sent by a program that was not asked.
    assert (outcome["late"], outcome["malformed"], outcome["foreign"]) == (1, 1, 101)
    assert kinds(sink).count("flood") == 1
    assert Run.from_memory(sink).arrays["/link/control"]["late"].sum() == LOGGED
    assert 1 in Run.from_memory(sink).arrays["/link/control"]["slot"][-1:]  # and the answer is found among them


@pytest.mark.parametrize("slots", [60, 1000])
def test_answers_that_a_stalled_controller_sends_late_are_no_flood(slots: int) -> None:
    """At 1 kHz a stall of 150 ms was called a flood, with exit status 6."""
    patient = compose(load_experiment("dc-motor-hinf", ["limits.watchdog_slots=2000", "duration=60"]), certify=False)
    answered: list[int] = []

    def late(k: int) -> list[bytes]:
        answered.extend(range(k + 1) if k == slots else ())
        return [control(g) for g in answered]

    sink = drive(patient, late, slots + 1)
    assert len(answered) == slots + 1
    assert "flood" not in kinds(sink) and "second controller" not in kinds(sink)


@pytest.mark.parametrize("forged", [0, 1, -1], ids=["none", "another", "old"])
def test_an_answer_to_other_frames_than_were_sent_is_never_applied_and_is_reported(loop: Loop, forged: int) -> None:
    class Both(Script):
        """A second controller that answers first, without the sensor frames, and the true controller."""

        def __init__(self) -> None:
            super().__init__(direct, lambda k: None)
            self.said = [7, 7]

        def ask(self, t_ns: int, frames: Sequence[bytes]) -> None:
            self.said.append(echo(frames))

        def answer(self, t_ns: int, on_frame: Callable[[bytes], bool]) -> None:
            k, true = t_ns // self.period_ns, self.said[-1]
            wrong = {0: 0, 1: true ^ 1, -1: self.said[-2]}[forged]
            for u, echoed in ((2.0, wrong), (0.0, true)):
                on_frame(encode_control(ControlPacket(k, t_ns, 0, 0, 1, ((u,), (u,)), echoed)))

    # without delays every slot has a fresh sample
    at_once = ["network.sc.law.matrix=[[1.0]]", "network.sc.law.kind=markov"]
    direct = compose(load_experiment("dc-motor-hinf", at_once), certify=False)
    sink = MemorySink(channels_of(direct))
    rig = Rig(direct, 0, sink, channels_of(direct), lambda: None, session_wire(b"k" * 16))
    slot = Slot(rig, Both())
    for k in range(30):
        slot.run(k * direct.experiment.period_ns)
    assert kinds(sink) == ["second controller"]
    applied = Run.from_memory(sink).arrays["/actuator/applied"]
    assert np.abs(applied["voltage"]).max() == 0.0 and OK in applied["status"]
    assert rig.outcome()["late"] == 0 and rig.outcome()["foreign"] == 30


def test_packets_of_four_samples_are_certified_and_run_as_the_recursion_says() -> None:
    """Gains that leave the two oldest samples alone are those of two samples: the same verdict and the same bits."""
    two = load_experiment("dc-motor-ours-two-samples", ["duration=3"])
    solved = compose(two).controller
    wide = tuple(tuple(tuple((*row, 0.0, 0.0) for row in mat) for mat in rows) for rows in solved.gains)
    loop = compose(msgspec.structs.replace(two, controller=replace(solved, gains=wide, samples=4)))
    assert loop.samples == 4
    ours, theirs = simulate(loop, 2).arrays, simulate(compose(two), 2).arrays
    assert (ours["/plant/state"] == theirs["/plant/state"]).all()
    assert (ours["/actuator/applied"] == theirs["/actuator/applied"]).all()


def test_a_trip_zeroes_an_input_that_was_not_zero_and_the_run_ends_exactly_after_the_grace(loop: Loop) -> None:
    sink = drive(loop, lambda k: answer(k, ((0.4,), (0.4,))) if k < 10 else answer(k, ((7.0,), (7.0,))), 200)
    applied = Run.from_memory(sink).arrays["/actuator/applied"]
    trip = int(np.flatnonzero(applied["status"] == SAFE)[0])
    assert np.all(applied["voltage"][3:trip] == np.float32(0.4)) and np.all(applied["voltage"][trip:] == 0.0)
    grace = round(loop.experiment.limits.after_trip / loop.experiment.period)
    assert len(applied) == trip + grace + 1


def test_the_watchdog_begins_to_count_when_a_packet_could_have_come(loop: Loop) -> None:
    """The first packet may take d_max slots; of the slots after these the watchdog lets three pass."""
    got = statuses(loop, drive(loop, lambda k: None, 100))
    before = loop.model.d_max + loop.experiment.limits.watchdog_slots
    assert got == [NONE_YET] * before + [SAFE] * (len(got) - before) and len(got) == before + 21  # 1 s of 50 ms behind the trip


@pytest.mark.parametrize(("selection", "row"), [("generated", 1), ("previous", 1), ("both", 2)])
@pytest.mark.parametrize("measured", [-1, 2, 9])
def test_where_nothing_usable_was_there_the_row_of_the_longest_delay_is_taken(selection: str, row: int, measured: int) -> None:
    assert row_index(selection, 0, 1, [measured, measured, 0], 1) == row
