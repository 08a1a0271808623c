"""Packets in our own logs: what `hil probe` measured, or what the emulated network of a run did with every packet."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hil.errors import HilError
from hil.log.read.arrays import StructuredArray
from hil.log.read.run import read_run
from hil.log.run import Run
from hil.log.topics import CA, PROBE, SC
from hil.recordings.recording import BACK, THERE, Recording, Way
from transport.draws import DELIVERED, LOST, NO_MODE, OVERFLOW, SENT


def read_own_log(path: Path) -> Recording:
    """Read a log of `hil probe`, or of a run.

    Raises:
        HilError: it is no log, or has no packets.
    """
    run = read_run(path)
    if PROBE.name in run.arrays:
        return _probe(path, run)
    if SC.name not in run.arrays or CA.name not in run.arrays:
        raise HilError(f"{path}: has no packets; expected a log of `hil probe` or of a run")
    period = float(run.resolved.get("period", 0.0))
    if not period > 0.0:
        raise HilError(f"{path}: resolved.json: period: missing, expected seconds")
    nodes = run.arrays[SC.name]
    if "node" in (nodes.dtype.names or ()) and len(np.unique(nodes["node"])) > 1:
        raise HilError(f"{path}: several sensor nodes; a law is that of one")
    ways = {name: _emulated(run.arrays[topic], period) for name, topic in ((THERE, SC.name), (BACK, CA.name))}
    notes = (f"{path}: the emulated network of a run, and no measured one: {run.metadata.get('experiment', '?')}",)
    return Recording(source=str(path), ways=ways, clocks=1, notes=notes)


def _emulated(draws: StructuredArray, period_s: float) -> Way:
    """A packet law says the latency of every packet; under an age law what was superseded has not come by then."""
    own = draws["mode"] != NO_MODE
    if np.isin(draws["reason"][own], (SENT, LOST, OVERFLOW)).all():
        ticks = draws["packet_tick"][own]
        latency = np.where(draws["reason"][own] == SENT, draws["latency_s"][own], np.nan)
        return Way(sent_s=ticks * period_s, difference_s=latency)
    slots = int(draws["tick"].max(initial=-1)) + 1
    latency, until = np.full(slots, np.nan), np.arange(slots, 0, -1, dtype=np.float64) * period_s
    arrived = draws[(draws["reason"] == DELIVERED) & (draws["packet_tick"] >= 0)]
    newest = -1
    for tick, packet in zip(arrived["tick"].tolist(), arrived["packet_tick"].tolist()):
        if packet > newest:
            latency[packet] = (tick - packet) * period_s
            overtaken = np.arange(newest + 1, packet)
            until[overtaken] = (tick - overtaken) * period_s
            newest = packet
    return Way(sent_s=np.arange(slots, dtype=np.float64) * period_s, difference_s=latency, until_s=until)


def _probe(path: Path, run: Run) -> Recording:
    found = run.arrays[PROBE.name]
    sent, there, back = (found[name] * 1e-9 for name in ("sent_ns", "answered_ns", "received_ns"))
    came = found["received_ns"] > 0
    where = run.session.get("clocks", "2")
    return Recording(
        source=str(path), clocks=1 if where == "1" else 2,
        ways={THERE: Way(sent_s=sent, difference_s=np.where(came, there - sent, np.nan)),
              BACK: Way(sent_s=there[came], difference_s=(back - there)[came])},
        notes=(f"{path}: {int((~came).sum())} of {len(found)} round trips did not come back: on which way is not known, "
               "they are counted as lost on the way there",) if not came.all() else (),
    )  # fmt: skip
