"""Many seeds of one experiment on one core, all cores or many machines: same loop, same code, no log files."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import isnan
from typing import Final

import msgspec
import numpy as np

from design.monte_carlo import Workers, spread
from design.monte_carlo.confidence import StopRule
from hil.compose import compose
from hil.compose.judged import caution
from hil.errors import HilError, exit_status
from hil.experiment import Experiment
from hil.log.records import EVENTS_TOPIC
from hil.log.run import Run
from hil.log.topics import channels_of
from hil.measure import Named, Quantity, each_output, in_one_row, measures_of, quantities_of, refuse_unsound_measures
from hil.measure.batch_protocols import BatchMeasure, BatchView
from hil.measure.signals import signals_of
from hil.measure.summary import run_metrics, withdrawal
from hil.plugins import is_ours
from hil.plugins.user_plugins import words
from hil.rig import in_words_of_parts
from hil.rig.loop import Array, Loop
from hil.runtime.virtual import rehearsal, simulate
from hil.sweeps import Sweep, SweepStore
from hil.sweeps.lockstep import measured_alone, run_batch, runs_per_batch, swept_at_once, view_of_batch

MOST_JOBS = 512
LAST_SEED = 2**63 - 1


def foreign_parts(loop: Loop) -> tuple[str, ...]:
    """Return the classes of plant, controller, network laws and measures that are not ours, by name."""
    parts = (loop.experiment.plant, loop.controller, *loop.rig.laws, *measures_of(loop.experiment))
    return tuple(dict.fromkeys(type(part).__qualname__ for part in parts if not is_ours(part)))


def copied(loop: Loop) -> Loop:
    """Return a loop as a worker gets it."""
    from cloudpickle import dumps, loads

    copy: Loop = loads(dumps(loop))
    return copy


def refuse_other_numbers(
    loop: Loop, alone: Sequence[Mapping[str, float]], swept: Sequence[Mapping[str, float]], *, kept: str = ""
) -> None:  # fmt: skip
    """Refuse a sweep whose first or last run has other numbers than it has alone.

    It is for a loop with a part that is not ours: these two are made alone. Tests hold that a loop of our own parts has the
    same numbers, bit for bit. A user's plant may inherit `start_batch` from one of ours and move otherwise, or
    be another one once it was pickled for a worker; a user's `of_batch` may give every run the numbers of the first.

    Args:
        loop: what is swept.
        alone: numbers of runs that were made alone.
        swept: numbers of runs of the sweep, which may lack these seeds.
        kept: the file that these were taken from; empty: they were computed now.

    Raises:
        HilError: with the number that differs most plainly: the first one.
    """
    numbers = {row["seed"]: row for row in swept}
    for row in alone:
        for name, value in row.items():
            other = numbers.get(row["seed"], row)[name]
            if not (value == other or (isnan(value) and isnan(other))):
                why = "start_batch(), ages_of_batch() or of_batch()" if swept_at_once(loop) else "what is left of it when pickled"
                where, helps = (f"in {kept}", "keep the runs of what it is now in another file") if kept else (
                    "in the sweep", f"correct {why}"
                )  # fmt: skip
                raise HilError(
                    f"{', '.join(foreign_parts(loop))}: a sweep has other numbers than its runs: {name} of seed "
                    f"{row['seed']:.0f} is {other:.6g} {where} and {value:.6g} in a run of its own; {helps}"
                )


WORTH_WORKERS = 3_000_000
"""Slots of a sweep in lockstep, some 1 s, up to which starting processes takes longer than the sweep."""


def quantities_in(experiment: Experiment) -> tuple[Quantity, ...]:
    """Return what the experiment's measures give per run; ``sse.angle`` is that of one output, where several are tracked."""
    measures, signals = measures_of(experiment), signals_of(experiment.plant)
    return quantities_of(measures, signals) + each_output(measures, signals)


def columns_of(experiment: Experiment) -> tuple[str, ...]:
    """Return the columns of a sweep besides ``seed``: whether safety stopped the run, and every number of the measures.

    Args:
        experiment: what is run.
    """
    return ("stopped", *(quantity.name for quantity in quantities_in(experiment)))


def run_seeds(loop: Loop, seeds: Sequence[int]) -> list[dict[str, float]]:
    """Run a loop for some seeds in this process; return one row of metrics per seed (NaN where undefined).

    Where the loop can be run in lockstep, all seeds are computed at once; the numbers are the same, bit for bit.
    """
    with in_words_of_parts(loop.experiment):
        if swept_at_once(loop):
            size = runs_per_batch(loop)
            return [row for i in range(0, len(seeds), size) for row in _in_one_chunk(loop, seeds[i : i + size])]
        return run_one_by_one(loop, seeds)


