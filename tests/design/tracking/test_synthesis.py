"""Tracking designs reach the best known norms, deterministically, with a certificate from the gains themselves."""

import os
import subprocess
import sys

import numpy as np
import pytest

from design.controllers.gain_rows import held_exactly, nearest_held, steady_state
from design.errors import DesignError, Infeasible, NotStable
from design.jump_linear import MJLS
from design.jump_linear.certificate import certify_system
from design.networked_loop.certify import certify_loop, certify_structure
from design.networked_loop.closed_loop import loop_structure
from design.processes.delay_chain import DelayChain
from design.tracking import COARSER, INFORMATION, embed, gain_parametrisation, selection_of, state_gains_of
from design.tracking.bfgs import bfgs
from design.tracking.loop_objective import LoopObjective, closed_classes, stabilising
from design.tracking.synthesis import TrackingProblem, solve
from tests.bench.modes import shortening_chain
from tests.design.chapter7 import LAMBDA, MOTOR, PI, PRINTED_HINF, VTOL, VTOL_R, zero_order_hold
from tests.waiting import LIMIT_S

# What the issue demands: stacked z, R = 0.01, uniform initial distribution.
H2_GOALS = {
    ("motor", "generated"): 3.7110, ("motor", "applied"): 3.4697, ("motor", "both"): 3.2918,
    ("vtol", "generated"): 0.12044, ("vtol", "applied"): 0.11709, ("vtol", "both"): 0.11497,
    # and the rest of the table, as found before
    ("motor", "constant"): 3.8913, ("motor", "tau"): 3.7433, ("motor", "previous"): 3.7386, ("motor", "total"): 3.5124,
    ("vtol", "constant"): 0.12396, ("vtol", "tau"): 0.12094, ("vtol", "total"): 0.11747,
}  # fmt: skip
HINF_GOALS = {
    ("motor", "generated", "stacked"): 17.424, ("motor", "generated", "sum"): 17.405,
    ("motor", "applied", "stacked"): 16.279, ("motor", "both", "stacked"): 15.339,
    ("vtol", "generated", "stacked"): 0.2819,
}  # fmt: skip


def problem(plant, **options):
    A, B, C = {"motor": MOTOR, "vtol": VTOL}[plant]
    return TrackingProblem(A=A, B=B, C=C, sc=LAMBDA, ca=PI, R=VTOL_R if plant == "vtol" else 0.01, **options)


@pytest.mark.parametrize(
    "plant, information", [pytest.param(*g, marks=[pytest.mark.slow] * (k >= 6)) for k, g in enumerate(H2_GOALS)]
)
def test_h2_designs_reach_the_best_known_norms(plant, information):
    design = solve(problem(plant, information=information, starts=1))
    assert design.certificate.h2_norm <= H2_GOALS[plant, information]
    assert design.certificate.stable and design.certificate.h2_residual < 1e-12


@pytest.mark.parametrize(
    "plant, information, output", [pytest.param(*g, marks=[pytest.mark.slow] * (k > 1)) for k, g in enumerate(HINF_GOALS)]
)
def test_hinf_designs_reach_the_best_known_norms(plant, information, output):
    design = solve(problem(plant, objective="hinf", information=information, output=output, starts=1))
    assert design.certificate.hinf_norm <= HINF_GOALS[plant, information, output]
    assert design.certificate.hinf_margin > 0  # (7.28) is strict at gamma (1 + 1e-6)


def test_published_hinf_gains_are_close_to_the_optimum_on_the_correct_model():
    design = solve(problem("motor", objective="hinf", information="generated", output="sum", starts=1))
    assert np.abs(design.gains - PRINTED_HINF).max() < 0.004


@pytest.mark.slow
def test_mixed_design_keeps_its_bound():
    design = solve(
        problem("motor", objective="mixed", information="generated", output="sum", hinf_bound=17.5, starts=1)
    )
    assert design.certificate.hinf_norm <= 17.5
    assert design.certificate.h2_norm <= 3.805


