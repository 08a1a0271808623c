"""What an experiment says of its rig, derived: one frozen value, made once; every room reads it, and derives nothing again.

It holds sensor nodes, media, CAN identifiers, delay chains, faults in time and port; a run's processes receive it with the loop,
and with what the loop is compared with while it runs. Of a plant it takes the port of a device (the force that its motor puts
out, the position that it acts on, what resists there) and the matrices by which it moves, where a designer sees others.

Who makes it checks the tables of the experiment, and reports every fault with its path.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

import numpy as np
from msgspec import Struct, structs

from design.controllers import LoopModel, SensorNodes, controller_traits
from hil.errors import ExperimentError, HilError
from hil.experiment import Experiment
from hil.experiment.table import UnavailablePlugin
from hil.experiment.tables import Links
from hil.plugins.user_plugins import user_failure
from hil.rig.can_bus import bus_nodes, can_bus_faults, can_bus_of, can_faults
from hil.rig.receiver import Receiver
from hil.rig.schedules import FaultSchedule, beyond_the_end, fault_schedule, fault_schedule_faults
from hil.rig.sensors import Sensor, SharedMedium, node_faults, sensors_of, shared_media
from hil.rig.slotted_media import sensor_nodes
from plants.parts import Signal, StateSpace
from plants.parts.protocols import JumpPlant, MovesOtherwise, Plant
from transport.laws import NetworkLaw, prepare
from transport.links.traits import CanFraming, traits_of

CONJUGATE: Final = (("N", "m"), ("N m", "rad"))
"""Units of an input and an output whose product is energy."""


class Port(Struct, frozen=True, kw_only=True):
    """A device that only takes energy, under one force: mass x'' + damping x' + stiffness x = force.

    Args:
        mass: above 0, in the unit of force per acceleration.
        damping: what damping takes, at least 0, per speed.
        stiffness: of a spring to rest, at least 0; per length.
        output: index of the output that is the position, None if none of them is it.
    """

    mass: float
    damping: float
    stiffness: float
    output: int | None


def port_of(plant: Plant) -> Port | None:
    """Return the port of a plant with the state (position, speed) and one input, read from its motion; None for others.

    Args:
        plant: any plant.
    """
    model = plant.motion() if isinstance(plant, MovesOtherwise) else plant.model()
    if isinstance(plant, JumpPlant) or not isinstance(model, StateSpace) or model.A.shape != (2, 2) or model.B.shape != (2, 1):
        return None
    if model.A[0].tolist() != [0.0, 1.0] or model.A[1].max() > 0.0 or model.B[0, 0] or not model.B[1, 0] > 0.0:
        return None
    mass = 1.0 / float(model.B[1, 0])
    force, pairs = plant.inputs[0].unit, zip(model.C.tolist(), plant.outputs)
    found = [i for i, (row, y) in enumerate(pairs) if row == [1.0, 0.0] and (force, y.unit) in CONJUGATE]
    return Port(
        mass=mass,
        damping=0.0 - float(model.A[1, 1]) * mass,
        stiffness=0.0 - float(model.A[1, 0]) * mass,
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


@contextmanager
def in_words_of_parts(experiment: Experiment) -> Iterator[None]:
    """Report an unforeseen exception of a user's own part, before a run, with the name of the part and the line.

    Raises:
        ExperimentError: the exception came of plant, controller or a network law that is not ours.
    """
    try:
        yield
    except HilError:
        raise
    except (Exception, SystemExit) as error:  # whatever an author's part raises when it is asked
        from traceback import walk_tb  # where a part fails

        text = user_failure(error, _parts(experiment).values())
        if text is None:
            raise
        asked = [frame.f_locals.get("self") for frame, _ in walk_tb(error.__traceback__)]
        paths = [path for path, part in _parts(experiment).items() if any(part is each for each in asked)]
        raise ExperimentError(experiment.name, [f"{paths[0] if paths else 'a plug-in'}: {text}"]) from error


def _parts(e: Experiment) -> dict[str, object]:
    laws = {f"network.nodes.{name}.law": node.law for name, node in e.network.nodes.items()}
    ends = {"network.sc.law": e.network.sc.law, "network.ca.law": e.network.ca.law}
    return {"plant": e.plant, "controller": e.controller, **ends, **laws}


def rig_of(e: Experiment) -> RigSpec:
    """Return the rig of an experiment. A plant that a log cannot make again is not compared with the tables beside it.

    Args:
        e: the experiment, its laws' files read.

    Raises:
        ExperimentError: tables that do not fit the plant, the nodes, the link or the time line, each with its path.
        PlantError: the plant has no model.
    """
    with in_words_of_parts(e):
        return _rig_of(e)


def _rig_of(e: Experiment) -> RigSpec:
    plant, network, links = e.plant, e.network, e.links
    absent = isinstance(plant, UnavailablePlugin)
    port = None if absent else port_of(plant)
    faults, nodes = [] if absent else _size_faults(e) + _port_faults(e, port), node_faults(e)
    if nodes:
        raise ExperimentError(e.name, faults + nodes + fault_schedule_faults(e))
    names, period_s = sorted(network.nodes, key=lambda name: network.nodes[name].id or 0), float(e.period)
    traits = traits_of(links.secured(e.folder))
    framing = traits.can or CanFraming()
    sensors, media = sensors_of(e, names, framing), shared_media(e, names)
    deadline_s = e.timing.deadline * period_s
    rig = RigSpec(
        name=e.name, folder=e.folder, period_ns=e.period_ns, slots=e.slots,
        states=tuple(plant.states), inputs=tuple(plant.inputs), outputs=tuple(plant.outputs),
        port=port, passivity=e.limits.passivity is not None,
        sensors=sensors, media=media, nodes=sensor_nodes(sensors, media),
        ca_law=network.ca.law, ca_kind=e.kinds.get("network.ca.law", "?"),
        at_controller=Receiver(period_s, deadline_s, network.sc.max_age, holds_input=False),
        at_actuator=Receiver(period_s, deadline_s, network.ca.max_age, holds_input=True),
        fault_schedule=fault_schedule(e, [sensor.name for sensor in sensors]), unreached=beyond_the_end(e),
        links=links, framing=framing, row_sojourns=controller_traits(e.controller).row_sojourns,
    )  # fmt: skip
    bus = can_bus_of(rig)
    faults += ([] if absent else [*can_faults(rig, traits), *can_bus_faults(rig)])
    faults += fault_schedule_faults(e, () if bus is None else bus_nodes(rig, bus), timed_link=traits.timed)
    if faults:
        raise ExperimentError(e.name, faults)
    return rig


def _size_faults(e: Experiment) -> list[str]:
    """Return where tables do not fit the plant, each with its path."""
    counts, names = {"output": len(e.plant.outputs), "input": len(e.plant.inputs)}, [s.name for s in e.plant.states]
    given = [(f"reference[{i}].value", "output", step.value) for i, step in enumerate(e.reference)]
    given += [(f"disturbance[{i}].value", "input", pulse.value) for i, pulse in enumerate(e.disturbance)]
    given += [("limits.input", "input", e.limits.input)] if e.limits.input is not None else []
    return [
        f"{path}: length {len(value)}, expected {counts[signal]}: one for each {signal}"
        for path, signal, value in given if len(value) != counts[signal]
    ] + [
        f"limits.state.{name}: the plant has no such state (there are: {', '.join(names)})"
        for name in e.limits.state if name not in names
    ]  # fmt: skip


def _port_faults(e: Experiment, port: Port | None) -> list[str]:
    if e.limits.passivity is None or (port is not None and port.output is not None):
        return []
    taken, measured = ([f"{s.name} in {s.unit}" for s in signals] for signals in (e.plant.inputs, e.plant.outputs))
    return [
        "limits.passivity: needs a passive device that takes one force and measures the position that it acts on; "
        f"this plant takes {', '.join(taken)} and measures {', '.join(measured)}"
    ]
