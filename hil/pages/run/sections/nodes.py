"""Named sensor nodes in the report: which node sent in which slot, how old the newest sample of each is, and the load of each."""

from __future__ import annotations

from functools import partial

import numpy as np
import numpy.typing as npt

from hil.log.append_column import pieces
from hil.log.topics import SC
from hil.measure.network_paths import loads
from hil.measure.view import RunView
from hil.pages.html.figures import Block, Cell, Figure, Section, Series, Table
from hil.pages.run.sections.time_panels import Records, curve, curve_of, markers
from transport.draws import DELIVERED, DISORDERED, LOST


def newest_ages(draws: npt.NDArray[np.void], node: int, slots: int) -> npt.NDArray[np.float64]:
    """Return the age in slots of a node's newest sample at the controller, slot by slot; NaN before the first.

    Args:
        draws: records of `/network/sc` with the field `node`.
        node: number of the node.
        slots: length of the run.
    """
    newest = np.full(slots, -1, dtype=np.int64)
    for piece in pieces(draws):
        came = (piece["node"] == node) & np.isin(piece["reason"], (DELIVERED, DISORDERED)) & (piece["tick"] < slots)
        np.maximum.at(newest, piece["tick"][came], piece["packet_tick"][came])
    newest = np.maximum.accumulate(newest) if slots else newest
    return np.where(newest >= 0, np.arange(slots) - newest, np.nan)


def section(view: RunView) -> Section | None:
    """Return the figures and the table of a run whose log numbers its sensor nodes.

    A log that does not has one node, which the figures of the delays show.
    """
    draws, rig = view.run.arrays.get(SC.name), view.rig
    if rig is None or draws is None or not len(draws) or "node" not in (draws.dtype.names or ()):
        return None
    marks, sensors, outputs = view.once(markers), rig.sensors, [signal.name for signal in rig.outputs]
    names, slots = [sensor.name for sensor in sensors], max(int(piece["tick"].max()) for piece in pieces(draws)) + 1
    t = np.asarray(np.arange(slots) * view.period_s, dtype=np.float64)
    sent_by: list[Series] = []
    for reasons, label, colour in (((DELIVERED, DISORDERED), "received", 0), ((LOST,), "lost", 4)):
        chosen = partial(_with_reason, reasons)
        if any(chosen(piece).any() for piece in pieces(draws)):
            sent_s = partial(_sent_s, view.period_s)
            sent_by.append(curve(draws, "node", label=label, style="points", where=chosen, x=sent_s, colour=colour))
    ages = tuple(
        curve_of(t, newest_ages(draws, i, slots), label=name, style="step", colour=i) for i, name in enumerate(names)
    )
    numbered = ", ".join(f"{i}: {name}" for i, name in enumerate(names))
    rows: list[list[Cell]] = [
        [load.node, ", ".join(outputs[i] for i in own.outputs), load.packets, load.lost, load.packets_per_s, load.bits_per_s]
        for own, load in zip(sensors, view.once(loads))
    ]
    blocks: tuple[Block, ...] = (
        Figure(title="Which node sent", y_label="node", series=tuple(sent_by), markers=marks, integer_y=True, note=numbered),
        Figure(
            title="Age of each node's newest sample", y_label="age", y_unit="samples", series=ages, markers=marks, integer_y=True
        ),
        Table(
            title="Network load", columns=["node", "outputs", "packets", "lost", "packets/s", "bit/s"], rows=rows,
            note="Sensor packets as sent, lost ones included, with their headers.",
        ),
    )  # fmt: skip
    return Section(title="Sensor nodes", place=40, blocks=blocks)


SECTIONS = (section,)


def _with_reason(reasons: tuple[int, ...], draws: Records) -> npt.NDArray[np.bool_]:
    return np.isin(draws["reason"], reasons)


def _sent_s(period_s: float, draws: Records) -> npt.NDArray[np.float64]:
    return np.asarray((draws["tick"] - draws["age"]) * period_s, dtype=np.float64)
