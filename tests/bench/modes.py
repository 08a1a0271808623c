"""Designs and certificates over many modes: CPU time, each beside the plain way or a peer, in the same run.

    designs        H2 and H-infinity over tau_max = d_max = 1, 2, ..; a plant of 20 states; an evaluation beside one alone
    certificates   484 modes, beside scipy's ARPACK on plain products; one mode, beside python-control
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from design.tracking import TrackingProblem

Array = np.ndarray[Any, np.dtype[np.float64]]
Row = dict[str, Any]

H2_GOALS_S = {4: 10.0, 8: 60.0}
LARGE_PLANT, LARGE_GOAL_S = 20, 10.0
HINF_TIMES = 5.0
CERTIFICATE_SIDE, CERTIFICATE_GOAL_S = 22, 10.0
EVALUATIONS = 5


def bench_modes(
    progress: Callable[[str], None] = lambda text: None,
    *,
    h2: tuple[int, ...] = (1, 2, 3, 4, 8),
    hinf: tuple[int, ...] = (1, 2, 3, 4),
    large: int = LARGE_PLANT,
) -> list[Row]:
    """Return the CPU time of designs over ever more modes, one start each, and of one evaluation beside the plain one.

    Args:
        progress: called with what is being done.
        h2, hinf: values of tau_max = d_max that designs of this norm are made for, with the gains of the motor.
        large: states of the plant of the last two designs, with 6 modes.
    """
    rows = []
    for objective, sizes in (("h2", h2), ("hinf", hinf)):
        times = 1.0 if objective == "h2" else HINF_TIMES
        for most in sizes:
            goal = None if most not in H2_GOALS_S else times * H2_GOALS_S[most]
            rows.append(design_row(f"motor, tau_max = d_max = {most}", motor_problem(most, objective), goal, progress))
        goal = times * LARGE_GOAL_S if large == LARGE_PLANT else None
        rows.append(design_row(f"{large} states, tau_max = 2, d_max = 1", large_problem(large, objective), goal, progress))
    return rows


def motor_problem(most: int, objective: str) -> TrackingProblem:
    """Return the motor's design with both delays from 0 to `most`, the gain knowing both."""
    from design.tracking import TrackingProblem
    from hil.compose import compose
    from hil.experiment import load_experiment

    model = compose(load_experiment("dc-motor-hinf"), certify=False).model
    chain = shortening_chain(most)
    return TrackingProblem(A=model.A, B=model.B, C=model.C, sc=chain, ca=chain, starts=1, objective=objective)


def large_problem(states: int, objective: str) -> TrackingProblem:
    """Return the design for a plant of many states (fixed random numbers, spectral radius 0.97), with 6 modes."""
    from design.tracking import TrackingProblem

    rng = np.random.default_rng(0)
    A = rng.standard_normal((states, states))
    A *= 0.97 / float(np.abs(np.linalg.eigvals(A)).max())
    B, C = rng.standard_normal((states, 1)), rng.standard_normal((1, states))
    return TrackingProblem(A=A, B=B, C=C, sc=shortening_chain(2), ca=shortening_chain(1), starts=1, objective=objective)


def shortening_chain(most: int) -> Array:
    """Return a chain of the delays 0 .. most in which a delay grows by at most one: (most + 1, most + 1).

    >>> shortening_chain(2).tolist()
    [[0.5, 0.5, 0.0], [0.5, 0.25, 0.25], [0.5, 0.25, 0.25]]
    """
    chain = np.zeros((most + 1, most + 1))
    for i in range(most + 1):
        reach = min(i + 1, most)
        chain[i, 0] = 0.5
        chain[i, 1 : reach + 1] = 0.5 / reach
    return chain


def design_row(name: str, problem: TrackingProblem, goal: float | None, progress: Callable[[str], None]) -> Row:
    """Return the CPU time of a design, and of an H2 evaluation along its descent beside one alone.

    Args:
        name: of the loop.
        problem: what is asked.
        goal: CPU time that it may take, s.
        progress: called with what is being done.
    """
    from design.tracking.synthesis import solve

    progress(f"{problem.objective} design, {name}")
    design, spent = _cpu(partial(solve, problem))
    certificate = design.certificate
    ours, alone = _evaluations(problem, design.gains)
    return {
        "design": f"{'H2' if problem.objective == 'h2' else 'H-infinity'}, {name}",
        "modes": certificate.modes,
        "states": certificate.order,
        "norm": certificate.h2_norm if problem.objective == "h2" else certificate.hinf_norm,
        "CPU s": round(spent, 2),
        "goal s": goal,
        "met": None if goal is None else spent <= goal,
        "evaluations": design.evaluations,
        "H2 evaluation ms": round(ours * 1e3, 2),
        "alone ms": round(alone * 1e3, 2),
        "ratio": round(ours / alone, 3),
    }


