"""The certifier of Chapters 2 to 4: state feedback by mode and sojourn time over a plant that jumps."""

from __future__ import annotations

from typing import TYPE_CHECKING

from design.controllers import ModeSchedule
from design.errors import DesignError
from design.verdict import Kind, Verdict
from hil.compose.certifier import LoopToCertify, limited_to_model, undecided
from hil.compose.jump_plant import process_of, system_of
from hil.experiment.protocols import JumpPlant

if TYPE_CHECKING:
    from design.controllers.scheduled_gain import ScheduledGain
    from design.processes.semi_markov import FaultDetection, SemiMarkov
    from design.semi_markov_loop.certificate import JumpCertificate
    from design.semi_markov_loop.system import DelayedJumpSystem, JumpSystem


def certify_jump_loop(loop: LoopToCertify) -> Verdict | None:
    """Return the verdict on scheduled state feedback over a plant that jumps; None for any other loop.

    The conditions of Chapters 2 to 4 are of a feedback that acts at every instant on the state of that instant. The loop
    samples it at T and delays it, so that their word alone leaves the loop undecided.
    """
    plant, controller = loop.plant, loop.controller
    if not isinstance(controller, ModeSchedule):
        return None
    kind: Kind = "mean-square stability"
    if not isinstance(plant, JumpPlant):
        return undecided(loop, kind, "there is no certificate for gains by mode over a plant that does not jump")
    if loop.sc is None or loop.ca is None:
        return undecided(loop, kind, "there is no certificate for this kind of network law")
    try:
        system, process = system_of(plant.jump_system()), process_of(plant.jump_process())
        found = in_continuous_time(system, controller.schedule_of_modes(), process)
    except (ValueError, DesignError) as error:
        return undecided(loop, kind, f"the theory does not cover this plant: {error}")
    return limited_to_model(loop, _of_the_sampled_loop(loop, found))


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


def _of_the_sampled_loop(loop: LoopToCertify, found: JumpCertificate) -> Verdict:
    """Return what a verdict in continuous time says of the loop that runs at T with its delays."""
    T, tau, d = loop.model.period_s, loop.model.tau_max, loop.model.d_max
    delays = f" with delays up to tau = {tau} and d = {d} samples" if tau or d else ""
    details = {**found.to_json(), "stable": False, "verdict": "undecided", "continuous_time": found.verdict}
    return Verdict(
        kind="mean-square stability" if found.gamma is None else "L2 gain",
        state="undecided",
        reason=f"{found.verdict} in continuous time; not decided at T = {T:g} s{delays} (continuous time: {found.reason})",
        number=found.gamma,
        quantity="" if found.gamma is None else "gamma in continuous time",
        assumptions=found.assumptions,
        method=found.method,
        details=details,
        digest=loop.digest,
    )
