"""What an experiment says of its rig, derived: one frozen value, made once; every room reads it, and derives nothing again.

It holds sensor nodes, media, CAN identifiers, delay chains, faults in time and port; a run's processes receive it with the loop,
and with what the loop is compared with while it runs. Of a plant it takes the port of a device (the force that its motor puts
out, the position that it acts on, what resists there) and the matrices by which it moves, where a designer sees others.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from msgspec import Struct, structs

from design.controllers import LoopModel, SensorNodes
from hil.experiment.tables import Links
from hil.rig.receiver import Receiver
from hil.rig.schedules import FaultSchedule
from hil.rig.sensors import Sensor, SharedMedium
from plants.parts import Signal
from plants.parts.protocols import JumpPlant, MovesOtherwise, Plant
from transport.laws import NetworkLaw, prepare
from transport.links.traits import CanFraming

CONJUGATE: Final = (("N", "m"), ("N m", "rad"))
"""Units of an input and an output whose product is energy."""


class Port(Struct, frozen=True, kw_only=True):
    """A device under one force: mass x'' + damping x' + stiffness x = force.

    Args:
        mass: in the unit of force per acceleration.
        damping: what damping takes, per speed.
        stiffness: of a spring to rest, at least 0; per length.
        output: index of the output that is the position, None if none of them is it.
    """

    mass: float
    damping: float
    stiffness: float
    output: int | None


def port_of(plant: Plant) -> Port | None:
    """Return the port of a plant with the state (position, speed) and one input, read from its model; None for others.

    Args:
        plant: any plant.
    """
    model = plant.model()
    if isinstance(plant, JumpPlant) or model.A.shape != (2, 2) or model.B.shape != (2, 1) or model.A[0].tolist() != [0.0, 1.0]:
        return None
    if not model.B[1, 0]:
        return None
    mass = 1.0 / float(model.B[1, 0])
    force, pairs = plant.inputs[0].unit, zip(model.C.tolist(), plant.outputs)
    found = [i for i, (row, y) in enumerate(pairs) if row == [1.0, 0.0] and (force, y.unit) in CONJUGATE]
    return Port(
        mass=mass,
        damping=-float(model.A[1, 1]) * mass,
        stiffness=max(-float(model.A[1, 0]) * mass, 0.0),
        output=found[0] if found else None,
    )


def motion_of(plant: Plant, model: LoopModel) -> LoopModel:
    """Return the loop's model with the matrices by which the plant moves; the model itself where these are what a designer sees.

    Args:
        plant: what runs.
        model: what controllers know of it.
    """
    if not isinstance(plant, MovesOtherwise):
        return model
    moves = plant.motion().discretise(model.period_s)
    return structs.replace(model, A=np.asarray(moves.A), B=np.asarray(moves.B), C=np.asarray(moves.C))


class RigSpec(Struct, frozen=True, kw_only=True):
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
        row_sojourns: lengths of stay at d for which an answer has a row each.
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
    row_sojourns: int = 1

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
        sensors = tuple(structs.replace(sensor, law=prepare(sensor.law)) for sensor in self.sensors)
        return structs.replace(self, sensors=sensors, ca_law=prepare(self.ca_law))
