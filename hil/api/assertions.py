"""What a test asserts of a networked loop: a probability, by Wald's sequential test over seeds, and the law of a run's delays."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from design.monte_carlo.confidence import SequentialTest
from hil.api.experiment_source import Source, as_change, checked_arguments, checked_experiment
from hil.compose import compose
from hil.errors import HilError, located, nearest
from hil.session import Session, simulated_session
from hil.sweeps.seeds import refuse_seed

SHOWN_SEEDS = 20
"""So many failed seeds a message names."""


@checked_arguments
def assert_probability(
    source: Source,
    holds: Callable[[Session], object],
    *,
    at_least: float,
    margin: float | None = None,
    alpha: float = 1e-3,
    beta: float = 1e-3,
    most_runs: int = 10_000,
    first_seed: int = 0,
    **changes: Any,
) -> str:
    """Assert that a condition holds with at least some probability, by Wald's sequential test over seeded sessions.

    It runs seed after seed in virtual time and stops as soon as it may. If the probability is ``at_least`` or less, it passes
    with probability at most ``alpha``; if it is ``at_least + margin`` or more, it is decided that it is too low with probability
    at most ``beta``. A test that has not decided after ``most_runs`` fails too, and says so: that is no part of ``beta``.

    Args:
        source: as in `run`.
        holds: says of a session whether the condition holds, ``lambda s: s.metrics["sse"] < 12``.
        at_least: the probability to be exceeded, between 0 and 1.
        margin: how far above it the probability must lie to pass surely; half of the way to 1 by default.
        alpha, beta: largest probabilities of a wrong pass and of a wrong failure.
        most_runs: after so many runs it fails as undecided.
        first_seed: seeds are ``first_seed``, ``first_seed + 1``, ...
        changes: path to value, as in `load_experiment`.

    Returns:
        one line: how many runs, how many held, which seeds failed.

    Raises:
        AssertionError: with that line and the command that runs a failed seed again, if the probability is too low or undecided.
        HilError: if the experiment cannot be run, the numbers mean nothing, or ``most_runs`` cannot suffice.

    Reference: A. Wald, Sequential Analysis, 1947.
    """
    __tracebackhide__ = True  # pytest shows the line of the test, not this function
    if not 0.0 < at_least < 1.0:
        raise HilError(f"assert_probability: at_least: {at_least:g}; expected a number between 0 and 1")
    sure = at_least + (0.5 * (1.0 - at_least) if margin is None else margin)
    if not at_least < sure < 1.0:
        room = 1.0 - at_least
        raise HilError(f"assert_probability: margin: {margin:g}; expected a number between 0 and 1 - at_least = {room:g}")
    with located("assert_probability", ValueError):
        test = SequentialTest(p0=at_least, p1=sure, alpha=alpha, beta=beta)
    if 1 <= most_runs < test.fewest:
        raise HilError(
            f"assert_probability: most_runs: {most_runs}; to tell {at_least:g} from {sure:g} takes {test.fewest} runs at least, "
            "in which it always holds: allow more, or a wider margin"
        )
    if most_runs < 1 or first_seed < 0:
        message = f"most_runs: {most_runs}, first_seed: {first_seed}; expected at least one run and no negative seed"
        raise HilError(f"assert_probability: {message}")
    refuse_seed(changes)
    loop = compose(checked_experiment(source, None, None, changes))
    failed, decided, runs = list[int](), None, 0
    while decided is None and runs < most_runs:
        held = holds(simulated_session(loop, first_seed + runs))
        if held is None:
            raise HilError(f"assert_probability: holds: returned None of seed {first_seed + runs}; expected True or False")
        if not held:
            failed.append(first_seed + runs)
        runs += 1
        decided = test.decide(runs - len(failed), runs)
    means = {
        "at least p1": f"a true probability of {at_least:g} or less would give this with probability at most {alpha:g}",
        "at most p0": f"a true probability of {sure:g} or more would give this with probability at most {beta:g}",
        None: f"too few to tell {at_least:g} from {sure:g}; allow more runs (most_runs) or a wider margin",
    }[decided]
    said = f"{loop.experiment.name}: required {at_least:g}, observed {runs - len(failed)} of {runs} runs; {means}"
    if failed:
        said += f"; failed seeds: {', '.join(map(str, failed[:SHOWN_SEEDS]))}{', ...' * (len(failed) > SHOWN_SEEDS)}"
    if decided != "at least p1":
        again = f"; to see one: {command_of(source, failed[0], changes)}" if failed else ""
        raise AssertionError(f"{said}{again}")
    return said


def command_of(source: Source, seed: int, changes: Mapping[str, Any]) -> str:
    """Return what runs one seed again: a command, or Python where an object of the caller's is part of it.

    Args:
        source, changes: as in `run`.
        seed: of the run.

    >>> command_of("dc-motor-hinf", 3, {"duration": 6, "plant.gain": 150})
    'hil run dc-motor-hinf --seed 3 --set duration=6 --set plant.gain=150'
    """
    plain = all(isinstance(value, str | int | float | list | tuple | dict) for value in changes.values())
    if not isinstance(source, str | Path) or not plain:
        return f"hil.run(..., seed={seed}) with the same objects"
    sets = [part for path, value in changes.items() for part in ("--set", f"{path}={as_change(value, path)}")]
    return shlex.join(["hil", "run", str(source), "--seed", str(seed), *sets])


@checked_arguments
def assert_law(session: Session, side: str, *, alpha: float = 1e-6) -> float:
    """Assert that the delays of a run are those of its network law, by the law's own test of goodness of fit.

    A run whose network is the law's fails with probability ``alpha``. Power at 1e-6: where one probability of a chain of three
    modes is off by 0.2, nearly all runs of 1000 slots fail and hardly any of 200; where by 0.1, one in nine of 1000 slots, and
    nearly all of 5000. That it passes says no more.

    Args:
        session: a finished run.
        side: "sc" (sensor to controller), "ca" (controller to actuator), or the name of a sensor node.
        alpha: largest probability of a wrong failure.

    Returns:
        the p-value.

    Raises:
        AssertionError: if the p-value is below ``alpha``.
        HilError: another side, or a law that has no test or too short a record for it.
    """
    __tracebackhide__ = True  # pytest shows the line of the test, not this function
    network = session.summary["network"]
    sides = {"sc": network["sc"], "ca": network["ca"], **network["nodes"]}
    if not 0.0 < alpha < 1.0:
        raise HilError(f"assert_law: alpha: {alpha:g}; expected a number between 0 and 1")
    if side not in sides:
        raise HilError(f"assert_law: side {side!r}; expected one of {', '.join(map(repr, sides))}{nearest(side, sides)}")
    found = sides[side]
    p_value = found["p_value"]
    if p_value is None:
        raise HilError(f"assert_law: {side}: the law {found['law']!r} has no test, was changed, or the run is too short for it")
    if p_value < alpha:
        counts = f"modes {found['mode_counts']}, transitions {found['transition_counts']}"
        raise AssertionError(f"{side}: not the law {found['law']!r}: p = {p_value:.3g} < {alpha:g}; {counts}")
    return float(p_value)
