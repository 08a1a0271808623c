"""The topic of the controller's answers: every row of the send-all packet, and what it was computed from."""

from __future__ import annotations

from hil.log.records import Field
from hil.log.topics.topic import TICK, Curve, Logged, Topic, floats, i32, i64


def _fields(logged: Logged) -> tuple[Field, ...]:
    u = floats(logged.inputs)
    rows = (Field(type="float64", name=f"row{i}_{f.name}", unit=f.unit) for i in range(max(logged.n_rows, 1)) for f in u)
    return (
        *rows, i64("sample_ns", "ns", "nominal time of the sample that was used"),
        i64("control_ns", "ns", "when the controller answered"), TICK,
        i32("tau", "samples", "sensor delay that the controller measured"),
        i32("selection", "1", "code of the selection rule"),
    )  # fmt: skip


ROWS = Topic(
    name="/controller/rows", order=5, schema="ControllerRows", filled_by="rig, when an answer arrives", since="0.1.0", paged=True,
    fields=_fields, curves=lambda names, outputs: [Curve(panel="delays, samples", field="tau", place=3)],
)  # fmt: skip
TOPICS = (ROWS,)
