"""Gains that know an event trigger: of least guaranteed H2 norm where every sample may be wrong by a share of itself.

While a node with a relative trigger is silent, the controller has y + Delta y of the newest sample, |Delta| <= share, another one
in every slot. With that sample as states s of the plant,

    x(k+1) = A x + B u,    s(k+1) = (I + Delta) C x(k+1) = (I + Delta) (C A x + C B u),    measured: s,

it is the uncertainty of Remark 7.6, exactly: [dA dB] = M Delta [N1 N2], M = share [0; I], N1 = [C A, 0], N2 = C B. z has the
plant's own outputs C x.

Every search has its part of a budget of equations: an answer comes over any network, the same on every machine, and says
which of its points the budget left undecided.

The gains use no ages: that of a sample which a silent node did not send again says nothing.

Reference: thesis Section 8.2.2, Remark 7.6; `design.tracking.robust_synthesis`.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from design.controllers.rendered_wall import RendersWall
from design.errors import DesignError
from design.networked_loop.uncertainty import robust_h2
from design.requests.tracking import solve_tracking
from design.tracking.robust_synthesis import GUARANTEE, BudgetSpent, EquationBudget, robust
from design.tracking.synthesis import Design, Progress
from design.whole_process import one_blas_thread
from hil.design_questions import TrackingTarget, problem_for, target_of
from hil.errors import HilError
from hil.experiment import Experiment, load_experiment
from plants.parts.protocols import JumpPlant

Array = NDArray[np.float64]
SHARES: Final = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5)
"""Thresholds of a relative trigger; gains are designed for each."""
POOL: Final = (0.1, 0.3, 0.5)
"""Shares for which gains are designed that dead bands are tried with: an error of a fixed size is no share."""
MULTIPLES: Final = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Thresholds of a dead band, as multiples of the experiment's own."""
UNKNOWNS: Final = 20_000_000
"""Budget of all searches together: bounded-real equations times the unknowns of each. About two minutes of an idle core."""


class Candidate(NamedTuple):
    """A threshold (0: the node sends in every slot), the share that the gain (m, p) was designed for, and its H2 norm.

    `bound` holds for every error that the trigger allows; None where none is proved, or under a dead band. `cut` says that the
    budget ended before the search for the gain, or its bound, did.
    """

    threshold: float
    share: float
    gain: Array
    bound: float | None
    cut: bool = False


class TriggerQuestion(NamedTuple):
    """An experiment with one sensor node, its trigger's ``path``, ``kind`` and ``thresholds``, and what else to set."""

    name: str
    path: str
    kind: str
    thresholds: tuple[float, ...]
    sets: tuple[str, ...]
    target: TrackingTarget


def trigger_question(name: str) -> TriggerQuestion:
    """Return the triggers that an experiment's sensor node is tried with: its own kind, else relative ones.

    Args:
        name: of an experiment.

    Raises:
        HilError: several nodes, a trigger without bound, a plant that jumps, a wall, or a network that is no chain of delays.
    """
    experiment = load_experiment(name, ("allow_uncertified=true",))
    nodes = experiment.network.nodes
    if len(nodes) > 1:
        grid = " ".join(f"--grid network.nodes.{node}.trigger.threshold=LOW,HIGH" for node in nodes)
        raise HilError(
            f"{name}: --trigger: {len(nodes)} sensor nodes, expected one: each node has a chain of ages of its own, and gains "
            "that know the trigger are sought over one chain. Write a gain that uses no ages (controller.kind = 'local') and the "
            f"triggers into the file, and run thresholds of each node: hil sweep {name} {grid}"
        )
    if isinstance(experiment.plant, JumpPlant):
        raise HilError(f"{name}: --trigger: its plant jumps between modes; such gains are sought for one linear plant")
    if isinstance(experiment.controller, RendersWall):
        raise HilError(f"{name}: --trigger: its controller renders a wall, and follows no reference as these gains do")
    node = next(iter(nodes), "sensor")
    kind, thresholds = _tried(name, experiment, node)
    path = f"network.nodes.{node}.trigger"
    outputs = "[" + ", ".join(f'"{each.name}"' for each in experiment.plant.outputs) + "]"
    sets = ("allow_uncertified=true", *(() if nodes else (f"network.nodes.sensor={{outputs={outputs}}}",)))
    always = load_experiment(name, (*sets, f'{path}={{kind="every-slot"}}'))
    return TriggerQuestion(name, path, kind, thresholds, sets, target_of(always, name))


def _tried(name: str, experiment: Experiment, node: str) -> tuple[str, tuple[float, ...]]:
    own = experiment.network.nodes[node].trigger if node in experiment.network.nodes else None
    if own is None or own.kind in ("every-slot", "relative"):
        return "relative", SHARES
    if own.kind != "dead-band":
        raise HilError(
            f"{name}: network.nodes.{node}.trigger.kind: {own.kind!r}: the sample sent last may be wrong by any amount under it; "
            "expected 'relative' or 'dead-band'"
        )
    if not own.threshold:
        raise HilError(f"{name}: network.nodes.{node}.trigger.threshold: 0, expected one above 0: its multiples are tried")
    return "dead-band", tuple(own.threshold * multiple for multiple in MULTIPLES)


