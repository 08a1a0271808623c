"""Robust feedback of Chapter 2: the scales that are asked for, certified from the returned gains alone."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from design.as_printed import chapter2_process, chapter2_system
from design.as_printed.chapters_2_to_4 import PrintedRequest
from design.errors import FieldError, Infeasible
from design.lmi import prove
from design.processes.rates import PiecewiseLinearRate, constant_rate
from design.processes.semi_markov import SemiMarkov
from design.semi_markov_loop import JumpSystem, VertexUncertainty
from design.semi_markov_loop.robust_feedback import FeedbackRequest, fastest_feedback, largest_uncertainty
from design.semi_markov_loop.second_moments import second_moment_radius
from design.semi_markov_loop.stability import analyse

PROCESS = chapter2_process()
STEP = PiecewiseLinearRate(times_s=(0.0, 0.4967, 0.4967), values=(0.01, 0.01, 200.0))


@pytest.mark.parametrize(("sections", "required"), [(2, 0.72), (8, 1.14)])
def test_certified_uncertainty_scale_reaches_the_required_one(sections: int, required: float) -> None:
    system = chapter2_system("vertices").scaled(required)
    certificate = FeedbackRequest(process=PROCESS, gain_bound=100.0, sections=sections).solve(system)
    gain = certificate.gain
    assert gain is not None and gain.norm <= 100.0
    assert certificate.certified and certificate.sound and certificate.check() > 0
    assert prove(certificate).proved
    # an independent look: worst constant uncertainty at a dense set of rates of the box, exactly
    for vertex in (0, 1):
        assert second_moment_radius(system.at_vertex(vertex), gain, PROCESS) < 1.0
    # and at 501 sojourn times, 5 uncertainties: V decreases along P interpolated from the certificate
    nodes = gain.starts_s[0]
    p = np.array([[certificate.matrices[f"P[{i},{r}]"] for r in range(nodes.size)] for i in range(2)])
    uncertainty = system.uncertainty
    values = []
    for i in range(2):
        for h in np.linspace(0.0, 5.0, 501):
            r = min(int(np.searchsorted(nodes, h, side="right")) - 1, nodes.size - 1)
            last = r == nodes.size - 1
            width = 1.0 if last else nodes[r + 1] - nodes[r]
            slope = np.zeros((2, 2)) if last else (p[i, r + 1] - p[i, r]) / width
            here = p[i, r] + slope * (h - nodes[r])
            rate = float(PROCESS.rate(i, h)[1 - i])
            K = gain.at(i, h)
            for rho in np.linspace(-1, 1, 5):
                a = system.a[i] + 0.5 * (1 + rho) * uncertainty.da[1, i] + 0.5 * (1 - rho) * uncertainty.da[0, i]  # type: ignore[union-attr]
                b = system.b[i] + 0.5 * (1 + rho) * uncertainty.db[1, i] + 0.5 * (1 - rho) * uncertainty.db[0, i]  # type: ignore[union-attr]
                loop = a + b @ K
                value = here @ loop + loop.T @ here + slope + rate * (p[1 - i, 0] - here)
                values.append(value)
    assert np.linalg.eigvalsh(values).max() < 0.0


@pytest.mark.slow
def test_more_sections_help_and_never_hurt_and_pwl_beats_pwc() -> None:
    scales = {}
    for method, sections in (("pwc", 1), ("pwc", 2), ("pwl", 2), ("pwl", 4)):
        request = FeedbackRequest(process=PROCESS, gain_bound=100.0, sections=sections, method=method)  # type: ignore[arg-type]
        scales[method, sections], certificate = largest_uncertainty(chapter2_system(), request, tolerance=5e-3)
        assert certificate.sound and certificate.check() > 0
    assert scales["pwc", 1] == pytest.approx(0.35, abs=0.01) and scales["pwc", 2] == pytest.approx(0.44, abs=0.01)
    assert scales["pwl", 2] > 0.72 and scales["pwl", 4] > 0.95


def test_theorem_2_4_is_feasible_where_the_text_says_it_is_not() -> None:
    # DEVIATION: "by applying Theorem 2.4, the condition in (2.20) is not feasible" is false for the printed F_A, F_B
    certificate = FeedbackRequest(process=PROCESS, gain_bound=30.0, sections=1, method="pwc").solve(chapter2_system("printed"))
    assert certificate.check() > 0 and prove(certificate).proved
    with pytest.raises(Infeasible, match="dual matrices prove"):  # and true for the F that give the printed A_i(t)
        FeedbackRequest(process=PROCESS, gain_bound=100.0, sections=1, method="pwc").solve(chapter2_system("matched"))


def test_printed_synthesis_returns_gains_that_destabilise() -> None:
    # an input that can do next to nothing: the printed (2.21) "stabilises" counterexample 1
    a = np.array([[[-0.6, -1.0], [10.0, -0.6]], [[-0.6, -10.0], [1.0, -0.6]]])
    system = JumpSystem(a=a, b=np.full((2, 2, 1), 1e-6))
    process = SemiMarkov(rates=((None, STEP), (STEP, None)))
    halves = ((0.0, 0.4967), (0.0, 0.4967))
    request = PrintedRequest(process=process, gain_bound=1.0, sections=halves)
    printed = request.judge(system, request.find(system, 0.0), 0.0)
    assert printed.certified and not printed.sound and printed.gain is not None
    assert analyse(system, printed.gain, process, method="exact").spectral_radius == pytest.approx(5.463, abs=1e-2)
    with pytest.raises(Infeasible, match="no solution with entries up to"):
        FeedbackRequest(process=process, gain_bound=1.0, sections=halves).solve(system)


def test_held_gains_are_certified_as_they_are_held() -> None:
    system = chapter2_system("vertices")
    certificate = FeedbackRequest(process=PROCESS, gain_bound=100.0, sections=8, schedule="hold").solve(system)
    assert certificate.gain is not None and certificate.gain.schedule == "hold"
    assert certificate.certified and certificate.check() > 0


@pytest.mark.slow
def test_decay_objective_finds_faster_gains_than_stability_alone() -> None:
    system = chapter2_system("printed")
    request = FeedbackRequest(process=PROCESS, gain_bound=30.0, sections=2)
    plain = request.solve(system)
    fast = fastest_feedback(system, request, tolerance=2e-2)
    assert fast.gain is not None and fast.gain.norm <= 30.0
    assert (fast.decay_rate or 0.0) > max(0.55, plain.decay_rate or 0.0)  # (2.27) as printed: .279 in |x|, .558 in |x|^2


def test_request_that_no_gain_can_meet_is_reported_before_any_solver_runs() -> None:
    slow = SemiMarkov(rates=((None, constant_rate(0.5)), (constant_rate(0.5), None)))
    a = np.array([[[-1.0, 0.0], [0.0, 0.4]], [[-1.0, 0.0], [0.0, -1.0]]])
    b = np.array([[[1.0], [0.0]], [[1.0], [1.0]]])
    with pytest.raises(Infeasible, match=r"mode 0: the eigenvalue \+0.4 is out of the input's reach"):
        FeedbackRequest(process=slow, gain_bound=10.0).solve(JumpSystem(a=a, b=b))
    quick = SemiMarkov(rates=((None, constant_rate(5.0)), (constant_rate(0.5), None)))
    assert FeedbackRequest(process=quick, gain_bound=10.0, sections=1).solve(JumpSystem(a=a, b=b)).certified


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"gain_bound": 0.0}, "gain_bound: 0.0"),
        ({"gain_bound": float("nan")}, "gain_bound: nan"),
        ({"method": "exact"}, "method: 'exact' is not pwl or pwc"),
        ({"points": 0}, "points: 0"),
        ({"decay": float("inf")}, "decay: inf"),
        ({"sections": ((0.0,),)}, "partition: 1 tuples"),
    ],
)
def test_bad_request_gets_one_clear_message(changes: dict[str, object], message: str) -> None:
    request: dict[str, object] = {"gain_bound": 10.0, **changes}
    decay = float(request.pop("decay", 0.0))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="^" + message):
        FeedbackRequest(process=PROCESS, **request).solve(chapter2_system(), decay)  # type: ignore[arg-type]


class UpTo:
    """Conditions that gains fulfil up to a size of the uncertainty or a decay rate; the gains there fail the proof near it."""

    def __init__(self, limit: float, proved: float = 1.0) -> None:
        self.limit, self.proved, self.asked = limit, proved, 0

    @staticmethod
    def size(system: JumpSystem, decay: float) -> float:
        assert isinstance(system.uncertainty, VertexUncertainty)
        return decay + float(np.abs(system.uncertainty.da).max()) / 0.7

    def find(self, system: JumpSystem, decay: float, *, quick: bool = False) -> Any:
        self.asked += 1
        if self.size(system, decay) > self.limit:
            raise Infeasible("beyond")
        return self.size(system, decay)

    def judge(self, system: JumpSystem, found: Any, decay: float) -> Any:
        if found > self.proved * self.limit:
            raise Infeasible("not proved")
        return found


@pytest.mark.parametrize("limit", [0.03, 0.7, 1.0, 5.3])
def test_the_largest_uncertainty_and_the_fastest_decay_are_found_by_bisection(limit: float) -> None:
    scale, found = largest_uncertainty(chapter2_system(), UpTo(limit), tolerance=1e-3)
    assert scale == pytest.approx(found) == pytest.approx(limit, rel=3e-3) and scale <= limit
    rate = fastest_feedback(chapter2_system().scaled(0.0), UpTo(limit), tolerance=1e-3)
    assert rate == pytest.approx(limit, rel=3e-3)
    back, found = largest_uncertainty(chapter2_system(), UpTo(limit, proved=0.99), tolerance=1e-3)
    assert 0.98 * limit < back == pytest.approx(found) and back <= 0.99 * limit
    with pytest.raises(Infeasible, match="not proved"):
        largest_uncertainty(chapter2_system(), UpTo(limit, proved=0.9), tolerance=1e-3)


def test_where_nothing_is_uncertain_nothing_is_scaled() -> None:
    with pytest.raises(FieldError, match="there is none to scale"):
        largest_uncertainty(chapter2_system("none"), UpTo(1.0))