def _evaluations(problem: TrackingProblem, gains: Array) -> tuple[float, float]:
    """CPU seconds of an H2 norm with its derivative: near the last one, as a descent takes it, and each alone."""
    from threadpoolctl import threadpool_limits

    from design.jump_linear import h2_derivative
    from design.tracking.loop_objective import LoopObjective

    structure, space = problem.structure(), problem.space()
    alpha, v = problem.alpha(structure), space.coordinates(gains)
    objective, rng = LoopObjective(structure, space, alpha), np.random.default_rng(0)
    points = [v * (1.0 + 1e-3 * rng.standard_normal(v.size)) for _ in range(EVALUATIONS)]
    spent = []
    with threadpool_limits(1, user_api="blas"):
        objective.h2(v)
        for task in (
            lambda: [objective.h2(point) for point in points],
            lambda: [
                h2_derivative(structure.matrices(space.gains(point)), structure.B, structure.C, structure.transition, alpha)
                for point in points
            ],
        ):
            spent.append(_cpu(task)[1] / EVALUATIONS)
    return spent[0], spent[1]


def bench_certificates(
    progress: Callable[[str], None] = lambda text: None,
    *,
    side: int = CERTIFICATE_SIDE,
    orders: tuple[int, ...] = (4, 10, 20, 40),
) -> list[Row]:
    """Return the CPU time of a certificate over many modes beside ARPACK alone, and of one mode's norms beside python-control.

    Args:
        progress: called with what is being done.
        side: delays of either direction; their square is the number of modes.
        orders: states of the loops of one mode.
    """
    return [_many_modes(side, progress), *(row for n in orders for row in _one_mode(n, progress))]


def _many_modes(side: int, progress: Callable[[str], None]) -> Row:
    from threadpoolctl import threadpool_limits

    from design.jump_linear.second_moment import backward, to_matrix, to_vector
    from design.networked_loop.certify import certify_structure
    from design.networked_loop.closed_loop import loop_structure

    progress(f"certificate of {side**2} modes")
    plant = motor_problem(1, "h2")
    chain = shortening_chain(side - 1)
    structure = loop_structure(plant.A, plant.B, plant.C, chain, chain, "generated")
    gains = np.full(structure.gain_shape, -0.05)
    certificate, spent = _cpu(partial(certify_structure, structure, gains, output="stacked"))
    A, transition = structure.matrices(gains), structure.transition
    modes, n, _ = A.shape

    def radius() -> float:
        from scipy.sparse.linalg import LinearOperator, eigs

        def product(vector: Array) -> Array:
            return to_vector(backward(A, transition, to_matrix(vector.reshape(modes, -1), n))).ravel()

        start = to_vector(np.broadcast_to(np.eye(n), A.shape)).ravel()
        operator = LinearOperator((start.size, start.size), matvec=product, dtype=np.float64)
        return float(np.abs(eigs(operator, k=1, v0=start, ncv=40, return_eigenvectors=False, tol=1e-12)).max())

    with threadpool_limits(1, user_api="blas"):
        peer, alone = _cpu(radius)
    goal = CERTIFICATE_GOAL_S if side == CERTIFICATE_SIDE else None
    return {
        "certificate": f"motor, both delays to {side - 1}, gains of the delay when generated",
        "modes": modes,
        "states": n,
        "value": certificate.mean_square_radius,
        "CPU s": round(spent, 4),
        "goal s": goal,
        "met": None if goal is None else bool(certificate.stable and spent <= goal),
        "peer": "the radius alone, ARPACK on plain products",
        "peer s": round(alone, 4),
        "peer's value": peer,
        "ratio": round(spent / alone, 2),
    }


def _one_mode(n: int, progress: Callable[[str], None]) -> list[Row]:
    import control

    from design.jump_linear import MJLS, h2_norm
    from design.jump_linear.bounded_real import hinf_norm

    progress(f"norms of one mode, {n} states")
    rng = np.random.default_rng(n)
    A = rng.standard_normal((n, n))
    A *= 0.95 / float(np.abs(np.linalg.eigvals(A)).max())
    B, C = rng.standard_normal((n, 2)), rng.standard_normal((2, n))
    system = MJLS(A=A[None], B=B, C=C, transition=[[1.0]])
    plain = control.ss(A, B, C, np.zeros((2, 2)), True)
    rows = []
    for name, ours, kind in (("H2", h2_norm, 2), ("H-infinity", hinf_norm, "inf")):
        value, spent = _cpu(partial(_thrice, partial(ours, system)))
        peer, alone = _cpu(partial(_thrice, partial(control.system_norm, plain, kind, 1e-9)))
        rows.append({
            "certificate": f"{name} norm of one mode", "modes": 1, "states": n, "value": value, "CPU s": round(spent / 3, 4),
            "goal s": None, "met": None, "peer": "python-control", "peer s": round(alone / 3, 4), "peer's value": float(peer),
            "ratio": round(spent / alone, 2),
        })  # fmt: skip
    return rows


def _thrice(task: Callable[[], float]) -> float:
    """The value of a task that runs three times, the first of which may import."""
    first, _, _ = task(), task(), task()
    return first


def _cpu(task: Callable[[], Any]) -> tuple[Any, float]:
    begun = time.process_time()
    value = task()
    return value, time.process_time() - begun
