"""The sensor nodes of an experiment: one list of one or more, the media that they share, and what is wrong with them.

They count by their number, or by the CAN identifier that decides the arbitration; `hil.rig.RigSpec` has them for every room.
"""

from __future__ import annotations

from collections.abc import Sequence

from msgspec import Struct

from design.controllers import controller_traits
from hil.errors import nearest
from hil.experiment.nodes import ClockTable, Medium, TriggerTable
from hil.experiment.tables import Experiment
from transport.laws import BoundedAge, NetworkLaw
from transport.links.can_identifiers import FRAGMENTS, derived
from transport.links.traits import CanFraming
from transport.packets import MAX_OUTPUTS, MAX_VALUES


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


class Sensor(Struct, frozen=True, kw_only=True):
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
        numbered: the log says of each draw that it is of this node; the newest packet of the only one that is not goes to the
            controller again in a slot in which no new one has come.
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
    numbered: bool
    can_id: int
    own_can_id: int | None = None


def sensors_of(e: Experiment, names: Sequence[str], framing: CanFraming) -> tuple[Sensor, ...]:
    """Return the sensor nodes by number: the named ones, or the only one that `network.sc` stands for.

    Args:
        e: checked, see `node_faults`.
        names: of the nodes, by number.
        framing: of the experiment's link.
    """
    kind = e.kinds.get("network.sc.law", "?")
    if not e.network.nodes:  # the short form; readers of the list need not know it
        return (
            Sensor(
                name="sensor", path="network.sc", outputs=tuple(range(len(e.plant.outputs))), law=e.network.sc.law, law_kind=kind,
                buffer=controller_traits(e.controller).samples, trigger=TriggerTable(), clock=ClockTable(),
                stream="link.sc", numbered=False, can_id=first_identifiers([None], framing)[0],
            ),
        )  # fmt: skip
    index = {s.name: i for i, s in enumerate(e.plant.outputs)}
    nodes = [e.network.nodes[name] for name in names]
    return tuple(
        Sensor(
            name=name, path=f"network.nodes.{name}", outputs=tuple(index[output] for output in node.outputs), buffer=node.buffer,
            trigger=node.trigger, clock=node.clock, law=e.network.sc.law if node.law is None else node.law,
            law_kind=kind if node.law is None else e.kinds.get(f"network.nodes.{name}.law", "?"),
            stream=f"link.sc.{name}", numbered=True, can_id=can_id, own_can_id=node.can_id,
        )
        for name, node, can_id in zip(names, nodes, first_identifiers([n.can_id for n in nodes], framing), strict=True)
    )  # fmt: skip


MOST_NODES = 255


class SharedMedium(Struct, frozen=True, kw_only=True):
    """A medium on which some nodes take turns.

    Args:
        name: of the medium.
        nodes: numbers of its nodes, in its order.
        table: how they take turns.
    """

    name: str
    nodes: tuple[int, ...]
    table: Medium


def node_faults(e: Experiment) -> list[str]:
    """Return what is wrong with nodes and media, each with its path."""
    nodes, media, covered = e.network.nodes, e.network.media, e.network.sc.max_age
    if not nodes:
        return [f"network.media.{name}: no node shares it; add [network.nodes.NAME]" for name in media]
    faults, outputs, samples = [], [s.name for s in e.plant.outputs], controller_traits(e.controller).samples
    if samples > 1 and (len(nodes) > 1 or min(node.buffer for node in nodes.values()) < samples):
        faults.append(f"controller.samples: {samples} in one packet, but no node alone sends so many samples of every output")
    owner: dict[str, str] = {}
    taken: dict[int, str] = {}
    if len(nodes) > MOST_NODES:
        faults.append(f"network.nodes: {len(nodes)} of them, at most {MOST_NODES}")
    for name, node in nodes.items():
        own, number = f"network.nodes.{name}", node.id or 0
        if not 0 <= number < len(nodes):
            faults.append(f"{own}.id: {number}, expected 0 to {len(nodes) - 1}, a number for each node")
        elif number in taken:
            faults.append(f"{own}.id: {number} is the number of node {taken[number]!r} already")
        taken.setdefault(number, name)
        for i, output in enumerate(node.outputs):
            at = f"{own}.outputs[{i}]"
            if output not in outputs:
                hint = nearest(output, outputs)
                faults.append(f"{at}: the plant has no output {output!r}{hint} (there are: {', '.join(outputs)})")
            elif owner.setdefault(output, name) != name:
                faults.append(f"{at}: {output!r} is measured by node {owner[output]!r} already")
        if len(node.outputs) > MAX_OUTPUTS or len(node.outputs) * node.buffer + len(outputs) > MAX_VALUES:
            faults.append(f"{own}.buffer: {node.buffer} samples of {len(node.outputs)} outputs do not fit a packet")
        bound = node.law.max_age if isinstance(node.law, BoundedAge) else None
        if bound is not None and bound > covered:
            faults.append(f"{own}.law: its largest delay {bound} is above network.sc.max_age = {covered}")
    faults += [f"network.nodes: no node measures the output {name!r}" for name in outputs if name not in owner]
    on: dict[str, str] = {}
    for name, medium in media.items():
        for i, node_name in enumerate(medium.nodes):
            at = f"network.media.{name}.nodes[{i}]"
            if node_name not in nodes:
                faults.append(f"{at}: there is no node {node_name!r}{nearest(node_name, nodes)} (there are: {', '.join(nodes)})")
            elif on.setdefault(node_name, name) != name:
                faults.append(f"{at}: node {node_name!r} is on medium {on[node_name]!r} already")
    return faults


def shared_media(e: Experiment, names: Sequence[str]) -> tuple[SharedMedium, ...]:
    """Return the media on which nodes take turns.

    Args:
        e: checked.
        names: of the nodes, by number.
    """
    number = {name: i for i, name in enumerate(names)}
    return tuple(
        SharedMedium(name=name, nodes=tuple(number[node] for node in medium.nodes), table=medium)
        for name, medium in e.network.media.items()
        if medium.kind != "independent"
    )