def test_no_gains_nearby_meet_a_mixed_bound_with_a_smaller_h2_norm():
    """The bound lies between the H-infinity norms of the pure designs, and the design is at it."""
    plant = {"A": [[1.2]], "B": [[1.0]], "C": [[1.0]], "sc": [[0.7, 0.3], [0.6, 0.4]], "ca": [[1.0]], "R": 0.5, "starts": 1}
    low, high = (solve(TrackingProblem(**plant, objective=each)).certificate.hinf_norm for each in ("hinf", "h2"))
    bound = (low * high) ** 0.5
    design = solve(TrackingProblem(**plant, objective="mixed", hinf_bound=bound))
    assert 0.9999 * bound <= design.certificate.hinf_norm <= bound
    structure, rng = design.problem.structure(), np.random.default_rng(1)
    steps = [size * rng.normal(size=design.gains.shape) for size in np.repeat([1e-3, 1e-2, 1e-1], 20)]
    around = [certify_structure(structure, design.gains + step, output="stacked", hinf=True) for step in steps]
    within = [c.h2_norm for c in around if c.stable and c.hinf_norm <= bound]
    assert len(within) > 10 and min(within) >= (1.0 - 1e-5) * design.certificate.h2_norm


@pytest.mark.slow
def test_more_information_is_never_worse():
    norms = {i: solve(problem("motor", information=i, starts=1)).certificate.h2_norm for i in INFORMATION}
    assert all(norms[fine] <= norms[coarse] + 1e-9 for fine, coarse in COARSER.items())


@pytest.mark.slow
def test_deadbeat_optimum_is_reached_although_its_norm_has_no_fold():
    # x+ = 0.9 x + u + w: with K = -0.9 the loop has finite memory, and no other gain has a smaller H-infinity norm
    scalar = TrackingProblem(
        A=[[0.9]], B=[[1.0]], C=[[1.0]], sc=[[1.0]], ca=[[1.0]], R=0.1, objective="hinf", starts=1
    )
    design = solve(scalar)
    assert np.isclose(design.gains.item(), -0.9, atol=1e-6)
    assert np.isclose(design.certificate.hinf_norm, np.sqrt(1 + 0.09**2), rtol=1e-6)


def test_same_problem_same_gains():
    first, second = (solve(problem("motor", information="constant", starts=2, seed=5)) for _ in range(2))
    assert np.array_equal(first.gains, second.gains)


@pytest.mark.slow
def test_gain_bound_is_kept_and_costs():
    free = solve(problem("vtol", information="generated", starts=1)).certificate.h2_norm
    norms = []
    for bound in (1.0, 2.0, 3.0):
        design = solve(problem("vtol", information="generated", starts=1, gain_bound=bound))
        assert np.abs(design.gains).max() <= bound
        norms.append(design.certificate.h2_norm)
    assert norms == sorted(norms, reverse=True) and norms[-1] > free


def test_input_weight_lowers_the_gains():
    small, large = (
        np.abs(solve(problem("motor", starts=1)).gains).max(),
        np.abs(solve(TrackingProblem(A=MOTOR[0], B=MOTOR[1], C=MOTOR[2], sc=LAMBDA, ca=PI, R=1.0, starts=1)).gains).max(),
    )
    assert large < small


def test_two_samples_per_packet_are_a_mode_dependent_pd():
    design = solve(problem("motor", information="generated", samples=2, output="sum", starts=1))
    assert design.gains.shape == (3, 2, 1, 2)
    assert design.certificate.h2_norm <= 1.3765  # against 3.7055 with one sample


def test_integral_action_keeps_the_loop_stable_with_the_integral_in_it():
    design = solve(problem("motor", integral=0.01, starts=1))
    assert design.gains.shape == (3, 2, 1, 2) and np.abs(design.gains[..., 1]).max() > 1e-4
    again = certify_loop(*MOTOR, LAMBDA, PI, design.gains, "applied", integral=0.01)
    assert again.stable and np.isclose(again.h2_norm, design.certificate.h2_norm)


