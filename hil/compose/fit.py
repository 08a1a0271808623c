"""Whether what belongs together fits: tables and plant, a controller of the user's own and the loop, references and inputs."""

from __future__ import annotations

from design.controllers import Controller, GainTable, LoopModel, held_exactly, integrates
from design.errors import FieldError
from hil.errors import ExperimentError, HilError
from hil.experiment import Experiment
from hil.plugins.own_plugins import words
from hil.plugins.protocols import NamesField
from hil.rig.can_frames import can_faults
from hil.rig.port import port_of
from hil.rig.sensors import node_faults
from hil.rig.time_line import time_line_faults


def size_faults(e: Experiment) -> list[str]:
    """Return where tables do not fit the plant, the nodes or the time line, each with its path."""
    faults: list[str] = []
    p, m, names = len(e.plant.outputs), len(e.plant.inputs), [s.name for s in e.plant.states]
    for i, step in enumerate(e.reference):
        if len(step.value) != p:
            faults.append(f"reference[{i}].value: {len(step.value)} entries, but the plant has {p} outputs")
    for i, pulse in enumerate(e.disturbance):
        if len(pulse.value) != m:
            faults.append(f"disturbance[{i}].value: {len(pulse.value)} entries, but the plant has {m} inputs")
    if e.limits.input is not None and len(e.limits.input) != m:
        faults.append(f"limits.input: {len(e.limits.input)} entries, but the plant has {m} inputs")
    for name in e.limits.state:
        if name not in names:
            faults.append(f"limits.state.{name}: the plant has no such state (there are: {', '.join(names)})")
    if e.limits.passivity is not None:
        port = port_of(e.plant)
        if port is None or port.output is None:
            taken, measured = ([f"{s.name} in {s.unit}" for s in signals] for signals in (e.plant.inputs, e.plant.outputs))
            faults.append(
                "limits.passivity: needs a device that takes one force and measures the position that it acts on; "
                f"this plant takes {', '.join(taken)} and measures {', '.join(measured)}"
            )
    return faults + (node_faults(e) or can_faults(e)) + time_line_faults(e)


def check_own(controller: Controller, model: LoopModel) -> None:
    """Refuse a controller of the user's own that does not answer as a loop asks: told now, and not in slot 17."""
    from hil.plugins.checks import check_answers, check_table  # which no run of ours needs

    try:
        check_answers(controller, model)
        if isinstance(controller, GainTable):
            check_table(controller, model)
    except AssertionError as error:
        raise FieldError("kind", f"check_controller: {error}") from error
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # whatever a stranger's controller does when it runs
        if isinstance(error, HilError | NamesField):  # it says itself what does not fit
            raise
        raise FieldError("kind", f"check_controller: {words(error)}") from error


def check_references(e: Experiment, controller: Controller, model: LoopModel) -> None:
    """Refuse what a table of gains cannot follow: with more outputs than inputs a reference must be one that some input holds.

    Raises:
        ExperimentError: with every step that no input holds.
    """
    n_inputs, n_outputs = model.B.shape[1], model.C.shape[0]
    if not isinstance(controller, GainTable) or n_outputs <= n_inputs:
        return
    faults = [
        f"reference[{i}].value: no input holds the {n_outputs} outputs at {list(step.value)}"
        for i, step in enumerate(e.reference)
        if not held_exactly(model, step.value)
    ]
    if integrates(controller):
        faults.append(f"controller.integral: {n_inputs} inputs cannot bring the mean errors of {n_outputs} outputs to zero")
    if faults:
        raise ExperimentError(e.name, faults)
