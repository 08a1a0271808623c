"""The certifier of Chapters 2 to 4: state feedback by mode and sojourn time over a plant that jumps."""

from __future__ import annotations

from dataclasses import replace
from math import isfinite
from typing import TYPE_CHECKING

from design.controllers import ModeSchedule
from design.errors import DesignError
from design.verdict import Kind, Verdict
from hil.certify.certifier import CertificationProblem, limited_to_model, undecided
from hil.certify.jump_plant import process_of, system_of
from hil.plugins.protocols import JumpPlant

if TYPE_CHECKING:
    from design.controllers.scheduled_gain import ScheduledGain
    from design.processes.semi_markov import FaultDetection, SemiMarkov
    from design.semi_markov_loop.certificate import JumpCertificate
    from design.semi_markov_loop.system import DelayedJumpSystem, JumpSystem


KIND: Kind = "mean-square stability"


def certify_jump_loop(loop: CertificationProblem) -> Verdict | None:
    """Return the verdict on scheduled state feedback over a plant that jumps; None for any other loop.

    The state of the verdict is that of the loop as it runs: sampled at T, held, delayed by whole samples, its modes seen at the
    samples. The conditions of Chapters 2 to 4 are of a feedback that acts at every instant on the state of that instant; what
    they say stands in the details, and leaves a loop undecided that nobody can decide at T.

    Reference: thesis (2.4), (3.27), (4.14).
    """
    plant, controller = loop.plant, loop.controller
    if not isinstance(controller, ModeSchedule):
        return None
    if not isinstance(plant, JumpPlant):
        return undecided(loop, KIND, (
            f"[controller] has gains by mode, and [plant] {type(plant).__qualname__} states no modes (jump_system(), "
            "jump_process()); over one set of matrices a table of gains or output feedback is judged"
        ))  # fmt: skip
    if len(loop.model.nodes.names) > 1:
        several = len(loop.model.nodes.names)
        return undecided(loop, KIND, f"gains by mode are judged over one sensor node, and [nodes] has {several}")
    if loop.sc is None or loop.ca is None:
        return undecided(loop, KIND, loop.no_chain())
    from design.semi_markov_loop.sampled import sampled_verdict

    try:
        system = system_of(loop.said.once("jump system", plant.jump_system))
        process = process_of(loop.said.once("jump process", plant.jump_process))
        gain = loop.said.once("schedule", controller.schedule_of_modes)
        found = sampled_verdict(system, process, gain, period_s=loop.model.period_s, tau=loop.sc, d=loop.ca)
    except (ValueError, DesignError) as error:
        return undecided(loop, KIND, f"the theory does not cover this plant: {error}")
    return limited_to_model(loop.plant, _with_continuous_time(loop, found, system, gain, process), knows_jumps=True)


def in_continuous_time(
    system: JumpSystem | DelayedJumpSystem, gain: ScheduledGain, process: SemiMarkov | FaultDetection
) -> JumpCertificate:
    """Return what Chapters 2, 3 or 4 say of the gains as they are, acting at every instant without delay.

    Raises:
        ValueError: a plant or a schedule that no chapter covers.
        DesignError: no verdict could be computed.
    """
    from design.processes.semi_markov import FaultDetection
    from design.semi_markov_loop.system import DelayedJumpSystem

    if isinstance(process, FaultDetection):
        from design.semi_markov_loop.fault_tolerant_analysis import analyse_fault_tolerant

        if isinstance(system, DelayedJumpSystem):
            raise ValueError("a delay inside the plant together with a detected mode")
        return analyse_fault_tolerant(system, gain, process)
    if isinstance(system, DelayedJumpSystem):
        from design.semi_markov_loop.delayed_hinf import analyse_delayed

        return analyse_delayed(system, gain, process)
    from design.semi_markov_loop.stability import analyse

    coarse = analyse(system, gain, process, parts=1)
    return coarse if coarse.verdict == "certified" else analyse(system, gain, process)


def _with_continuous_time(
    loop: CertificationProblem,
    found: Verdict,
    system: JumpSystem | DelayedJumpSystem,
    gain: ScheduledGain,
    process: SemiMarkov | FaultDetection,
) -> Verdict:
    """Return the verdict at T with what the chapters add to it: gamma, and a word where nothing is decided at T."""
    details: dict[str, object] = {"sound": True, "period_s": loop.model.period_s, **found.details}
    try:
        ideal = in_continuous_time(system, gain, process)
        details |= ideal.to_json()
        word, gamma = str(ideal.verdict), ideal.gamma
    except (ValueError, DesignError) as error:
        word, gamma = f"not covered ({error})", None
    details |= {"stable": found.certified, "verdict": found.state, "continuous_time": word}
    reason, assumed = found.reason, found.assumptions
    if found.state == "undecided":
        T, tau, d = loop.model.period_s, loop.model.tau_max, loop.model.d_max
        delays = f" with delays up to tau = {tau} and d = {d} samples" if tau or d else ""
        reason = f"{word} in continuous time; not decided at T = {T:g} s{delays}: {found.reason}"
    else:
        reason = f"at T = {loop.model.period_s:g} s {found.reason}"
    if gamma is not None:
        assumed = (*assumed, "gamma alone is of the feedback that acts at every instant, without delays")
    number = found.number if found.number is None or isfinite(found.number) else None
    return replace(found, number=number, reason=reason, assumptions=assumed, details=details, digest=loop.digest)