@pytest.mark.slow
def test_lower_bounds_lie_below_every_design():
    for plant in ("motor", "vtol"):
        design = solve(problem(plant, information="both", starts=1))
        bounds = design.bounds
        assert 0 < bounds.h2_full_information <= bounds.h2_delayed_information < design.certificate.h2_norm
        assert bounds.hinf_delayed_information < design.certificate.hinf_norm
        assert design.gap > 0
    assert design.gap < 0.053  # VTOL: at most 5.3 % from the best causal controller


def test_norm_derivatives_in_every_gain_parametrisation_are_difference_quotients():
    rng = np.random.default_rng(2)
    held = solve(problem("motor", information="constant", starts=1)).gains
    for information in INFORMATION:
        gains = np.broadcast_to(held, problem("motor", information=information).structure().gain_shape)
        for bound in (None, 0.5):
            p = problem("motor", information=information, gain_bound=bound)
            objective = LoopObjective(p.structure(), p.space(), p.alpha(p.structure()))
            v = p.space().coordinates(gains) * 0.9
            for norm in (objective.h2, objective.hinf):
                step = 1e-5 * rng.standard_normal(v.size)
                quotient = (norm(v + step)[0] - norm(v - step)[0]) / 2
                assert np.isclose(quotient, norm(v)[1] @ step, rtol=1e-3, atol=1e-9)


def test_embedding_runs_the_same_loop():
    rng = np.random.default_rng(3)
    sc, ca = DelayChain(transition=LAMBDA), DelayChain(transition=PI)
    for fine, coarse in COARSER.items():
        loops = [loop_structure(*MOTOR, sc, ca, selection_of(i)) for i in (fine, coarse)]
        space = gain_parametrisation(loops[1], coarse, sc, ca)
        gains = space.gains(0.1 * rng.standard_normal(space.size) - 0.2)
        radii = [loops[0].system(embed(gains, loops[0].gain_shape[1])).radius(), loops[1].system(gains).radius()]
        assert np.isclose(*radii, rtol=1e-9)


# --- bad input: refused with the number that decides it -------------------------------------------------------------


def test_unstabilisable_plant_is_refused_with_its_eigenvalue():
    with pytest.raises(NotStable, match=r"the input cannot move the eigenvalue 1\.1, modulus 1\.1,") as caught:
        solve(TrackingProblem(A=np.diag([1.1, 0.5]), B=[[0.0], [1.0]], C=[[1.0, 1.0]], sc=LAMBDA, ca=PI))
    assert np.isclose(caught.value.value, 1.1)
    with pytest.raises(NotStable, match=r"the output does not show the eigenvalue 1\.2, modulus 1\.2,"):
        solve(TrackingProblem(A=np.diag([1.2, 0.5]), B=[[1.0], [1.0]], C=[[0.0, 1.0]], sc=LAMBDA, ca=PI))


def test_too_unstable_plant_for_the_network_is_refused_with_the_radius():
    with pytest.raises(NotStable, match=r"none in 5 starts of the search, best second-.*: try order = 1 \(") as caught:
        solve(TrackingProblem(A=[[3.0]], B=[[1.0]], C=[[1.0]], sc=LAMBDA, ca=PI, starts=1))
    assert caught.value.value > 1


@pytest.mark.parametrize(("information", "norm"), [("constant", 1.78), ("total", 1.6), ("applied", 1.48)])
def test_a_controller_with_a_state_is_far_better_than_static_gains(information, norm):
    """The motor's best static gains have 3.89, 3.51 and 3.47; the norm is that of the gains in the loop that runs."""
    design = solve(problem("motor", information=information, order=1, starts=1))
    gains, state_gains = state_gains_of(design.gains, 1)
    found = certify_loop(*MOTOR, LAMBDA, PI, gains, design.selection, R=0.01, state_gains=state_gains)
    assert found.stable and found.h2_norm < norm and found.h2_norm == pytest.approx(design.certificate.h2_norm, rel=1e-12)
    assert design.bounds is not None and design.bounds.h2_delayed_information < found.h2_norm


