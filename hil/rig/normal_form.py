"""Makes the rig of an experiment: checks its tables, reports every fault with its path, and returns one frozen value."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from design.controllers import row_sojourns_distinguished
from hil.errors import ExperimentError, HilError
from hil.experiment import Experiment
from hil.experiment.table import UnavailablePlugin
from hil.plugins.user_plugins import user_failure
from hil.rig import Port, RigSpec, port_of
from hil.rig.can_bus import bus_nodes, can_bus_faults, can_bus_of, can_faults
from hil.rig.receiver import Receiver
from hil.rig.schedules import beyond_the_end, fault_schedule, fault_schedule_faults
from hil.rig.sensors import node_faults, sensor_nodes, sensors_of, shared_media
from transport.links.traits import CanFraming, traits_of


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
    except Exception as error:  # whatever an author's part raises when it is asked
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
        links=links, framing=framing, row_sojourns=row_sojourns_distinguished(e.controller),
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
        "limits.passivity: needs a device that takes one force and measures the position that it acts on; "
        f"this plant takes {', '.join(taken)} and measures {', '.join(measured)}"
    ]