def _in_one_chunk(loop: Loop, seeds: Sequence[int]) -> list[dict[str, float]]:
    together = run_batch(loop, seeds)
    view = view_of_batch(loop, together)
    found: dict[str, Array] = {}
    if together.known.any():
        for measure in measures_of(loop.experiment):
            if isinstance(measure, BatchMeasure):
                found |= _of_many(measure, view)
    columns = columns_of(loop.experiment)[1:]
    runs = (int(np.count_nonzero(together.known)),)
    for name in columns if found else ():
        if (given := found.get(name)) is None or given.shape != runs:
            told = "is missing" if given is None else f"has shape {given.shape}"
            raise HilError(f"of_batch(view): {name} {told}; expected shape {runs}, a number of every run")
    lists = [found[name].tolist() for name in columns] if found else [[]] * len(columns)
    known = iter(zip(*lists))
    return [
        dict(zip(columns, next(known))) | {"seed": seed, "stopped": 0.0} if fits else run_one_by_one(loop, [seed])[0]
        for seed, fits in zip(seeds, together.known.tolist())
    ]


def _of_many(measure: BatchMeasure, view: BatchView) -> dict[str, Array]:
    """Return what `of_batch` gives of all outputs and, where several are tracked, of each.

    Raises:
        HilError: it raised.
    """
    names, views = view.signals.tracked, {"": view}
    for c, name in enumerate(names if len(names) > 1 else ()):
        views[f".{name}"] = msgspec.structs.replace(
            view, outputs=(view.outputs[c],), reference=view.reference[:, c : c + 1], signals=view.signals.only(name)
        )
    try:
        found = {of: measure.of_batch(each) for of, each in views.items()}
        return {f"{key}{of}": np.asarray(value, dtype=np.float64) for of in found for key, value in found[of].items()}
    except (Exception, SystemExit) as error:  # whatever an author's measure raises
        raise HilError(f"{type(measure).__name__}: of_batch(view): {words(error)}") from error


def run_one_by_one(loop: Loop, seeds: Sequence[int]) -> list[dict[str, float]]:
    """Run a loop seed by seed with the nodes of a session: what `run_seeds` is held to."""
    names = columns_of(loop.experiment)[1:]
    wanted = {topic for measure in measures_of(loop.experiment) for topic in measure.topics}
    topics = {EVENTS_TOPIC, *(wanted & channels_of(loop).keys())}
    return [_row(simulate(loop, seed, topics), loop, names, seed) for seed in seeds]


def _row(run: Run, loop: Loop, names: Sequence[str], seed: int) -> dict[str, float]:
    found = in_one_row(run_metrics(run, loop.experiment, loop.rig))
    row = {name: float("nan") if found[name] is None else float(found[name]) for name in names}
    return row | {"seed": seed, "stopped": float(any(e["kind"] == "safety" for e in run.events))}


def refuse_seed(changes: Iterable[str]) -> None:
    """Refuse to change ``seed``: many runs have seeds of their own.

    Args:
        changes: paths, or ``path=value``.

    Raises:
        HilError: one of them is the seed.
    """
    if any(change.partition("=")[0].strip() == "seed" for change in changes):
        raise HilError("seed: has no effect on many runs; those of a sweep have first_seed (--first-seed) and the next ones")


def seeds_of(runs: int, first_seed: int = 0, *, least: int = 1) -> range:
    """Return the seeds of so many runs.

    Raises:
        HilError: fewer runs than the least that mean something, or seeds that no log can hold.
    """
    if runs < least or first_seed < 0 or first_seed + runs - 1 > LAST_SEED:
        raise HilError(f"runs: {runs}, first_seed: {first_seed}; expected at least {least}, and seeds from 0 to 2^63 - 1")
    return range(first_seed, first_seed + runs)


def here(jobs: int) -> Workers:
    """So many processes on this machine, -1 for one per core.

    Raises:
        HilError: a number that means nothing, or that would only bring the machine down.
    """
    if jobs == 0 or not -1 <= jobs <= MOST_JOBS:
        raise HilError(f"jobs: {jobs}; expected -1 or a number from 1 to {MOST_JOBS}")
    return Workers(backend="serial") if jobs == 1 else Workers(backend="loky", jobs=jobs)


MOST_RUNS: Final = 1_000_000
"""The numbers of so many runs take half a gigabyte where an experiment has eight."""


