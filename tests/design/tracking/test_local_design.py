"""Local designs: python-control's numbers, and a controller that runs and is certified as it runs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from design.controllers import LinearFeedback, LinearLaw, LoopModel, OutputFeedback, RowsLaw
from design.errors import DesignError, FieldError
from design.jump_linear.certificate import certify_system
from design.networked_loop.certify import certify_loop
from design.networked_loop.closed_loop import dynamic_loop
from design.processes.delay_chain import DelayChain
from design.requests.tracking import DesignTask, LocalDesigned
from design.tracking.local_design import _filter, game_feedback, local_design, lqr_feedback
from tests.design.chapter7 import LAMBDA, MOTOR, PI

A, B, C = (np.asarray(M, dtype=float) for M in MOTOR)
NOW = DelayChain(transition=((1.0,),))


def model(tau_max: int = 2, d_max: int = 1) -> LoopModel:
    return LoopModel(A=A, B=B, C=C, period_s=0.05, tau_max=tau_max, d_max=d_max)


def test_without_a_network_the_norms_are_python_controls() -> None:
    """The loop that the certificate is of, built by python-control from plant and controller, has the same H2 norm."""
    import control

    law = local_design(A, B, C, "lqg")
    loop, gains = dynamic_loop(A, B, C, NOW, NOW, law)
    ours = certify_system(loop.system(gains), initial=loop.default_initial, hinf=True)
    plant = control.ss(A, np.hstack([B, B]), np.vstack([C, np.zeros((1, 2)), C]), np.array([[0, 0], [0, 0.01], [0, 0]]), 1.0)
    closed = plant.lft(control.ss(law.A, law.B, law.C, law.D, 1.0))
    gramian = control.dlyap(closed.A, closed.B @ closed.B.T)
    assert ours.h2_norm == pytest.approx(np.sqrt(np.trace(closed.C @ gramian @ closed.C.T)), rel=1e-6)
    response = control.frequency_response(closed, np.linspace(0.0, np.pi, 4001))
    peak = float(np.linalg.norm(response.complex, 2, axis=(0, 1)).max())
    # ours is proved by an inequality, from above
    assert ours.hinf_norm is not None and peak * (1.0 - 1e-6) < ours.hinf_norm < 1.01 * peak


def test_lqr_is_the_best_and_the_game_bounds_every_disturbance() -> None:
    def norms(F: np.ndarray) -> tuple[float, float]:
        feedback = LinearLaw(A=np.zeros((0, 0)), B=np.zeros((0, 2)), C=np.zeros((1, 0)), D=-F)
        loop, gains = dynamic_loop(A, B, np.eye(2), NOW, NOW, feedback)
        system = loop.system(gains)
        output = np.concatenate([np.asarray(system.C)[:, :1], np.asarray(system.C)[:, 2:]], axis=1)  # the angle and the input
        found = certify_system(type(system)(A=system.A, B=system.B, C=output, transition=system.transition), hinf=True)
        return found.h2_norm or np.inf, found.hinf_norm or np.inf

    best, game = lqr_feedback(A, B, C, 0.01), game_feedback(A, B, C, 0.01)
    rng = np.random.default_rng(0)
    assert all(norms(best)[0] <= norms(best * (1 + 0.02 * rng.uniform(-1, 1, 2)))[0] for _ in range(8))
    assert norms(game)[1] < norms(best)[1] and norms(best)[0] < norms(game)[0]


def test_the_law_that_runs_is_the_law_that_is_certified() -> None:
    """Running the controller slot by slot against the plant, over fixed delays, follows the matrices of the loop."""
    task = DesignTask(model=model())
    controller = LocalDesigned(method="hinf").solve(task)
    assert isinstance(controller, LinearFeedback)
    late = DelayChain(transition=((0.0, 1.0), (0.0, 1.0)))
    loop, gains = dynamic_loop(A, B, C, late, late, controller.linear_law(model()))
    matrix = loop.matrices(gains)[3]  # tau = 1, d = 1
    running, x = controller.start(model()), np.array([0.3, -1.0])
    state = np.concatenate([x, np.zeros(matrix.shape[0] - 2)])
    sample, row = np.zeros(1), np.zeros(1)
    for k in range(12):
        (u,) = running.rows(k, 1, tuple(sample), (0.0,))
        sample, x, row = C @ x, A @ x + B @ row, np.array(u)
        state = matrix @ state
        np.testing.assert_allclose(state[:2], x, rtol=1e-9, atol=1e-12)


def test_delays_that_the_design_does_not_know_can_undo_it() -> None:
    law = local_design(A, B, C, "lqr")
    (now, gains), (over, late) = (
        dynamic_loop(A, B, C, *chains, law)
        for chains in ((NOW, NOW), (DelayChain(transition=LAMBDA), DelayChain(transition=PI)))
    )
    assert certify_system(now.system(gains)).state == "certified"
    assert certify_system(over.system(late)).state == "refused"


@pytest.mark.parametrize("solve", [lqr_feedback, _filter])
def test_an_integrator_that_no_input_reaches_and_no_output_shows_is_refused(solve: Callable[..., object]) -> None:
    """scipy returns gains for it, with the spectral radius 1."""
    with pytest.raises(DesignError, match=r"spectral radius|stabilising"):
        solve(np.eye(2), np.array([[0.0], [1.0]]), np.array([[0.0, 1.0]]), 0.01)


def test_the_game_is_alike_in_every_unit_of_the_output() -> None:
    """gamma is in output units per unit of the disturbance: in units a hundred times as large it is a hundredth, F the same."""
    np.testing.assert_allclose(game_feedback(A, B, 0.01 * C, 0.01), game_feedback(A, B, C, 1.0), rtol=1e-3)


@pytest.mark.parametrize(
    ("change", "field"), [({"D": ((1.0, 2.0),)}, "D"), ({"A": ((1.0,),)}, "B"), ({"C": ((float("nan"), 0.0),)}, "C")]
)
def test_matrices_that_do_not_fit_are_refused_by_name(change: dict[str, object], field: str) -> None:
    good: dict[str, object] = {"A": ((0.5, 0.0), (0.0, 0.5)), "B": ((1.0,), (0.0,)), "C": ((1.0, 0.0),), "D": ((0.0,),)}
    assert OutputFeedback(**good).linear_law(model()).A.shape == (2, 2)  # type: ignore[arg-type]
    with pytest.raises(FieldError, match=f"^{field}:"):
        OutputFeedback(**{**good, **change}).linear_law(model())  # type: ignore[arg-type]


@pytest.mark.parametrize("selection", ["constant", "generated", "applied"])
def test_rows_without_a_state_are_the_table_of_their_gains_however_late_they_act(selection: str) -> None:
    """A table of gains is a law without a state, asked for either way; packets are up to two slots under way."""
    sc = DelayChain(transition=((0.6, 0.4), (0.7, 0.3)))
    ca = DelayChain(transition=((0.5, 0.3, 0.2), (0.4, 0.3, 0.3), (0.2, 0.4, 0.4)))
    gains = -0.01 * np.arange(1.0, 7.0).reshape(2, 3, 1, 1)[:, : 1 if selection == "constant" else 3]
    rows = [RowsLaw(A=np.zeros((0, 0)), B=np.zeros((0, 1)), C=np.zeros((len(D), 1, 0)), D=D) for D in gains]
    loop, table = dynamic_loop(A, B, C, sc, ca, rows, selection)
    own = certify_system(loop.system(table), hinf=False)
    assert own.mean_square_radius == pytest.approx(certify_loop(A, B, C, sc, ca, gains, selection).mean_square_radius, rel=1e-8)
