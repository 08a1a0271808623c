"""What is claimed of a composed loop, of its squared errors over many runs too, and what its run is compared with."""

from __future__ import annotations

from math import log
from typing import TYPE_CHECKING

import numpy as np
from msgspec.structs import replace

from design.controllers import AgedFeedback, Controller, GainTable, LinearFeedback, LoopModel, controller_traits
from design.errors import TooLarge
from design.jump_linear.order_of_modes import strong_classes
from design.verdict import Verdict
from hil.certify import CertificationProblem
from hil.certify.certify import certify, of_external, own_laws
from hil.certify.conformance import NOISY, one_step
from hil.certify.stated_controller import stated_by
from hil.errors import ExperimentError
from hil.experiment import Experiment
from hil.plugins import is_ours
from hil.rig import RigSpec
from hil.rig.delay_chains import Chains, gains_over, state_gains_within, within_reach, without_held
from hil.rig.loop import CANCELS, EQUAL, RUN_AGAIN, JumpStep, Loop, OneStep, Watched, digest_of
from hil.rig.loop_chains import ANY_PHASE, IN_PHASE, loop_chains
from hil.rig.missing_packets import STOPPED, chance_behind_cuts, never_received, percent, waited_for, watchdog_chance
from hil.rig.schedules import disturbance_changes, whole_again
from plants.parts.protocols import JumpPlant

if TYPE_CHECKING:
    from design.jump_linear.higher_moments import FourthMoments
    from design.processes.delay_chain import DelayChain


BOUNDED = (
    "what the controller adds of its own, on samples of zero, stays bounded while a reference stays: looked at in the run, in a "
    "second instance that shares no memory with the first"
)
NOT_COMPARED = "the plant keeps to its model beyond the test: in the run it is not compared"
RESTARTED = (
    "a controller that was restarted answers again when its restart ends: in real time its process may take seconds to start, "
    "and what it answered before is not compared"
)
DELAYED = f"{NOT_COMPARED}, for its delay reaches states between the samples, which no record holds"

LEAST_PHASE = "directions or clocks repeat, and meet in the phases in which the loop grows least"
MOST_PAIRS = 400
"""Pairs of modes up to which every phase is judged by itself."""


def judge(
    experiment: Experiment, rig: RigSpec, chains: Chains, controller: Controller, model: LoopModel, selection: str, *,
    external: bool, in_phase: bool = True, taken_over: LoopModel | None = None,
) -> tuple[Verdict, Watched | None]:  # fmt: skip
    """Return the verdict on a loop, and what its run is compared with; None where no claim rests on it.

    Args:
        in_phase: whether both directions begin together; else any of their phases may meet, and a loop that is not stable in all
            pairs of phases is undecided.
        taken_over: the plant's nominal model, where the controller knows another one.

    Raises:
        ExperimentError: the loop has no certificate, and ``allow_uncertified`` is not set.
    """
    behind = chance_behind_cuts(chains, experiment, model.d_max)
    problem = _problem(experiment, rig, chains, controller, model, selection, in_phase, behind)
    problem = replace(problem, taken_over=taken_over)
    verdict = _in_every_phase(problem, certify(problem))
    watched = _watched(problem, verdict, external)
    if watched is not None and watched.claimed:
        drawn, assumed = own_laws(rig)
        watched = replace(watched, laws=drawn)
        if watched.plant is None:
            delayed = isinstance(problem.plant, JumpPlant) and problem.plant.jump_system().Ad
            assumed += (DELAYED if delayed else NOT_COMPARED,)
        assumed += _run_again_in_part(problem, verdict, watched.plant, experiment.slots)
        assumed += (BOUNDED,) if watched.controller is not None and experiment.reference else ()
        assumed += (RESTARTED,) if any(first < experiment.slots for first, _ in rig.fault_schedule.restarts) else ()
        trips = watchdog_chance(chains, experiment, model.d_max)
        if trips > STOPPED:
            assumed += (f"the watchdog stops {percent(trips)} of the runs, of which nothing is claimed",)
        if behind > STOPPED:
            said = f"by its faults the watchdog stops at most about {percent(behind)} of the runs"
            assumed += (f"{said}, of which nothing is claimed",)
        verdict = verdict.assuming(*assumed)
    if external:
        return of_external(verdict, experiment.kinds.get("controller", "")), watched
    if not (verdict.certified or experiment.allow_uncertified):
        said = f"controller: no certificate of {verdict.kind}, {verdict.state}: {verdict.reason}"
        raise ExperimentError(experiment.name, [f"{said}; set allow_uncertified = true to run it all the same"])
    return verdict, watched


