"""Topics of a link alone: what was on a CAN bus that takes time, and the round trips of `hil probe`.

The bus is told in the words of FMI-LS-BUS 1.0: each frame from its Transmit to Confirm or Bus Error.
"""

from __future__ import annotations

from hil.log.topics.topic import TICK, Topic, i32, i64, u8

EXTENDED, REMOTE, FD, SWITCH = 1, 2, 4, 8
"""Bits of ``/link/bus.flags``."""

BUS = Topic(
    name="/link/bus", order=11, schema="BusFrame", filled_by="rig, every frame on the emulated CAN bus", since="0.1.0",
    paged=True, logged=lambda logged: logged.bus,
    fields=lambda logged: (
        i64("queued_ns", "ns", "session time of Transmit: since when it waited"),
        i64("start_ns", "ns", "session time of its start of frame"),
        i64("end_ns", "ns", "session time of the end of its EOF or of the error delimiter"),
        i64("idle_ns", "ns", "session time at which the bus is idle again"), TICK,
        i32("can_id", "1", "identifier, 11 or 29 bits"),
        i32("node", "1", "number of the node that sent it: nodes of the rig, controller, actuator, others"),
        i32("lost", "1", "arbitrations that it has lost (Arbitration Lost)"),
        i32("error_bit", "1", "bit of the frame that was disturbed, -1 if none"),
        i32("tec", "1", "transmit error counter of its node"),
        u8("operation", "0 Confirm, 1 Bus Error"), u8("flags", "1 extended, 2 remote, 4 CAN FD, 8 bit-rate switch"),
        u8("length", "bytes of data"),
    ),
)  # fmt: skip

PROBE = Topic(
    name="/probe/packet", order=11, schema="ProbePacket", filled_by="hil probe", since="0.1.0",
    logged=lambda logged: False,  # no session has it
    fields=lambda logged: (
        i64("sent_ns", "ns", "sensor frame out, since the first one"),
        i64("answered_ns", "ns", "when the other end answered, by its clock, since that instant of ours; 0 if never"),
        i64("received_ns", "ns", "control frame in, 0 if none came"), TICK,
    ),
)  # fmt: skip
TOPICS = (BUS, PROBE)
