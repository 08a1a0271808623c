"""The topic of a probed link: every round trip of `hil probe`, by the clocks of both ends."""

from __future__ import annotations

from hil.log.topics.topic import TICK, Topic, i64

PROBE = Topic(
    name="/probe/packet", order=11, schema="ProbePacket", filled_by="hil probe", since="0.1.0",
    logged=lambda logged: False,  # no session has it
    fields=lambda logged: (
        i64("sent_ns", "ns", "sensor frame out, since the first one"),
        i64("answered_ns", "ns", "when the other end answered, by its clock, since that instant of ours; 0 if never"),
        i64("received_ns", "ns", "control frame in, 0 if none came"), TICK,
    ),
)  # fmt: skip
TOPICS = (PROBE,)
