"""Certificates of networked loops: delays that are never 0, tails that are cut, margins, and the mode of the impulse."""


import msgspec
import numpy as np
import pytest

from design.jump_linear import MJLS, certificate
from design.jump_linear.certificate import certify_system
from design.networked_loop.certify import certify_loop, lower_bounds
from design.networked_loop.closed_loop import loop_structure
from design.processes.delay_chain import DelayChain
from design.tracking.synthesis import TrackingProblem, solve
from hil.rig.delay_chains import delay_chain
from tests.design.chapter7 import LAMBDA, MOTOR, PI, PRINTED_H2
from tests.design.networked_loop.literal_loop import literal_radius
from transport.laws.semi_markov import SemiMarkovAge
from transport.laws.sojourn import DiscreteWeibull, Geometric

ONE = DelayChain(transition=[[1.0]], delays=[1])
ONE_OR_TWO = DelayChain(transition=[[0.6, 0.4], [0.7, 0.3]], delays=[1, 2])
MIXED = DelayChain(transition=[[0.5, 0.5], [0.7, 0.3]])


@pytest.mark.parametrize("selection", ["constant", "generated", "previous", "applied"])
@pytest.mark.parametrize(("sc", "ca"), [(MIXED, ONE), (MIXED, ONE_OR_TWO), (ONE, ONE_OR_TWO), (ONE_OR_TWO, ONE), (ONE, MIXED)])
def test_a_delay_that_is_never_0_is_certified_as_whole_packets_in_the_state_are(sc, ca, selection):
    rng = np.random.default_rng(7)
    A, B, C = [[1.0, 0.1], [0.0, 0.9]], [[0.0], [0.1]], [[1.0, 0.0]]
    for scale in (0.3, 3.0):  # about stable, and not
        shape = loop_structure(A, B, C, sc, ca, selection).gain_shape
        gains = -scale * rng.random(shape)
        found = certify_loop(A, B, C, sc, ca, gains, selection)
        assert found.mean_square_radius == pytest.approx(literal_radius(A, B, C, sc, ca, gains, selection), abs=1e-8)
        assert found.stable == (found.mean_square_radius < 1)


@pytest.mark.parametrize("information", ["constant", "tau", "generated", "applied", "previous", "both", "total"])
def test_a_delay_that_is_never_0_is_designed_for(information):
    design = solve(TrackingProblem(A=[[0.95]], B=[[1.0]], C=[[1.0]], sc=MIXED, ca=ONE, information=information))
    assert design.certificate.stable
    assert design.gap >= 0


def test_a_delay_of_1_for_ever_is_a_plant_with_one_delay_more():
    # x(k+1) = 0.95 x + v(k-1), v = K x: the state [x; v(k-1)]
    found = certify_loop([[0.95]], [[1.0]], [[1.0]], [[1.0]], ONE, [[[[0.0]], [[-0.4]]]], "applied")
    expected = max(abs(np.linalg.eigvals([[0.95, 1.0], [-0.4, 0.0]]))) ** 2
    assert found.mean_square_radius == pytest.approx(expected, rel=1e-12)


def cut(stay, leave, last):
    """Two modes: the first is left in every slot; the second is a cut tail, left with probability `last`, in bounds."""
    matrix = np.array([[0.0, 1.0], [last, 1.0 - last]])
    low, high = matrix.copy(), matrix.copy()
    low[1], high[1] = [leave[0], stay[0]], [leave[1], stay[1]]
    return DelayChain(transition=matrix, delays=[0, 1], between=(low, high))


