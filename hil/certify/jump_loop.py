"""The certifier of Chapters 2 to 4: state feedback by mode and sojourn time over a plant that jumps."""

from __future__ import annotations

from dataclasses import replace
from math import isfinite
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from design.controllers import LoopModel, ModeSchedule
from design.controllers.contract import StatesConstraint
from design.errors import DesignError, NotInstalled
from design.verdict import Kind, Verdict
from hil.certify import CertificationProblem, limited_to_model, undecided
from hil.rig.loop import Array, JumpStep
from plants.parts.protocols import JumpPlant

if TYPE_CHECKING:
    from design.controllers.scheduled_gain import ScheduledGain
    from design.processes.semi_markov import FaultDetection, SemiMarkov
    from design.semi_markov_loop import DelayedJumpSystem, JumpSystem
    from design.semi_markov_loop.certificate import JumpCertificate
    from plants.parts.semi_markov import JumpModel, JumpRates, TransitionRates


def system_of(plant: JumpModel) -> JumpSystem | DelayedJumpSystem:
    """Return the matrices of a plant as a system of Chapters 2 to 4.

    Its matrices are the plant's own, handed over and nowhere typed again.

    Raises:
        ValueError: matrices that do not fit each other, a delay that grows as fast as time (3.2), or both a delay inside and
            uncertain matrices, for which there is no theory.
    """
    from design.semi_markov_loop import DelayedJumpSystem, JumpSystem, VertexUncertainty

    a, b = np.array(plant.A, dtype=float), np.array(plant.B, dtype=float)
    c = np.array(plant.C, dtype=float) if plant.C else None
    e = np.array(plant.E, dtype=float) if plant.E else None
    if plant.Ad:
        if plant.changes:
            raise ValueError("changes: no theory covers uncertain matrices together with an internal delay")
        if plant.S:
            raise ValueError("S: no theory covers sensors that fail together with an internal delay")
        return DelayedJumpSystem(
            a=a, ad=np.array(plant.Ad, dtype=float), b=b, delay_max_s=plant.max_delay_s,
            delay_slopes=np.array(plant.delay_slopes, dtype=float),
            c=np.broadcast_to(np.eye(a.shape[1]), a.shape) if c is None else c, e=b if e is None else e,
        )  # fmt: skip
    vertices = None
    if plant.changes:
        dA, dB = (np.array([change[k] for change in plant.changes], dtype=float) for k in (0, 1))
        vertices = VertexUncertainty(da=dA, db=dB)
    sensors = np.array(plant.S, dtype=float) if plant.S else None
    return JumpSystem(a=a, b=b, c=c, e=e, uncertainty=vertices, sensors=sensors)


def process_of(rates: JumpRates) -> SemiMarkov | FaultDetection:
    """Return the rates of a plant as a process of Chapters 2 and 3, or of Chapter 4 where only the detected mode is measured."""
    from design.processes.semi_markov import FaultDetection

    if not rates.detection:
        return _semi_markov(rates.rates)
    return FaultDetection(
        failure=_semi_markov(rates.rates),
        detection=tuple(_semi_markov(table) for table in rates.detection),
        failure_restarts_detection_clock=rates.failure_restarts_detection_clock,
    )


def _semi_markov(table: TransitionRates) -> SemiMarkov:
    from design.processes.rates import PiecewiseLinearRate
    from design.processes.semi_markov import SemiMarkov

    def rate(i: int, j: int) -> PiecewiseLinearRate | None:
        values = tuple(matrix[i][j] for matrix in table.rates)
        return PiecewiseLinearRate(times_s=table.nodes_s, values=values) if i != j and any(values) else None

    return SemiMarkov(rates=tuple(tuple(rate(i, j) for j in range(table.modes)) for i in range(table.modes)))


KIND: Kind = "mean-square stability"


