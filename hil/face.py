"""What a program or a notebook calls: the functions behind ``import hil``, each a few lines over the rooms."""

from __future__ import annotations

import dataclasses
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from hil import experiment as asked
from hil.compose.design_problem import problem_for, tracking_target
from hil.compose.loop import Loop, compose
from hil.errors import HilError
from hil.experiment import Experiment
from hil.experiment.objects import with_objects
from hil.log.read.run import Run, read_run
from hil.replay import Verdict as LogVerdict
from hil.replay import experiment_of
from hil.replay import verify as verify_run
from hil.session import ClockName, Session, run_session
from hil.session import simulate as simulate_loop
from hil.sweeps.comparison import Comparison
from hil.sweeps.comparison import compare as compare_experiments
from hil.sweeps.probability import frequency
from hil.sweeps.seeds import Sweep, here, run_sweep
from plants import LinearPlant, from_control

if TYPE_CHECKING:
    from design.tracking.synthesis import Design

Source = str | Path | Experiment
OBJECTS = ("plant", "controller")
"""Tables of an experiment for which an object may stand."""


def load_experiment(
    source: str | Path, sets: Sequence[str] = (), *, seed: int | None = None, duration: str | float | None = None, **changes: Any
) -> Experiment:
    """Read and check an experiment.

    Args:
        source: name of a shipped experiment, or path of a TOML file.
        sets: changes ``path=value`` in TOML notation, as ``hil run --set`` takes them.
        seed: root of all random streams.
        duration: length of a run: seconds, or text such as "2 min".
        changes: path to value, as ``**{"plant.gain": 150, "links.sc.max_age": 4}``. ``plant`` takes a `control.StateSpace` or a
            `control.TransferFunction`, or what `plants.from_control` made of it; ``controller`` a fixed gain as one of them, a
            matrix (m, p) or a number, or a model in discrete time that the error y - r drives and whose output adds to u*. Both
            take an object of any class, one of a notebook's cell too, that is a plant (`plants.Plant`) or a controller
            (`design.controllers.Controller`); the log says so, and `verify` takes it again.

    Raises:
        HilError: with every fault found, each with the path of its field.
    """
    tables = {path: _table_of(path, value) for path, value in changes.items()}
    objects = {path: value for path, value in tables.items() if path in OBJECTS and not isinstance(value, str | Mapping)}
    said = [*sets, *(f"{path}={_toml(value, path)}" for path, value in tables.items() if path not in objects)]
    found = asked.load_experiment(source, said, seed=seed, duration=None if duration is None else str(duration))
    return with_objects(found, **objects)


def verify(
    log: str | Path, *, plant: object = None, controller: object = None, folder: str | Path | None = None
) -> LogVerdict:
    """Run controller and plant of a log again on what was recorded; compare every record, bit for bit.

    Args:
        log: the file.
        plant, controller: what ran, where it was built in Python.
        folder: where the file of an own module or an FMU stands, which the log names and does not hold.

    Returns:
        ``difference``: the first sample that differs, None if all are identical; ``answers`` and ``states`` were compared.

    Raises:
        HilError: what ran cannot be made again, with what it takes.
    """
    run = read_run(Path(log))
    where = None if folder is None else str(folder)
    return verify_run(run, str(log), experiment_of(run, str(log), plant=plant, controller=controller, folder=where))


def run(
    source: Source,
    *,
    seed: int | None = None,
    duration: str | float | None = None,
    clock: ClockName = "virtual",
    link: str | None = None,
    log: str | Path | None = None,
    external: bool = False,
    **changes: Any,
) -> Session:
    """Run an experiment and measure it.

    Args:
        source: name of a shipped experiment, path of a TOML file, or what `load_experiment` returned.
        seed, duration: as in `load_experiment`.
        clock: "virtual" (one process, reproducible) or "real" (separate processes over ``link``).
        link: URI of the real link; the experiment's own by default.
        log: where to keep the log, a new file; without it none is kept.
        external: somebody else's controller answers on the link.
        changes: path to value, as in `load_experiment`; of a loaded experiment plant and controller alone.

    Returns:
        the session: ``metrics``, ``arrays``, ``summary``, ``status``.

    Raises:
        HilError: if the experiment cannot be run, or the log exists already.
    """
    checked = _checked(source, seed, duration, changes)
    if clock == "virtual" and (link is not None or external):
        raise HilError("link and external need clock='real': virtual time runs in one process, without a link")
    if log is not None:
        path = Path(log)
        if path.exists():
            raise HilError(f"log {path}: exists already; choose another")
        return run_session(checked, clock=clock, link=link, path=path, external=external)
    with tempfile.TemporaryDirectory(prefix="hilrig-") as folder:
        session = run_session(checked, clock=clock, link=link, path=Path(folder) / "run.mcap", external=external)
        run = session.run  # before its file is gone
    summary = session.summary | {"log": session.summary["log"] | {"path": None}}
    return Session(log=lambda: run, summary=summary, status=session.status)


