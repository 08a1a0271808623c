"""What the log of a slot costs the loop in real time, as a session writes it, beside record by record, alternately at 1 kHz.

Ours is packed by two structs, and leaves with that of the slots around it; record by record, every slot is one write. What is
measured is the mean of as many slots in a row as leave together. Both get the records of the same run, each into a pipe of its
own, behind which a process keeps a log as a session does. Code is as cold as in a session, and the values are as fresh.
"""

from __future__ import annotations

import json
import marshal
import os
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from statistics import median
from typing import Any, Final

from hil.compose import compose
from hil.experiment import load_experiment
from hil.log.topics import channels_of
from hil.log.write import PayloadWriter, Record
from hil.log.write.mcap_sink import McapSink
from hil.log.write.pipe_sink import MOST_TOGETHER, PipeSink
from hil.log.write.provenance import Provenance
from hil.log.write.pump import pump
from hil.rig.loop import Loop
from hil.runtime.clock import RealClock, monotonic_ns
from hil.runtime.real import die_with_parent, go_real_time
from hil.runtime.real.child import python_module
from hil.runtime.virtual import run_virtual

EXPERIMENT: Final = "dc-motor-1khz"
PRIORITY: Final = 60
SLOTS: Final = 200
PERIOD_NS: Final = 1_000_000
KEEP: Final = "keep"

Call = tuple[tuple[str, ...], tuple[Any, ...]]
"""Topics, and what is logged of them: time in ns, and fields."""


class _Calls:
    """Takes what a rig logs, slot by slot: several records at once, or each for itself."""

    def __init__(self, at_once: bool) -> None:
        self.slots: list[list[Call]] = [[]]
        self._at_once = at_once

    def channel(self, topic: str) -> PayloadWriter | None:
        return None

    def records(self, topics: Sequence[str]) -> Record | None:
        if len(topics) > 1 and not self._at_once:
            return None

        def note(t_ns: int, values: Sequence[Any]) -> None:
            self.slots[-1].append((tuple(topics), (t_ns, values)))

        return note

    def event(self, t_ns: int, kind: str, message: str, *, slot: int = -1, severity: str = "info", **data: object) -> None:
        """Events are rare."""

    def commit(self) -> None:
        self.slots.append([])


def loop_log_us(slots: int) -> tuple[float, float]:
    """Return the median time of the log of a slot in the loop, mean of eight in a row, us: ours, and record by record.

    Args:
        slots: of either, at 1 kHz.
    """
    command = python_module("tests.bench.loop_log", str(slots))
    said = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
    ours, plain = json.loads(said)
    return float(ours), float(plain)


_Slot = tuple[list[Record], bytes]
"""What takes the records of a slot, and their times and values, which are made from these bytes just before."""


def _slots_of(loop: Loop, take: Callable[[tuple[str, ...]], Record | None], at_once: bool) -> list[_Slot]:
    calls = _Calls(at_once)
    run_virtual(loop, 0, calls)
    of: dict[tuple[str, ...], Record | None] = {topics: take(topics) for slot in calls.slots for topics, _ in slot}
    made = [[(put, values) for topics, values in slot if (put := of[topics]) is not None] for slot in calls.slots]
    slots = [slot for slot in made if slot][SLOTS // 2 :]
    return [([put for put, _ in slot], marshal.dumps([values for _, values in slot])) for slot in slots]


def _loop() -> Loop:
    return compose(load_experiment(EXPERIMENT, [f"duration={SLOTS / 1000!r}"]), certify=False)


def keep_log() -> None:
    """Keep a log of what comes through the pipe at standard input."""
    die_with_parent(os.getppid())
    about = Provenance(experiment="bench", experiment_text="", resolved={}, seed=0, clock="real", link="")
    channels = channels_of(_loop())
    with McapSink(os.devnull, channels, about, now=lambda: 0.0) as sink:
        pump(0, sink, channels)


def main() -> None:
    """Print both medians, us."""
    die_with_parent(os.getppid())
    loop = _loop()
    channels = channels_of(loop)
    with ExitStack() as stack:
        sinks = []
        for period_ns in (PERIOD_NS, 0):
            reading, writing = os.pipe()
            reader = stack.enter_context(subprocess.Popen(python_module("tests.bench.loop_log", KEEP), stdin=reading))
            stack.callback(reader.kill)
            os.close(reading)
            sinks.append(PipeSink(writing, channels, period_ns))
            stack.callback(sinks[-1].close)
        ours, plain = sinks

        def by_bytes(topics: tuple[str, ...]) -> Record | None:
            (topic,) = topics
            put, pack = plain.channel(topic), channels[topic].schema.pack
            if put is None:
                return None
            return lambda t_ns, values: put(t_ns, pack(*values))

        turns = [(ours, _slots_of(loop, ours.records, True)), (plain, _slots_of(loop, by_bytes, False))]
        go_real_time(PRIORITY, None, awake=True)
        clock, taken = RealClock(monotonic_ns() + PERIOD_NS), ([], [])  # type: tuple[RealClock, tuple[list[int], list[int]]]
        for k in range(2 * MOST_TOGETHER * -(-int(sys.argv[1]) // MOST_TOGETHER)):
            clock.wait_until(k * PERIOD_NS)
            sink, slots = turns[k % 2]
            puts, packed = slots[k % len(slots)]
            made = marshal.loads(packed)  # a session has just computed what it logs
            begun = monotonic_ns()
            for put, (t_ns, values) in zip(puts, made):
                put(t_ns, values)
            sink.commit()
            taken[k % 2].append(monotonic_ns() - begun)
    means = ([sum(each[i : i + MOST_TOGETHER]) / MOST_TOGETHER for i in range(0, len(each), MOST_TOGETHER)] for each in taken)
    print(json.dumps([median(each) / 1e3 for each in means]))


if __name__ == "__main__":
    keep_log() if sys.argv[1] == KEEP else main()