def test_a_tail_whose_hazard_may_fall_is_no_certificate():
    tail = cut(stay=(0.5, 1.0), leave=(0.0, 0.5), last=0.5)
    loop = ([[1.01]], [[1.0]], [[1.0]], tail, [[1.0]])  # |x|^2 grows by 1.0201 in every slot of the tail
    gains = [[[[-1.01]]], [[[0.0]]]]
    found = certify_loop(*loop, gains, "constant")
    assert found.mean_square_radius < 0.6  # where the tail is cut
    assert found.tail_radius == pytest.approx(1.0201)
    assert (found.stable, found.state, found.h2_norm) == (False, "undecided", None)
    assert "tail" in found.reason
    calm = certify_loop([[0.99]], *loop[1:], gains, "constant")  # no growth there: whatever the hazard does
    assert (calm.stable, calm.state) == (True, "certified")
    assert calm.mean_square_radius < calm.tail_radius < 1


def test_a_tail_that_is_long_enough_for_sure_is_refused():
    tail = cut(stay=(0.9, 1.0), leave=(0.0, 0.1), last=0.1)
    found = certify_loop([[1.2]], [[1.0]], [[1.0]], tail, [[1.0]], [[[[-1.2]]], [[[0.0]]]], "constant")
    assert (found.stable, found.state) == (False, "refused")


HEAVY = DiscreteWeibull(q=0.6, beta=0.8)  # its hazard falls to 0


def between_ages(stay, ages=(0, 1)):
    """Two ages in turn, the second for a stay of that law."""
    gaps = ages[1] > 1
    return delay_chain(
        SemiMarkovAge(matrix=((0, 1), (1, 0)), sojourn=(Geometric(p=0.3), stay), ages=ages, allow_gaps=gaps)
    )


def test_a_tail_is_refused_where_its_growth_outruns_the_limit_of_its_hazard():
    # review-theory.md F7: x' = 0.05 x, K = 0 while tau = 1. Of one stay alone E x^2 = sum over n of Pr(h = n) a^(2 n)
    a, chain = float(np.exp(0.05 * 0.1)), between_ages(HEAVY)
    n = 1e10
    assert 2 * n * np.log(a) + n**HEAVY.beta * np.log(HEAVY.q) > 1e7  # log of a term of that sum: it has no limit
    loop, free = ([[a]], [[1.0]], [[1.0]]), [[[[-0.5]]], [[[0.0]]]]
    found = certify_loop(*loop, chain, [[1.0]], free, "constant")
    assert (found.stable, found.state) == (False, "refused") and "a sojourn that has lasted long" in found.reason
    assert found.mean_square_radius == pytest.approx(0.8688, abs=1e-4)
    assert found.long_stay_radius == pytest.approx(a * a) and found.tail_radius > 1
    kept = certify_loop(*loop, chain, [[1.0]], [[[[-0.5]]], [[[-0.2]]]], "constant")  # no growth while tau = 1
    assert kept.state == "certified" and kept.long_stay_radius < kept.tail_radius < 1
    rising = certify_loop(*loop, between_ages(DiscreteWeibull(q=0.6, beta=1.3)), [[1.0]], free, "constant")
    assert rising.state == "certified" and rising.long_stay_radius is None  # the hazard rises to 1: every stay ends
    silent = msgspec.structs.replace(chain, stays=None)  # a law that does not say its limit
    assert certify_loop(*loop, silent, [[1.0]], free, "constant").state == "undecided"


def test_a_tail_on_the_way_to_the_actuator_or_on_both_ways_or_behind_a_gap_refuses_too():
    loop = ([[1.005]], [[1.0]], [[1.0]])
    short = DiscreteWeibull(q=0.05, beta=0.8)  # of few slots, with the same limit
    tail, gap = between_ages(short), between_ages(short, (0, 2))
    late = certify_loop(*loop, [[1.0]], tail, [[[[-0.5]], [[0.0]]]], "applied")
    both = certify_loop(*loop, tail, tail, [[[[-0.5]], [[-0.1]]], [[[-0.1]], [[0.0]]]], "applied")  # grows while both are old
    behind = certify_loop(*loop, gap, [[1.0]], [[[[-0.5]]], [[[-0.1]]], [[[0.0]]]], "constant")
    for found in (late, both, behind):
        assert found.mean_square_radius < 1 and found.state == "refused"
        assert found.long_stay_radius == pytest.approx(1.005**2)