def simulate(
    source: Source | Loop,
    *,
    seed: int | None = None,
    duration: str | float | None = None,
    topics: Sequence[str] | None = None,
    **changes: Any,
) -> Run:
    """Run an experiment in virtual time and keep its records in memory: no file, no summary, the quickest way.

    Args:
        source: as in `run`, or a loop that was composed once for many runs.
        seed, duration: as in `load_experiment`.
        topics: what to keep; everything by default.
        changes: path to value, as in `load_experiment`.

    Raises:
        HilError: if the experiment cannot be run.
    """
    if isinstance(source, Loop):
        if duration is not None or changes:
            raise HilError("a composed loop takes no changes: give them to load_experiment")
        return simulate_loop(source, source.experiment.seed if seed is None else seed, topics)
    checked = _checked(source, seed, duration, changes)
    return simulate_loop(compose(checked), checked.seed, topics)


def sweep(source: Source, *, runs: int = 100, first_seed: int = 0, jobs: int = -1, **changes: Any) -> Sweep:
    """Run an experiment for many seeds in virtual time.

    Args:
        source: as in `run`.
        runs: how many; seeds ``first_seed``, ``first_seed + 1``, ...
        first_seed: the first of them.
        jobs: processes on this machine, -1 for one per core.
        changes: path to value, as in `load_experiment`.

    Returns:
        ``values``: column to array, one entry per seed (``seed``, ``stopped`` and every number of the measures).

    Raises:
        HilError: if the experiment cannot be run.
    """
    if runs < 1 or first_seed < 0:
        raise HilError(f"runs: {runs}, first_seed: {first_seed}; expected at least one run and no negative seed")
    return run_sweep(_checked(source, None, None, changes), range(first_seed, first_seed + runs), workers=here(jobs))


def compare(*sources: Source, runs: int = 200, jobs: int = -1, **changes: Any) -> Comparison:
    """Run several experiments for the same seeds, so that those with the same network laws meet the same delays.

    Args:
        sources: as in `run`; differences are against the first.
        runs: of each; seeds 0, 1, ...
        jobs: processes on this machine, -1 for one per core.
        changes: path to value, for all of them.

    Raises:
        HilError: if an experiment cannot be run, or two have one name.
    """
    checked = [_checked(source, None, None, changes) for source in sources]
    named = {experiment.name: experiment for experiment in checked}
    if not named or len(named) < len(checked):
        raise HilError(f"compare: {len(checked)} experiments have {len(named)} names; expected one name each")
    if runs < 2:
        raise HilError(f"compare: {runs} runs of each; expected at least 2")
    return compare_experiments(named, runs, jobs=jobs)


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
    with probability at most ``alpha``; if it is ``at_least + margin`` or more, it fails with probability at most ``beta``.

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
        AssertionError: with that line, if the probability is too low or undecided.
        HilError: if the experiment cannot be run, or the numbers mean nothing.

    Reference: A. Wald, Sequential Analysis, 1947.
    """
    from design.monte_carlo.sequential import SequentialTest

    try:
        test = SequentialTest(
            p0=at_least, p1=at_least + (0.5 * (1.0 - at_least) if margin is None else margin), alpha=alpha, beta=beta
        )
    except ValueError as error:
        raise HilError(f"assert_probability: {error}") from error
    found = frequency(_checked(source, None, None, changes), holds, test, most_runs=most_runs, first_seed=first_seed)
    if not found.holds:
        raise AssertionError(str(found))
    return str(found)


def assert_law(session: Session, side: str, *, alpha: float = 1e-6) -> float:
    """Assert that the delays of a run are those of its network law, by the law's own test of goodness of fit.

    A run whose network is the law's fails with probability ``alpha``.

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
    network = session.summary["network"]
    sides = {"sc": network["sc"], "ca": network["ca"], **network["nodes"]}
    if side not in sides:
        raise HilError(f"assert_law: side {side!r}; expected one of {', '.join(map(repr, sides))}")
    found = sides[side]
    p_value = found["p_value"]
    if p_value is None:
        raise HilError(f"assert_law: {side}: the law {found['law']!r} has no test, or the run is too short for it")
    if p_value < alpha:
        counts = f"modes {found['mode_counts']}, transitions {found['transition_counts']}"
        raise AssertionError(f"{side}: not the law {found['law']!r}: p = {p_value:.3g} < {alpha:g}; {counts}")
    return float(p_value)


