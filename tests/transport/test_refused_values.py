"""What a message, a frame, a record, a law and a bus may be, up to its edges, and what is refused with its field."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from transport.can_analysis import ErrorBursts, PeriodicMessage
from transport.can_bus_model import CanFrame, Periodic
from transport.can_bus_model.bits import frame_bounds
from transport.errors import FieldError
from transport.law_fit.packet_record import LEAST, PacketRecord
from transport.laws.age import MarkovAge
from transport.laws.packet import PacketLaw
from transport.links.can_identifiers import Identifiers
from transport.medium.scheduled import ArbitratedBus

Make = Callable[..., object]
HALVES = ((0.5, 0.5), (0.5, 0.5))


def message(**values: Any) -> PeriodicMessage:
    return PeriodicMessage(**{"name": "m", "identifier": 1, "period_ns": 1, **values})


def traffic(**values: Any) -> Periodic:
    return Periodic(**{"node": 0, "frame": CanFrame(identifier=1), "period_ns": 1, **values})


def record(n: int = LEAST, late: int = LEAST, until: int | None = None, sent: tuple[int, float] = (0, 0.0)) -> PacketRecord:
    at: NDArray[np.float64] = np.linspace(0.0, 0.1 * (n - 1), n)
    at[sent[0]] += sent[1]
    return PacketRecord(sent_s=at, latency_s=np.zeros(late), until_s=None if until is None else np.full(until, math.inf))


def bus(frames: int) -> ArbitratedBus:
    return ArbitratedBus([], frames, 0.0, np.random.default_rng(0))


def law(*rows: object) -> PacketLaw:
    return PacketLaw(latency={"table": [*rows]})


@pytest.mark.parametrize(
    ("make", "values", "field"),
    [
        (message, {"period_ns": 0}, "period_ns"),
        (message, {"jitter_ns": -1}, "jitter_ns"),
        (ErrorBursts, {"burst": 0, "interval_ns": 1}, "burst"),
        (ErrorBursts, {"interval_ns": 0}, "interval_ns"),
        (traffic, {"period_ns": 0}, "period_ns"),
        (traffic, {"offset_ns": -1}, "offset_ns"),
        (traffic, {"jitter_ns": -1}, "offset_ns"),
        (frame_bounds, {"length": 9}, "length"),
        (frame_bounds, {"length": -1}, "length"),
        (frame_bounds, {"length": 9, "fd": True}, "length"),
        (frame_bounds, {"length": 8, "bitrate_switch": True}, "fd"),
        (record, {"n": LEAST - 1, "late": LEAST - 1}, "packets"),
        (record, {"late": LEAST + 1}, "latency_s"),
        (record, {"until": LEAST + 1}, "latency_s"),
        (record, {"sent": (3, math.inf)}, "sent_s[3]"),
        (record, {"sent": (3, 0.2)}, "sent_s[4]"),
        (MarkovAge, {"matrix": HALVES, "ages": "01"}, "ages"),
        (MarkovAge, {"matrix": HALVES, "ages": 1}, "ages"),
        (MarkovAge, {"matrix": HALVES, "ages": (0, 1, 2)}, "ages"),
        (MarkovAge, {"matrix": HALVES, "ages": (0, -1)}, "ages[1]"),
        (MarkovAge, {"matrix": HALVES, "ages": (0, True)}, "ages[1]"),
        (MarkovAge, {"matrix": (0.5, HALVES[0])}, "matrix[0]"),
        (Identifiers, {"sensors": (range(1), range(1, 1)), "control": range(5, 6)}, "node 1"),
        (Identifiers, {"sensors": (range(-1, 1),), "control": range(5, 6)}, "node 0"),
        (Identifiers, {"sensors": (range(1),), "control": range(0x7FF, 0x801)}, "control"),
        (bus, {"frames": 0}, "frames"),
    ],
)
def test_a_value_out_of_range_is_refused_with_its_field(make: Make, values: dict[str, Any], field: str) -> None:
    with pytest.raises(FieldError) as refused:
        make(**values)
    assert refused.value.field == field


@pytest.mark.parametrize(
    ("make", "values"),
    [
        (message, {"period_ns": 1, "jitter_ns": 0}),
        (ErrorBursts, {"burst": 1, "interval_ns": 1}),
        (traffic, {"offset_ns": 0, "jitter_ns": 0}),
        (frame_bounds, {"length": 0}),
        (frame_bounds, {"length": 64, "fd": True, "bitrate_switch": True}),
        (record, {"until": LEAST}),
        (record, {"sent": (3, 0.1)}),
        (MarkovAge, {"matrix": HALVES, "ages": (0, 1)}),
        (Identifiers, {"sensors": (range(1),), "control": range(0x7FE, 0x800)}),
        (bus, {"frames": 1}),
    ],
)
def test_a_value_at_the_edge_of_its_range_is_taken(make: Make, values: dict[str, Any]) -> None:
    assert make(**values)


@pytest.mark.parametrize(
    ("rows", "place"),
    [
        ([[0.0, 0.001]], ""), ([[0.0, 0.001], 3], "[1]"), ([[0.0, 0.001], [1.0]], "[1]"),
        ([[0.1, 0.001], [1.0, 0.002]], "[0][0]"), ([[0.0, 0.001], [0.9, 0.002]], "[1][0]"),
    ],
)  # fmt: skip
def test_a_table_of_latencies_that_is_none_is_refused_with_its_place(rows: list[object], place: str) -> None:
    with pytest.raises(FieldError) as refused:
        law(*rows)
    assert refused.value.field == f"latency.table{place}"
    law([0.0, 0.001], [1.0, 0.002])