def test_a_step_of_the_reference_counts_as_its_weight_says():
    """The square of the norm is that of the input's impulse and, times the weight's square, that of a step."""
    plain, stepped = (problem("motor", order=1, starts=1, reference_weight=weight) for weight in (0.0, 2.0))
    K = solve(stepped).gains
    alone, both = (certify_structure(p.structure(), K, output="stacked").h2_norm for p in (plain, stepped))
    system = stepped.structure().system(K)
    step = certify_system(
        MJLS(A=system.A, B=system.B[:, :, 1:], C=system.C, transition=system.transition), selection="applied", output="stacked",
        initial=plain.structure().default_initial, initial_law="uniform",
    ).h2_norm  # fmt: skip
    assert both**2 == pytest.approx(alone**2 + step**2, rel=1e-12) and system.B.shape[2] == 2
    assert np.array_equal(system.B[:, :2, 1], np.full((len(system.B), 2), [2.0, 0.0]))
    assert solve(plain).certificate.h2_norm < alone  # which it pays for the step


@pytest.mark.parametrize("sc", [[[1.0]], LAMBDA], ids=["no-delay", "markov"])
def test_cart_pole_at_a_short_period_is_stabilised_from_two_samples(sc):
    A = np.array([[0, 1, 0, 0], [0, -0.1, -0.98, 0], [0, 0, 0, 1], [0, 0.2, 21.56, -0.05]])
    A, B = zero_order_hold(A, np.array([[0], [1], [0], [-2]]), 0.01)
    C = [[1.0, 0, 0, 0], [0, 0, 1.0, 0]]  # gains of -300 and 300 on two samples of the angle: no start near zero finds them
    for asked in ({"samples": 2}, {"order": 2}):  # a state of two holds the samples before
        assert solve(TrackingProblem(A=A, B=B, C=C, sc=sc, ca=[[1.0]], starts=1, **asked)).certificate.mean_square_radius < 0.9999


def test_absorbing_bad_mode_is_named_with_the_radius():
    stuck = np.array([[0.9, 0.1, 0.0], [0.5, 0.4, 0.1], [0.0, 0.0, 1.0]])  # tau = 2 for ever
    with pytest.raises(NotStable, match=r"never leaves the modes \(tau=2, d=0\)") as caught:
        solve(TrackingProblem(A=[[1.6]], B=[[1.0]], C=[[1.0]], sc=stuck, ca=[[1.0]], starts=1))
    assert caught.value.value >= 1


def test_infeasible_mixed_bound_is_refused_with_the_smallest_norm():
    with pytest.raises(Infeasible, match=r"hinf_bound: 15 is not reached; .* 17\.4047") as caught:
        solve(problem("motor", objective="mixed", information="generated", output="sum", hinf_bound=15.0, starts=1))
    assert round(caught.value.value, 3) == 17.405


@pytest.mark.parametrize(
    "change, message",
    [
        ({"objective": "h3"}, "objective: 'h3'"),
        ({"information": "all"}, "information: 'all'"),
        ({"method": "magic"}, "method: 'magic'"),
        ({"gain_bound": 0.0}, "gain_bound: 0"),
        ({"gain_bound": np.nan}, "gain_bound: nan"),
        ({"hinf_bound": 17.5}, "hinf_bound: only a mixed design"),
        ({"objective": "mixed", "hinf_bound": -1.0}, "hinf_bound: -1"),
        ({"objective": "mixed", "hinf_bound": "a"}, "hinf_bound: 'a', expected a finite number above 0"),
        ({"starts": -1}, "starts: "),
        ({"initial": [0.5, 0.5]}, r"initial: shape \(2,\), expected \(6,\)"),
        ({"sc": [[0.5, 0.48], [0, 1]]}, r"Lambda\[0\]: row sums to 0.98"),
        ({"B": [[1.0]]}, "B: 1 rows, expected 2"),
    ],
)
def test_wrong_problems_are_refused_by_field(change, message):
    good = {"A": MOTOR[0], "B": MOTOR[1], "C": MOTOR[2], "sc": LAMBDA, "ca": PI}
    with pytest.raises(ValueError, match="^" + message):
        TrackingProblem(**(good | change))