def test_what_a_law_may_not_say_of_long_stays_is_refused():
    with pytest.raises(ValueError, match="stays: expected 2 probabilities, none above the upper bound of staying"):
        DelayChain(transition=[[0.5, 0.5], [1.0, 0.0]], stays=[0.0, 1.0])


def test_the_bound_of_a_tail_covers_every_law_below_it():
    # 50 laws of the tail's hazard, 30 slots long, within the bounds: none has a larger radius than the bound's
    rng = np.random.default_rng(11)
    A, gains = 1.1, [[[[-1.0]]], [[[-0.2]]]]
    low, high = 0.3, 0.6
    found = certify_loop([[A]], [[1.0]], [[1.0]], cut((1 - high, 1 - low), (low, high), 0.45), [[1.0]], gains, "constant")
    for _ in range(50):
        hazards = rng.uniform(low, high, 30)
        matrix = np.zeros((31, 31))
        matrix[0, 1] = 1.0
        for n, hazard in enumerate(hazards, 1):
            matrix[n, 0], matrix[n, min(n + 1, 30)] = hazard, 1 - hazard
        chain = DelayChain(transition=matrix, delays=[0] + [1] * 30)
        assert certify_loop([[A]], [[1.0]], [[1.0]], chain, [[1.0]], gains, "constant").mean_square_radius < found.tail_radius


def test_bounds_that_do_not_hold_the_matrix_are_refused():
    with pytest.raises(ValueError, match="between: expected 0 <= lower"):
        cut(stay=(0.9, 1.0), leave=(0.0, 0.1), last=0.5)


def test_stable_hangs_on_the_margin_of_the_inequality_and_not_on_the_radius():
    # the radius is 1 - 2e-16: P = 5e15, and what (7.17) leaves drowns in the rounding of that
    system = MJLS(A=[[1.0 - 2.0**-53]], B=[[1.0]], C=[[1.0]], transition=[[1.0]])
    found = certify_system(system)
    assert found.mean_square_radius < 1
    assert found.rounding > found.lyapunov_margin > 0
    assert (found.stable, found.state, found.h2_norm) == (False, "undecided", None)
    assert "floating point" in found.reason


def test_eigenvalues_that_rounding_moves_over_1_refuse_nothing():
    """Eight equal factors in coordinates of small whole numbers, exact in binary: an eigenvalue 0.99 comes out as 1.04."""
    mix = np.eye(8)
    for i, j in ((0, 3), (5, 2), (7, 1), (4, 6), (2, 7), (1, 0)):
        mix[i] += mix[j]
    for factor, states in ((0.99, {"undecided", "certified"}), (1.5, {"refused"})):
        A = mix @ (np.round(factor * 2**16) / 2**16 * np.eye(8) + np.diag(np.ones(7), 1)) @ np.round(np.linalg.inv(mix))
        found = certify_loop(A, np.eye(8)[:, 7:], np.eye(8)[:1], [[1.0]], [[1.0]], np.zeros((1, 1, 1, 1)), "constant")
        assert found.mean_square_radius > 1.0 and found.state in states


def test_units_of_the_states_decide_nothing():
    """A position in um beside a speed in m/s: at 1e6 the margins in these units are lost in rounding."""
    for unit in (1.0, 1e6):
        A, B = [[1.005, 0.01 * unit], [0.0, 0.905]], [[5e-5 * unit], [0.0095]]
        found = certify_loop(A, B, [[1.0, 0.0]], [[1.0]], [[1.0]], [[[[-10.0 / unit]]]], "constant")
        assert found.state == "certified" and found.mean_square_radius == pytest.approx(0.9876425, abs=1e-6)


