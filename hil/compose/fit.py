"""Whether a controller fits its loop: one of the user's own what a loop asks, references what the inputs can hold."""

from __future__ import annotations

from design.controllers import Controller, GainTable, LoopModel, held_exactly, integrates
from design.errors import FieldError
from hil.errors import ExperimentError, HilError
from hil.experiment import Experiment
from hil.plugins.protocols import FieldFault
from hil.plugins.user_plugins import words


def check_own(controller: Controller, model: LoopModel) -> None:
    """Refuse a controller of the user's own that does not answer as a loop asks: said now, and not in slot 17."""
    from hil.plugins.checks import check_answers, check_statements, check_table  # which no run of ours needs

    try:
        check_answers(controller, model)
        check_statements(controller, model)
        if isinstance(controller, GainTable):
            check_table(controller, model)
    except AssertionError as error:
        raise FieldError("kind", f"check_controller: {error}") from error
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # whatever a user's controller does when it runs
        if isinstance(error, HilError | FieldFault):  # it says itself what does not fit
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
        faults.append(f"controller.integral: {n_inputs} inputs cannot make the mean errors of {n_outputs} outputs zero")
    if faults:
        raise ExperimentError(e.name, faults)


def changed_meanwhile(experiment: Experiment) -> ExperimentError:
    """Return the refusal of a plant or a controller whose fields changed while they were asked: no verdict is on what runs."""
    plant, own = type(experiment.plant).__qualname__, type(experiment.controller).__qualname__
    return ExperimentError(experiment.name, [
        f"controller ({own}) or plant ({plant}): fields changed while it was asked what it is; parameters stay as they are, and "
        "what changes belongs into what start() returns"
    ])  # fmt: skip
