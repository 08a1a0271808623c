"""Ten loops of networked control, of `problems.toml`, as experiments; and what a controller reaches on one of them.

A problem is a plant, a network, an objective and seeds, with the best controller that is known, and a lower bound.
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from msgspec import Struct

from design.errors import DesignError
from design.monte_carlo.confidence import mean_interval
from hil.compose import compose
from hil.compose.judged import caution
from hil.errors import HilError
from hil.experiment import Experiment, load_experiment
from hil.sweeps.seeds import run_seeds

PULSE_AT_S, LASTS_S = 8.0, 7.0
OBJECTIVE = "sse"


class Problem(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One problem.

    Args:
        name: of the problem.
        experiment: a shipped experiment, or a file beside the set.
        source: where plant and network come from.
        pulse: added to every input for one sample, in the input's unit.
        tried: tables of the controllers that were tried, in TOML.
    """

    name: str
    experiment: str
    source: str
    pulse: float
    tried: tuple[str, ...]

    @property
    def named(self) -> str:
        """The experiment as `load_experiment` takes it."""
        return str(folder() / self.experiment) if self.experiment.endswith(".toml") else self.experiment

    def load(self, controller: str | None = None) -> Experiment:
        """Return the experiment, at rest except for one pulse, with another controller where one is given.

        Raises:
            HilError: the controller does not fit.
        """
        plain = load_experiment(self.named)
        zeros, pulse = [0.0] * len(plain.plant.outputs), [self.pulse] * len(plain.plant.inputs)
        sets = [
            "allow_uncertified=true",
            f"duration={PULSE_AT_S + LASTS_S}",
            f"reference=[{{at=0,value={zeros}}}]",
            f"disturbance=[{{at={PULSE_AT_S},samples=1,value={pulse}}}]",
        ]
        sets += [] if controller is None else [f"controller={controller}"]
        return load_experiment(self.named, sets)


class Reached(Struct, frozen=True, kw_only=True):
    """What a controller reaches on a problem.

    Args:
        problem: its name.
        controller: its table, in TOML.
        mean, low, high: of the objective, with its 95 % interval; None where it did not run.
        runs: how many seeds, from 0.
        stopped: runs that safety stopped; their objective is no number of the problem.
        verdict: the verdict on the loop.
        said: why it did not run, or what is to be said beside its mean, see `hil.compose.judged.caution`; else empty.
    """

    problem: str
    controller: str
    mean: float | None
    low: float | None
    high: float | None
    runs: int
    stopped: int
    verdict: str
    said: str = ""


def folder() -> Path:
    """Return where the set stands."""
    return Path(str(resources.files("hil.sweeps"))) / "problems"


def problems() -> tuple[Problem, ...]:
    """Return the problem set."""
    found = msgspec.toml.decode((folder() / "problems.toml").read_bytes(), type=dict[str, tuple[Problem, ...]])
    return found["problem"]


def best_known() -> dict[str, dict[str, Any]]:
    """Return what is stored of every problem: the best `Reached` as plain values, and `lower_bound`."""
    found: dict[str, dict[str, Any]] = msgspec.json.decode((folder() / "best.json").read_bytes())
    return found


def reached(problem: Problem, controller: str, runs: int) -> Reached:
    """Run a controller on a problem over seeds 0 ... runs - 1; one that does not fit it says why."""
    try:
        loop = compose(problem.load(controller))
    except (HilError, DesignError) as error:
        return Reached(problem=problem.name, controller=controller, mean=None, low=None, high=None, runs=0, stopped=0, verdict="",
                       said=str(error).replace("\n", "; ")[:300])  # fmt: skip
    went = [row[OBJECTIVE] for row in run_seeds(loop, range(runs)) if not row["stopped"]]
    interval, stopped = mean_interval(np.array(went)), runs - len(went)
    known = interval.n > 1 and not stopped
    return Reached(
        problem=problem.name, controller=controller, runs=runs, stopped=stopped, mean=interval.value if known else None,
        low=interval.low if known and interval.bounded else None, high=interval.high if known and interval.bounded else None,
        verdict="undecided" if loop.verdict is None else loop.verdict.state,
        said=caution(loop) if known else f"safety stopped {stopped} of {runs} runs",
    )  # fmt: skip
