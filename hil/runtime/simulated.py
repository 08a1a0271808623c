"""Runs in virtual time in memory: for sweeps, for theory beside what ran, for rehearsals and tests."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import Any

import msgspec

from hil.log.run import Run
from hil.log.topics import channels_of
from hil.log.write.sinks import MemorySink
from hil.rig.loop import Loop
from hil.runtime.virtual import run_virtual
from transport.draws import REASONS
from transport.packets import SELECTIONS


def simulate(loop: Loop, seed: int, topics: Collection[str] | None = None) -> Run:
    """Run a loop in virtual time without a file, keeping only some topics."""
    sink = MemorySink(channels_of(loop), topics)
    rig = run_virtual(loop, seed, sink)
    return Run.from_memory(sink, summary=dict(rig.outcome()))


def simulate_as_logged(loop: Loop, seed: int) -> Run:
    """Run a loop in virtual time without a file; return what its log would say."""
    sink = MemorySink(channels_of(loop))
    rig = run_virtual(loop, seed, sink)
    return _as_logged(sink, loop, seed, summary=dict(rig.outcome()))


def rehearsal(loop: Loop, slots: int = 20) -> Run:
    """Return the first slots of a run, which ends in order where a plug-in fails."""
    experiment = loop.experiment
    short = msgspec.structs.replace(experiment, duration=min(slots, experiment.slots) * experiment.period)
    sink = MemorySink(channels_of(loop))
    run_virtual(replace(loop, experiment=short), 0, sink, failed=lambda error: not isinstance(error, KeyboardInterrupt))
    return _as_logged(sink, loop, 0)


def _as_logged(sink: MemorySink, loop: Loop, seed: int, **about: Any) -> Run:
    experiment = loop.experiment
    return Run.from_memory(
        sink,
        metadata={"experiment": experiment.name, "seed": str(seed), "clock": "virtual", "link": "memory:"} | experiment.origins(),
        codes={"reason": list(REASONS), "selection": list(SELECTIONS)},
        experiment_text=experiment.text,
        resolved=experiment.resolved(),
        certificate=loop.certificate or {},
        **about,
    )