def _in_every_phase(problem: CertificationProblem, verdict: Verdict) -> Verdict:
    """Return the verdict on the phases in which a loop grows least, where it is refused and any may meet; else the one given.

    It stays undecided in a run where there are too many to be looked at.
    """
    from design.processes.delay_chain import kron_of

    sc, ca = problem.sc, problem.ca
    knows = isinstance(problem.controller, GainTable | LinearFeedback | AgedFeedback)
    if verdict.state != "refused" or ANY_PHASE not in problem.unmet or not knows or sc is None or ca is None:
        return verdict
    if sc.modes * ca.modes > MOST_PAIRS:
        return verdict
    chances = kron_of([sc.bounds[1], ca.bounds[1]])
    closed = [own for own in strong_classes(chances) if np.count_nonzero(chances[own].any(axis=0)) == len(own)]
    least = problem.unmet.replace(ANY_PHASE, LEAST_PHASE)
    found = []
    for at_sc, at_ca in (divmod(int(own[0]), ca.modes) for own in closed):
        begun = [replace(chain, begins=np.arange(chain.modes) == at) for chain, at in ((sc, at_sc), (ca, at_ca))]
        found.append(certify(replace(problem, sc=begun[0], ca=begun[1], unmet=least)))
        if found[-1].state != "refused" or found[-1].number is None:
            return verdict
    return min(found, key=lambda each: each.number or 0.0)


def _run_again_in_part(
    problem: CertificationProblem, verdict: Verdict, step: OneStep | JumpStep | None, slots: int
) -> tuple[str, ...]:
    """Return the assumption on a user's plant that has noise or loads for more slots than a second run is compared in.

    Without commands the motion of an unstable plant grows, until the difference of both runs is lost in it.
    """
    if not isinstance(step, OneStep) or is_ours(problem.plant) or not (step.stated or NOISY in verdict.assumptions):
        return ()
    rate = float(np.abs(np.linalg.eigvals(problem.motion.A)).max())
    compared = RUN_AGAIN if rate <= 1.0 + EQUAL else min(RUN_AGAIN, int(log(EQUAL / CANCELS) / log(rate)) + 1)
    if slots <= compared:
        return ()
    seen = "nothing is" if step.stated or compared < RUN_AGAIN else "what is left over may not grow, no more is"
    return (f"behind the first {compared} slots in which noise or a load moves the plant it keeps to its model: {seen} compared",)


def _watched(problem: CertificationProblem, verdict: Verdict, external: bool) -> Watched | None:
    """Return what the run of a loop is compared with: what its certificate rests on, and the plant of an external controller.

    A controller that states itself, word for word, is not compared with itself.
    """
    if not verdict.certified and not external:
        return None
    stated = None if external else problem.once("stated", lambda: stated_by(problem))
    twin = None if stated is None else stated[0]
    if twin is not None and type(twin) is type(problem.controller):
        twin = None
    plant, model = problem.plant, problem.motion
    if isinstance(plant, JumpPlant):
        from hil.certify.jump_loop import jump_step
    step = jump_step(plant, model) if isinstance(plant, JumpPlant) else one_step(plant, model)
    return Watched(plant=step, controller=twin, claimed=not external)