def test_a_wrong_solution_of_the_inequality_proves_nothing(monkeypatch):
    right = certificate.cost_once
    loop = (*MOTOR, LAMBDA, PI, PRINTED_H2, "generated")
    assert certify_loop(*loop).lyapunov_margin == pytest.approx(1.0)
    monkeypatch.setattr(certificate, "cost_once", lambda *system: 0.5 * right(*system))
    assert certify_loop(*loop).lyapunov_margin == pytest.approx(0.5)  # computed at the matrices found, not taken for granted
    monkeypatch.setattr(certificate, "cost_once", lambda A, transition, families: -np.abs(families))
    found = certify_loop(*loop)
    assert found.mean_square_radius < 1
    assert not found.stable


def split(parts):
    """The chain of LAMBDA, its last mode as `parts` modes that no measurement distinguishes."""
    matrix = np.zeros((2 + parts, 2 + parts))
    matrix[:, :2] = np.array(LAMBDA)[[0, 1] + [2] * parts, :2]
    matrix[:, 2] = np.array(LAMBDA)[[0, 1] + [2] * parts, 2]
    matrix[2:, 2] = 0.0
    matrix[2:, 2:] += np.array(LAMBDA)[2, 2] * np.roll(np.eye(parts), 1, axis=1)
    return DelayChain(transition=matrix, delays=[0, 1] + [2] * parts)


def test_the_norm_does_not_depend_on_how_many_modes_a_tail_is_counted_in():
    norms = [certify_loop(*MOTOR, split(parts), PI, PRINTED_H2, "generated") for parts in (2, 3, 9)]
    assert [n.initial for n in norms] == ["stationary"] * 3
    assert np.ptp([n.h2_norm for n in norms]) < 1e-9
    sc = DelayChain(transition=LAMBDA)
    weights = np.kron(sc.stationary, DelayChain(transition=PI).stationary)
    plain = certify_loop(*MOTOR, LAMBDA, PI, PRINTED_H2, "generated", initial=weights)
    assert plain.initial == "given"
    assert norms[0].h2_norm == pytest.approx(plain.h2_norm, rel=1e-9)


def test_plain_chains_keep_the_uniform_law_of_the_thesis():
    found = certify_loop(*MOTOR, LAMBDA, PI, PRINTED_H2, "generated")
    assert found.initial == "uniform"
    again = certify_loop(*MOTOR, LAMBDA, PI, PRINTED_H2, "generated", initial=np.full(6, 1 / 6))
    assert found.h2_norm == pytest.approx(again.h2_norm, rel=1e-14)
    assert msgspec.structs.asdict(found).keys() >= {"state", "reason", "tail_radius", "initial"}


@pytest.mark.parametrize("selection", ["generated", "previous"])
def test_both_chains_stationary_where_both_count_slots(selection):
    ca = DelayChain(transition=[[0.0, 1.0, 0.0], [0.3, 0.0, 0.7], [1.0, 0.0, 0.0]], delays=[0, 1, 1])
    structure = loop_structure(*MOTOR, split(2), ca, selection)
    assert structure.initial_law == "stationary"
    assert structure.default_initial @ structure.transition == pytest.approx(structure.default_initial, abs=1e-12)


def test_a_bound_from_one_mode_waits_for_as_long_as_its_two_delays_are_together() -> None:
    """x(k+1) = 2 x(k) + u + w with delays that stay: the impulse grows until it is known at the actuator, and is 0 then."""
    sc, ca = DelayChain(transition=np.eye(3), delays=(0, 1, 2)), DelayChain(transition=np.eye(2), delays=(0, 1))
    one = np.eye(1)
    for mode, late in enumerate((0, 1, 1, 2, 2, 3)):  # of tau 0, 1, 2, each with d 0, 1
        found = lower_bounds(2.0 * one, one, one, sc, ca, initial=np.eye(6)[mode], present=np.eye(6, dtype=bool)[mode])
        energy = sum(4.0**k for k in range(late + 1))
        assert found.h2_delayed_information**2 == pytest.approx(energy) == pytest.approx(found.hinf_delayed_information**2)
        assert found.h2_full_information == pytest.approx(1.0) == pytest.approx(found.hinf_full_information)
