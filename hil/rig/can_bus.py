"""What a rig sends on a CAN bus: the identifiers of its sensor nodes and of its controller, and what is wrong with them.

Of a bus that takes time: who is on it, what travels there, and how long that may take.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from design.controllers import row_count
from hil.experiment.nodes import Medium, TrafficTable
from hil.experiment.rig_tables import BIT_ERRORS, Fault
from hil.rig.sensors import Sensor, SharedMedium, first_identifiers
from transport.can_bus_model import BitRates, CanFrame
from transport.links.can_identifiers import FRAGMENTS, LARGEST, derived, identifiers_text
from transport.links.traits import CanFraming, LinkTraits
from transport.wire import control_length, frame_length, sensor_length

if TYPE_CHECKING:
    from hil.rig import RigSpec
    from transport.can_analysis import PeriodicMessage
    from transport.can_bus_model import Periodic

CONTROL: Final = "links.control_can_id"


def can_faults(rig: RigSpec, traits: LinkTraits) -> list[str]:
    """Return what is wrong with the CAN identifiers of a rig, each with its path.

    Args:
        rig: the rig.
        traits: of the link; one that is no CAN link is judged as a CAN link by default.
    """
    if len(rig.sensors) > FRAGMENTS and any(sensor.own_can_id is None for sensor in rig.sensors):
        if traits.can is None:
            return []
        many = f"{len(rig.sensors)} of them; a CAN link has identifiers for {FRAGMENTS}, unless each names its can_id"
        return [f"network.nodes: {many}"]
    framing = traits.can or CanFraming()
    faults: list[str] = []
    names, owner = {path_of(sensor): sensor.name for sensor in rig.sensors}, dict[int, str]()
    needed = _needed(rig, framing, traits.keyed)
    for path, own in ranges_of(rig, framing, traits.keyed).items():
        frames = f"its packets take {needed[path]} frames" if needed[path] > 1 else "its packets take 1 frame"
        if own[-1] > LARGEST:
            faults.append(f"{path}: {own[0]:#x}, and {frames}: above {LARGEST:#x} (11 bits)")
        elif needed[path] > len(own):
            faults.append(f"{path}: {frames}, and its identifiers are {identifiers_text(own)}; give it a can_id of its own")
        taken = next((identifier for identifier in own if identifier in owner), None)
        if taken is not None:
            whose = "the control packets" if owner[taken] == CONTROL else f"node {names[owner[taken]]!r}"
            other = "" if taken == own[0] else f" ({taken:#x}, for {frames})"
            faults.append(f"{path}: {own[0]:#x} is the identifier of {whose} already{other}")
        for identifier in own:
            owner.setdefault(identifier, path)
    return faults


def path_of(sensor: Sensor) -> str:
    """Return where a node's identifier stands in the experiment, for messages."""
    return f"{sensor.path}.can_id" if sensor.numbered else sensor.path  # the short form has no key for it


def own_identifiers(rig: RigSpec) -> bool:
    """Return whether the experiment sets an identifier."""
    return rig.links.control_can_id is not None or any(sensor.own_can_id is not None for sensor in rig.sensors)


def ranges_of(rig: RigSpec, framing: CanFraming, keyed: bool) -> dict[str, range]:
    """Return path to identifiers; where some are set, all take as many as their packets have frames.

    Args:
        rig: the rig.
        framing: of the link.
        keyed: whether every packet has a message authentication code.
    """
    paths = [path_of(sensor) for sensor in rig.sensors]
    below = derived(framing.base, framing.fd, len(paths) if len(paths) <= FRAGMENTS else 1)
    if not own_identifiers(rig):
        return dict(zip((*paths, CONTROL), (*below.sensors, below.control), strict=True))
    first = dict(zip(paths, first_identifiers([sensor.own_can_id for sensor in rig.sensors], framing), strict=True))
    first[CONTROL] = below.control[0] if rig.links.control_can_id is None else rig.links.control_can_id
    needed = _needed(rig, framing, keyed)
    return {path: range(start, start + needed[path]) for path, start in first.items()}


