"""Designs of Chapter 7: norm and time of every one, beside the thesis's iterated matrix inequalities in the same run."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

from design.errors import DesignError

if TYPE_CHECKING:
    from design.semi_markov_loop.certificate import JumpCertificate
    from design.tracking.synthesis import TrackingProblem

CCL_PROGRAMMES = 40
"""Semidefinite programmes that the iterated route gets; it is far from its end by then, and its time is reported."""


class Goal(NamedTuple):
    """One design with the norm that it must reach and the time that it may take, s."""

    plant: str
    objective: str
    information: str
    output: str
    norm: float
    limit_s: float
    hinf_bound: float | None = None


GOALS = (
    Goal("dc-motor", "h2", "generated", "stacked", 3.7110, 2.0),
    Goal("dc-motor", "h2", "applied", "stacked", 3.4697, 2.0),
    Goal("dc-motor", "h2", "both", "stacked", 3.2918, 2.0),
    Goal("vtol", "h2", "generated", "stacked", 0.12044, 2.0),
    Goal("vtol", "h2", "applied", "stacked", 0.11709, 2.0),
    Goal("vtol", "h2", "both", "stacked", 0.11497, 2.0),
    Goal("dc-motor", "hinf", "generated", "stacked", 17.424, 45.0),
    Goal("dc-motor", "hinf", "generated", "sum", 17.405, 45.0),
    Goal("dc-motor", "hinf", "applied", "stacked", 16.279, 45.0),
    Goal("dc-motor", "hinf", "both", "stacked", 15.339, 45.0),
    Goal("vtol", "hinf", "generated", "stacked", 0.2819, 90.0),
    Goal("vtol", "hinf", "generated", "sum", 0.2553, 90.0),
    Goal("dc-motor", "mixed", "generated", "sum", 3.805, 120.0, 17.5),
)


def bench_design(
    progress: Callable[[str], None] = lambda text: None, *, goals: tuple[Goal, ...] = GOALS, programmes: int = CCL_PROGRAMMES
) -> list[dict[str, Any]]:
    """Solve every goal directly and, where that route exists, by cone complementarity; one row each.

    Args:
        progress: called with what is being done.
        goals: designs to solve.
        programmes: budget of the iterated route, in semidefinite programmes; 0 leaves it out.
    """
    from design.tracking.synthesis import solve
    from hil.design_questions import problem_for, tracking_target

    rows = []
    for goal in goals:
        name = f"{goal.plant} {goal.objective} {goal.information}{' (sum)' if goal.output == 'sum' else ''}"
        progress(name)
        target = tracking_target(goal.plant)
        problem = problem_for(
            target,
            objective=goal.objective,
            information=goal.information,
            output=goal.output,
            hinf_bound=goal.hinf_bound,
        )
        begun = time.perf_counter()
        design = solve(problem)
        spent = time.perf_counter() - begun
        certificate = design.certificate
        norm = certificate.hinf_norm if goal.objective == "hinf" else certificate.h2_norm
        bounded = goal.hinf_bound is None or (certificate.hinf_norm or float("inf")) <= goal.hinf_bound
        reached = bool(norm is not None and norm <= goal.norm and bounded and certificate.stable)
        row: dict[str, Any] = {
            "design": name,
            "norm": norm,
            "goal": goal.norm,
            "s": round(spent, 3),
            "limit_s": goal.limit_s,
            "reached": reached,
            "met": reached and spent <= goal.limit_s,
        }
        row |= _iterated(problem, spent, programmes)
        rows.append(row)
    return rows


def _iterated(problem: TrackingProblem, direct_s: float, programmes: int) -> dict[str, Any]:
    """The same problem by the thesis's route, with the ratio of the times."""
    empty: dict[str, Any] = {"ccl_norm": None, "ccl_s": None, "ccl_ratio": None}
    if not programmes or problem.objective == "mixed":
        return empty
    from design.as_printed.cone_complementarity import solve_ccl

    begun = time.perf_counter()
    try:
        result = solve_ccl(problem, iterations=programmes)
    except DesignError:
        return empty
    spent = time.perf_counter() - begun
    return {"ccl_norm": result.level, "ccl_s": round(spent, 3), "ccl_ratio": round(spent / direct_s, 1)}


def bench_scheduled(progress: Callable[[str], None] = lambda text: None) -> list[dict[str, Any]]:
    """The syntheses of Chapters 2 to 4: what each reached, what it must reach, and how long it took.

    Args:
        progress: called with what is running.
    """
    from tests.bench.semi_markov import LIMIT_S, bench_cases

    rows = []
    for case in bench_cases():
        progress(case.name)
        begun = time.perf_counter()
        reached, certificate = case.run()
        spent = time.perf_counter() - begun
        rows.append({
            "design": case.name,
            "quantity": case.quantity,
            "reached": reached,
            "goal": f"{case.sense} {case.required:g}",
            "s": round(spent, 3),
            "limit_s": LIMIT_S,
            "met": bool(case.met(reached) and certificate.certified and certificate.sound and spent <= LIMIT_S),
            **_second(certificate),
        })  # fmt: skip
    return rows


def _second(certificate: JumpCertificate) -> dict[str, Any]:
    """The certificate's inequalities, asked of another modeller and another solver; None where it has none."""
    if certificate.rebuild is None or not certificate.matrices:
        return {"cvxpy": None, "cvxpy_margin": None, "cvxpy_s": None}
    from design.lmi import program_of, second_opinion

    begun = time.perf_counter()
    found = second_opinion(program_of(certificate))
    spent_s = time.perf_counter() - begun
    return {"cvxpy": "holds" if found.holds else "not found", "cvxpy_margin": found.margin, "cvxpy_s": round(spent_s, 3)}
