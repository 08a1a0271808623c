"""What was sent in a run: which sensor node sent when, how old its newest sample is; every message on a CAN bus with time.

Every message of such a bus stands beside its bound, and a time line says who sent and who waited.
"""

from __future__ import annotations

from functools import partial
from typing import Final

import numpy as np
import numpy.typing as npt

from hil.log.append_column import pieces
from hil.log.topics import BUS, EXTENDED, SC
from hil.measure.bus_load import BusLoad, MessageOnBus, bus_of
from hil.measure.network_paths import loads
from hil.measure.view import RunView
from hil.pages import Block, Cell, Figure, Section, Series, Table
from hil.pages.html import can_id_text
from hil.pages.sections.time_panels import Records, curve, markers
from transport.draws import DELIVERED, DISORDERED, LOST

SHOWN: Final = 60
"""Frames of the time line on either side of the longest wait of a packet of the rig."""


def newest_ages(draws: npt.NDArray[np.void], node: int, slots: int) -> npt.NDArray[np.float64]:
    """Return the age in slots of a node's newest sample at the controller, slot by slot; NaN before the first.

    Args:
        draws: records of `/network/sc` with the field `node`.
        node: number of the node.
        slots: length of the run.
    """
    newest = np.full(slots, -1, dtype=np.int64)
    for piece in pieces(draws):
        came = (piece["node"] == node) & np.isin(piece["reason"], (DELIVERED, DISORDERED))
        came &= (piece["slot"] >= 0) & (piece["slot"] < slots)
        np.maximum.at(newest, piece["slot"][came], piece["packet_slot"][came])
    newest = np.maximum.accumulate(newest) if slots else newest
    return np.where(newest >= 0, np.arange(slots) - newest, np.nan)


def sensor_nodes(view: RunView) -> Section | None:
    """Return the figures and the table of a run whose log numbers its sensor nodes.

    A log that does not has one node, which the figures of the delays show.
    """
    draws, rig = view.run.arrays.get(SC.name), view.rig
    if rig is None or draws is None or not len(draws) or "node" not in (draws.dtype.names or ()):
        return None
    marks, sensors, outputs = view.once(markers), rig.sensors, [signal.name for signal in rig.outputs]
    names, slots = [sensor.name for sensor in sensors], max(int(piece["slot"].max()) for piece in pieces(draws)) + 1
    t = np.asarray(np.arange(slots) * view.period_s, dtype=np.float64)
    sent_by: list[Series] = []
    for reasons, label, colour in (((DELIVERED, DISORDERED), "received", 0), ((LOST,), "lost", 4)):
        chosen = partial(_with_reason, reasons)
        if any(chosen(piece).any() for piece in pieces(draws)):
            sent_s = partial(_sent_s, view.period_s)
            sent_by.append(curve(draws, "node", label=label, style="points", where=chosen, x=sent_s, colour=colour))
    ages = tuple(Series(label=name, x=t, y=newest_ages(draws, i, slots), style="step", colour=i) for i, name in enumerate(names))
    rows: list[list[Cell]] = [
        [load.node, ", ".join(outputs[i] for i in own.outputs), load.packets, load.lost, load.packets_per_s, load.bits_per_s]
        for own, load in zip(sensors, view.once(loads))
    ]
    blocks: tuple[Block, ...] = (
        Figure(
            title="Which node sent", y_label="node", series=tuple(sent_by), markers=marks, integer_y=True, y_names=tuple(names)
        ),
        Figure(
            title="Age of each node's newest sample", y_label="age", y_unit="samples", series=ages, markers=marks, integer_y=True
        ),
        Table(
            title="Network load", columns=["node", "outputs", "packets", "lost", "packets/s", "bit/s"], rows=rows,
            note="Sensor packets as sent, lost ones included, with their headers.",
        ),
    )  # fmt: skip
    return Section(title="Sensor nodes", place=40, blocks=blocks)


def _with_reason(reasons: tuple[int, ...], draws: Records) -> npt.NDArray[np.bool_]:
    return np.isin(draws["reason"], reasons)


def _sent_s(period_s: float, draws: Records) -> npt.NDArray[np.float64]:
    return np.asarray((draws["slot"] - draws["age"]) * period_s, dtype=np.float64)