def test_steady_state_holds_the_reference():
    for A, B, C in (MOTOR, VTOL):
        star = steady_state(A, B, C)
        assert np.allclose(A @ star.state + B @ star.input, star.state, atol=1e-12)
        assert np.allclose(C @ star.state, np.eye(C.shape[0]), atol=1e-12)
    # p < m: the solution of least norm is N'(NN')^-1
    A, B, C = VTOL
    N = np.block([[A - np.eye(4), B], [C, np.zeros((1, 2))]])
    printed = N.T @ np.linalg.solve(N @ N.T, np.array([0, 0, 0, 0, 1.0]))
    assert np.allclose(np.concatenate([star.state, star.input])[:, 0], printed)


def test_steady_state_that_cannot_be_held_is_refused_with_the_rank():
    with pytest.raises(DesignError, match="has rank 2, expected 3") as caught:
        steady_state(np.eye(2), [[1.0], [0.0]], [[0.0, 1.0]])
    assert caught.value.value == 2


@pytest.mark.parametrize("unit", [1e-6, 1e8])
def test_units_of_the_states_change_no_steady_state(unit):
    A, B, _ = MOTOR
    D = np.diag([1.0, unit])
    in_units = D @ A @ np.linalg.inv(D), D @ B
    star = steady_state(*in_units, [[1.0, 0.0]])
    assert np.allclose(star.state[:, 0], [1.0, 0.0], atol=1e-12)
    both = np.linalg.inv(D)
    assert held_exactly(*in_units, both, [3.0, 0.0]) and not held_exactly(*in_units, both, [3.0, 1.0])


def test_more_outputs_than_inputs_are_held_where_some_input_holds_them():
    A, B, _ = MOTOR
    assert held_exactly(A, B, np.eye(2), [[3.0, 0.0], [-1.0, 0.0], [0.0, 0.0]])
    for reference in ([3.0, 1.0], [0.0, 1.0]):  # an angle that stays has no speed
        assert not held_exactly(A, B, np.eye(2), [[3.0, 0.0], reference])
    tanks = np.eye(2) + [[-0.053, 0.053], [0.053, -0.087]], [[0.11], [0.0]], [[0.0, 1.0], [1.0, 0.0]]
    assert not held_exactly(*tanks, [5.0, 5.0]) and held_exactly(*tanks, nearest_held(*tanks, [5.0, 5.0]))


def test_closed_classes_of_a_chain():
    matrix = np.array([[0.5, 0.5, 0, 0], [0.2, 0.5, 0.3, 0], [0, 0, 0.5, 0.5], [0, 0, 1.0, 0]])
    assert [c.tolist() for c in closed_classes(matrix)] == [[2, 3]]
    assert [c.tolist() for c in closed_classes(np.eye(2))] == [[0], [1]]
    ring = np.roll(np.eye(7), 1, axis=1)  # all reach each other, in up to six steps
    assert [c.tolist() for c in closed_classes(ring)] == [[*range(7)]]
    ring[6] = np.eye(7)[6]
    assert [c.tolist() for c in closed_classes(ring)] == [[6]]


def test_problem_digest_distinguishes_problems():
    assert problem("motor").digest() == problem("motor").digest() != problem("motor", seed=1).digest()


# --- all of it, with the time it may take: minutes ---------------------------------------------------------------------


@pytest.mark.slow
def test_sum_output_with_large_gains_is_found_by_the_multistart():
    design = solve(problem("vtol", objective="hinf", information="generated", output="sum"))
    assert design.certificate.hinf_norm <= 0.2553
    assert np.abs(design.gains).max() > 50  # what the sum buys it with


def test_the_first_programme_of_the_ccl_route_asks_for_less_than_the_gains_that_it_starts_from():
    from design.as_printed.cone_complementarity import STEP, solve_ccl

    (_, begun), (_, reached) = solve_ccl(problem("motor", information="generated"), iterations=1).history
    assert reached < (1.0 - STEP) * begun


