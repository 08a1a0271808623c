"""How often a run does what is asked of it: Wald's sequential test over seeded sessions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from design.monte_carlo.confidence import SequentialTest
from hil.compose.loop import compose
from hil.errors import HilError
from hil.experiment import Experiment
from hil.session import Session, simulated_session

SHOWN_SEEDS = 20
"""So many failed seeds a message names."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Frequency:
    """What a sequential test saw and decided.

    Args:
        experiment: its name.
        test: the test.
        runs: how many were made; seeds ``first_seed``, ``first_seed + 1``, ...
        first_seed: the first of them.
        failed: seeds of the runs in which the condition did not hold.
        holds: what was decided; None if the runs that were allowed did not suffice.
    """

    experiment: str
    test: SequentialTest
    runs: int
    first_seed: int
    failed: tuple[int, ...]
    holds: bool | None

    def __str__(self) -> str:
        t = self.test
        seeds = ", ".join(map(str, self.failed[:SHOWN_SEEDS])) + (", ..." if len(self.failed) > SHOWN_SEEDS else "")
        count = f"{self.experiment}: required {t.p0:g}, observed {self.runs - len(self.failed)} of {self.runs} runs"
        text = {
            True: f"a true probability of {t.p0:g} or less would give this with probability at most {t.alpha:g}",
            False: f"a true probability of {t.p1:g} or more would give this with probability at most {t.beta:g}",
            None: f"too few to tell {t.p0:g} from {t.p1:g}; allow more runs (most_runs) or a wider margin",
        }[self.holds]
        return f"{count}; {text}" + (f"; failed seeds: {seeds}" if self.failed else "")


def frequency(
    experiment: Experiment,
    holds: Callable[[Session], object],
    test: SequentialTest,
    *,
    most_runs: int = 10_000,
    first_seed: int = 0,
) -> Frequency:
    """Run an experiment in virtual time, seed by seed, until the test decides.

    Args:
        experiment: what runs; its own seed does not matter.
        holds: says of a session whether the condition holds.
        test: when to stop.
        most_runs: after so many runs it stops undecided.
        first_seed: seeds are ``first_seed``, ``first_seed + 1``, ...

    Raises:
        HilError: if the experiment cannot be run, or the numbers mean nothing.
    """
    if most_runs < 1 or first_seed < 0:
        raise HilError(f"most_runs: {most_runs}, first_seed: {first_seed}; expected at least one run and no negative seed")
    loop = compose(experiment)
    failed: list[int] = []
    decided = None
    runs = 0
    while decided is None and runs < most_runs:
        seed = first_seed + runs
        if not holds(simulated_session(loop, seed)):
            failed.append(seed)
        runs += 1
        decided = test.decide(runs - len(failed), runs)
    return Frequency(
        experiment=experiment.name,
        test=test,
        runs=runs,
        first_seed=first_seed,
        failed=tuple(failed),
        holds=None if decided is None else decided == "at least p1",
    )
