"""Topics of the emulated network: what it decided about every packet, in each direction."""

from __future__ import annotations

from hil.log.records import Field
from hil.log.topics.topic import PACKET_TICK, TICK, Curve, Topic, f64, i32, u8

_DRAW: tuple[Field, ...] = (
    f64("latency_s", "s", "drawn latency, NaN for an age law"), TICK, PACKET_TICK,
    i32("mode", "1", "mode of the law"), i32("age", "samples", "age of the newest packet, -1 if none"),
    u8("reason", "code of the fate, names in the metadata"),
)  # fmt: skip
_NODE_DRAW = (*_DRAW[:-1], i32("node", "1", "number of the sensor node"), _DRAW[-1])
_AGE = (Curve(panel="network, age in samples", field="age", place=5),)

SC = Topic(
    name="/network/sc", order=6, filled_by="rig, every decision of the medium", since="0.1.0", paged=True,
    schema=lambda logged: "NodeDraw" if logged.numbered else "NetworkDraw",
    fields=lambda logged: _NODE_DRAW if logged.numbered else _DRAW, curves=lambda names, outputs: _AGE,
)  # fmt: skip
CA = Topic(
    name="/network/ca", order=7, filled_by="rig, every decision of the medium", since="0.1.0", paged=True,
    schema="NetworkDraw", fields=lambda logged: _DRAW, curves=lambda names, outputs: _AGE,
)  # fmt: skip
TOPICS = (SC, CA)
