"""A small session's records, for the tests of the log."""

from __future__ import annotations

import math
import random
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hil.log import Logged
from hil.log.records import Channel
from hil.log.run import StructuredArray
from hil.log.topics import channels
from hil.log.write import Sink
from hil.log.write.mcap_sink import McapSink
from hil.log.write.provenance import Provenance

PERIOD_NS = 1_000_000


class Signal(NamedTuple):
    name: str
    unit: str


TABLE: dict[str, Channel] = channels(Logged(
    states=(Signal("angle", "rad"), Signal("speed", "rad/s")),
    inputs=(Signal("voltage", "V"),),
    outputs=(Signal("angle", "rad"),),
    n_rows=3,
))


def provenance(**changes: Any) -> Provenance:
    about: dict[str, Any] = {
        "experiment": "demo",
        "experiment_text": "# demo\nperiod = 0.001\n",
        "resolved": {"period": 0.001, "limits": {"voltage": 24.0}},
        "certificate": {"state": "certified", "reason": "radius below 1", "radius": 0.9},
        "seed": 7,
        "clock": "virtual",
        "link": "memory:",
        "codes": {"reason": ("delivered", "lost"), "status": ("ok", "hold")},
    }
    return Provenance(**{**about, **changes})


def assert_same_arrays(got: dict[str, StructuredArray], expected: dict[str, StructuredArray]) -> None:
    """Same topics, fields and values, NaN included."""
    assert list(got) == list(expected)
    for topic, array in got.items():
        assert array.dtype == expected[topic].dtype
        for name in array.dtype.names or ():
            np.testing.assert_array_equal(array[name], expected[topic][name], err_msg=f"{topic} {name}")


def record(sink: Sink, slots: int, *, start: int = 0, seed: int = 1) -> int:
    """Write what a session of ``slots`` slots writes; returns the number of records."""
    rng = random.Random(seed)
    puts = {topic: (sink.channel(topic), channel.schema.pack) for topic, channel in TABLE.items()}
    count = 0

    def put(topic: str, t_ns: int, *values: Any) -> None:
        nonlocal count
        to, pack = puts[topic]
        if to is not None:
            to(t_ns, pack(*values))
            count += 1

    for k in range(start, start + slots):
        t_ns = k * PERIOD_NS
        angle = math.sin(k / 100)
        put("/plant/state", t_ns, angle, rng.gauss(0, 1), k)
        put("/plant/measurement", t_ns, angle, k)
        put("/reference", t_ns, 3.0, k)
        put("/network/sc", t_ns, math.nan, k, k - 1, rng.randrange(3), 1, 0)
        put("/link/sensor", t_ns, k, 0, rng.randbytes(20))
        if k % 2:
            put("/controller/rows", t_ns, 1.0, 2.0, rng.random(), t_ns, t_ns, k, 1, 2)
            put("/link/control", t_ns, k, 0, rng.randbytes(48))
        put("/network/ca", t_ns, math.nan, k, k, 0, 0, 0)
        put("/actuator/applied", t_ns, rng.random(), 0.0, k, k, 0, 0, 0)
        put("/timing/slot", t_ns, 10.0, math.nan, 100.0, k, 0, 0)
        if k % 100 == 0:
            sink.event(t_ns, "mark", f"slot {k}", slot=k, u=math.nan, reason={"b": 1, "a": [k]})
            count += 1
        sink.commit()
    return count


def record_chunks(path: Path, chunks: int) -> McapSink:
    """Write a log in real-time mode whose every chunk holds 20 slots."""
    now = 0.0
    with McapSink(path, TABLE, provenance(), now=lambda: now) as sink:
        for chunk in range(chunks):
            record(sink, 19, start=20 * chunk, seed=chunk)
            now += 0.06
            record(sink, 1, start=20 * chunk + 19)
        sink.summary({"metrics": {"sse": 1.0}})
    return sink
