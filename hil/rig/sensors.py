"""The sensor nodes of an experiment: what is wrong with them, who shares what, and what the theory takes of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from design.controllers import SensorNodes, Turns
from hil.experiment import Experiment
from hil.experiment.nodes import Medium
from hil.rig.schedules import bus_cycle
from hil.rig.sensor_list import Sensor
from transport.laws.delay_states import delay_states
from transport.laws.protocols import BoundedAge, NetworkLaw
from transport.packets import MAX_OUTPUTS, MAX_VALUES

MOST_NODES = 255


@dataclass(frozen=True, slots=True, kw_only=True)
class SharedMedium:
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
    faults, outputs = [], [s.name for s in e.plant.outputs]
    owner: dict[str, str] = {}
    taken: dict[int, str] = {}
    if len(nodes) > MOST_NODES:
        faults.append(f"network.nodes: {len(nodes)} of them, at most {MOST_NODES}")
    for position, (name, node) in enumerate(nodes.items()):
        own, number = f"network.nodes.{name}", position if node.id is None else node.id
        if not 0 <= number < len(nodes):
            faults.append(f"{own}.id: {number}, expected 0 to {len(nodes) - 1}, a number for each node")
        elif number in taken:
            faults.append(f"{own}.id: {number} is the number of node {taken[number]!r} already")
        taken.setdefault(number, name)
        for i, output in enumerate(node.outputs):
            at = f"{own}.outputs[{i}]"
            if output not in outputs:
                faults.append(f"{at}: the plant has no output {output!r} (there are: {', '.join(outputs)})")
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
                faults.append(f"{at}: there is no node {node_name!r} (there are: {', '.join(nodes)})")
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


def sensor_nodes(sensors: Sequence[Sensor], shared: Sequence[SharedMedium]) -> SensorNodes:
    """Return the sensor nodes as a controller and the theory see them.

    Args:
        sensors: the nodes, by number.
        shared: media on which they take turns.
    """
    mixed = len(shared) > 1 or any(set(medium.nodes) != set(range(len(sensors))) for medium in shared)
    on_bus = bool(shared) and not mixed and shared[0].table.kind == "can-arbitration"
    turns = _turns(shared[0], sensors) if shared and not mixed else None
    return SensorNodes(
        names=tuple(s.name for s in sensors),
        outputs=tuple(s.outputs for s in sensors),
        buffers=tuple(s.buffer for s in sensors),
        delays=tuple(_constant_delay(s.law) for s in sensors),
        turns=turns if isinstance(turns, Turns) else None,
        silent=tuple(s.name for s in sensors if s.trigger.kind != "every-slot" or (s.clock.every > 1 and not on_bus)),
        mixed=mixed,
        unforeseen=turns if isinstance(turns, str) else "",
    )


def _turns(shared: SharedMedium, sensors: Sequence[Sensor]) -> Turns | str:
    table = shared.table
    if table.kind == "can":
        return "the theory knows no chain of the delays that a CAN bus in time makes"
    if table.kind == "can-arbitration":
        received = bus_cycle([s.clock for s in sensors], table.frames, [s.can_id for s in sensors])
        return received if isinstance(received, str) else Turns(received=received, loss=table.loss)
    if table.kind == "round-robin":
        return Turns(order=shared.nodes, phase=table.phase, loss=table.loss)
    position = {node: i for i, node in enumerate(shared.nodes)}
    every, matrix, shares = range(len(position)), table.transition(), table.shares()
    transition = tuple(tuple(matrix[position[a]][position[b]] for b in every) for a in every)
    return Turns(transition=transition, initial=tuple(shares[position[a]] for a in every), loss=table.loss)


def _constant_delay(law: NetworkLaw) -> int | None:
    states = delay_states(law)
    if states is None:
        return None
    ages: Sequence[int] = sorted({int(age) for age in states.ages})
    return ages[0] if len(ages) == 1 else None