def _needed(rig: RigSpec, framing: CanFraming, keyed: bool) -> dict[str, int]:
    """Return path to the frames of its longest packet."""
    step, outputs = framing.frame_bytes, len(rig.outputs)
    values = {path_of(sensor): len(sensor.outputs) * sensor.buffer for sensor in rig.sensors}
    needed = {path: -(-sensor_length(own + outputs, keyed) // step) for path, own in values.items()}
    control = control_length(most_rows(rig, framing) * len(rig.inputs), keyed)
    return needed | {CONTROL: min(-(-control // step), FRAGMENTS)}


def most_rows(rig: RigSpec, framing: CanFraming) -> int:
    """Return the most rows that an answer may have, whatever the rule, or that its frames hold."""
    room = FRAGMENTS * framing.frame_bytes - control_length(0)
    oldest = rig.at_actuator.max_age
    return min(max(row_count("both", oldest), row_count("applied", oldest, rig.row_sojourns)), room // (4 * len(rig.inputs)))


CONTROLLER, ACTUATOR, RECORDING = "controller", "actuator", "recording"


class OwnPacket(Struct, frozen=True, kw_only=True):
    """What a node of the rig sends on the bus.

    Args:
        sender: its name on the bus.
        path: where the experiment says its identifier.
        first: identifier of the first frame.
        values: 32-bit floats in a packet.
        period_ns: from one packet to the next.
        jitter_ns: by how much its clock may be late.
    """

    sender: str
    path: str
    first: int
    values: int
    period_ns: int
    jitter_ns: int = 0

    def sizes(self, *, fd: bool) -> list[int]:
        """Return the bytes of each of its frames."""
        step = 64 if fd else 8
        left = [min(step, 4 * self.values - at) for at in range(0, max(4 * self.values, 1), step)]
        return [frame_length(size) if fd else size for size in left]


def can_bus_of(rig: RigSpec) -> SharedMedium | None:
    """Return the CAN bus that takes time, None where there is none."""
    return next((shared for shared in rig.media if shared.table.kind == "can"), None)


def is_disturbed(medium: Medium, faults: Sequence[Fault]) -> bool:
    """Return whether bits on a bus are disturbed, or nodes are off it, so that bounds without errors do not hold.

    Args:
        medium: the bus.
        faults: on the time line.
    """
    return medium.bit_error_rate > 0.0 or any(fault.kind in (BIT_ERRORS, "bus-off") for fault in faults)


def own_packets(rig: RigSpec, bus: SharedMedium, rows: int | None = None) -> list[OwnPacket]:
    """Return what the rig's own nodes send on the bus: its sensor nodes by number, then the controller.

    Args:
        rig: the rig.
        bus: its bus.
        rows: of a control packet; by default one for each age and length of stay.
    """
    found = []
    for sensor in (rig.sensors[number] for number in sorted(bus.nodes)):
        values, clock, path = len(sensor.outputs) * sensor.buffer, sensor.clock, path_of(sensor)
        found.append(
            OwnPacket(
                sender=sensor.name, path=path, first=sensor.can_id, values=values, period_ns=clock.every * rig.period_ns,
                jitter_ns=clock.jitter * rig.period_ns,
            )
        )  # fmt: skip
    if bus.table.control:
        given = rig.links.control_can_id
        first = derived(rig.framing.base, rig.framing.fd).control[0] if given is None else given
        values = len(rig.inputs) * (row_count("applied", rig.at_actuator.max_age, rig.row_sojourns) if rows is None else rows)
        found.append(OwnPacket(sender=CONTROLLER, path=CONTROL, first=first, values=values, period_ns=rig.period_ns))
    return found


def bus_nodes(rig: RigSpec, bus: SharedMedium) -> tuple[str, ...]:
    """Return the names of all nodes on the bus by number: those that send packets of the rig, the actuator, and the others."""
    own = [rig.sensors[number].name for number in sorted(bus.nodes)]
    others = dict.fromkeys(message.sender for message in bus.table.traffic)
    return (*own, CONTROLLER, ACTUATOR, *others, *((RECORDING,) if bus.table.recorded else ()))


def rates_of(medium: Medium) -> BitRates:
    """Return the bit rates of a bus."""
    return BitRates(medium.bitrate or 0, medium.dbitrate)


def periodic_traffic(medium: Medium, number: Mapping[str, int]) -> list[Periodic]:
    """Return the background traffic, in the order of its table.

    Args:
        medium: the bus.
        number: of each sender.
    """
    from transport.can_bus_model import Periodic  # loaded where there is a bus

    return [
        Periodic(
            node=number[message.sender], frame=frame_of(message, medium), period_ns=_ns(message.period),
            offset_ns=_ns(message.offset), jitter_ns=_ns(message.jitter), random=message.data is None and message.length > 0,
        )
        for message in medium.traffic
    ]  # fmt: skip


def periodic_message(message: TrafficTable, medium: Medium) -> PeriodicMessage:
    """Return a message of a table for the analysis of its response time."""
    from transport.can_analysis import PeriodicMessage  # loaded where there is a bus

    frame = frame_of(message, medium)
    return PeriodicMessage(
        name=message.said, identifier=message.can_id, length=len(frame.data), period_ns=_ns(message.period),
        jitter_ns=_ns(message.jitter), extended=message.extended, fd=message.fd, bitrate_switch=frame.bitrate_switch,
    )  # fmt: skip


def frame_of(message: TrafficTable, medium: Medium) -> CanFrame:
    """Return a message as a frame."""
    data = bytes(message.length) if message.data is None else bytes.fromhex(message.data)
    switch = message.fd and medium.dbitrate is not None
    return CanFrame(identifier=message.can_id, data=data, extended=message.extended, fd=message.fd, bitrate_switch=switch)


def analysed(rig: RigSpec, bus: SharedMedium, rows: int | None = None) -> list[PeriodicMessage]:
    """Return everything that is sent again and again on the bus, for the analysis of its response times."""
    from transport.can_analysis import PeriodicMessage  # loaded where there is a bus

    medium = bus.table
    fd = medium.dbitrate is not None
    found = []
    for packet in own_packets(rig, bus, rows):
        for i, size in enumerate(packet.sizes(fd=fd)):
            name = packet.sender if not i else f"{packet.sender}, frame {i + 1}"
            found.append(
                PeriodicMessage(
                    name=name, identifier=packet.first + i, length=size, period_ns=packet.period_ns, jitter_ns=packet.jitter_ns,
                    fd=fd, bitrate_switch=fd,
                )
            )  # fmt: skip
    return found + [periodic_message(message, medium) for message in medium.traffic]


def can_bus_faults(rig: RigSpec) -> Iterator[str]:
    """Yield what is wrong with the CAN bus of a rig, each with its path."""
    buses = [shared.name for shared in rig.media if shared.table.kind == "can"]
    yield from (f"network.media.{name}: medium {buses[0]!r} is a CAN bus already, an experiment has one" for name in buses[1:])
    bus = can_bus_of(rig)
    if bus is None:
        return
    at, medium, names = bus.name, bus.table, [sensor.name for sensor in rig.sensors]
    owner: dict[tuple[bool, int], str] = {}
    for packet in own_packets(rig, bus):
        for i in range(len(packet.sizes(fd=medium.dbitrate is not None))):
            taken = owner.setdefault((False, packet.first + i), packet.sender)
            if taken != packet.sender:
                yield f"{packet.path}: {packet.first + i:#x} is the identifier of {taken!r} already, on network.media.{at}"
    yield from recorded_faults(medium, at, owner)
    sent: dict[tuple[bool, int], str] = {}
    for i, message in enumerate(medium.traffic):
        key = (message.extended, message.can_id)
        path = f"network.media.{at}.traffic[{i}].can_id"
        if key in owner:
            yield f"{path}: {message.can_id:#x} is the identifier of {owner[key]!r} already"
        elif sent.setdefault(key, message.said) != message.said:
            yield f"{path}: {message.can_id:#x} is the identifier of {sent[key]!r} already"
        if message.sender in (*names, CONTROLLER, ACTUATOR, RECORDING):
            yield f"network.media.{at}.traffic[{i}].{'node' if message.node else 'name'}: {message.sender!r} is a node of the rig"
        if message.fd and medium.dbitrate is None:
            yield f"network.media.{at}.traffic[{i}].fd: the bus has no dbitrate, expected one for CAN FD"


def recorded_faults(medium: Medium, medium_name: str, owner: Mapping[tuple[bool, int], str]) -> Iterator[str]:
    """Yield what is wrong with recorded frames, the first of each kind.

    Args:
        medium: the bus.
        medium_name: its name.
        owner: of the identifiers of the rig.
    """
    if not medium.recorded:
        return
    from hil.rig.named_files import MOST, due_of

    last = 0
    for i, line in enumerate(medium.recorded):
        path = f"network.media.{medium_name}.recorded[{i}]"
        try:
            due = due_of(line)
        except ValueError as error:
            yield f"{path}: {error}"
            return
        key = (due.frame.extended, due.frame.identifier)
        if key in owner:
            yield f"{path}: {due.frame.identifier:#x} is the identifier of {owner[key]!r} already"
            return
        if due.at_ns < last or i >= MOST:
            yield f"{path}: {'earlier than the one before it' if i < MOST else f'more than {MOST} frames'}"
            return
        last = due.at_ns


def _ns(seconds: float) -> int:
    return round(float(seconds) * 1e9)