def _problem(
    e: Experiment, rig: RigSpec, chains: Chains, controller: Controller, model: LoopModel, selection: str, in_phase: bool,
    behind: float,
) -> CertificationProblem:  # fmt: skip
    """Return the loop of the controller that is named, as it is judged; `behind`: see `chance_behind_cuts`."""
    found = loop_chains(rig, chains, controller, model, in_phase=in_phase)
    sc, ca, chainless, unmet = found.sc, found.ca, found.chainless, found.unmet
    repeat = sc is not None and ca is not None and min(sc.modes, ca.modes) > 1 and not (sc.begins is None or ca.begins is None)
    if not in_phase and sc is not None and ca is not None:
        begun = loop_chains(rig, chains, controller, model).sc
        if repeat or begun is None or begun.modes < sc.modes:
            sc, ca, repeat = replace(sc, begins=None), replace(ca, begins=None), False
            unmet = f"{unmet}; {ANY_PHASE}" if unmet else ANY_PHASE
    if repeat:
        unmet = f"{unmet}; {IN_PHASE}" if unmet else IN_PHASE
    if not isinstance(controller, GainTable | LinearFeedback | AgedFeedback):
        holds = next((name for name, chain in (("sc", sc), ("ca", ca)) if chain is not None and without_held(chain) is None), "")
        sc, ca = without_held(sc), without_held(ca)
        chainless = chainless or (
            f"over network.{holds} a receiver may keep what it had before, and the theory of this controller has ages alone"
        )
        if repeat and sc is not None and ca is not None and min(sc.modes, ca.modes) > 1:
            sc, chainless = None, "both directions repeat, and the theory of this controller does not know which phases meet"
    known, history = sc is not None and ca is not None, found.history
    return CertificationProblem(
        plant=e.plant, port=rig.port, controller=controller, model=model, sc=sc, ca=ca,
        digest=digest_of(e, controller, model),
        damped=rig.passivity, whole=_whole(e, rig, ca, model.d_max, behind),
        faults=sum(fault.slots(float(e.period))[0] < e.slots for fault in e.fault),
        input_limits=e.limits.input, state_limits=e.limits.state, selection=selection,
        slack=found.slack, shares=found.shares, history=history, unmet=unmet,
        chainless="" if known else chainless,
        neglects=chains.neglects() if known else chains.applied.neglects() if history is not None else "",
        silent="" if history is not None else never_received(sc, ca, rig), waited=waited_for(controller, rig),
        steps=tuple({round(s.at / e.period): s.value for s in e.reference}.items()),  # of one slot the last counts
        disturbance=tuple(disturbance_changes(e).items()),
    )  # fmt: skip


def _whole(e: Experiment, rig: RigSpec, ca: DelayChain | None, d_max: int, behind: float) -> float | str:
    """Return from when on the faults have no more effect, or why that is unknown, see `whole_again`."""
    whole = whole_again(e, rig, _ages(ca, d_max))
    if isinstance(whole, float) and behind > 1.0 - STOPPED:
        return "by it network.ca brings no command for so long that the watchdog trips in nearly every run"
    return whole


def _ages(ca: DelayChain | None, d_max: int) -> tuple[int, int, int]:
    """Return the smallest and the largest age of a command that the law draws, and the largest that rows cover.

    Where commands may be missing anyhow, the cuts alone count: what they leave has a chance, see `chance_behind_cuts`.
    """
    if ca is None or ca.holds.any():
        return 0, 0, 0
    return int(ca.delay.min()), int(ca.delay.max()), d_max


def fourth_moments_of(loop: Loop) -> FourthMoments | None:
    """Return how the fourth moments of a loop's linear model grow; None where no chain of delays describes the loop.

    Args:
        loop: the composed experiment.
    """
    from design.jump_linear.higher_moments import FourthMoments, fourth_moments
    from design.networked_loop.closed_loop import loop_structure
    from design.whole_process import one_blas_thread

    if not isinstance(loop.controller, GainTable) or isinstance(loop.experiment.plant, JumpPlant):
        return None
    sc, ca, its = loop.chains.sc, loop.chains.ca, controller_traits(loop.controller)
    if sc is None or ca is None or its.integral_limit:
        return None
    if (first := loop.chains.initial()) is not None:
        sc, ca = within_reach(sc, first[0]), within_reach(ca, first[1])
    model, controller = loop.model, loop.controller
    try:
        structure = loop_structure(
            model.A, model.B, model.C, sc, ca, controller.selection, samples=loop.samples, integral=float(its.integrates),
            state_gains=state_gains_within(controller, sc),
        )  # fmt: skip
    except TooLarge as error:
        return FourthMoments(radius=None, state="undecided", reason=str(error))
    closed = structure.matrices(gains_over(controller, model, sc, ca))
    with one_blas_thread(), np.errstate(all="ignore"):
        return fourth_moments(closed, structure.transition, upper=None if structure.between is None else structure.between[1])


def caution(loop: Loop) -> str:
    """Return what is to be said beside a mean of squared errors over runs of a loop; nothing where it converges."""
    found = fourth_moments_of(loop)
    if found is None or found.state == "bounded":
        return ""
    if found.state == "undecided":
        return f"whether a mean of squared errors converges well is undecided: {found.reason}"
    number = "" if found.radius is None else f" (radius {found.radius:.5g})"
    growth = f"fourth moments of the linear loop grow{number}"
    if loop.verdict is not None and loop.verdict.number is not None and loop.verdict.number >= 1.0:
        return f"{growth}, and so do second ones ({loop.verdict.number:.5g}): a mean of squared errors grows with the duration"
    return f"{growth}: a mean of squared errors converges badly, and its interval is too narrow"
