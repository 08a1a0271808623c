"""Topics of the plant: its states, its outputs, and the reference that these follow."""

from __future__ import annotations

from collections.abc import Sequence

from hil.log.topics.topic import TICK, Curve, Topic, floats


def _states(names: Sequence[str], outputs: Sequence[str]) -> list[Curve]:
    return [Curve(panel=name, field=name, place=1) for name in names]


def _outputs(names: Sequence[str], outputs: Sequence[str]) -> list[Curve]:
    return [Curve(panel=name, field=name, place=0) for name in names if name in outputs]


STATE = Topic(
    name="/plant/state", order=1, schema="PlantState", filled_by="rig, every slot", since="0.1.0", paged=True,
    fields=lambda logged: (*floats(logged.states), TICK), curves=_states,
)  # fmt: skip
MEASUREMENT = Topic(
    name="/plant/measurement", order=2, schema="PlantMeasurement", filled_by="rig, every slot", since="0.1.0", paged=True,
    fields=lambda logged: (*floats(logged.outputs), TICK), curves=_outputs,
)  # fmt: skip
REFERENCE = Topic(
    name="/reference", order=3, schema="Reference", filled_by="rig, every slot", since="0.1.0", paged=True,
    fields=lambda logged: (*floats(logged.outputs), TICK), curves=_outputs,
)  # fmt: skip
TOPICS = (STATE, MEASUREMENT, REFERENCE)
