"""Which identifiers to give the packets of a loop: every place among the other messages, as an experiment of its own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from msgspec.structs import replace

from hil.errors import HilError
from hil.experiment import Experiment
from hil.rig.can_bus import can_bus_of
from hil.rig.named_files import with_traffic_files
from hil.rig.normal_form import rig_of
from transport.can_bus_model import BASE_MOST

ROOM: Final = 16
"""Identifiers that are kept for the frames of each packet."""
NEAR: Final = 0.01
"""Share by which the cost of a place may be above the least and still count as as good."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """A place of the loop's packets among the messages of 11 bits.

    Args:
        above: messages that win over them.
        can_id: first identifier of the first sensor node.
        control_can_id: of the control packets.
        moved: messages below that need other identifiers, for there is no room in front of them; 0: none.
        experiment: with these identifiers.
    """

    above: int
    can_id: int
    control_can_id: int
    moved: int
    experiment: Experiment


@dataclass(frozen=True, slots=True, kw_only=True)
class Judged:
    """What a place is worth.

    Args:
        place: the place.
        cost: squared error of a run, in its unit; None where the run was stopped.
        state: of the certificate.
        bounds_ms: bound of the response time of the first sensor node's packet and of the control packet; None without one.
        in_time: whether both have a bound within their period.
    """

    place: Place
    cost: float | None
    state: str
    bounds_ms: tuple[float | None, float | None]
    in_time: bool


def places_of(experiment: Experiment) -> list[Place]:
    """Return every place, from the most urgent on.

    Args:
        experiment: has a CAN bus with time, whose traffic has periods.

    Raises:
        HilError: it has none, its traffic is recorded, or there is no room.
    """
    e = with_traffic_files(experiment)
    rig = rig_of(e)
    bus = can_bus_of(rig)
    if bus is None:
        raise HilError(f"{e.name}: no medium of kind 'can', see hil guide can-bus")
    if bus.table.recorded:
        raise HilError(f"{e.name}: network.media.{bus.name}: recorded frames keep their identifiers, expected periodic traffic")
    names = [rig.sensors[number].name for number in sorted(bus.nodes)]
    need = ROOM * (len(names) + bus.table.control)
    others = sorted({message.can_id for message in bus.table.traffic if not message.extended})
    found = []
    for above in range(len(others) + 1):
        first = others[above - 1] + 1 if above else 0
        room = (others[above] if above < len(others) else BASE_MOST + 1) - first
        shift = max(0, need - room)
        if (others[-1] if others and above < len(others) else first + need - 1) + shift > BASE_MOST:
            continue
        moved = tuple(
            replace(message, can_id=message.can_id + shift) if not message.extended and message.can_id >= first else message
            for message in bus.table.traffic
        )
        nodes = {name: replace(e.network.nodes[name], can_id=first + ROOM * i) for i, name in enumerate(names)}
        media = {**e.network.media, bus.name: replace(bus.table, traffic=moved)}
        control = first + ROOM * len(names)
        links = replace(e.links, control_can_id=control) if bus.table.control else e.links
        changed = replace(e, network=replace(e.network, nodes={**e.network.nodes, **nodes}, media=media), links=links)
        found.append(
            Place(
                above=above, can_id=first, control_can_id=control, moved=len(others) - above if shift else 0, experiment=changed
            )
        )  # fmt: skip
    if not found:
        raise HilError(f"{e.name}: network.media.{bus.name}: no {need} identifiers of 11 bits are left")
    return found


def recommended(judged: list[Judged], *, free: bool) -> Judged | None:
    """Return the least urgent place whose cost is within a hundredth of the least, among those that are in time.

    Certified places count before all others: the bus is left to who needs it. None where no run came to its end.

    Args:
        judged: the places.
        free: only those that leave every other message its identifier.
    """
    able = [each for each in judged if each.cost is not None and (not free or not each.place.moved)]
    for good in ([e for e in able if e.in_time and e.state == "certified"], [e for e in able if e.in_time], able):
        if good:
            least = min(each.cost or 0.0 for each in good)
            return max((e for e in good if (e.cost or 0.0) <= (1.0 + NEAR) * least), key=lambda each: each.place.above)
    return None
