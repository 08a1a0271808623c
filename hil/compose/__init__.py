"""An experiment becomes a loop that can run: plug-ins, design, certificate.

Plug-ins are made, the design is solved, what does not fit is refused, and the certificate is computed.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

import numpy as np
from msgspec.structs import replace

from design.controllers import Controller, GainTable, HistoryGains, IntegralAction, LoopModel, controller_traits, row_count
from design.controllers.gain_rows import held_exactly, nearest_held
from design.controllers.rendered_wall import RendersWall
from design.errors import DesignError, FieldError
from design.whole_process import one_blas_thread
from hil.compose.judged import judge
from hil.errors import ExperimentError, ForeignVerdict, HilError
from hil.experiment import Experiment
from hil.experiment.table import UnavailablePlugin
from hil.experiment.table_check import fault_at
from hil.plugins import is_own
from hil.plugins.registry import OBJECT
from hil.plugins.user_plugins import Designer, FieldFault, GainsOnFile, GivesGains, NamedController, words
from hil.rig import RigSpec, in_words_of_parts, rig_of
from hil.rig.can_bus import can_bus_of
from hil.rig.delay_chains import Chains, chains_for, without_held
from hil.rig.loop import Gains, Loop
from hil.rig.named_files import with_named_files
from plants.errors import PlantError
from plants.parts.protocols import JumpPlant
from transport.errors import NotKnown
from transport.packets import MAX_OUTPUTS, MAX_ROWS

if TYPE_CHECKING:
    from design.requests.tracking import DesignTask


def compose(
    experiment: Experiment, *, certify: bool = True, external: bool = False, rig: RigSpec | None = None, in_phase: bool = True,
    knows: LoopModel | None = None,
) -> Loop:  # fmt: skip
    """Make the loop of an experiment: check what belongs together, solve the design, certify the closed loop.

    Args:
        experiment: the checked description.
        certify: whether to say what can be claimed of the loop.
        rig: of the experiment, where it is known already.
        external: an external controller answers on the link: of its loop nothing is known.
        in_phase: whether both directions of the network begin together, and not one of them in the run.
        knows: the model that the controller was started with, where another plant took over since.

    Raises:
        ExperimentError: if sizes do not fit, or the loop has no certificate and ``allow_uncertified`` is not set.
    """
    with in_words_of_parts(experiment), _small_matrices():
        try:
            return _compose(experiment, certify, external, rig, in_phase, knows)
        except ForeignVerdict as error:
            raise changed_meanwhile(experiment) from error


def solved_gains(experiment: Experiment) -> tuple[NamedController, str] | None:
    """Solve the gains that an experiment asks for, whatever is stored; return them and the digest of their problem.

    None where the experiment itself gives the gains.

    Raises:
        ExperimentError: no gains meet the request, or the problem has no digest.
    """
    asked: Any = experiment.controller
    if not isinstance(asked, Designer) or (isinstance(asked, GivesGains) and asked.gains_given):
        return None
    from hil.compose.stored_gains import problem_digest, solve

    with _small_matrices():
        experiment, rig, model = _modelled(experiment)
        try:
            task = _task(experiment, rig, chains_for(rig, asked), model)
            return solve(asked, task), problem_digest(asked, task)
        except (ValueError, DesignError) as e:
            raise ExperimentError(experiment.name, [fault_at("controller", e)]) from e


@contextmanager
def _small_matrices() -> Iterator[None]:
    # A second BLAS thread costs time on a quiet machine and minutes on a busy one.
    # What overflows is judged where its number is: certificates say undecided, a run is stopped by its limits.
    with one_blas_thread(), np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        yield


def _modelled(experiment: Experiment, known: RigSpec | None = None) -> tuple[Experiment, RigSpec, LoopModel]:
    """Return the experiment with its laws' files read, its rig, and what the controller knows of its plant."""
    lost = [str(part.missing()) for part in (experiment.plant, experiment.controller) if isinstance(part, UnavailablePlugin)]
    if lost:
        raise ExperimentError(experiment.name, lost)
    experiment = with_named_files(experiment)
    try:
        rig = rig_of(experiment) if known is None else known
        discrete = experiment.plant.model().discretise(float(experiment.period))
    except PlantError as e:
        raise ExperimentError(experiment.name, [f"period: {e}"]) from e
    return experiment, rig, LoopModel(
        A=np.asarray(discrete.A),
        B=np.asarray(discrete.B),
        C=np.asarray(discrete.C),
        period_s=float(experiment.period),
        tau_max=rig.at_controller.max_age,
        d_max=rig.at_actuator.max_age,
        sensors=rig.nodes,
    )


def _solved(experiment: Experiment, rig: RigSpec, model: LoopModel) -> tuple[Experiment, Gains | None, Chains | None]:
    """Return the experiment with the controller that runs, where its gains come from, and the chains that they are for."""
    asked = experiment.controller
    if not isinstance(asked, Designer):
        return experiment, None, None
    from hil.compose.stored_gains import fitted, solve_controller

    chains = chains_for(rig, asked)
    solved, gains = solve_controller(experiment, _task(experiment, rig, chains, model))
    if isinstance(asked, GainsOnFile) and asked.file:
        chains = chains_for(rig, solved)
        solved, gains = fitted(asked, solved, _task(experiment, rig, chains, model))
    return replace(experiment, controller=solved, kinds={**experiment.kinds, "controller": solved.kind}), gains, chains