def test_the_thesis_method_is_asked_for_elsewhere():
    with pytest.raises(ValueError, match="method: 'ccl' is not solved here"):
        solve(problem("motor", method="ccl"))


def test_above_its_ceiling_an_hinf_norm_need_not_be_found_and_below_it_is():
    design = problem("motor", objective="hinf", information="constant")
    structure, space = design.structure(), design.space()
    v = stabilising(LoopObjective(structure, space, design.alpha(structure)), np.zeros(space.size))
    norm, _ = LoopObjective(structure, space, design.alpha(structure)).hinf(v)
    for share, found in ((0.99, np.inf), (1.01, norm)):
        objective = LoopObjective(structure, space, design.alpha(structure))
        objective.ceiling = share * norm
        assert objective.hinf(v)[0] == pytest.approx(found, rel=1e-12)


@pytest.mark.parametrize("bound", [None, 8.0])
def test_over_many_modes_a_descent_starts_with_the_curvature_of_its_loop(bound, monkeypatch):
    """Beside the same descent without: over these 16 modes a fifth of the evaluations, over 81 a tenth."""
    chain = shortening_chain(3)
    A, B, C = MOTOR
    design = TrackingProblem(A=A, B=B, C=C, sc=chain, ca=chain, starts=1, gain_bound=bound)
    found = solve(design)
    monkeypatch.setattr(LoopObjective, "descend_h2", lambda self, start: bfgs(self.h2, start))
    plain = solve(design)
    assert 2 * found.evaluations < plain.evaluations
    assert found.certificate.h2_norm == pytest.approx(plain.certificate.h2_norm, rel=1e-9)


@pytest.mark.parametrize(("start", "length"), [([0.2, 0.0], 0.1), ([30.0, 40.0], 5.0)])
def test_the_first_step_of_a_descent_is_a_tenth_of_where_it_begins(start: list[float], length: float) -> None:
    tried: list[np.ndarray] = []

    def bowl(x: np.ndarray) -> tuple[float, np.ndarray]:
        tried.append(x)
        return 50.0 * float(x @ x), 100.0 * x

    found = bfgs(bowl, np.array(start))
    assert np.linalg.norm(tried[1] - tried[0]) == pytest.approx(length)
    assert found.value < 1e-15


@pytest.mark.parametrize(("at", "hidden"), [(1e-12, True), (1e-3, False)])
def test_a_descent_ends_where_rounding_would_hide_the_next_step(at: float, hidden: bool) -> None:
    """A search for a gain of a few 1e-16 of the value took 35 evaluations, on one CPU and not on another."""

    def well(x: np.ndarray) -> tuple[float, np.ndarray]:
        return 1.0 + 0.5e6 * float(x @ x), 1e6 * x

    found = bfgs(well, np.array([at]), metric=lambda x: np.eye(1) * 0.9e-6, gradient_tolerance=1e-30)
    assert found.reason == "no more gain" and found.value == pytest.approx(1.0, abs=1e-12)
    assert (found.evaluations == 1) == hidden


def test_a_design_holds_every_blas_to_one_thread_scipys_own_too():
    """scipy's is loaded with the first factorisation; with two threads the VTOL's design took six times the CPU time."""
    code = (
        "from threadpoolctl import threadpool_info\n"
        "from design.tracking.synthesis import TrackingProblem, solve\n"
        "def tell(*_): print([p['num_threads'] for p in threadpool_info() if p['user_api'] == 'blas'])\n"
        "solve(TrackingProblem(A=[[0.9]], B=[[1.0]], C=[[1.0]], sc=[[1.0]], ca=[[1.0]], starts=1), progress=tell)\n"
    )
    environment = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    python = [sys.executable, "-c", code]
    reported = subprocess.run(python, env=environment, capture_output=True, text=True, check=True, timeout=LIMIT_S)
    counts = set(reported.stdout.split())
    assert counts and all(line.strip("[],") == "1" for line in counts), reported.stdout
