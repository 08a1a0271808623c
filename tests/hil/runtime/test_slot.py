"""The order of a slot, the arrays that the motor of the thesis must keep giving, and no memory that grows with the slots."""

from __future__ import annotations

import hashlib
import tracemalloc
from collections.abc import Sequence

import numpy as np
import pytest

from hil.compose import compose
from hil.experiment import load_experiment
from hil.log.run import Run
from hil.log.topics import channels_of
from hil.log.write import MemorySink
from hil.log.write.provenance import loop_form
from hil.measure.summary import summarise
from hil.measure.view import view_of
from hil.runtime.nodes import session_wire
from hil.runtime.nodes.controller_node import ControlNode
from hil.runtime.nodes.rig import Rig
from hil.runtime.slot import OnFrame, Slot
from hil.runtime.virtual import DirectExchange, simulate


class Spy:
    """Rig and exchange in one, which write down who was called."""

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.cut = False

    def sense(self, t_ns: int) -> list[bytes]:
        self.calls.append("sense")
        return [b"y"]

    def ask(self, t_ns: int, frames: Sequence[bytes]) -> None:
        self.calls.append(f"ask {frames}")

    def record(self, t_ns: int, frames: Sequence[bytes]) -> None:
        self.calls.append("record")

    def answer(self, t_ns: int, on_frame: OnFrame) -> None:
        on_frame(b"u")

    def on_frame(self, data: bytes) -> bool:
        self.calls.append(f"hear {data!r}")
        return True

    def actuate(self, t_ns: int) -> None:
        self.calls.append("actuate")


@pytest.mark.skipif(loop_form() == "compiled", reason="the compiled slot takes a Rig alone, and no spy")
@pytest.mark.parametrize("cut", [False, True])
def test_slot_is_sense_ask_record_receive_actuate_commit_and_one_cut_off_is_not_completed(cut: bool) -> None:
    spy = Spy()
    rig: Rig = spy  # type: ignore[assignment]
    Slot(rig, spy, lambda: spy.calls.append("commit"), lambda: cut).run(7)
    whole = ["sense", "ask [b'y']", "record", "hear b'u'", "actuate", "commit"]
    assert spy.calls == (whole[:4] if cut else whole)


def digest(name: str) -> str:
    """SHA-256 of every field of states and inputs, seed 0, with its name."""
    run = simulate(compose(load_experiment(name)), 0)
    sha = hashlib.sha256()
    for topic in ("/plant/state", "/actuator/applied"):
        records = run.arrays[topic]
        for field in records.dtype.names or ():
            sha.update(field.encode())
            sha.update(np.ascontiguousarray(records[field]).tobytes())
    return sha.hexdigest()


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("dc-motor-hinf", "bb139714c5fa90bf81f440b71894f981b2208fa5d86338d5db89217344d8beba"),
        ("dc-motor-packets", "5f5e7472d2efbd5d686d60f1e27dd96ffca7f6eda56b8d184237e7f3cd3e4bfe"),
    ],
)
def test_states_and_inputs_of_seed_0_are_as_ever(name: str, expected: str) -> None:
    assert digest(name) == expected


def test_a_slot_that_a_signal_cuts_off_is_counted_nowhere() -> None:
    """SIGTERM while slot 3 waits for its answer: rig, summary and the log's last complete slot say 3 slots."""
    loop = compose(load_experiment("dc-motor-hinf", duration=1))
    sink = MemorySink(channels_of(loop))
    rig = Rig(loop, 0, sink, channels_of(loop), lambda: None)
    slot = Slot(rig, DirectExchange(ControlNode(loop)), stopped=lambda: rig.k == 3)
    for k in range(4):
        slot.run(k * loop.experiment.period_ns)
    run = Run.from_memory(sink)
    summary = summarise(view_of(run, loop.experiment))
    assert rig.outcome()["slots"] == summary["slots"] == len(run.arrays["/actuator/applied"]) == 3


@pytest.mark.parametrize("name", ["dc-motor-1khz", "dc-motor-packets"])
def test_no_node_of_a_rig_grows_with_its_slots(name: str) -> None:
    loop = compose(load_experiment(name))
    rig = Rig(loop, 0, MemorySink(channels_of(loop), []), channels_of(loop), lambda: None, session_wire(b"k" * 16))
    node = ControlNode(loop)

    class Here:
        def ask(self, t_ns: int, frames: list[bytes]) -> None:
            self.frames = frames

        def answer(self, t_ns: int, on_frame) -> None:  # type: ignore[no-untyped-def]
            for data in map(node.on_frame, self.frames):
                if data is not None:
                    on_frame(data)

    slot = Slot(rig, Here())  # type: ignore[arg-type]

    def run(first: int, last: int) -> None:
        for k in range(first, last):
            slot.run(k * loop.experiment.period_ns)

    run(0, 1000)
    tracemalloc.start()
    try:
        run(1000, 3000)
        before, _ = tracemalloc.get_traced_memory()  # what is replaced from now on was itself traced
        run(3000, 4250)
        after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert after - before < 5_000  # a list of one number a slot has 10,000 bytes more