def _compose(
    experiment: Experiment, certify: bool, external: bool, known: RigSpec | None, in_phase: bool, knows: LoopModel | None
) -> Loop:
    asked, rig, nominal = _modelled(experiment, known)
    model = nominal if knows is None else replace(nominal, A=knows.A, B=knows.B, C=knows.C)
    try:
        experiment, gains, chains = _solved(asked, rig, model)
        controller: Controller = experiment.controller  # type: ignore[assignment]  # no design is left
        kind = experiment.kinds.get("controller", "")
        if is_own(kind) or kind.startswith(OBJECT):
            check_own(controller, model)
        running = controller.start(model)
        its, wanted = controller_traits(controller), controller_traits(asked.controller)
        samples = its.samples
        if chains is None or its != wanted:
            chains = chains_for(rig, controller)
        if (rows := row_count(running.selection, model.d_max, its.row_sojourns)) > MAX_ROWS:
            raise FieldError("selection", f"{running.selection} needs {rows} rows, a packet carries {MAX_ROWS}")
        if (samples, rig.row_sojourns) != (wanted.samples, its.row_sojourns):
            rig = rig_of(experiment)  # packets have as many samples and rows as the controller takes and gives
        check_references(experiment, controller, model)
        if not 1 <= samples * len(rig.outputs) <= MAX_OUTPUTS:
            raise FieldError("samples", f"{samples} of {len(rig.outputs)} outputs, a packet carries 1 to {MAX_OUTPUTS} values")
    except (ValueError, DesignError) as e:
        raise ExperimentError(experiment.name, [fault_at("controller", e)]) from e
    if isinstance(controller, HistoryGains):
        from hil.certify.historical_loop import mask_faults

        unknown = mask_faults(controller, model.nodes)
        if unknown:
            raise ExperimentError(experiment.name, unknown)
    verdict, watched = None, None
    if certify:
        verdict, watched = judge(
            experiment, rig, chains, controller, model, running.selection, external=external, in_phase=in_phase,
            taken_over=None if knows is None else nominal,
        )  # fmt: skip
    return Loop(
        experiment=experiment,
        model=model,
        controller=controller,
        rig=rig.tabulated(),
        chains=chains,
        rows=rows,
        selection=running.selection,
        samples=samples,
        verdict=verdict,
        gains=gains,
        watched=watched,
    )


def _task(e: Experiment, rig: RigSpec, chains: Chains, model: LoopModel) -> DesignTask:
    """Return what a design has to solve: the loop with the plant's own matrices and rates."""
    from design.requests.tracking import DesignTask  # loaded where gains are asked for
    from hil.certify.historical_loop import delayed_plant_of, known_past
    from hil.certify.jump_loop import process_of, system_of
    from hil.rig.bus_delays import bus_chains
    from hil.rig.loop_chains import OLDEST_DISTINGUISHED, settled
    from hil.rig.received_ages import received_ages

    plant, sc, ca, chainless = e.plant, chains.sc, chains.ca, chains.why_none
    if not isinstance(e.controller, IntegralAction):  # the designs of Chapter 7 state it; others have no packets in their theory
        sc, ca = without_held(sc), without_held(ca)
        chainless = chainless or "the theory of this design has no packet laws"
    elif can_bus_of(rig) is not None:
        sc, ca, chainless = None, None, ""
        try:
            sc, ca = bus_chains(rig, longest=True)
        except NotKnown as why:
            chainless = str(why)
    if sc is None and ca is not None and isinstance(e.controller, RendersWall):
        with suppress(NotKnown):  # a coupler is for the delays that come of its node's clock and medium too
            found = received_ages(rig, chains.arriving, OLDEST_DISTINGUISHED, bands="of a wall")
            sc = without_held(settled(found, ca)[0])
    jumps: dict[str, Any] = {}
    if isinstance(plant, JumpPlant):
        try:
            jumps = {"jump_system": system_of(plant.jump_system()), "jump_process": process_of(plant.jump_process())}
        except ValueError as error:
            raise FieldError("kind", f"no design covers this plant: {error}") from error
    delayed = delayed_plant_of(plant, model, ca)
    initial = None if delayed is None else known_past(plant)[0]
    return DesignTask(
        model=model, sc=sc, ca=ca, folder=rig.folder, delayed_plant=delayed, initial_state=initial,
        chainless=chainless, **jumps,
    )  # fmt: skip


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
        f"reference[{i}].value: no input holds the {n_outputs} outputs at {list(step.value)}; the nearest that "
        f"one holds are {nearest_held(model.A, model.B, model.C, step.value)}"
        for i, step in enumerate(e.reference)
        if not held_exactly(model.A, model.B, model.C, step.value)
    ]
    if controller_traits(controller).integrates:
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