def design(source: str, *, period: float | None = None, sojourns: int = 1, **options: Any) -> Design:
    """Design gains for a plant over the network (7.34), or for the plant and network of an experiment.

    Args:
        source: name of a plant plug-in or of an experiment.
        period: sample period in s; the thesis's, or the experiment's, by default.
        sojourns: lengths of stay at the measured tau that a gain tells apart, over semi-Markov delays.
        options: of `design.TrackingProblem`: objective ("h2", "hinf", "mixed"), information, R, samples, ...

    Returns:
        the design: ``gains``, ``certificate``, ``problem``.

    Raises:
        HilError: an option that does not fit, or no gains meet the request.
    """
    from design.errors import DesignError
    from design.requests.tracking import solve_tracking

    try:
        return solve_tracking(problem_for(tracking_target(source, period, sojourns), **options))
    except (DesignError, TypeError) as error:
        raise HilError(f"design: {error}") from error


def _checked(source: Source, seed: int | None, duration: str | float | None, changes: Mapping[str, Any]) -> Experiment:
    if not isinstance(source, Experiment):
        given = {"seed": seed, "duration": duration}
        return load_experiment(source, **{key: value for key, value in given.items() if value is not None} | dict(changes))
    tables = [path for path, v in changes.items() if path not in OBJECTS or isinstance(_table_of(path, v), str | Mapping)]
    if duration is not None or tables:
        raise HilError("a loaded experiment takes no changes but a plant and a controller: give them to load_experiment")
    found = with_objects(source, **changes)
    return found if seed is None else msgspec.structs.replace(found, seed=seed)


def _table_of(path: str, value: Any) -> Any:
    """Return the table of an experiment that a model, a plant or a gain stands for; anything else as it is."""
    control = sys.modules.get("control")  # who has a model of python-control has imported it
    model = control is not None and isinstance(value, control.StateSpace | control.TransferFunction)
    if path == "plant":
        plant = from_control(value) if model else value
        if isinstance(plant, LinearPlant):
            fields = {f.name: getattr(plant, f.name) for f in dataclasses.fields(plant)}
            return {"kind": "state-space", **fields}
    if path == "controller":
        if control is not None and model:
            found = control.ss(value)
            if found.nstates and not found.isdtime(strict=True):
                raise HilError("controller: a model with states in continuous time is no fixed gain; sample it first")
            if found.nstates:
                return {"kind": "output-feedback", "A": found.A, "B": found.B, "C": found.C, "D": found.D}
            value = found.D
        if isinstance(value, np.ndarray | list | tuple | float | int):
            return {"kind": "local", "gain": np.atleast_2d(np.asarray(value, dtype=np.float64))}
    return value


def _toml(value: Any, path: str) -> str:
    """Return a value in TOML notation."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, str):
        return msgspec.json.encode(value).decode()
    if isinstance(value, list | tuple):
        return f"[{', '.join(_toml(v, path) for v in value)}]"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_toml(str(k), path)} = {_toml(v, path)}" for k, v in value.items()) + "}"
    raise HilError(f"{path}: {type(value).__name__} is not a value of an experiment; expected a number, text, a list or a table")
