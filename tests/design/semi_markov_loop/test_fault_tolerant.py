"""Fault-tolerant feedback of Chapter 4: what sees the detection only, certified; what the printed gains do then."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest

from design.as_printed import chapter4_gain, chapter4_partitioned_gain, chapter4_process, chapter4_seen_gain, chapter4_system
from design.as_printed.chapters_2_to_4 import detection_section, free_gains
from design.controllers.scheduled_gain import ScheduledGain, constant_gain
from design.errors import FieldError, Infeasible
from design.lmi import prove
from design.processes.rates import PiecewiseLinearRate, constant_rate
from design.processes.semi_markov import FaultDetection, SemiMarkov
from design.semi_markov_loop import JumpSystem
from design.semi_markov_loop.certificate import JumpCertificate
from design.semi_markov_loop.fault_tolerant import fault_tolerant_feedback
from design.semi_markov_loop.fault_tolerant_analysis import (
    Siqc,
    analyse_fault_tolerant,
    check_loop,
    loop_inequalities,
    mean_square_abscissa,
    worst_growth,
)
from design.semi_markov_loop.second_moments import second_moment_decay

SYSTEM = chapter4_system()
PROCESS = chapter4_process(failure_restarts_detection_clock=False)
ONE = ((0.0,),) * 2
ETA, DETECTION = ((0.0, 1.0),) * 2, ((0.0, 0.3),) * 2


def known_fault(gain: np.ndarray) -> ScheduledGain:
    sections = gain.reshape(4, -1, 2, 4)
    starts = np.array([[0.0, 0.3][: sections.shape[1]]] * 4)
    return ScheduledGain(gain=sections, starts_s=starts, measured=("eta", "r"))


@cache
def designed() -> JumpCertificate:
    return fault_tolerant_feedback(SYSTEM, PROCESS, gain_bound=2.0)


def test_required_level_is_certified_seeing_the_detection_only() -> None:
    certificate = designed()
    assert certificate.certified and certificate.sound
    assert certificate.gain is not None and certificate.gain.measured == ("r",) and certificate.gain.norm <= 2.0 * (1 + 1e-12)
    assert certificate.gamma is not None and certificate.gamma <= 0.0060
    assert certificate.check() > 0 and prove(certificate, bits=40).proved


@pytest.mark.slow
def test_one_blind_gain_is_about_as_good_and_a_known_fault_is_by_choice() -> None:
    blind = fault_tolerant_feedback(SYSTEM, PROCESS, gain_bound=2.0, measured=())
    assert blind.gain is not None and blind.gain.modes == 1 and (blind.gamma or 1) < 0.0060
    known = fault_tolerant_feedback(SYSTEM, PROCESS, gain_bound=2.0, measured=("eta", "r"), rounds=3)
    assert known.gain is not None and known.gain.modes == 4 and (known.gamma or 1) < 0.0066


@pytest.mark.slow
@pytest.mark.parametrize("restarts", [False, True])
def test_two_clocks_with_sections_are_certified_under_both_reset_rules(restarts: bool) -> None:
    process = chapter4_process(failure_restarts_detection_clock=restarts)
    certificate = fault_tolerant_feedback(
        SYSTEM, process, gain_bound=2.0, sections=DETECTION, eta_nodes=ETA, gamma=0.0062, rounds=4
    )
    assert certificate.gain is not None and certificate.gain.gain.shape[:2] == (2, 2)
    assert (certificate.gamma or 1) <= 0.0062 and certificate.check() > 0


def test_published_gains_used_as_the_text_prescribes_diverge() -> None:
    # DEVIATION: (4.30) holds K_ik, (4.2)-(4.3) prescribe K(r): K_11 acts while the fault is not detected yet
    gain = chapter4_seen_gain(partitioned=False)
    assert np.linalg.eigvals(SYSTEM.a[1] + SYSTEM.b[1] @ gain.gain[0, 0]).real.max() == pytest.approx(10.90, abs=0.01)
    certificate = analyse_fault_tolerant(SYSTEM, gain, PROCESS)
    assert certificate.verdict == "refused" and "second moments grow" in certificate.reason
    assert certificate.decay_rate is not None and -21.0 < certificate.decay_rate < -20.0


@pytest.mark.parametrize(
    ("gain", "level"),
    [
        (chapter4_seen_gain(partitioned=True), 0.0161),
        (known_fault(chapter4_gain()), 0.0239),
        (known_fault(chapter4_partitioned_gain()), 0.0175),
    ],
)
def test_levels_of_the_published_gains(gain: ScheduledGain, level: float) -> None:
    certificate = analyse_fault_tolerant(SYSTEM, gain, PROCESS)
    assert certificate.gamma == pytest.approx(level, abs=1e-4) and certificate.check() > 0


def test_printed_levels_are_loose_and_speak_against_the_partition() -> None:
    single = detection_section(SYSTEM, PROCESS, ONE, ONE, 0, chapter4_gain())
    assert single.gamma == pytest.approx(0.0622, abs=2e-4) and not single.sound
    second = detection_section(SYSTEM, PROCESS, ETA, DETECTION, 1, chapter4_partitioned_gain()[:, :, 1])
    assert second.gamma == pytest.approx(0.1468, abs=5e-4)


def test_printed_conditions_carry_their_flag_in_synthesis() -> None:
    made = detection_section(SYSTEM, PROCESS, ONE, ONE, 0, None, gain_bound=5.0)
    assert made.gamma == pytest.approx(0.52, abs=0.02) and not made.sound
    gains = free_gains(made, ("0,0", "0,1", "1,0", "1,1")).reshape(2, 2, 2, 4)
    assert np.linalg.norm(gains, 2, axis=(2, 3)).max() < 5.0 * (1.0 + 1e-6)
    again = detection_section(SYSTEM, PROCESS, ONE, ONE, 0, gains)
    assert again.gamma is not None and again.gamma <= made.gamma * (1.0 + 1e-3)


def test_printed_sections_miss_the_pair_of_clocks_that_diverges() -> None:
    # DEVIATION from Corollary 4.3: pairs (1,1) and (2,2) pass, eta in section 2 with r in section 1 diverges
    def two(section: int) -> tuple[FaultDetection, JumpSystem]:
        rate, detect = (0.1, 3.0) if section == 0 else (6.0, 60.0)
        return process(rate, detect), system

    def step(first: float, second: float) -> PiecewiseLinearRate:
        return PiecewiseLinearRate(times_s=(0.0, 1.0, 1.0), values=(first, first, second))

    def process(*_: float) -> FaultDetection:
        eta = SemiMarkov(rates=((None, step(0.1, 6.0)), (step(0.1, 6.0), None)))
        alarm, find = step(0.06, 1.2), step(3.0, 60.0)
        normal = SemiMarkov(rates=((None, alarm), (find, None)))
        faulty = SemiMarkov(rates=((None, find), (alarm, None)))
        return FaultDetection(failure=eta, detection=(normal, faulty), failure_restarts_detection_clock=False)

    # matched a = -1, mismatched a = +1.3: a_i + b_i k_r with a = 0.15, b_0 = 1.15, b_1 = -1.15, k = -1, +1
    system = JumpSystem(
        a=np.full((2, 1, 1), 0.15), b=np.array([[[1.15]], [[-1.15]]]), c=np.ones((2, 1, 1)), e=np.ones((2, 1, 1))
    )
    gains = np.array([-1.0, 1.0]).reshape(2, 1, 1)
    known = np.stack([gains, gains])
    sections = ((0.0, 1.0),) * 2
    for m in (0, 1):
        assert detection_section(system, two(m)[0], sections, sections, m, known, vertices=True).certified
    loops = np.array([[[-1.0]], [[1.3]], [[1.3]], [[-1.0]]])  # (eta, r) = (0,0), (0,1), (1,0), (1,1)
    rates = np.array([[0, 0.06, 6, 0], [3, 0, 0, 6], [6, 0, 0, 3], [0, 6, 0.06, 0]], dtype=float)
    assert mean_square_abscissa(loops, rates) == pytest.approx(0.2016, abs=1e-3)
    ours = analyse_fault_tolerant(system, constant_gain(gains), process(), eta_nodes=sections, r_nodes=sections)
    assert ours.verdict == "refused"


def test_growth_at_constant_rates_is_the_abscissa_of_the_generator() -> None:
    gain = designed().gain
    assert gain is not None
    worst = worst_growth(SYSTEM, gain, PROCESS)
    assert worst is not None and worst[0] < 0


def test_quadratic_constraint_with_a_cross_term_is_met() -> None:
    siqc = Siqc(g11=np.eye(1), g12=np.array([[0.01, 0.0]]), g22=-4e-4 * np.eye(2))
    certificate = fault_tolerant_feedback(SYSTEM, PROCESS, gain_bound=2.0, performance=siqc)
    assert certificate.certified and certificate.gamma is None and certificate.check() > 0
    plain = Siqc(g11=np.eye(1), g12=np.zeros((1, 2)), g22=-(0.007**2) * np.eye(2))
    gain = fault_tolerant_feedback(SYSTEM, PROCESS, gain_bound=2.0, gamma=0.0066).gain
    assert gain is not None and analyse_fault_tolerant(SYSTEM, gain, PROCESS, performance=plain).certified
    strict = Siqc(g11=np.eye(1), g12=np.zeros((1, 2)), g22=-(0.003**2) * np.eye(2))
    assert not analyse_fault_tolerant(SYSTEM, gain, PROCESS, performance=strict).certified


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: fault_tolerant_feedback(SYSTEM, PROCESS, gain_bound=0.0), "gain_bound: 0.0"),
        (lambda: fault_tolerant_feedback(SYSTEM, PROCESS, gain_bound=1.0, measured=("x",)), r"measured: \('x',\)"),
        (
            lambda: fault_tolerant_feedback(SYSTEM, PROCESS, gain_bound=1.0, measured=(), sections=DETECTION),
            "sections: a controller without detection",
        ),
        (
            lambda: analyse_fault_tolerant(SYSTEM, constant_gain(np.zeros((3, 2, 4))), PROCESS),
            r"gain: \(modes, inputs, states\) = \(3",
        ),
        (
            lambda: analyse_fault_tolerant(
                JumpSystem(a=SYSTEM.a, b=SYSTEM.b, c=SYSTEM.c), chapter4_seen_gain(partitioned=True), PROCESS
            ),
            "e: is needed",
        ),
        (lambda: Siqc(g11=-np.eye(1), g12=np.zeros((1, 1)), g22=-np.eye(1)), "g11: eigenvalue -1, expected a positive"),
        (lambda: Siqc(g11=np.eye(1), g12=np.zeros((1, 1)), g22=np.eye(1)), "g22: eigenvalue 1, expected a negative"),
        (lambda: Siqc(g11=np.eye(1), g12=np.zeros((2, 1)), g22=-np.eye(1)), r"g12: shape \(2, 1\)"),
    ],
)
def test_bad_input_gets_one_clear_message(call: object, message: str) -> None:
    with pytest.raises(ValueError, match="^" + message):
        call()  # type: ignore[operator]


def test_level_that_was_not_reached_is_said_to_be_unproved() -> None:
    with pytest.raises(Infeasible, match="not proved to be the best"):
        fault_tolerant_feedback(SYSTEM, PROCESS, gain_bound=2.0, gamma=0.001, rounds=1)


def _scalar_loop(process: FaultDetection, gains: list[float], starts: list[float]) -> tuple[JumpSystem, ScheduledGain]:
    one = np.ones((2, 1, 1))
    gain = ScheduledGain(gain=np.array([[[[k]] for k in gains]] * 2), starts_s=np.array([starts] * 2))
    return JumpSystem(a=-one, b=one, c=one, e=one), gain


def test_sections_of_the_gain_inside_a_cell_are_not_passed_over() -> None:
    # -1 for one second, +49 after it: one cell had the gain of its start only and was certified with gamma 0.5
    slow = constant_rate(0.5)
    process = FaultDetection(
        failure=SemiMarkov(rates=((None, slow), (slow, None))), detection=(SemiMarkov(rates=((None, slow), (slow, None))),) * 2,
        failure_restarts_detection_clock=False,
    )  # fmt: skip
    system, gain = _scalar_loop(process, [-1.0, 50.0], [0.0, 1.0])
    assert not analyse_fault_tolerant(system, gain, process, r_nodes=ONE).certified
    with pytest.raises(ValueError, match=r"r_nodes\[0\]: a section of the gains starts at 1 s"):
        loop_inequalities(system, process, gain, ONE, ONE, None, 1.0)
    system, gain = _scalar_loop(process, [-1.0, -2.0], [0.0, 1.0])
    coarse = analyse_fault_tolerant(system, gain, process, r_nodes=ONE)
    assert coarse.certified and coarse.gamma == pytest.approx(analyse_fault_tolerant(system, gain, process).gamma, rel=1e-3)
    smaller = partial(coarse.rebuild.func, *coarse.rebuild.args[:-1], 0.9 * coarse.gamma)
    assert coarse.check() > 0 > replace(coarse, rebuild=smaller).check()  # the proof is of this gamma and of no smaller one


def test_decay_of_a_certificate_is_one_that_the_process_keeps() -> None:
    # a rate within its bounds that is slow at first and fast later decays more slowly than either held constant
    step = PiecewiseLinearRate(times_s=(0.0, 0.4967, 0.4967), values=(0.01, 0.01, 30.0))
    still = SemiMarkov(rates=((None,),))
    process = FaultDetection(
        failure=SemiMarkov(rates=((None, step), (step, None))), detection=(still, still), failure_restarts_detection_clock=False
    )
    a = np.array([[[0.0, -1.0], [10.0, 0.0]], [[0.0, -10.0], [1.0, 0.0]]])
    gain = constant_gain(np.zeros((1, 1, 2)))
    for shift in (5.0, 8.0):
        moved = a - shift * np.eye(2)
        system = JumpSystem(a=moved, b=np.zeros((2, 2, 1)), c=np.ones((2, 1, 2)), e=np.ones((2, 2, 1)))
        certificate = analyse_fault_tolerant(system, gain, process)
        plain = JumpSystem(a=moved, b=np.zeros((2, 2, 1)))
        exact = second_moment_decay(plain, constant_gain(np.zeros((2, 1, 2))), process.failure)
        held = worst_growth(system, gain, process)
        assert certificate.certified and certificate.decay_rate is not None and held is not None
        assert 0.0 < certificate.decay_rate < exact < -held[0]


def test_rates_that_no_section_allows_together_refuse_nothing() -> None:
    # the bad gain is left to 0 in its first 0.1 s and to 1 after it, at 10/s always: both rates are never 0 at once
    def step(before: float, after: float) -> PiecewiseLinearRate:
        return PiecewiseLinearRate(times_s=(0.0, 0.1, 0.1), values=(before, before, after))

    slow = constant_rate(1.0)
    detection = SemiMarkov(rates=((None, None, slow), (None, None, slow), (step(10.0, 0.0), step(0.0, 10.0), None)))
    failure = SemiMarkov(rates=((None, slow), (slow, None)))
    process = FaultDetection(failure=failure, detection=(detection,) * 2, failure_restarts_detection_clock=False)
    one = np.ones((2, 1, 1))
    system, gain = JumpSystem(a=0.0 * one, b=one, c=one, e=one), constant_gain(np.array([-2.0, -2.0, 1.0]).reshape(3, 1, 1))
    certificate = analyse_fault_tolerant(system, gain, process, r_nodes=((0.0,), (0.0,), (0.0, 0.1)))
    assert certificate.certified and certificate.gamma == pytest.approx(0.7047, rel=1e-3)
    assert analyse_fault_tolerant(system, gain, process).verdict == "refused"


SEEN = chapter4_seen_gain(partitioned=False)
WIDE = JumpSystem(a=np.zeros((3, 1, 1)), b=np.ones((3, 1, 1)), c=np.ones((3, 1, 1)), e=np.ones((3, 1, 1)))


@pytest.mark.parametrize(
    ("system", "gain", "field"),
    [
        (replace(SYSTEM, c=None), None, "c"),
        (replace(SYSTEM, e=None), None, "e"),
        (WIDE, None, "process"),
        (SYSTEM, replace(SEEN, measured=("eta",)), "measured"),
        (SYSTEM, replace(SEEN, measured=()), "gain"),
        (SYSTEM, replace(SEEN, schedule="linear"), "gain"),
    ],
)
def test_parts_that_do_not_fit_each_other_are_refused(system: JumpSystem, gain: ScheduledGain | None, field: str) -> None:
    check_loop(SYSTEM, PROCESS, SEEN)
    with pytest.raises(FieldError) as refused:
        check_loop(system, PROCESS, gain)
    assert refused.value.field == field