def certify_jump_loop(loop: CertificationProblem) -> Verdict | None:
    """Return the verdict on scheduled state feedback over a plant that jumps; None for any other loop.

    The state of the verdict is that of the loop as it runs: sampled at T, held, delayed by whole samples, its modes seen at the
    samples. The conditions of Chapters 2 to 4 are of a feedback that acts at every instant on the state of that instant; what
    they say stands in the details, and leaves a loop undecided that cannot be decided at T.

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
        names = ", ".join(loop.model.nodes.names)
        return undecided(loop, KIND, f"gains by mode are judged over one node; network.nodes has several sensor nodes: {names}")
    if loop.sc is None or loop.ca is None:
        return undecided(loop, KIND, loop.no_chain())
    from design.processes.semi_markov import FaultDetection
    from design.semi_markov_loop.sampled import sampled_verdict

    try:
        stated, rates, gain = _within_reach(
            loop.once("jump system", plant.jump_system), loop.once("jump process", plant.jump_process),
            loop.once("schedule", controller.schedule_of_modes),
        )  # fmt: skip
        system, process = system_of(stated), process_of(rates)
        system, gain = _with_seen_sensors(system, gain, hidden=isinstance(process, FaultDetection))
        verdict = sampled_verdict(
            system, process, gain, period_s=loop.model.period_s, tau=loop.sc, d=loop.ca, least_delay_s=stated.min_delay_s
        )
    except NotInstalled as error:
        return undecided(loop, KIND, f"its certificate was not computed: {error}")
    except (ValueError, DesignError) as error:
        return undecided(loop, KIND, f"the theory does not cover this plant: {error}")
    constraint = controller.constraint_of_modes() if isinstance(controller, StatesConstraint) else None
    verdict = _with_continuous_time(loop, verdict, system, gain, process)
    if constraint is not None:
        verdict = _with_constraint(verdict, constraint, system, gain, process)
    return limited_to_model(loop.plant, verdict, knows_jumps=True)


def _within_reach(plant: JumpModel, rates: JumpRates, gain: ScheduledGain) -> tuple[JumpModel, JumpRates, ScheduledGain]:
    """Return matrices, rates and gains of the modes that a run comes to; what is never met decides nothing."""
    true, detected = rates.reached()
    shown = detected if rates.detection else true
    if gain.modes == (rates.detection[0] if rates.detection else rates.rates).modes > len(shown):
        gain = replace(gain, gain=gain.gain[shown], starts_s=gain.starts_s[shown])
    return plant.of_modes(true), rates.of_modes(true, detected), gain


def _with_constraint(
    verdict: Verdict,
    constraint: tuple[Array, Array, Array],
    system: JumpSystem | DelayedJumpSystem,
    gain: ScheduledGain,
    process: SemiMarkov | FaultDetection,
) -> Verdict:
    """Return the verdict with what the conditions of Chapter 4 say of a quadratic constraint (4.6)."""
    from design.processes.semi_markov import FaultDetection
    from design.semi_markov_loop import DelayedJumpSystem
    from design.semi_markov_loop.fault_tolerant_analysis import Siqc, analyse_fault_tolerant

    try:
        if isinstance(system, DelayedJumpSystem) or not isinstance(process, FaultDetection):
            raise ValueError("the plant does not show a detected mode")
        wanted = Siqc(g11=constraint[0], g12=constraint[1], g22=constraint[2])
        judged = analyse_fault_tolerant(system, gain, process, performance=wanted)
        word, why = str(judged.verdict), judged.reason
    except (ValueError, DesignError) as error:
        word, why = "undecided", str(error)
    said = {"certified": "holds", "refused": "has no proof of this form", "undecided": "is undecided"}[word]
    details = {**verdict.details, "constraint": {"state": word, "reason": why}}
    return msgspec.structs.replace(
        verdict, details=details, reason=f"{verdict.reason}; the constraint (4.6) {said}",
        assumptions=(*verdict.assumptions, "the constraint (4.6) is of the feedback that acts at every instant, without delays"),
    )  # fmt: skip


def _with_seen_sensors(
    system: JumpSystem | DelayedJumpSystem, gain: ScheduledGain, *, hidden: bool
) -> tuple[JumpSystem | DelayedJumpSystem, ScheduledGain]:
    """Return K_i S_i in the place of the gains where the mode is seen: sample and mode are of the same instant."""
    from design.semi_markov_loop import DelayedJumpSystem

    if hidden or isinstance(system, DelayedJumpSystem) or system.sensors is None:
        return system, gain
    if gain.modes != system.modes or gain.gain.shape[3] != system.states:
        raise ValueError(f"gains of {gain.modes} modes for {gain.gain.shape[3]} states, the plant has {system.modes}")
    return replace(system, sensors=None), replace(gain, gain=gain.gain @ system.sensors[:, None])


def in_continuous_time(
    system: JumpSystem | DelayedJumpSystem, gain: ScheduledGain, process: SemiMarkov | FaultDetection
) -> JumpCertificate:
    """Return what Chapters 2, 3 or 4 say of the gains as they are, acting at every instant without delay.

    Raises:
        ValueError: a plant or a schedule that no chapter covers.
        DesignError: no verdict could be computed.
    """
    from design.processes.semi_markov import FaultDetection
    from design.semi_markov_loop import DelayedJumpSystem

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
    verdict: Verdict,
    system: JumpSystem | DelayedJumpSystem,
    gain: ScheduledGain,
    process: SemiMarkov | FaultDetection,
) -> Verdict:
    """Return the verdict at T with what the chapters add to it: gamma, and a word where nothing is decided at T."""
    details: dict[str, object] = {"sound": True, "period_s": loop.model.period_s, **verdict.details}
    try:
        ideal = in_continuous_time(system, gain, process)
        details |= ideal.to_json()
        word, ideals = str(ideal.verdict), {"gamma": ideal.gamma, "decay_rate": ideal.decay_rate}
    except (ValueError, DesignError) as error:
        word, ideals = f"not covered ({error})", {}
    details |= {"stable": verdict.certified, "verdict": verdict.state, "continuous_time": word}
    reason, assumed = verdict.reason, verdict.assumptions
    if verdict.state == "undecided":
        T, tau, d = loop.model.period_s, loop.model.tau_max, loop.model.d_max
        delays = f" with delays up to tau = {tau} and d = {d} samples" if tau or d else ""
        reason = f"{word} in continuous time; not decided at T = {T:g} s{delays}: {verdict.reason}"
    else:
        reason = f"at T = {loop.model.period_s:g} s {verdict.reason}"
    of_ideal = [name for name, value in ideals.items() if value is not None]
    if of_ideal:
        said = f"{' and '.join(of_ideal)} alone {'are' if of_ideal[1:] else 'is'} of the feedback that acts at every instant"
        assumed = (*assumed, f"{said}, without delays")
    number = verdict.number if verdict.number is None or isfinite(verdict.number) else None
    return msgspec.structs.replace(
        verdict, number=number, reason=reason, assumptions=assumed, details=details, digest=loop.digest
    )


def jump_step(plant: JumpPlant, model: LoopModel) -> JumpStep | None:
    r"""Return what the record of a plant that jumps fulfils; None where it does not show the state: a delay, sensors that fail.

    In a slot in which its mode stays it is the flow of that mode.

    What is uncertain lies within +-D_A, +-D_B. With M(A) for A with the absolute values beside its diagonal, the deviation e of
    the motion from that of the mode is bounded by the flow of

    .. math::
        X' = (M(A) + D_A) X + (|B| + D_B) |v|, \quad E' = M(A) E + D_A X + D_B |v|, \quad X(0) = |x(k)|,\; E(0) = 0.

    Args:
        plant: what runs.
        model: of the loop, with its period.
    """
    from scipy.linalg import expm

    system, rates, T = plant.jump_system(), plant.jump_process(), model.period_s
    if system.Ad or system.S:
        return None
    A, B = np.array(system.A, dtype=float), np.array(system.B, dtype=float)
    N, n, m = B.shape
    DA, DB = np.zeros_like(A), np.zeros_like(B)
    for dA, dB in system.changes:
        DA, DB = np.maximum(DA, np.abs(np.array(dA, dtype=float))), np.maximum(DB, np.abs(np.array(dB, dtype=float)))
    flows, bands = np.zeros((N, n, n + m)), np.zeros((N, n, n + m))
    for i in range(N):
        flows[i] = expm(T * np.block([[A[i], B[i]], [np.zeros((m, n + m))]]))[:n]
        if DA[i].any() or DB[i].any():
            away = np.abs(A[i])
            np.fill_diagonal(away, np.diag(A[i]))
            whole = np.block([
                [away + DA[i], np.zeros((n, n)), np.abs(B[i]) + DB[i]], [DA[i], away, DB[i]], [np.zeros((m, 2 * n + m))],
            ])  # fmt: skip
            bands[i] = np.delete(expm(T * whole)[n : 2 * n], slice(n, 2 * n), axis=1)
    fastest = max((sum(rate for rate in row if rate > 0.0) for matrix in rates.rates.rates for row in matrix), default=0.0)
    return JumpStep(
        flows=flows, bands=bands, seen=not rates.detection,
        unseen=fastest * T if rates.detection else (fastest * T) ** 2,
        names=tuple((str(s.name), str(s.unit)) for s in plant.outputs[:n]),
    )  # fmt: skip