def run_sweep(
    experiment: Experiment,
    seeds: Sequence[int],
    *,
    workers: Workers,
    progress: Callable[[int], None] = lambda done: None,
    store: SweepStore | None = None,
    until: tuple[str, StopRule] | None = None,
    loop: Loop | None = None,
) -> Sweep:
    """Run an experiment for every seed, or for as many as a confidence interval needs.

    Every run has its own seed, so the numbers are the same for every number of jobs and machines and every split.

    Args:
        experiment: what to run, in virtual time.
        seeds: one run each; with ``until`` the most that may be run.
        workers: Where: this process, the cores of this machine, or a dask cluster.
        progress: called with how many runs have been done.
        store: where finished runs are kept, and taken from instead of being run again.
        until: (metric, StopRule). Stop as soon as the interval of the metric is narrow enough. It is looked at only at the rule's
            numbers of runs, which is what its error rate needs; runs in which the metric is undefined do not count for it.
        loop: of the experiment, where it is composed already.

    Raises:
        HilError: more than `MOST_RUNS`.
    """
    if seeds[MOST_RUNS:]:
        raise HilError(f"runs: more than {MOST_RUNS} of one experiment; run them in parts, by the first seed of each")
    done = {seed: store.rows[seed] for seed in seeds if seed in store.rows} if store else {}
    look, interval, reached, interrupted = 0, None, False, 0
    wanted: Sequence[int] = seeds
    loop = loop or compose(experiment)
    refuse_unsound_measures(loop, rehearsal)
    ends = list(dict.fromkeys((seeds[0], seeds[-1])))
    alone = run_one_by_one(replace(loop, watched=None), ends) if foreign_parts(loop) else []
    if alone:
        with in_words_of_parts(experiment):  # of one that cannot be pickled, too
            swept = run_seeds(copied(replace(loop, watched=None)), ends)
        refuse_other_numbers(loop, alone, swept)
        if store:
            refuse_other_numbers(loop, alone, [*store.rows.values()], kept=f"--resume {store.path}")
    together = swept_at_once(loop)
    if together and workers.backend == "loky" and len(seeds) * experiment.slots <= WORTH_WORKERS:
        workers = Workers(backend="serial")
    try:
        while not reached and (look == 0 or len(wanted) < len(seeds)):
            look += 1
            if until is not None:
                wanted = seeds[: until[1].runs(look)]
            progress(sum(seed in done for seed in wanted))
            missing = [seed for seed in wanted if seed not in done]
            parts = _parts(missing, workers, runs_per_batch(loop) if together else None)
            for rows in spread(partial(run_seeds, replace(loop, watched=None)), parts, workers):
                if store:
                    store.add(rows)
                done.update((int(row["seed"]), row) for row in rows)
                progress(sum(seed in done for seed in wanted))
            if until is not None:
                found = np.array([done[seed][until[0]] for seed in wanted])
                interval = until[1].interval(found[np.isfinite(found)], look)
                reached = interval.half_width <= until[1].half_width
                interval = interval._replace(level=until[1].level)
    except KeyboardInterrupt as e:
        interrupted = exit_status(e)  # what is done is worth having
        done |= {seed: store.rows[seed] for seed in seeds if seed in store.rows} if store else {}
        wanted = seeds
    rows = [done[seed] for seed in wanted if seed in done]
    values = {name: np.array([row[name] for row in rows]) for name in ("seed", *columns_of(experiment))}
    refuse_other_numbers(loop, alone, rows)
    unseen = interrupted or not rows or (together and not alone)
    said = "" if unseen else withdrawal(simulate(loop, int(rows[0]["seed"]), (EVENTS_TOPIC,))) or ""
    judged = loop.verdict
    doubt = "" if judged is None or judged.certified else f"the loop is {judged.state}, {judged.kind}: {judged.reason}"
    cautions = "; ".join(filter(None, (doubt, said, caution(loop))))
    return Sweep(
        Named("column", values), interrupted, interval, reached, cautions, measured_alone(loop), experiment.name,
        quantities_in(experiment),
    )  # fmt: skip


def _parts(seeds: Sequence[int], workers: Workers, chunk: int | None) -> list[Sequence[int]]:
    """Seeds for one job each: few enough that Ctrl-C loses little, and that all workers have work to the end.

    In lockstep up to a chunk: the more runs are computed at once, the less each costs.
    """
    serial = workers.backend == "serial"
    count = 1 if serial and chunk else workers.jobs if workers.jobs > 0 else len(os.sched_getaffinity(0))
    most, parts = (25, 4 * count) if chunk is None else (chunk, 2 * count)
    size = max(1, min(most, -(-len(seeds) // parts)))
    return [seeds[i : i + size] for i in range(0, len(seeds), size)]
