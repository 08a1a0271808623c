"""Sweeps over parameters: points of a grid or of a Latin hypercube, each run for the same seeds."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from design.monte_carlo.parallel import Workers
from hil.errors import HilError
from hil.experiment import Experiment, load_experiment
from hil.measure.measure import Quantity
from hil.sweeps.comparison import common_quantities
from hil.sweeps.seeds import columns_of, quantities_in, run_sweep
from hil.sweeps.store import SweepStore

MOST_POINTS = 10_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Points:
    """Where an experiment is run.

    Args:
        keys: paths of the fields that change.
        values: one row per point: what each field is set to, in TOML notation.
        axes: the values of each key, where the points are a grid; nothing otherwise.
    """

    keys: tuple[str, ...]
    values: tuple[tuple[str, ...], ...]
    axes: tuple[tuple[str, ...], ...] = ()

    def changes(self, point: int) -> list[str]:
        """Return what a point changes, as ``--set`` takes it."""
        return [f"{key}={value}" for key, value in zip(self.keys, self.values[point])]


@dataclass(frozen=True, slots=True, kw_only=True)
class ParameterSweep:
    """What a sweep over parameters has found.

    Args:
        points: where it was run.
        columns: per point that was done, column to one entry per seed: ``seed``, ``stopped`` and every quantity.
        quantities: what every point measures.
        interrupted: 130 if Ctrl-C came (143 if SIGTERM did), else 0; then the last points are missing.
        alone: which measures kept the runs from being computed at once, nothing where none did.
    """

    points: Points
    columns: tuple[Mapping[str, NDArray[np.float64]], ...]
    quantities: tuple[Quantity, ...]
    interrupted: int = 0
    alone: str = ""


def grid(asked: Sequence[str]) -> Points:
    """Return all combinations of the values of several keys, the last key changing first.

    Args:
        asked: ``key=a,b,c`` each; commas within brackets, braces and quotes belong to a value.

    Raises:
        HilError: for another form, a key that is named twice, or too many points.

    >>> grid(["period=10 ms,20 ms", "plant.gain=150,170"]).values
    (('10 ms', '150'), ('10 ms', '170'), ('20 ms', '150'), ('20 ms', '170'))
    """
    keys, axes = [], []
    for text in asked:
        key, equal, listed = text.partition("=")
        values = split_values(listed)
        if not equal or not key.strip() or not all(values):
            raise HilError(f"--grid {text!r:.60}: expected key=a,b,c, such as period=10ms,25ms")
        if key.strip() in keys:
            raise HilError(f"--grid {key.strip()}: named twice")
        keys.append(key.strip())
        axes.append(tuple(map(with_space, values)))
    count = int(np.prod([len(axis) for axis in axes], dtype=np.float64))
    if count > MOST_POINTS:
        raise HilError(f"--grid: {count} points; at most {MOST_POINTS}")
    return Points(keys=tuple(keys), values=tuple(itertools.product(*axes)), axes=tuple(axes))


def latin_hypercube(asked: Sequence[str], count: int, seed: int = 0) -> Points:
    """Return points that fill a box evenly: every key takes one value in each of ``count`` equal parts of its range.

    Args:
        asked: ``key=low:high`` each, with one unit for both where there is one: ``period=10ms:50ms``.
        count: number of points.
        seed: of the points, not of the runs.

    Raises:
        HilError: for another form, a key that is named twice, or too many points.

    Reference: M. McKay, R. Beckman, W. Conover, Technometrics 21 (1979) 239-245.
    """
    from scipy.stats import qmc

    if not 1 <= count <= MOST_POINTS:
        raise HilError(f"--points: {count}; expected 1 to {MOST_POINTS}")
    keys, lows, highs, units = [], [], [], []
    for text in asked:
        key, _, span = text.partition("=")
        ends = [with_space(end).partition(" ") for end in span.split(":")]
        try:
            low, high = (float(number) for number, _, _ in ends)
        except ValueError:
            raise HilError(f"--range {text!r:.60}: expected key=low:high, such as plant.gain=100:200") from None
        unit = ends[1][2]
        if not (np.isfinite((low, high)).all() and low < high) or ends[0][2] not in ("", unit):
            raise HilError(f"--range {text!r:.60}: expected two finite numbers, the lower first, in one unit")
        if key.strip() in keys or not key.strip():
            raise HilError(f"--range {text!r:.60}: the key is missing or repeated")
        keys.append(key.strip())
        lows.append(low)
        highs.append(high)
        units.append(unit)
    drawn = qmc.scale(qmc.LatinHypercube(d=len(keys), rng=np.random.default_rng(seed)).random(count), lows, highs)
    rows = [tuple(f"{value:.6g}{f' {unit}' if unit else ''}" for value, unit in zip(row, units)) for row in drawn.tolist()]
    return Points(keys=tuple(keys), values=tuple(rows))


def split_values(text: str) -> list[str]:
    """Return the values of a list without brackets.

    >>> split_values("1, [2, 3],'a,b'")
    ['1', '[2, 3]', "'a,b'"]
    """
    found, depth, quote, start = [], 0, "", 0
    for i, c in enumerate(text):
        if quote:
            quote = "" if c == quote else quote
        elif c in "\"'":
            quote = c
        elif c in "[{":
            depth += 1
        elif c in "]}":
            depth -= 1
        elif c == "," and depth == 0:
            found.append(text[start:i].strip())
            start = i + 1
    return [*found, text[start:].strip()]


def with_space(text: str) -> str:
    """Return a number that stands against its unit with a space between them; anything else as it is.

    >>> with_space("10ms"), with_space("1e-3"), with_space("markov")
    ('10 ms', '1e-3', 'markov')
    """
    stripped = text.strip()
    number = stripped.rstrip("abcdefghijklmnopqrstuvwxyz").rstrip()
    unit = stripped[len(number) :].strip()
    try:
        float(number)
    except ValueError:
        return stripped
    return f"{number} {unit}" if unit else number


def load_points(source: str | Path, points: Points, sets: Sequence[str] = ()) -> list[Experiment]:
    """Return the experiment at every point, all checked before anything runs.

    Raises:
        HilError: if a point is no valid experiment; the message names its changes.
    """
    found = []
    for number in range(len(points.values)):
        try:
            found.append(load_experiment(source, [*sets, *points.changes(number)]))
        except HilError as error:
            raise HilError(f"{', '.join(points.changes(number))}: {error}") from error
    return found


def sweep_parameters(
    source: str | Path,
    points: Points,
    *,
    sets: Sequence[str] = (),
    runs: int,
    first_seed: int = 0,
    workers: Workers,
    folder: Path | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> ParameterSweep:
    """Run an experiment at every point for the same seeds, so that points with the same network laws meet the same delays.

    Args:
        source: shipped name or TOML file.
        points: where.
        sets: changes of all points, made first.
        runs: at each point; seeds ``first_seed``, ``first_seed + 1``, ...
        first_seed: the first of them.
        workers: where the runs are computed.
        folder: finished runs are kept in here, a file per point, and taken from there instead of being run again.
        progress: told how many runs of all have been done.

    Raises:
        HilError: if a point is no valid experiment or cannot be composed, or the folder holds something else.
    """
    experiments = load_points(source, points, sets)
    quantities = common_quantities([quantities_in(e) for e in experiments])
    done: list[Mapping[str, NDArray[np.float64]]] = []
    if folder is not None:
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise HilError(f"--resume: {folder}: {error.strerror}") from error
    alone = ""
    for number, experiment in enumerate(experiments):
        before = number * runs
        name = sha256("\n".join(points.changes(number)).encode()).hexdigest()[:16]
        store = SweepStore(folder / f"{name}.jsonl", experiment, columns_of(experiment)) if folder is not None else None
        try:
            found = run_sweep(
                experiment,
                range(first_seed, first_seed + runs),
                workers=workers,
                progress=lambda n, before=before: progress(before + n),  # type: ignore[misc]
                store=store,
            )
        except HilError as error:
            raise HilError(f"{', '.join(points.changes(number))}: {error}") from error
        finally:
            if store is not None:
                store.close()
        if found.interrupted:
            return ParameterSweep(points=points, columns=tuple(done), quantities=quantities, interrupted=found.interrupted)
        done.append(found.values)
        alone = alone or found.alone
    return ParameterSweep(points=points, columns=tuple(done), quantities=quantities, alone=alone)
