"""Topics of the actuator node: what it applied, and what its passivity controller did."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from hil.log.records import STATUS
from hil.log.topics.topic import PACKET_TICK, TICK, Curve, Topic, f64, floats, i32, u8


def _inputs(names: Sequence[str], outputs: Sequence[str]) -> list[Curve]:
    """Plot every input with its disturbance; beside every `x` stands a field `w_x`."""
    inputs = [name for name in names if not (name.startswith("w_") and name[2:] in names)]
    own = [Curve(panel=name, field=field, place=2) for name in inputs for field in (name, f"w_{name}")]
    return [*own, Curve(panel="delays, samples", field="d", place=4)]


APPLIED = Topic(
    name="/actuator/applied", order=4, schema="ActuatorApplied", filled_by="rig, every slot", since="0.1.0", paged=True,
    fields=lambda logged: (
        *(u := floats(logged.inputs)), *(replace(f, name=f"w_{f.name}", doc="input disturbance") for f in u), TICK, PACKET_TICK,
        i32("d", "samples", "age of the packet at the actuator"), i32("row", "1", "index of the row that was applied"),
        u8("status", ", ".join(STATUS)),
    ),
    curves=_inputs,
)  # fmt: skip
PASSIVITY = Topic(
    name="/actuator/passivity", order=11, schema="ActuatorPassivity", filled_by="rig, with limits.passivity", since="0.2.0",
    logged=lambda logged: logged.passivity, paged=True,
    fields=lambda logged: (
        f64("energy", "J", "given by the motor beyond what damping takes"),
        f64("damping", "1", "injected, force per speed of the device"),
        f64("force", floats(logged.inputs)[0].unit if logged.inputs else "1", "injected on top of the command"), TICK,
    ),
)  # fmt: skip
TOPICS = (APPLIED, PASSIVITY)
