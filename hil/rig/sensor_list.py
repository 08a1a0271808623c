"""The sensor nodes of an experiment as one list of one or more; rig, controller, theory, measures and link read it."""

from __future__ import annotations

from dataclasses import dataclass, replace

from design.controllers import packet_samples
from hil.errors import ExperimentError
from hil.experiment.nodes import ClockTable, TriggerTable
from hil.experiment.tables import Experiment
from hil.rig.sensor_order import first_identifiers, ordered_names
from transport.laws.protocols import NetworkLaw, prepare


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensor:
    """One sensor node.

    Args:
        name: of the node.
        path: where the experiment says what it is, for messages.
        outputs: indices of the plant's outputs, in the order of its packets.
        buffer: samples in one packet.
        trigger: when it sends.
        clock: in which slots it has something to send.
        law: network from it to the controller.
        law_kind: name of the law's plug-in.
        stream: name of the random stream of its channel.
        repeats: the newest packet goes to the controller again in a slot in which no new one has come.
        numbered: the log says of each draw that it is of this node.
        can_id: CAN identifier of its first frame: the lower one wins on a medium with arbitration.
    """

    name: str
    path: str
    outputs: tuple[int, ...]
    buffer: int
    trigger: TriggerTable
    clock: ClockTable
    law: NetworkLaw
    law_kind: str
    stream: str
    repeats: bool
    numbered: bool
    can_id: int

    def prepared(self) -> Sensor:
        """Return the same node, its law tabulated: no process that keeps time computes it."""
        return replace(self, law=prepare(self.law))


def sensors_of(e: Experiment) -> tuple[Sensor, ...]:
    """Return the sensor nodes by number: the named ones, or the only one that `links.sc` stands for.

    Args:
        e: checked.

    Raises:
        ExperimentError: a node measures what the plant does not put out.
    """
    kind = e.kinds.get("links.sc.law", "?")
    if not e.nodes:  # the short form; whoever reads the list need not know it
        return (
            Sensor(
                name="sensor", path="links.sc", outputs=tuple(range(len(e.plant.outputs))), buffer=packet_samples(e.controller),
                trigger=TriggerTable(), clock=ClockTable(), law=e.links.sc.law, law_kind=kind,
                stream="link.sc", repeats=True, numbered=False, can_id=first_identifiers(e)[0],
            ),
        )  # fmt: skip
    names, index = ordered_names(e), {s.name: i for i, s in enumerate(e.plant.outputs)}
    unknown = [
        f"nodes.{name}.outputs[{i}]: the plant has no output {output!r} (there are: {', '.join(index)})"
        for name in names
        for i, output in enumerate(e.nodes[name].outputs)
        if output not in index
    ]
    if unknown:
        raise ExperimentError(e.name, unknown)
    return tuple(
        Sensor(
            name=name, path=f"nodes.{name}", outputs=tuple(index[output] for output in node.outputs), buffer=node.buffer,
            trigger=node.trigger, clock=node.clock, law=e.links.sc.law if node.law is None else node.law,
            law_kind=kind if node.law is None else e.kinds.get(f"nodes.{name}.law", "?"),
            stream=f"link.sc.{name}", repeats=False, numbered=True, can_id=can_id,
        )
        for name, node, can_id in zip(names, map(e.nodes.__getitem__, names), first_identifiers(e), strict=True)
    )  # fmt: skip
