"""One run, from an experiment to its log and its summary. Read this file from top to bottom."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any, Literal

import msgspec

from hil.compose.loop import compose
from hil.errors import DiskFull
from hil.experiment import Experiment
from hil.log.events import DEPARTED, WITHDRAWN
from hil.log.topics import channels_of
from hil.log.write.mcap_sink import McapSink
from hil.log.write.mcap_writer import Index
from hil.log.write.provenance import Provenance
from hil.log.write.sinks import PayloadWriter, TeeSink, harmless, published, together
from hil.measure.measure import measures_of, quantities_of, refuse_unsound_measures
from hil.measure.signals import signals_of
from hil.measure.summary import summarise
from hil.measure.view import view_of
from hil.rig.loop import Loop
from hil.rig.session_link import link_of, no_link, refuse_undisturbed
from hil.runtime.clock import monotonic_ns, wall_clock
from hil.runtime.real.machine import machine
from hil.runtime.virtual import rehearsal, simulate_as_logged
from hil.session import finished
from hil.session.both_clocks import Onlooker, run_in_real_time, run_in_virtual_time
from hil.session.finished import Session
from transport.draws import REASONS
from transport.packets import SELECTIONS

ClockName = Literal["virtual", "real"]
CARRIED = (
    "the link, a plug-in of the user's own, carries every frame as it was sent: answers are compared before it, the plant behind "
    "it; with auth=KEY an altered frame is refused"
)
"""What a certificate assumes of a link that is not ours."""


def simulated_session(loop: Loop, seed: int) -> Session:
    """Run a loop in virtual time without a file and sum it up: the session of `run_session`, without a log.

    Args:
        loop: the composed experiment; its own seed is not read.
        seed: seed of the run.
    """
    begun = monotonic_ns()
    experiment = loop.experiment
    run = simulate_as_logged(loop, seed)
    summary = summarise(view_of(run, experiment, loop.rig)) | finished.gains_in(loop)
    summary["wall_s"] = round((monotonic_ns() - begun) / 1e9, 3)
    summary["log"] = {"path": None, "sha256": "", "messages": sum(map(len, run.arrays.values())) + len(run.events), "dropped": 0}
    summary["problems"] = finished.messages_of(run, {WITHDRAWN, DEPARTED}) | finished.unreached(loop)
    status = finished.LEFT if finished.kinds_of(run) & {WITHDRAWN, DEPARTED} else 3 if summary["safety"] else 0
    return Session(log=lambda: run, summary=summary, status=status, experiment=experiment)


def run_session(
    experiment: Experiment,
    *,
    clock: ClockName = "virtual",
    link: str | None = None,
    path: Path,
    external: bool = False,
    wait_s: float | None = None,
    taps: Mapping[str, PayloadWriter] | None = None,
    signals: str | None = None,
    index: Index = "full",
    onlooker: Onlooker | None = None,
) -> Session:
    """Run an experiment, log it, and sum it up.

    Args:
        experiment: the checked description.
        clock: ``virtual`` (one process, reproducible) or ``real`` (separate processes over ``link``).
        link: URI of the real link; the experiment's own by default.
        path: the log to write.
        external: an external controller answers on the link.
        wait_s: how long the rig waits for a first answer, s; by default 120 for an external controller.
        taps: topic to a function that gets its records as they come, for a live view.
        signals: where subscribers over zenoh read named signals as they come, such as ``zenoh:tcp/127.0.0.1:7448``.
        index: `full`, or `chunk` for a log of less than half the size that some viewers cannot read.
        onlooker: observes the run, may change it, and in virtual time pace it.

    Raises:
        HilError: if the experiment cannot be composed, the log cannot be written, or the session could not start.
        DiskFull: not one record of the run could be written.
    """
    # 1. Compose: plug-ins, design, certificate. Nothing is started or written before this has passed.
    loop = compose(experiment, external=external)
    refuse_unsound_measures(loop, rehearsal)
    quantities_of(measures_of(experiment), signals_of(experiment.plant))  # measures that disagree are reported now
    on = no_link(loop.rig) if clock == "virtual" else link_of(loop.rig, link)
    refuse_undisturbed(experiment, loop.rig, on)
    loop = _assuming(loop, CARRIED) if clock == "real" and on.unproved else loop

    # 2. Say in the log where it comes from. In virtual time nothing of this machine or this day may stand there.
    provenance = Provenance(
        experiment=experiment.name,
        experiment_text=experiment.text,
        resolved=loop.experiment.resolved(),
        certificate=loop.certificate,
        seed=experiment.seed,
        clock=clock,
        link=on.uri,
        codes={"reason": REASONS, "selection": SELECTIONS},
        channels=on.channel_metadata(loop.rig),
        origins=experiment.origins(),
        session={} if clock == "virtual" else {
            "started": wall_clock(), "external_controller": str(external), "accepted_from": on.traits.commanders, **machine(),
        },
    )

    # 3. Run, with the log open. Real time is watched from here; virtual time runs here.
    begun = monotonic_ns()
    now = None if clock == "virtual" else (lambda: monotonic_ns() / 1e9)
    keep = finished.summary_needs(loop) if clock == "virtual" else None  # nothing is read back then
    table = channels_of(loop, on_can=on.on_can)
    if onlooker is not None:
        taps = together(taps or {}, onlooker.begin(loop, table))
    with (
        published(signals, table, taps) as publishing,
        McapSink(path, table, provenance, now=now, index=index, keep=keep) as sink,
    ):
        observers = harmless(publishing or {}, sink)
        outcome: dict[str, Any] = {}
        if clock == "virtual":
            outcome = run_in_virtual_time(loop, sink, TeeSink(sink, observers) if observers else sink, onlooker)
        else:
            changes = None if onlooker is None else onlooker.changes
            outcome = run_in_real_time(loop, on, sink, external, wait_s, observers, changes)
        sink.commit()
        outcome |= finished.unreached(loop)
        problems = {name: text for name, text in outcome.items() if text}
        if problems:
            sink.summary({"problems": problems})
        log = sink.reader()
        gone = sink.gone()

    # 4. Sum up what the log says, and what only this process knows.
    wall_s = (monotonic_ns() - begun) / 1e9
    if sink.error is not None:
        message = f"disk full at slot {sink.failed_ns // experiment.period_ns}: {sink.error}"
        if not sink.messages:
            os.close(log)
            if gone is None:  # the name is still that of this log
                sink.discard()
            raise DiskFull(f"{message}; it took no record of the run; free some space, or write elsewhere (-o)")
        outcome["log_error"] = f"{message}; what was written before is kept: hil recover {path}"
    if gone is not None:
        outcome["log_lost"] = f"{path} {gone}"
    try:
        if keep is not None:
            run = finished.kept_run(sink, provenance)
        else:
            run = finished.read_back(path, whole=sink.error is None, descriptor=log)
        summary = finished.summary_of(run, loop, sink, outcome, wall_s)
        summary |= {"accepted_from": on.traits.commanders} | finished.gains_in(loop)
        summary["log"]["sha256"] = _sha256(log)
    finally:
        os.close(log)
    status = finished.status_of(run, sink, outcome)
    read = cache(partial(finished.read_back, path)) if keep is not None else lambda: run
    return Session(log=read, summary=summary, status=status, experiment=loop.experiment)


def _assuming(loop: Loop, assumption: str) -> Loop:
    verdict = loop.verdict
    if verdict is None or not verdict.certified:
        return loop
    return replace(loop, verdict=msgspec.structs.replace(verdict, assumptions=(*verdict.assumptions, assumption)))


def _sha256(descriptor: int) -> str:
    with open(descriptor, "rb", closefd=False) as file:
        file.seek(0)
        return hashlib.file_digest(file, "sha256").hexdigest()


