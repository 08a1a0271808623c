"""What thresholds and gains of an event trigger cost in runs, and how many packets they send (Section 8.2.2)."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from design.monte_carlo import Workers
from design.monte_carlo.confidence import Interval
from hil.compose import compose
from hil.design_questions.trigger_gains import Candidate, TriggerQuestion
from hil.errors import HilError, Terminated
from hil.experiment import Experiment, load_experiment
from hil.measure.signals import signals_of
from hil.measure.tracking import without_sense
from hil.rig.loop_chains import loop_chains
from hil.sweeps.seeds import run_sweep
from hil.sweeps.shown import as_plain, interval_of

RUNS: Final = 20
"""Seeds of every point, the same for all."""
MEASURES: Final = 'report.measures=["tracking", "cost"]'


class TriggerPoint(NamedTuple):
    """A candidate, judged and run.

    `ends_within` has the root mean square of every output under a dead band; `cost` is the squared tracking error and `packets`
    those of the sensor per second, each with its 95 % interval over the runs; `stopped` counts the runs that safety stopped.
    """

    of: Candidate
    state: str
    reason: str
    ends_within: dict[str, float]
    cost: Interval
    packets: Interval
    stopped: int

    def to_json(self) -> dict[str, object]:
        """Return it as plain values."""
        return {
            "threshold": self.of.threshold, "designed_for_share": self.of.share, "gain": self.of.gain.tolist(),
            "h2_bound": self.bound, "certificate": self.state, "reason": self.reason, "ends_within": self.ends_within,
            "cost": None if self.stopped else as_plain(self.cost), "packets_per_s": as_plain(self.packets),
            "stopped": self.stopped, "budget_spent": self.of.cut,
        }  # fmt: skip

    @property
    def bound(self) -> float | None:
        """The H2 norm that holds for every error that the trigger allows; None where the loop is not certified."""
        return self.of.bound if self.state == "certified" else None


class OpenPoint(NamedTuple):
    """A point that is not decided: threshold, share that its gain is designed for, and why."""

    threshold: float
    designed_for_share: float
    why: str

    def __str__(self) -> str:
        """Say which, and why."""
        gain = f"the gain for {self.designed_for_share:.0%} wrong" if self.designed_for_share else "the gain for no trigger"
        return f"threshold {self.threshold:g}, {gain}: {self.why}"


NOT_REACHED: Final = "not reached before the interrupt"
CUT: Final = "the budget of equations was spent before the search for its gain, or its H2 norm, ended; its row has the gain found"


def undecided(plan: Sequence[tuple[float, float]], points: Sequence[TriggerPoint]) -> list[OpenPoint]:
    """Return what is open of a plan: points that the budget cut short, and those that no run has reached."""
    cut = [OpenPoint(each.of.threshold, each.of.share, CUT) for each in points if each.of.cut]
    return cut + [OpenPoint(*each, NOT_REACHED) for each in plan[len(points) :]]


def experiment_with(question: TriggerQuestion, candidate: Candidate) -> Experiment:
    """Return the experiment with a trigger and a gain.

    Raises:
        HilError: outputs of several units, whose squared errors have no sum.
    """
    trigger = f'{{kind="{question.kind}", threshold={candidate.threshold!r}}}' if candidate.threshold else '{kind="every-slot"}'
    controller = f'controller={{kind="local", gain={json.dumps(candidate.gain.tolist())}}}'
    found = load_experiment(question.name, (*question.sets, MEASURES, f"{question.path}={trigger}", controller))
    if "sse" in without_sense(signals_of(found.plant)):
        raise HilError(f"{question.name}: --trigger: its outputs have several units, so that their squared errors have no sum")
    return found


def check_chains(question: TriggerQuestion) -> None:
    """Refuse a question to which every answer is undecided: the loop with a trigger has no chain of ages.

    Args:
        question: the question, of which nothing is solved yet.

    Raises:
        HilError: no chain, with its reason; or as of `experiment_with`.
    """
    gain = np.zeros((question.target.B.shape[1], len(question.target.C)))
    loop = compose(experiment_with(question, Candidate(question.thresholds[0], 0.0, gain, None)), certify=False)
    if why := loop_chains(loop.rig, loop.chains, loop.controller, loop.model).chainless:
        raise HilError(
            f"{question.name}: --trigger: every threshold would be undecided, as with a trigger no certificate covers this "
            f"network: {why}. Expected: a law of ages on network.sc, no bus and no loss"
        )


def run_candidate(question: TriggerQuestion, candidate: Candidate, runs: int = RUNS) -> TriggerPoint:
    """Certify a candidate, and run it for the seeds 0, 1, ...

    Args:
        question: the experiment.
        candidate: threshold and gain.
        runs: how many seeds.

    Raises:
        KeyboardInterrupt: Ctrl-C came.
    """
    experiment = experiment_with(question, candidate)
    loop = compose(experiment)
    sweep = run_sweep(experiment, range(runs), workers=Workers(backend="serial"), loop=loop)
    if sweep.interrupted:
        raise Terminated(sweep.interrupted - 128)
    state, reason, ends = ("undecided", "no verdict", None) if loop.verdict is None else (
        loop.verdict.state, loop.verdict.reason, loop.verdict.details.get("ends_within")
    )  # fmt: skip
    cost, packets = (interval_of(sweep.values[name]) for name in ("sse", "packets_per_s"))
    stopped = int(np.sum(sweep.values["stopped"]))
    return TriggerPoint(candidate, state, reason, dict(ends) if isinstance(ends, dict) else {}, cost, packets, stopped)


def front(points: Sequence[TriggerPoint]) -> list[TriggerPoint]:
    """Return the certified points that no other certified one beats in cost and packets, by their means, by rising packets."""
    able = [each for each in points if each.state == "certified" and not each.stopped]
    kept: list[TriggerPoint] = []
    for each in sorted(able, key=lambda one: (one.packets.value, one.cost.value)):
        if not kept or each.cost.value < kept[-1].cost.value:
            kept.append(each)
    return kept
