"""Topics of the link: every frame, with its CAN identifier where there is one."""

from __future__ import annotations

from hil.log.records import Field
from hil.log.topics.topic import TICK, Logged, Topic, i32, u8

_CAN_ID = i32("can_id", "1", "CAN identifier of the frame, of the first one where several carry the packet")
_FRAME = (u8("late", "came after the deadline"), Field(type="uint8[]", name="data", doc="bytes on the link"))


def _schema(logged: Logged) -> str:
    return "CanFrame" if logged.on_can else "LinkFrame"


def _fields(logged: Logged) -> tuple[Field, ...]:
    return (TICK, *((_CAN_ID,) if logged.on_can else ()), *_FRAME)


SENSOR = Topic(
    name="/link/sensor", order=8, schema=_schema, fields=_fields, filled_by="rig, every sensor frame", since="0.1.0",
    paged=True, frames=True,
)  # fmt: skip
CONTROL = Topic(
    name="/link/control", order=9, schema=_schema, fields=_fields, filled_by="rig, every control frame", since="0.1.0",
    paged=True, frames=True,
)  # fmt: skip
TOPICS = (SENSOR, CONTROL)
