"""The sensor nodes of an experiment as one list of one or more; `hil.rig.spec.RigSpec` has them for every room.

In which order sensor nodes count: by their number, and by the CAN identifier that decides the arbitration.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from design.controllers import packet_samples
from hil.errors import ExperimentError
from hil.experiment.nodes import ClockTable, TriggerTable
from hil.experiment.tables import Experiment
from transport.laws.protocols import NetworkLaw
from transport.links.can_identifiers import FRAGMENTS, derived
from transport.links.traits import CanFraming


def ordered_names(e: Experiment) -> list[str]:
    """Return the names of the nodes by their number."""
    names = list(e.network.nodes)
    return sorted(names, key=lambda name: names.index(name) if e.network.nodes[name].id is None else e.network.nodes[name].id)  # type: ignore[arg-type,return-value]


def first_identifiers(given: Sequence[int | None], framing: CanFraming) -> list[int]:
    """Return the CAN identifier of each node's first frame, by number.

    Args:
        given: of each node, that of the experiment; None for that of the link's base.
        framing: of the link.
    """
    count, base = len(given), framing.base
    many = count > FRAGMENTS
    below = [range(base + n, base + n + 1) for n in range(count)] if many else derived(base, framing.fd, count).sensors
    return [own[0] if set_here is None else set_here for set_here, own in zip(given, below)]


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
        can_id: CAN identifier of its first frame on the experiment's link: the lower one wins on a medium with arbitration.
        own_can_id: the one that the experiment sets; None for that of the link's base.
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
    own_can_id: int | None = None


def sensors_of(e: Experiment, names: Sequence[str], framing: CanFraming) -> tuple[Sensor, ...]:
    """Return the sensor nodes by number: the named ones, or the only one that `network.sc` stands for.

    Args:
        e: checked.
        names: of the nodes, by number.
        framing: of the experiment's link.

    Raises:
        ExperimentError: a node measures what the plant does not put out.
    """
    kind = e.kinds.get("network.sc.law", "?")
    if not e.network.nodes:  # the short form; whoever reads the list need not know it
        return (
            Sensor(
                name="sensor", path="network.sc", outputs=tuple(range(len(e.plant.outputs))), buffer=packet_samples(e.controller),
                trigger=TriggerTable(), clock=ClockTable(), law=e.network.sc.law, law_kind=kind,
                stream="link.sc", repeats=True, numbered=False, can_id=first_identifiers([None], framing)[0],
            ),
        )  # fmt: skip
    index = {s.name: i for i, s in enumerate(e.plant.outputs)}
    nodes = [e.network.nodes[name] for name in names]
    unknown = [
        f"network.nodes.{name}.outputs[{i}]: the plant has no output {output!r} (there are: {', '.join(index)})"
        for name, node in zip(names, nodes)
        for i, output in enumerate(node.outputs)
        if output not in index
    ]
    if unknown:
        raise ExperimentError(e.name, unknown)
    return tuple(
        Sensor(
            name=name, path=f"network.nodes.{name}", outputs=tuple(index[output] for output in node.outputs), buffer=node.buffer,
            trigger=node.trigger, clock=node.clock, law=e.network.sc.law if node.law is None else node.law,
            law_kind=kind if node.law is None else e.kinds.get(f"network.nodes.{name}.law", "?"),
            stream=f"link.sc.{name}", repeats=False, numbered=True, can_id=can_id,
            own_can_id=node.can_id,
        )
        for name, node, can_id in zip(names, nodes, first_identifiers([n.can_id for n in nodes], framing), strict=True)
    )  # fmt: skip
