"""The CAN bus that takes time: every message beside its bound, and a time line of who sent and who waited."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from hil.log.topics import BUS
from hil.log.topics.loop import EXTENDED
from hil.measure.bus_load import BusLoad, MessageOnBus, bus_of
from hil.measure.view import RunView
from hil.pages.html.figures import Cell, Figure, Section, Series, Table
from hil.pages.html.numbers import can_id_text

SHOWN: Final = 60
"""Frames of the time line on either side of the longest wait of a packet of the rig."""


def section(view: RunView) -> Section | None:
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


SECTIONS = (section,)


def _table(found: BusLoad) -> Table:
    rows: list[list[Cell]] = [
        [
            can_id_text(each.can_id, extended=each.extended), each.name, each.frames, each.errors, 100 * each.load,
            each.waited_ms, each.waited_worst_ms, each.response_worst_ms, each.bound_ms,
        ]
        for each in found.messages
    ]  # fmt: skip
    columns = ["identifier", "message", "frames", "destroyed", "load, %", "waited, ms", "worst, ms", "response, ms", "bound, ms"]
    return Table(
        title="Messages by priority", columns=columns, rows=rows, wide=True,
        note="Waited: from Transmit to the start of the frame that got through, mean and worst. Response: worst, to the end of "
        "EOF. Bound: after Davis, Burns, Bril and Lukkien 2007; none where the load is too high or bits are disturbed.",
    )  # fmt: skip


def _by_node(found: BusLoad) -> tuple[Table, ...]:
    """Return the load of every node, the largest first; nothing where no node sends two messages, for the table above has it."""
    sent: dict[str, list[MessageOnBus]] = {}
    for each in found.messages:
        sent.setdefault(each.node, []).append(each)
    if all(len(own) < 2 for own in sent.values()):
        return ()
    rows: list[list[Cell]] = [
        [node, len(own), sum(each.frames for each in own), sum(each.errors for each in own), 100 * sum(each.load for each in own)]
        for node, own in sorted(sent.items(), key=lambda item: -sum(each.load for each in item[1]))
    ]
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
    names = ", ".join(f"{i}: {each.name}" for i, each in enumerate(found.messages))
    return Figure(
        title="The bus around the longest wait of a packet of the rig", y_label="message", series=tuple(series), sync=None,
        integer_y=True, height_px=max(240, min(14 * len(found.messages) + 60, 600)), note=f"By priority, {names}.",
    )  # fmt: skip


def _bars(
    grid: npt.NDArray[np.int64], begin: npt.NDArray[np.int64], end: npt.NDArray[np.int64], row: int, label: str, *, faint: bool
) -> Series:  # fmt: skip
    """Return pieces of a line at one height; all series of the figure have the same instants, or a gap would be bridged."""
    inside = ((begin[:, None] <= grid) & (grid <= end[:, None])).any(axis=0)
    return Series(label=label, x=grid / 1e9, y=np.where(inside, float(row), np.nan), colour=row, faint=faint)
