"""A loop's packets on a CAN bus with time: the network laws that it makes of them, and which identifiers to give them.

A law is exact where the ages repeat, else estimated from a run. Every place among the other messages is an experiment of its own.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from design.processes.delay_chain import DelayChain
from hil.errors import HilError, located
from hil.experiment import Experiment
from hil.experiment.nodes import ClockTable
from hil.experiment.table import Seconds
from hil.files.toml_text import toml_lines
from hil.log.recordings import class_text, fit_document, law_text
from hil.log.topics import APPLIED, BUS
from hil.rig import RigSpec, rig_of
from hil.rig.bus_delays import BusDelays, bus_delays, chain_of_ages
from hil.rig.can_bus import can_bus_of, own_packets
from hil.rig.loop import Loop
from hil.rig.named_files import with_traffic_files
from hil.rig.sensors import SharedMedium
from transport.can_bus_model import BASE_MOST
from transport.errors import FieldError, NotKnown
from transport.law_fit import fit_law
from transport.law_fit.packet_record import PacketRecord

LEAST_SLOTS: Final = 1000
"""Slots of the run that a law is estimated from, where the experiment has fewer."""
LEAST_PACKETS: Final = 300
"""Packets of a node in it."""


class BusLaw(Struct, frozen=True, kw_only=True):
    """The law of one way over the bus.

    Args:
        spec: its table, as an experiment has it.
        how: where it comes from, in words.
        exact: whether it is the bus's own, and no estimate.
        packets: that it was estimated from; 0 of an exact one.
        worst_ms: the longest response time that a packet can have, ms; None without a bound.
        largest_age: the largest age that can come, slots; None without a bound.
        no_bound: why there is none; empty where there is.
        text: the file that an experiment includes.
    """

    spec: dict[str, Any]
    how: str
    exact: bool
    packets: int
    worst_ms: float | None
    largest_age: int | None
    no_bound: str
    text: str


def ways_over(rig: RigSpec, bus: SharedMedium) -> dict[str, int | None]:
    """Return the ways of a loop's packets over a bus, in the order in which it counts them, each with its sensor node's number.

    The only sensor node's is "sc", one of several "sc.NAME"; the controller's is "ca", of no sensor node.
    """
    several = len(rig.sensors) > 1
    ways: dict[str, int | None] = {f"sc.{rig.sensors[n].name}" if several else "sc": n for n in sorted(bus.nodes)}
    return ways | ({"ca": None} if bus.table.control else {})


def exact_laws(loop: Loop) -> dict[str, BusLaw] | None:
    """Return the law of each way of a loop's packets over its bus, see `ways_over`; None if they are not exact.

    Raises:
        HilError: it has no CAN bus with time.
    """
    bus = _bus(loop.rig, loop.experiment.name)
    delays, _ = _delays(loop, bus)
    if delays is None or not delays.exact:
        return None
    return {way: _exact(loop, delays, number, way) for number, way in enumerate(ways_over(loop.rig, bus))}


def _bus(rig: RigSpec, name: str) -> SharedMedium:
    bus = can_bus_of(rig)
    if bus is None:
        raise HilError(f"{name}: no medium of kind 'can', see hil guide can-bus")
    return bus


def to_estimate_from(experiment: Experiment) -> Experiment:
    """Return an experiment that runs for long enough that a law can be estimated from the packets of each of its nodes."""
    slowest = max((node.clock.every for node in experiment.network.nodes.values()), default=1)
    slots = max(experiment.slots, LEAST_SLOTS, LEAST_PACKETS * slowest)
    return replace(experiment, duration=Seconds(slots * float(experiment.period)))


def _delays(loop: Loop, bus: SharedMedium) -> tuple[BusDelays | None, str]:
    """Return by how many slots packets are late, or None and why that has no bound."""
    try:
        return bus_delays(loop.rig, bus, loop.rows), ""
    except NotKnown as why:
        return None, str(why)


def _bounds(loop: Loop, delays: BusDelays | None, number: int) -> tuple[float | None, int | None]:
    if delays is None:
        return None, None
    return delays.worst_ns[number] / 1e6, _chain(loop, delays, number).max_delay


def _chain(loop: Loop, delays: BusDelays, number: int) -> DelayChain:
    receiver = loop.rig.at_controller if number < len(loop.rig.sensors) else loop.rig.at_actuator
    return chain_of_ages(delays.packets[number], receiver._replace(max_age=1 << 20))


def _exact(loop: Loop, delays: BusDelays, number: int, way: str) -> BusLaw:
    chain = _chain(loop, delays, number)
    at, ages = int(np.flatnonzero(np.asarray(chain.begins))[0]), []
    for _ in range(chain.modes):
        ages.append(int(chain.delay[at]))
        at = int(chain.matrix[at].argmax())
    spec: dict[str, Any] = {"kind": "trace", "ages": ages}
    if len(set(ages)) == 1:
        spec = {"kind": "constant", "age": ages[0]}
    worst, largest = _bounds(loop, delays, number)
    how = f"exact: the ages come again after {len(ages)} slots" if len(ages) > 1 else "exact: one age in every slot"
    said = {"source": loop.experiment.name, "way": way, "class": "exact", "bound_ms": worst, "largest_age": largest}
    text = f'# {how}\n# In an experiment: law = {{ file = "NAME.toml" }}\n\n{toml_lines(spec)}\n[fit]\n{toml_lines(said)}'
    return BusLaw(spec=spec, how=how, exact=True, packets=0, worst_ms=worst, largest_age=largest, no_bound="", text=text)


def estimated_laws(loop: Loop, run: Mapping[str, NDArray[np.void]]) -> dict[str, BusLaw]:
    """Return the law of each way, estimated from a run by `transport.law_fit`.

    Args:
        loop: the loop that ran.
        run: its records by topic.

    Raises:
        HilError: as of `exact_laws`; too few packets of a way.
    """
    experiment = loop.experiment
    bus = _bus(loop.rig, experiment.name)
    (delays, no_bound), period, slots = _delays(loop, bus), float(experiment.period), experiment.slots
    log, found, deadline = run[BUS.name], {}, experiment.timing.deadline * period
    packets, ways = own_packets(loop.rig, bus, loop.rows), ways_over(loop.rig, bus)
    for number, (packet, (way, node)) in enumerate(zip(packets, ways.items(), strict=True)):
        last = packet.first + len(packet.sizes(fd=bus.table.dbitrate is not None)) - 1
        own = log[(log["can_id"] == last) & (log["operation"] == 0) & (log["flags"] & 1 == 0)]
        clock = ClockTable() if node is None else loop.rig.sensors[node].clock
        phase, every = clock.phase, clock.every
        sent: NDArray[np.float64] = np.arange(phase, slots, every, dtype=np.float64) * period + (deadline if way == "ca" else 0.0)
        latency = np.full(len(sent), np.nan)
        at = np.searchsorted(sent, own["queued_ns"] / 1e9 - 1e-9)
        kept = at < len(sent)
        latency[at[kept]] = (own["end_ns"] - own["queued_ns"])[kept] / 1e9
        notes: tuple[str, ...] = ()
        if way == "ca":  # it is queued at the deadline and counts until the next slot; a law counts from slot to deadline
            latency = np.maximum(latency + 2.0 * deadline - period, 0.0)
            shift = period - 2.0 * deadline
            less = f"{1e3 * abs(shift):g} ms {'less' if shift >= 0.0 else 'more'}"
            notes = (f"latencies are {less} than on the bus: a slot of the law closes at the deadline",)
        with located(f"{experiment.name}: {way}", FieldError):
            fit = fit_law(PacketRecord(sent_s=sent, latency_s=latency), period, deadline)
        worst, largest = _bounds(loop, delays, number)
        source = f"{experiment.name}, seed {experiment.seed}, {slots} slots"
        said = fit_document(fit, way, source, notes)
        said |= {"bound_ms": worst, "largest_age": largest} if worst is not None else {"no_bound": no_bound}
        spec, seeded, text = fit.spec, f"a run with seed {experiment.seed}", ""
        how = "; ".join((f"estimated: {class_text(fit)}, from {len(sent)} packets of {seeded}", *notes))
        if fit.law_class == "none":
            ages = run[APPLIED.name]["d"] if node is None else _ages(sent, latency, slots, period, deadline)
            ages = ages[slots // 10 :]
            spec = {"kind": "trace", "ages": np.maximum(ages, 0).tolist(), "allow_gaps": True}
            how = f"recorded: no law explains its {len(sent)} packets; the ages of {seeded} stand here"
            text = f"# {how}\n\n{toml_lines(spec)}\n[fit]\n{toml_lines({'source': source, 'way': way, 'class': 'none'})}"
        found[way] = BusLaw(
            spec=spec, how=how, exact=False, packets=len(sent), worst_ms=worst, largest_age=largest,
            no_bound=no_bound, text=text or law_text(fit, said),
        )  # fmt: skip
    return found


def _ages(
    sent: NDArray[np.float64], latency: NDArray[np.float64], slots: int, period: float, deadline: float
) -> NDArray[np.int64]:
    """How old the newest packet is at the controller in every slot, (slots,); -1 before the first."""
    of = np.rint(sent / period).astype(np.int64)
    came = ~np.isnan(latency)
    late = np.maximum(np.ceil((latency[came] - deadline) / period - 1e-9), 0.0).astype(np.int64)
    newest = np.full(slots, -1, dtype=np.int64)
    for slot, at in zip(of[came].tolist(), (of[came] + late).tolist()):
        newest[at:] = np.maximum(newest[at:], slot)
    return np.where(newest < 0, -1, np.arange(slots) - newest)


ROOM: Final = 16
"""Identifiers that are kept for the frames of each packet."""
NEAR: Final = 0.01
"""Share by which the cost of a place may be above the least and still count as as good."""


class Place(Struct, frozen=True, kw_only=True):
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


class Judged(Struct, frozen=True, kw_only=True):
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
    bus = _bus(rig, e.name)
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