def can_bus(view: RunView) -> Section | None:
    """Return the section of a run with such a bus."""
    found = view.once(bus_of)
    if found is None:
        return None
    return Section(
        title="CAN bus",
        place=45,
        intro=f"{found.bitrate:,} bit/s{f', data {found.dbitrate:,} bit/s' if found.dbitrate else ''}: in use for "
        f"{100 * found.load:.1f} % of the time, {found.frames} frames, {found.errors} destroyed. The longest frames at their "
        f"periods would take {100 * found.stated_load:.1f} %.",
        blocks=(_table(found), *_by_node(found), _time_line(view.run.arrays[BUS.name], found)),
    )  # fmt: skip


def _table(found: BusLoad) -> Table:
    rows: list[list[Cell]] = [
        [
            can_id_text(each.can_id, extended=each.extended), each.name, each.frames, each.errors, _short(100 * each.load),
            _short(each.waited_ms), each.waited_worst_ms, each.response_worst_ms, each.bound_ms,
        ]
        for each in found.messages
    ]  # fmt: skip
    columns = ["identifier", "message", "frames", "destroyed", "load, %", "waited, ms", "worst, ms", "response, ms", "bound, ms"]
    return Table(
        title="Messages by priority", columns=columns, rows=rows, wide=True,
        note="Waited: from Transmit to the start of the frame that got through, mean and worst. Response: worst, to the end of "
        "EOF. Bound: after Davis, Burns, Bril and Lukkien 2007; none where the load is too high or bits are disturbed.",
    )  # fmt: skip


def _short(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.4g}")


def _by_node(found: BusLoad) -> tuple[Table, ...]:
    """Return the load of every node, the largest first; nothing where no node sends two messages, for the table above has it."""
    sent: dict[str, list[MessageOnBus]] = {}
    for each in found.messages:
        sent.setdefault(each.node, []).append(each)
    if all(len(own) < 2 for own in sent.values()):
        return ()
    rows: list[list[Cell]] = [
        [
            node, len(own), sum(each.frames for each in own), sum(each.errors for each in own),
            _short(100 * sum(each.load for each in own)),
        ]
        for node, own in sorted(sent.items(), key=lambda item: -sum(each.load for each in item[1]))
    ]  # fmt: skip
    return (Table(title="Load by node", columns=["node", "messages", "frames", "destroyed", "load, %"], rows=rows),)


def _time_line(frames: npt.NDArray[np.void], found: BusLoad) -> Figure:
    """Return who sent and who waited around the longest wait of a packet of the rig."""
    place = {(each.extended, each.can_id): i for i, each in enumerate(found.messages)}
    shown = frames[max(found.longest - SHOWN, 0) : found.longest + SHOWN]
    edges: list[npt.NDArray[np.int64]] = [shown[name] for name in ("queued_ns", "start_ns", "end_ns")]
    grid = np.unique(np.concatenate([*edges, *(edge + 1000 for edge in edges)]))  # less than a bit later
    grid = grid[grid >= shown["start_ns"][0]]
    extended: npt.NDArray[np.bool_] = (shown["flags"] & EXTENDED).astype(bool)
    series = []
    for key, i in place.items():
        mine = shown[(shown["can_id"] == key[1]) & (extended == key[0])]
        if len(mine):
            name = found.messages[i].name
            if found.messages[i].node in found.own_nodes:
                series.append(_bars(grid, mine["queued_ns"], mine["start_ns"], i, f"{name} waits", faint=True))
            series.append(_bars(grid, mine["start_ns"], mine["end_ns"], i, name, faint=False))
    broken = shown[shown["operation"] != 0]
    if len(broken):
        rows = [place.get((bool(f["flags"] & EXTENDED), int(f["can_id"])), -1) for f in broken]
        errors = Series(label="Bus Error", x=broken["end_ns"] / 1e9, y=np.array(rows, dtype=float), style="points", colour=4)
        series.append(errors)
    return Figure(
        title="The bus around the longest wait of a packet of the rig", y_label="message", series=tuple(series), sync=None,
        integer_y=True, height_px=max(240, min(14 * len(found.messages) + 60, 600)),
        y_names=tuple(each.name for each in found.messages), note="By priority, the most urgent message at the foot.",
    )  # fmt: skip


def _bars(
    grid: npt.NDArray[np.int64], begin: npt.NDArray[np.int64], end: npt.NDArray[np.int64], row: int, label: str, *, faint: bool
) -> Series:  # fmt: skip
    """Return pieces of a line at one height; all series of the figure have the same instants, or a gap would be bridged."""
    inside = ((begin[:, None] <= grid) & (grid <= end[:, None])).any(axis=0)
    return Series(label=label, x=grid / 1e9, y=np.where(inside, float(row), np.nan), colour=row, faint=faint)


SECTIONS = (sensor_nodes, can_bus)
