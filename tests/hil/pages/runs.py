"""Runs to report on: real loops in virtual time, kept in memory; times of a real-time run are added where wanted."""

from __future__ import annotations

import numpy as np

from hil.compose.loop import compose
from hil.experiment import load_experiment
from hil.log.read.run import Run
from hil.log.topics import channels_of
from hil.log.write.provenance import Provenance
from hil.log.write.sinks import MemorySink
from hil.runtime.virtual import run_virtual
from transport.draws import REASONS


def run_of(name: str, *sets: str, timed: bool = False) -> Run:
    """Return a finished run of a shipped experiment; `timed` adds what a real-time run measures of itself."""
    experiment = load_experiment(name, sets)
    loop = compose(experiment)
    sink = MemorySink(channels_of(loop))
    rig = run_virtual(loop, experiment.seed, sink)
    if timed:
        rng = np.random.default_rng(0)
        put, pack = sink.channel("/timing/slot"), channels_of(loop)["/timing/slot"].schema.pack
        assert put is not None
        lateness = 20.0 + rng.pareto(2.5, rig.k + 1) * 10.0
        for k in range(rig.k + 1):
            late = k % 2000 == 1999
            trip = float("nan") if late else float(90.0 + rng.gamma(2.0, 15.0))
            put(k * experiment.period_ns, pack(float(lateness[k]), trip, 80.0, k, late, 0))
        sink.event(0, "started", "rig started", scheduler="SCHED_FIFO 60")
        sink.event(1999 * experiment.period_ns, "late", "no control packet", slot=1999, severity="warning")
    about = Provenance(
        experiment=experiment.name,
        experiment_text=experiment.text,
        resolved=experiment.resolved(),
        seed=experiment.seed,
        clock="real" if timed else "virtual",
        link="can:hil:rig0" if timed else "memory:",
    )
    return Run.from_memory(
        sink,
        metadata=about.metadata()["hilrig"],
        versions=dict(about.versions),
        codes={"reason": list(REASONS)},
        experiment_text=experiment.text,
        resolved=dict(about.resolved),
        certificate=loop.certificate or {},
    )