def planned(question: TriggerQuestion) -> list[tuple[float, float]]:
    """Return threshold and share of every candidate, in the order in which `candidates` finds them."""
    others = question.thresholds if question.kind == "relative" else POOL
    if question.kind == "relative":
        pairs = [pair for share in others for pair in ((share, 0.0), (share, share))]
    else:
        pairs = [(threshold, share) for share in (0.0, *others) for threshold in question.thresholds]
    return [(0.0, 0.0), *pairs]


def candidates(
    question: TriggerQuestion, progress: Progress | None = None, unknowns: int = UNKNOWNS, **options: Any
) -> Iterator[Candidate]:
    """Yield thresholds with gains, each as it is found: the nominal H2 design, and those that know the trigger.

    Args:
        question: the experiment and its thresholds.
        progress: as `solve_tracking` takes it.
        unknowns: budget of the searches, as `UNKNOWNS` says it.
        options: of the problem, without objective and information.

    Raises:
        HilError: an option that does not fit.
        DesignError: no gains meet the request.
    """
    nominal = nominal_design(question.target, **options, progress=progress)
    budget = EquationBudget(unknowns // unknowns_of(nominal))
    relative = question.kind == "relative"
    shares = question.thresholds if relative else POOL
    yield Candidate(0.0, 0.0, nominal.gains[0, 0], nominal.certificate.h2_norm)
    if not relative:
        yield from (Candidate(threshold, 0.0, nominal.gains[0, 0], None) for threshold in question.thresholds)
    for n, share in enumerate(shares):
        mine = budget.part(len(shares) - n)
        if relative:
            yield _guaranteed(question.target, nominal, share, 0.0, mine)
        search = mine.part(1, GUARANTEE if relative else 0)
        with one_blas_thread():
            design = gains_for_share(question.target, nominal, share, _of_threshold(progress, share, n, len(shares)), search)
        mine.back(search)
        if relative:
            yield _guaranteed(question.target, design, share, share, mine, search.spent)
        else:
            yield from (Candidate(each, share, design.gains[0, 0], None, search.spent) for each in question.thresholds)
        budget.back(mine)


def unknowns_of(design: Design) -> int:
    """Return how many unknowns an equation of a design's loop has: a symmetric matrix in every mode."""
    modes, order = design.problem.structure().base.shape[:2]
    return int(modes * order * (order + 1) // 2)


def _guaranteed(
    target: TrackingTarget, design: Design, threshold: float, share: float, budget: EquationBudget, cut: bool = False
) -> Candidate:
    try:
        budget.take(GUARANTEE)
    except BudgetSpent:
        return Candidate(threshold, share, design.gains[0, 0], None, cut=True)
    with one_blas_thread():
        return Candidate(threshold, share, design.gains[0, 0], guaranteed(target, design, threshold), cut)


def _of_threshold(progress: Progress | None, share: float, number: int, count: int) -> Progress:
    """Progress that says for which share gains are designed, and how many shares are done."""

    def report(stage: str, start: int, starts: int, value: float) -> None:
        if progress is not None:
            progress(f"gains for {share:.0%} wrong, {stage}", number, count, value)

    return report


def nominal_design(target: TrackingTarget, progress: Progress | None = None, **options: Any) -> Design:
    """Return the H2 design without a trigger, of the plant that has its sample as states."""
    n, p = len(target.A), len(target.C)
    A = np.block([[target.A, np.zeros((n, p))], [target.C @ target.A, np.zeros((p, p))]])
    B, C = np.vstack([target.B, target.C @ target.B]), np.hstack([np.zeros((p, n)), np.eye(p)])
    Q = np.hstack([target.C, np.zeros((p, p))])
    problem = problem_for(target._replace(A=A, B=B, C=C), objective="h2", information="constant", Q=Q, **options)
    return solve_tracking(problem, progress=progress)


def gains_for_share(
    target: TrackingTarget, nominal: Design, share: float, progress: Progress | None = None, budget: EquationBudget | None = None
) -> Design:
    """Return the gains of least guaranteed H2 norm where samples are wrong by up to a share, beginning at the nominal ones."""
    return robust(nominal, *_error(target, share), progress=progress, budget=budget)


def guaranteed(target: TrackingTarget, design: Design, share: float) -> float | None:
    """Return the H2 norm that holds for every error up to a share; None where none is proved."""
    try:
        return robust_h2(design.problem.structure(), design.gains, *_error(target, share), design.problem.initial)[0]
    except DesignError:
        return None


def _error(target: TrackingTarget, share: float) -> tuple[Array, Array, Array]:
    """M, N1, N2 of the module's uncertainty."""
    n, p = len(target.A), len(target.C)
    N1 = np.hstack([target.C @ target.A, np.zeros((p, p))])
    return np.vstack([np.zeros((n, p)), share * np.eye(p)]), N1, target.C @ target.B
