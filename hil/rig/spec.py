"""The rig of an experiment in its normal form: one frozen value, made once; every room reads it, and derives nothing again."""

from __future__ import annotations

from dataclasses import dataclass, replace

from design.controllers import SensorNodes
from hil.experiment.tables import Links
from hil.rig.packet_ages import Receiver
from hil.rig.port import Port
from hil.rig.schedules import FaultSchedule
from hil.rig.sensor_list import Sensor
from hil.rig.sensors import SharedMedium
from plants.parts.linear import Signal
from transport.laws.protocols import NetworkLaw, prepare
from transport.links.traits import CanFraming


@dataclass(frozen=True, slots=True, kw_only=True)
class RigSpec:
    """What an experiment says of its rig: signals and port of the plant, sensor nodes, media, network laws, link, clocks, faults.

    Args:
        name: of the experiment.
        folder: where its file stands.
        period_ns: sample period T, ns.
        slots: of a run.
        states, inputs, outputs: the plant's signals.
        port: force and position of a device under one force, None for another plant, or one that no file made.
        passivity: whether a passivity controller stands between the controller and the plant.
        sensors: the sensor nodes, by number.
        media: what they share on their way to the controller.
        nodes: both, as a controller and the theory see them.
        ca_law: the network to the actuator.
        ca_kind: name of its plug-in.
        at_controller, at_actuator: how the two receive.
        fault_schedule: what is broken when.
        unreached: what of the time line a run never reaches, in words; empty: nothing.
        links: the real link, as the file names it.
        framing: CAN frames of that link; of one that is no CAN link, those of a CAN link by default.
    """

    name: str
    folder: str
    period_ns: int
    slots: int
    states: tuple[Signal, ...]
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    port: Port | None
    passivity: bool
    sensors: tuple[Sensor, ...]
    media: tuple[SharedMedium, ...]
    nodes: SensorNodes
    ca_law: NetworkLaw
    ca_kind: str
    at_controller: Receiver
    at_actuator: Receiver
    fault_schedule: FaultSchedule
    unreached: str
    links: Links
    framing: CanFraming

    @property
    def numbered(self) -> bool:
        """Whether the log says of each draw of which node it is."""
        return self.sensors[0].numbered

    @property
    def laws(self) -> tuple[NetworkLaw, ...]:
        """The network laws of all directions: from each node, then to the actuator."""
        return (*(sensor.law for sensor in self.sensors), self.ca_law)

    def tabulated(self) -> RigSpec:
        """Return the same rig with its laws tabulated: no process that keeps time computes their distributions."""
        sensors = tuple(replace(sensor, law=prepare(sensor.law)) for sensor in self.sensors)
        return replace(self, sensors=sensors, ca_law=prepare(self.ca_law))
