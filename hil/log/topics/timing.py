"""The topic of what was measured of a slot in real time."""

from __future__ import annotations

from hil.log.topics.topic import TICK, Curve, Topic, f64, u8

TIMING = Topic(
    name="/timing/tick", order=10, schema="TickTiming", filled_by="rig process, in real time", since="0.1.0", paged=True,
    fields=lambda logged: (
        f64("lateness_us", "us", "wake-up after the nominal time"),
        f64("round_trip_us", "us", "sensor frame out to control frame in, NaN if none came"),
        f64("work_us", "us", "time spent in the slot, waiting excluded"), TICK,
        u8("late", "no packet before the deadline"), u8("overrun", "the slot ended after its period"),
    ),
    curves=lambda names, outputs: [Curve(panel="timing, us", field=name, place=6) for name in ("lateness_us", "round_trip_us")],
)  # fmt: skip
TOPICS = (TIMING,)
