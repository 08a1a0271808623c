"""The CAN identifiers of a rig: of each sensor node and of the controller, and what is wrong with them."""

from __future__ import annotations

from typing import Final

from design.controllers import row_count
from hil.rig.sensors import Sensor, first_identifiers
from hil.rig.spec import RigSpec
from transport.links.can_identifiers import FRAGMENTS, LARGEST, derived, said
from transport.links.traits import CanFraming, LinkTraits
from transport.wire.layout import control_length, sensor_length

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
            faults.append(f"{path}: {frames}, and its identifiers are {said(own)}; give it a can_id of its own")
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
