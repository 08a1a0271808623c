"""No bound for any causal controller exceeds a norm that was achieved."""

from dataclasses import replace

import numpy as np
import pytest

from design.networked_loop.certify import lower_bounds
from design.processes.delay_chain import DelayChain
from design.tracking import TrackingProblem
from design.tracking.synthesis import certified, solve

SCALAR = {"A": [[1.0]], "B": [[1.0]], "C": [[1.0]], "R": 0.0, "sc": [[1.0]]}


def test_previous_with_zeros_in_pi():
    # bounds over pairs (tau, d), norm over triples: 1.2671 stood above an achieved 1.2572
    pi = [[0.9917, 0.0083, 0.0], [0.1028, 0.0, 0.8972], [0.5235, 0.4765, 0.0]]
    design = solve(TrackingProblem(**SCALAR, ca=pi, information="previous"))
    assert design.certificate.h2_norm == pytest.approx(1.2572, abs=1e-4)
    assert design.gap >= 0


def test_previous_honours_a_given_initial_law():
    # the bound forgot `initial`: 1.2247 stood above an achieved 1.0180
    problem = TrackingProblem(**SCALAR, ca=[[0.99, 0.01], [0.01, 0.99]], information="previous", initial=[1.0, 0.0, 0.0, 0.0])
    design = solve(problem)
    assert design.certificate.h2_norm == pytest.approx(1.0180, abs=2e-4)
    assert design.certificate.initial == "given"
    assert design.gap >= 0
    assert design.bounds.h2_delayed_information > 1.0


def test_previous_knows_no_mode_that_is_never_entered():
    # d = 2 comes from nowhere: the norm has no such mode, and no worst case in it
    pi = [[0.9, 0.1, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    problem = TrackingProblem(**SCALAR, ca=pi, information="previous", objective="hinf")
    design = certified(problem, np.array([[[[-0.6]], [[-0.5]], [[0.0]]]]), starts=(), evaluations=0)
    assert design.gap >= 0
    pairs = lower_bounds(*(np.array(M) for M in ([[1.0]], [[1.0]], [[1.0]])), *problem.chains)
    assert pairs.hinf_delayed_information > design.bounds.hinf_delayed_information  # d = 2 alone would be worse


def random_chain(rng, delays):
    modes = len(delays)
    while True:
        matrix = rng.random((modes, modes)) * (rng.random((modes, modes)) < 0.7)
        if matrix.sum(axis=1).all():
            return DelayChain(transition=matrix / matrix.sum(axis=1, keepdims=True), delays=delays)


@pytest.mark.parametrize("information", ["constant", "tau", "previous", "generated", "applied", "both", "total"])
def test_bounds_are_below_what_is_achieved(information):
    # exact numbers, no sampling: a single excess would be a false bound. 5 problems a pattern: zeros in both matrices,
    # delays that are never 0 or shared by modes, initial laws given, uniform and stationary.
    rng = np.random.default_rng(sorted(information)[0].encode()[0] + len(information))
    checked = 0
    while checked < 5:
        n = int(rng.integers(1, 3))
        A = rng.standard_normal((n, n)) * 0.6
        sc = random_chain(rng, [[0, 1], [1, 2], [0, 0, 1]][checked % 3])
        ca = random_chain(rng, [[0, 1], [1], [0, 1, 2], [1, 1, 2]][checked % 4])
        B, C = rng.standard_normal((n, 1)), rng.standard_normal((1, n))
        problem = TrackingProblem(A=A, B=B, C=C, sc=sc, ca=ca, information=information, R=0.0)
        if checked % 2:
            problem = replace(problem, initial=rng.dirichlet(np.full(problem.structure().base.shape[0], 0.3)))
        space = problem.space()
        gains = space.gains(0.1 * rng.standard_normal(space.size))
        radius = problem.structure().system(gains).radius()
        if radius >= 0.999:
            continue
        design = certified(problem, gains, starts=(), evaluations=0)
        norms, bounds = design.certificate, design.bounds
        assert bounds.h2_full_information <= bounds.h2_delayed_information * (1 + 1e-12)
        assert bounds.h2_delayed_information <= norms.h2_norm * (1 + 1e-9)
        assert bounds.hinf_delayed_information <= norms.hinf_norm * (1 + 1e-6)
        checked += 1
