"""Analysis of Chapter 2 loops: the printed conditions accept what diverges, ours refuse it, exact second moments decide."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from scipy.linalg import expm
from scipy.special import erf, erfcx

from design.as_printed import CHAPTER2_BOUNDARY_S, chapter2_gain, chapter2_process, chapter2_reference_gain, chapter2_system
from design.as_printed.chapters_2_to_4 import printed_stability
from design.controllers.scheduled_gain import ScheduledGain, constant_gain
from design.lmi import prove
from design.lmi.program import symmetric_part
from design.processes.further_rates import BathtubRate, ColdStandbyRate, KOutOfNRate
from design.processes.partitions import Partition, equal_probability, uniform
from design.processes.rates import PiecewiseLinearRate, Rate, ScaledRate, WeibullRate, constant_rate
from design.processes.semi_markov import SemiMarkov, sample_path
from design.semi_markov_loop import JumpSystem, NormBounded
from design.semi_markov_loop.second_moments import second_moment_decay, second_moment_radius
from design.semi_markov_loop.stability import analyse, largest_decay, stability_inequalities

PROCESS = chapter2_process()
STEP = PiecewiseLinearRate(times_s=(0.0, 0.4967, 0.4967), values=(0.01, 0.01, 200.0))
HALVES: Partition = ((0.0, 0.4967), (0.0, 0.4967))


def autonomous(*modes: object) -> JumpSystem:
    a = np.array(modes, dtype=float)
    return JumpSystem(a=a, b=np.zeros((*a.shape[:2], 1)))


STEP_SYSTEM = autonomous([[-0.6, -1], [10, -0.6]], [[-0.6, -10], [1, -0.6]])
STEP_PROCESS = SemiMarkov(rates=((None, STEP), (STEP, None)))
RAMP_SYSTEM = autonomous([[-0.7606, -0.2], [3.2, -0.7606]], [[-0.7606, -3.2], [0.2, -0.7606]])


def exact(system: JumpSystem, gain: ScheduledGain, process: SemiMarkov) -> tuple[float, float]:
    return second_moment_radius(system, gain, process), second_moment_decay(system, gain, process)


def test_printed_corollary_accepts_a_diverging_system_and_ours_refuse_it() -> None:
    # DEVIATION from Corollary 2.1: counterexample 1, ERRATA 1
    printed = printed_stability(STEP_SYSTEM, None, STEP_PROCESS, nodes=HALVES)
    assert printed.certified and printed.check() > 0 and not printed.sound
    assert prove(printed).proved  # the printed inequalities really hold, and the system really diverges
    exact = analyse(STEP_SYSTEM, None, STEP_PROCESS, method="exact")
    assert exact.verdict == "refused" and exact.spectral_radius == pytest.approx(5.463, abs=1e-3)
    for method in ("pwc", "pwl"):
        ours = analyse(STEP_SYSTEM, None, STEP_PROCESS, method=method, nodes=HALVES)  # type: ignore[arg-type]
        assert ours.verdict == "refused" and ours.sound and "dual matrices prove" in ours.reason


def test_printed_corollary_fails_for_the_rates_of_the_thesis_too() -> None:
    for sections in (12, 16):
        nodes = uniform(PROCESS, sections)
        assert printed_stability(RAMP_SYSTEM, None, PROCESS, nodes=nodes).certified
        assert analyse(RAMP_SYSTEM, None, PROCESS, method="pwc", nodes=nodes).verdict == "refused"
        assert analyse(RAMP_SYSTEM, None, PROCESS, method="pwl", nodes=nodes).verdict == "refused"
    exact = analyse(RAMP_SYSTEM, None, PROCESS, method="exact")
    assert exact.spectral_radius == pytest.approx(1.107, abs=1e-3)


def test_monte_carlo_sides_with_the_exact_second_moments() -> None:
    # mean log growth per jump of counterexample 1 is +0.847: almost every path diverges
    rng = np.random.default_rng(0)
    path = sample_path(STEP_PROCESS, 0, 400.0, rng)
    x, growth = np.array([1.0, 1.0]), 0.0

    for mode, h in zip(path.modes, np.diff(path.times_s)):
        x = expm(STEP_SYSTEM.a[mode] * h) @ x
        growth += np.log(np.linalg.norm(x))
        x /= np.linalg.norm(x)
    jumps = path.times_s.size - 1
    assert growth / jumps == pytest.approx(0.847, abs=0.1)


def test_two_corners_do_not_cover_the_rate_box_of_three_modes() -> None:
    # DEVIATION from Theorem 2.2: it tests "all low" and "all high" only; (10, 0.1) lies outside that segment
    def box(low: float, high: float) -> PiecewiseLinearRate:
        return PiecewiseLinearRate(times_s=(0.0, 1.0), values=(low, high))

    system = autonomous([[-0.05]], [[0.65]], [[-6.0]])
    back = constant_rate(3.0)
    rates = SemiMarkov(rates=((None, box(0.1, 10), box(0.1, 10)), (back, None, None), (back, None, None)))
    nodes: Partition = ((0.0,), (0.0,), (0.0,))
    assert printed_stability(system, None, rates, nodes=nodes).certified
    assert analyse(system, None, rates, method="pwc", nodes=nodes).verdict == "refused"
    worst = SemiMarkov(rates=((None, constant_rate(10), constant_rate(0.1)), (back, None, None), (back, None, None)))
    exact = analyse(system, None, worst, method="exact")
    assert exact.verdict == "refused"
    assert exact.decay_rate == pytest.approx(-0.986, abs=2e-3)


def test_exact_numbers_of_the_chapter_2_example() -> None:
    nominal = chapter2_system("none")
    radius, decay = exact(nominal, chapter2_gain(), PROCESS)
    assert radius == pytest.approx(0.15826, abs=1e-5) and decay / 2 == pytest.approx(1.1150, abs=1e-4)
    radius, decay = exact(nominal, chapter2_reference_gain(), PROCESS)
    assert radius == pytest.approx(0.41726, abs=1e-5) and decay / 2 == pytest.approx(0.3496, abs=1e-4)


def test_reference_gains_are_unstable_at_a_corner_of_the_printed_uncertainty() -> None:
    system = chapter2_system("vertices").at_vertex(1)
    assert second_moment_radius(system, chapter2_reference_gain(), PROCESS) == pytest.approx(1.518, abs=5e-4)
    assert second_moment_radius(system, chapter2_gain(), PROCESS) < 1.0


def test_published_gains_pass_the_printed_test_and_only_pwl_certifies_them() -> None:
    system = chapter2_system("printed")
    printed = printed_stability(system, chapter2_gain(), PROCESS)
    assert printed.certified and not printed.sound
    assert analyse(system, chapter2_gain(), PROCESS, method="pwc", condition=1e3).verdict == "refused"
    nodes: Partition = ((0.0, CHAPTER2_BOUNDARY_S, 4.6),) * 2
    pwl = analyse(system, chapter2_gain(), PROCESS, method="pwl", nodes=nodes)
    assert pwl.certified and pwl.sound and pwl.check() > 0
    best = largest_decay(system, chapter2_gain(), PROCESS, nodes=nodes)
    assert best.decay_rate is not None and best.decay_rate / 2 == pytest.approx(0.25, abs=0.01)
    assert best.check() > 0


def test_moments_beyond_every_float_end_no_exact_test() -> None:
    """A loop 1000 times as fast as its modes change is stable; one that grows to e^1185 within a stay is not decided."""
    fast = analyse(autonomous([[-200.0]], [[-200.0]]), None, PROCESS, method="exact")
    assert fast.certified and fast.decay_rate is not None and 100.0 < fast.decay_rate < 400.0
    slow = WeibullRate(scale_s=5.0, shape=1.5)
    grown = analyse(autonomous([[2.0]], [[-1.0]]), None, SemiMarkov(rates=((None, slow), (slow, None))), method="exact")
    assert grown.verdict == "undecided" and "larger than any float" in grown.reason


def test_pwl_decay_approaches_the_exact_one_from_below() -> None:
    exact = second_moment_decay(chapter2_system("none"), chapter2_gain(), PROCESS)
    rates = []
    for parts in (1, 4):
        certificate = largest_decay(chapter2_system("none"), chapter2_gain(), PROCESS, parts=parts, tolerance=1e-2)
        rates.append(certificate.decay_rate or 0.0)
    assert rates == sorted(rates) and 1.6 < rates[-1] < exact


def test_gains_linear_in_the_sojourn_time_are_certified_between_their_nodes_too() -> None:
    gain = ScheduledGain(
        gain=np.array([[[[-20.0, 13.0]], [[-11.0, 7.0]]], [[[-4.7, 6.3]], [[-4.0, 3.3]]]]),
        starts_s=np.array([[0.0, 1.5]] * 2),
        schedule="linear",
    )
    system = chapter2_system("none")
    certificate = analyse(system, gain, PROCESS, parts=3)
    assert certificate.certified and prove(certificate).proved
    radius, decay = exact(system, gain, PROCESS)
    assert radius < 1 and (certificate.decay_rate or 0) < decay
    with pytest.raises(ValueError, match="only method 'pwl' can follow it"):
        analyse(system, gain, PROCESS, method="pwc")


def test_exact_radius_agrees_with_a_simulated_second_moment() -> None:
    # E x x' after one jump, from 20,000 sampled sojourns, against the operator's own first step

    from design.semi_markov_loop.period_moments import smat, svec
    from design.semi_markov_loop.second_moments import _mode_moments, _operator

    system, gain = chapter2_system("none"), chapter2_reference_gain()
    moments = [_mode_moments(system, gain, PROCESS, i, 4) for i in range(2)]
    operator = _operator(moments, 0.0)
    assert operator is not None
    x = np.array([1.0, -0.5])
    predicted = smat(operator[3:, :3] @ svec(np.outer(x, x)))
    h, _ = PROCESS.next_jump(np.zeros(20_000, dtype=int), np.random.default_rng(8))
    a = system.a[0] + system.b[0] @ gain.gain[0, 0]
    after = expm(a * h[:, None, None]) @ x
    samples = np.einsum("ki,kj->kij", after, after)
    error = samples.std(axis=0) / np.sqrt(h.size)
    assert (np.abs(samples.mean(axis=0) - predicted) < 4 * error).all()


def test_constant_rates_give_the_markov_answer() -> None:
    # mode 0 grows, mode 1 decays: mean-square decay is minus the abscissa of [[2a0 - l, l], [l, 2a1 - l]]
    system = autonomous([[0.5]], [[-3.0]])
    process = SemiMarkov(rates=((None, constant_rate(2.0)), (constant_rate(2.0), None)))
    generator = np.array([[1.0 - 2.0, 2.0], [2.0, -6.0 - 2.0]])
    decay = second_moment_decay(system, constant_gain(np.zeros((2, 1, 1))), process)
    assert decay == pytest.approx(-np.linalg.eigvals(generator).real.max(), abs=1e-8)
    growing = autonomous([[1.5]], [[-3.0]])
    assert second_moment_radius(growing, constant_gain(np.zeros((2, 1, 1))), process) == np.inf


def test_rates_that_never_settle_are_integrated_to_the_end() -> None:
    weibull = WeibullRate(scale_s=1.0, shape=2.0)
    process = SemiMarkov(rates=((None, weibull), (weibull, None)))
    radius = second_moment_radius(autonomous([[0.3]], [[-0.8]]), constant_gain(np.zeros((2, 1, 1))), process)
    grow, fall = (1.0 + c * np.sqrt(np.pi) / 2 * np.exp(c * c / 4) * (1.0 + erf(c / 2)) for c in (0.6, -1.6))  # E e^(c h)
    assert radius == pytest.approx(np.sqrt(grow * fall), rel=1e-8)


def test_certificate_is_judged_by_its_own_matrices() -> None:
    good = analyse(chapter2_system("none"), chapter2_gain(), PROCESS)
    assert good.check() == pytest.approx(good.margin)
    spoiled = {**good.matrices, "P[0,0]": good.matrices["P[0,0]"] * 3.0}
    forged = replace(good, matrices=spoiled)
    assert forged.check() < 0 and not prove(forged).proved


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: analyse(STEP_SYSTEM, chapter2_gain(), STEP_PROCESS, nodes=((0.0, 0.5),) * 2),
            r"nodes\[0\]: a section",
        ),
        (lambda: analyse(STEP_SYSTEM, None, STEP_PROCESS, method="best"), "method: 'best' is not one of"),  # type: ignore[arg-type]
        (lambda: analyse(STEP_SYSTEM, None, STEP_PROCESS, decay=-1.0), "decay: -1.0"),
        (lambda: analyse(autonomous([[-1.0]]), None, STEP_PROCESS), "process: 2 modes, the system has 1"),
        (
            lambda: analyse(STEP_SYSTEM, constant_gain(np.zeros((2, 1, 3))), STEP_PROCESS),
            r"gain: \(modes, inputs, states\) = \(2, 1, 3\), expected \(2, 1, 2\)",
        ),
        (lambda: analyse(chapter2_system(), None, PROCESS, method="exact"), "uncertainty: the exact test"),
        (
            lambda: analyse(
                STEP_SYSTEM, None, SemiMarkov(rates=((None, WeibullRate(scale_s=1.0, shape=2.0)), (STEP, None)))
            ),
            r"rates\[0\]\[1\]: no finite bound on \[0, inf\) s",
        ),
        (
            lambda: JumpSystem(a=np.zeros((2, 2, 3)), b=np.zeros((2, 2, 1))),
            r"a: shape \(2, 2, 3\), expected 2 along axis 2",
        ),
        (
            lambda: JumpSystem(a=np.zeros((2, 2, 2)), b=np.zeros((2, 3, 1))),
            r"b: shape \(2, 3, 1\), expected 2 along axis 1",
        ),
        (
            lambda: JumpSystem(a=np.full((1, 2, 2), np.nan), b=np.zeros((1, 2, 1))),
            r"a\[0, 0, 0\]: nan is not finite",
        ),
        (lambda: JumpSystem(a=np.zeros((1, 2, 2)), b=None), r"b: 0 axes, expected 3"),  # type: ignore[arg-type]
        (lambda: equal_probability(PROCESS, 0), "sections: 0"),
    ],
)
def test_bad_input_gets_one_clear_message(call: object, message: str) -> None:
    with pytest.raises(ValueError, match="^" + message):
        call()  # type: ignore[operator]


FOR_EVER = [
    (KOutOfNRate(needed=1, installed=2, rate=1.0), 0.505, -1000.0),
    (ColdStandbyRate(installed=2, rate=1.0), 0.51, -1e6),
    (BathtubRate(infant=4.0, infant_time_s=0.5, useful=1.0, wear=0.0, wear_start_s=1.0, wear_span_s=1.0), 0.505, -1000.0),
    (ScaledRate(rate=KOutOfNRate(needed=1, installed=2, rate=1.0), factor=0.5), 0.255, -1000.0),
]


@pytest.mark.parametrize(("rate", "growing", "falling"), FOR_EVER)
def test_moments_that_outgrow_the_limit_of_a_rate_are_refused(rate: Rate, growing: float, falling: float) -> None:
    # E e^(2 a h) is infinite, as the rate tends to less than 2 a: the tail at survival e^-69 must not be forgotten
    process = SemiMarkov(rates=((None, rate), (constant_rate(1.0), None)))
    refused = analyse(autonomous([[growing]], [[falling]]), None, process, method="exact")
    assert refused.verdict == "refused" and refused.spectral_radius == np.inf
    limit = 0.5 * process.limit(0)
    below = analyse(autonomous([[limit - 0.02]], [[-1e3]]), None, process, method="exact")
    assert below.certified and below.decay_rate is not None and 0.0 < below.decay_rate < 0.04 + 1e-6
    assert analyse(autonomous([[limit]], [[falling]]), None, process, method="exact").verdict == "undecided"


def test_moments_under_a_rate_that_never_settles_are_the_closed_form() -> None:
    # two spares: h is Erlang(2, 1), E e^(2 a h) = (1 - 2 a)^-2; times E e^(2 b h) = 1 / (1 - 2 b) of the other mode
    process = SemiMarkov(rates=((None, ColdStandbyRate(installed=2, rate=1.0)), (constant_rate(1.0), None)))
    for a in (0.3, 0.45):
        certificate = analyse(autonomous([[a]], [[-20.0]]), None, process, method="exact")
        radius = np.sqrt((1 - 2 * a) ** -2 / 41.0)
        assert certificate.spectral_radius == pytest.approx(radius, rel=1e-6)
        assert certificate.certified == (radius < 1)


def test_a_rate_that_is_infinite_at_first_and_dies_out_is_judged_at_once() -> None:
    # Weibull of shape 1/2: E e^(-2 a h) = 1 - sqrt(pi) z e^(z^2) erfc(z), z = 1 / (2 sqrt(2 a)); it took millions of steps
    process = SemiMarkov(rates=((None, WeibullRate(scale_s=1.0, shape=0.5)), (constant_rate(1.0), None)))
    a = 0.5
    z = 1.0 / (2.0 * np.sqrt(2.0 * a))
    moment = np.sqrt(np.pi) * z * erfcx(z)
    stable = analyse(autonomous([[-a]], [[0.2]]), None, process, method="exact")
    assert stable.certified and stable.spectral_radius == pytest.approx(np.sqrt(moment / 0.6), rel=1e-6)
    growing = analyse(autonomous([[0.01]], [[-100.0]]), None, process, method="exact")
    assert growing.verdict == "refused"


def test_a_rate_that_does_not_say_where_it_tends_to_is_undecided() -> None:
    class Stranger:
        breaks, settled = (), np.inf

        def __call__(self, h: npt.ArrayLike) -> npt.NDArray[np.float64]:
            return 1.0 + np.exp(-np.asarray(h, dtype=float))

        def integral(self, h: npt.ArrayLike) -> npt.NDArray[np.float64]:
            return np.asarray(h, dtype=float) + 1.0 - np.exp(-np.asarray(h, dtype=float))

        def bounds(self, start: float, stop: float) -> tuple[float, float]:
            return float(self(stop)), float(self(start))

    process = SemiMarkov(rates=((None, Stranger()), (constant_rate(1.0), None)))
    found = analyse(autonomous([[-1.0]], [[-1.0]]), None, process, method="exact")
    assert found.verdict == "undecided" and "limit" in found.reason


def test_an_uncertain_input_matrix_counts_through_the_gain_as_the_closed_loop_has_it() -> None:
    """(dA, dB) = E delta (F_A, F_B) under u = K x is dA = E delta (F_A + F_B K) of a loop without an input."""
    rng = np.random.default_rng(5)
    a, b, gain = rng.normal(size=(2, 2, 2)), rng.normal(size=(2, 2, 1)), constant_gain(rng.normal(size=(2, 1, 2)))
    e, fa, fb = rng.normal(size=(2, 2, 2)), rng.normal(size=(2, 2, 2)), rng.normal(size=(2, 2, 1))
    system = JumpSystem(a=a, b=b, uncertainty=NormBounded(e=e, fa=fa, fb=fb))
    k = np.stack([gain.at(mode, 0.0) for mode in range(2)])
    closed = JumpSystem(a=a + b @ k, b=0.0 * b, uncertainty=NormBounded(e=e, fa=fa + fb @ k, fb=0.0 * fb))
    nothing = constant_gain(np.zeros((2, 1, 2)))
    nodes = uniform(PROCESS, 2)
    ours = stability_inequalities(system, gain, PROCESS, nodes, "pwl", 0.1)
    theirs = stability_inequalities(closed, nothing, PROCESS, nodes, "pwl", 0.1)
    assert len(ours) == len(theirs) > 8
    found = {name: symmetric_part(rng.normal(size=(1, 1) if name.startswith("eps") else (2, 2)))
             for item in ours for name in item.on}  # fmt: skip
    for one, other in zip(ours, theirs):
        given = [found[name] for name in one.on]
        assert one.function(*given) == pytest.approx(other.function(*given), abs=1e-12)


def test_a_gain_that_is_linear_in_the_sojourn_has_the_moments_of_its_integral() -> None:
    """Scalar: x' = (a + b k(h)) x with k from k0 to k1 over 2 s and one rate out; E x^2 at the jump is an integral."""
    a, b, k0, k1, span = 0.3, 0.5, -1.0, 0.4, 2.0
    gain = ScheduledGain(gain=np.array([[[[k0]], [[k1]]]] * 2), starts_s=np.array([[0.0, span]] * 2), schedule="linear")
    system = JumpSystem(a=np.full((2, 1, 1), a), b=np.full((2, 1, 1), b))
    process = SemiMarkov(rates=((None, constant_rate(1.5)), (constant_rate(1.5), None)))
    h = np.linspace(0.0, span, 20_001)
    grown = 2.0 * (a * h + b * (k0 * h + (k1 - k0) * h**2 / (2.0 * span)))
    within = np.trapezoid(1.5 * np.exp(grown - 1.5 * h), h)
    beyond = 1.5 * np.exp(grown[-1] - 1.5 * span) / (1.5 - 2.0 * (a + b * k1))
    assert second_moment_radius(system, gain, process) == pytest.approx(within + beyond, rel=1e-6)
