"""What a program or a notebook calls: the functions behind ``import hil``, each a few lines over the rooms."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, overload

import numpy as np
from msgspec import structs

from hil.api.experiment_source import (
    Source,
    as_change,
    checked_arguments,
    checked_experiment,
    load_experiment,
    object_of,
    waited,
)  # fmt: skip
from hil.compose import compose
from hil.errors import HilError, unknown_name
from hil.experiment import Experiment
from hil.files import check_output, check_page, write_output
from hil.log.read import read_run
from hil.log.records import EVENTS_TOPIC
from hil.log.run import Run
from hil.log.topics import channels_of
from hil.measure.view import view_of
from hil.rig.loop import Loop
from hil.runtime.virtual import simulate as simulate_loop
from hil.session import ClockName, Session, run_session
from hil.session.replay.replay import Verdict as LogVerdict
from hil.session.replay.replay import experiment_of
from hil.session.replay.replay import verify as verify_run
from hil.sweeps import Sweep
from hil.sweeps.comparison import Comparison, check_named
from hil.sweeps.comparison import compare as compare_experiments
from hil.sweeps.parameters import ParameterSweep, load_points, sweep_parameters
from hil.sweeps.points import Points, grid_of, latin_hypercube
from hil.sweeps.seeds import here, refuse_seed, run_sweep, seeds_of


@checked_arguments
def verify(
    log: str | Path, *, plant: object = None, controller: object = None, laws: Mapping[str, object] | None = None,
    folder: str | Path | None = None,
) -> LogVerdict:  # fmt: skip
    """Run controller and plant of a log again on what was recorded; compare every record, bit for bit.

    Args:
        log: the file.
        plant, controller: what ran, where it was built in Python.
        laws: network laws that were built in Python, by their paths, such as ``{"network.sc.law": Mine()}``.
        folder: where the file of an own module or an FMU stands, which the log names and does not hold.

    Returns:
        ``difference``: the first sample that differs, None if all are identical; ``answers`` and ``states`` were compared.

    Raises:
        HilError: what ran cannot be made again, with what it takes.
    """
    run = read_run(Path(log))
    where = None if folder is None else str(folder)
    given = {"plant": plant, "controller": controller}
    made = {name: None if value is None else object_of(name, value) for name, value in given.items()}
    return verify_run(run, str(log), experiment_of(run, str(log), folder=where, laws=laws, **made))


@checked_arguments
def run(
    source: Source,
    *,
    seed: int | None = None,
    duration: str | float | None = None,
    clock: ClockName = "virtual",
    link: str | None = None,
    log: str | Path | None = None,
    force: bool = False,
    signals: str | None = None,
    external: bool = False,
    wait: float | None = None,
    **changes: Any,
) -> Session:
    """Run an experiment and measure it.

    Args:
        source: name of a shipped experiment, path of a TOML file, or what `load_experiment` returned.
        seed, duration: as in `load_experiment`.
        clock: "virtual" (one process, reproducible) or "real" (separate processes over ``link``).
        link: URI of the real link; the experiment's own by default.
        log: where to keep the log, a new file; without it none is kept.
        force: replace a log that is there already.
        signals: where subscribers over zenoh read named signals while it runs, such as "zenoh:tcp/127.0.0.1:7448".
        external: an external controller answers on the link.
        wait: how long the rig waits for it, s; 120 by default.
        changes: path to value, as ``**{"plant.gain": 150}``; `load_experiment` says which take objects, as ``plant=Cart()``. Of
            a loaded experiment plant and controller alone.

    Returns:
        the session: ``metrics``, ``arrays``, ``summary``, ``status``.

    Raises:
        HilError: if the experiment cannot be run, or the log exists already.
    """
    checked = checked_experiment(source, seed, duration, changes)
    if clock == "virtual" and (link is not None or external):
        raise HilError("link and external need clock='real': virtual time runs in one process, without a link")
    how: dict[str, Any] = {"clock": clock, "link": link, "signals": signals}
    how |= {"external": external, "wait_s": waited(wait, external)}
    if log is not None:
        path = Path(log)
        check_output(path, "a log", ".mcap", force=force, remedy="choose another log=..., or add force=True")
        return run_session(checked, path=path, replace=force, **how)
    with tempfile.TemporaryDirectory(prefix="hilrig-") as folder:
        path = Path(folder) / "run.mcap"
        session = run_session(checked, path=path, **how)
        run = session.run  # before its file is gone
    return structs.replace(session, log=run, summary=session.summary | {"log": session.summary["log"] | {"path": None}})


@checked_arguments
def report(
    source: Session | Comparison | Sweep | ParameterSweep | str | Path,
    *,
    output: str | Path | None = None,
    force: bool = False,
    figures: str | Path | None = None,
    folder: str | Path | None = None,
) -> tuple[Path, ...]:
    """Make one self-contained HTML page of a run: its sections, and those that the experiment's plug-ins draw.

    Args:
        source: a session, or the file of a log; a comparison or a sweep, whose page needs ``output``; a folder of logs, whose
            page lists them all, or those of the folders below it where it has none, and each has a page of its own.
        output: the page, a file; beside the log by default, with the ending ``.html``, and ``index.html`` for a folder.
        force: replace a file that is there already and is no page; a page always is replaced.
        figures: a folder in which every plot is written as SVG and PDF too.
        folder: where the files of own modules stand that the log names; without it none of them is run, and they draw nothing.

    Returns:
        the files that were written, the page first.

    Raises:
        HilError: the log cannot be read, or the page or the figures cannot be written.
    """
    from hil.pages.many_runs import compare_page, parameter_page, sweep_page
    from hil.pages.paper import write_figures
    from hil.pages.run_page import render_report, report_runs
    from hil.pages.sections import sections_of

    many = isinstance(source, Comparison | Sweep | ParameterSweep)
    in_folder = isinstance(source, str | Path) and Path(source).is_dir()
    for name, value in (("figures", figures), ("folder", folder)):
        if value is not None and (many or in_folder):
            what = "many runs" if many else "a folder"
            raise HilError(f"report: {name}: belongs to the page of a run, {what} has output='page.html' alone")
    if isinstance(source, Comparison | Sweep | ParameterSweep):
        if output is None:
            raise HilError("report: many runs keep no log to write the page beside; expected output='page.html' alone")
        target = Path(output)
        check_page(target, force=force, remedy="choose another output=..., or add force=True")
        if isinstance(source, Sweep):
            page = sweep_page(source)
        else:
            page = compare_page(source) if isinstance(source, Comparison) else parameter_page(source)
        write_output(target, page)
        return (target,)
    if isinstance(source, str | Path) and in_folder:
        return report_runs(Path(source), None if output is None else Path(output), force=force)
    log = source.summary["log"]["path"] if isinstance(source, Session) else source
    if log is None and output is None:
        raise HilError("report: this session kept no log to write the page beside; expected output='page.html'")
    if isinstance(source, Session):
        view = view_of(source.run, source.experiment)
    else:
        run = read_run(Path(source))
        view = view_of(run, None if folder is None else experiment_of(run, str(source), folder=str(folder)))
    target = Path(output) if output is not None else Path(log).with_suffix(".html")
    if log is not None and target.resolve() == Path(log).resolve():
        raise HilError(f"{target} is the log itself; choose another -o (in Python output=...)")
    check_page(target, force=force, remedy="choose another -o (in Python output=...), or add --force (force=True)")
    drawn = [] if figures is None else write_figures(view.once(sections_of), Path(figures))
    write_output(target, render_report(view))
    return (target, *drawn)


@checked_arguments
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
    checked = checked_experiment(source, seed, duration, changes)
    loop = compose(checked)
    unknown = sorted({*map(str, topics or ())} - {*channels_of(loop), EVENTS_TOPIC})
    if unknown:
        raise unknown_name("topic", unknown[0], channels_of(loop))
    return simulate_loop(loop, checked.seed, topics)


@overload
def sweep(
    source: Source, *, grid: None = None, range: None = None, points: None = None, runs: int = 100, first_seed: int = 0,
    jobs: int = -1, **changes: Any,
) -> Sweep: ...
@overload
def sweep(source: Source, *, grid: Mapping[str, Sequence[Any]], **options: Any) -> ParameterSweep: ...
@overload
def sweep(source: Source, *, range: Mapping[str, Sequence[Any]], points: int, **options: Any) -> ParameterSweep: ...
@checked_arguments
def sweep(
    source: Source,
    *,
    runs: int = 100,
    first_seed: int = 0,
    jobs: int = -1,
    grid: Mapping[str, Sequence[Any]] | None = None,
    range: Mapping[str, Sequence[Any]] | None = None,
    points: int | None = None,
    **changes: Any,
) -> Sweep | ParameterSweep:
    """Run an experiment for many seeds in virtual time, at one point or, with ``grid`` or ``range``, at many.

    Args:
        source: as in `run`.
        runs: how many at each point; seeds ``first_seed``, ``first_seed + 1``, ..., the same at every point.
        first_seed: the first of them.
        jobs: processes on this machine, -1 for one per core.
        grid: path to values; all combinations are run: ``{"plant.gain": [150, 170], "period": ["25 ms", "50 ms"]}``.
        range: path to lowest and highest value: ``{"plant.gain": (100, 200)}``, with ``points``.
        points: so many points of a Latin hypercube over ``range``.
        changes: path to value, as in `load_experiment`.

    Returns:
        one point: a `Sweep` with ``values``, column to array, one entry per seed (``seed``, ``stopped`` and every number of the
        measures). Many: a `ParameterSweep` with ``points`` and ``columns``, the same per point. Both have ``to_pandas()`` and
        ``plot()``, and show themselves in a notebook.

    Raises:
        HilError: if the experiment cannot be run, or the points are none.
    """
    seeds = seeds_of(runs, first_seed)
    refuse_seed([*changes, *(grid or ()), *(range or ())])
    if grid is None and range is None and points is None:
        return run_sweep(checked_experiment(source, None, None, changes), seeds, workers=here(jobs))
    where = _points(grid, range, points)
    if isinstance(source, Experiment):
        raise HilError("sweep: grid and range change the file of an experiment; give its name or path, not a loaded one")
    experiments = load_points(lambda sets: load_experiment(source, sets, **changes), where)
    return sweep_parameters(experiments, where, seeds=seeds, workers=here(jobs))


def _points(axes: Mapping[str, Sequence[Any]] | None, ranges: Mapping[str, Sequence[Any]] | None, count: int | None) -> Points:
    """Return the points of a grid or of ranges.

    Raises:
        HilError: both, none, a number of points without ranges, or values that are no list.
    """
    if (axes is None) == (ranges is None):
        raise HilError("sweep: expected grid={...}, or range={...} with points=N, one of them")
    if (ranges is None) != (count is None):
        raise HilError("sweep: range={...} and points=N belong together: N points of a Latin hypercube over the ranges")
    said: dict[str, list[str]] = {}
    for path, values in (axes or ranges or {}).items():
        if isinstance(values, str) or not isinstance(values, Sequence | np.ndarray) or not len(values):
            raise HilError(f"sweep: {path}: {values!r:.40}; expected a list of values, such as [150, 170]")
        if ranges is not None and len(values) != 2:
            raise HilError(f"sweep: range: {path}: {len(values)} values; expected the lowest and the highest, such as (100, 200)")
        said[path] = [as_change(value, path) for value in values]
    if not said:
        raise HilError("sweep: no parameter is named; expected a path and its values, such as {'plant.gain': [150, 170]}")
    if ranges is None:
        return grid_of(said)
    return latin_hypercube([f"{path}={':'.join(ends)}" for path, ends in said.items()], count or 0)


@checked_arguments
def compare(*sources: Source, runs: int = 200, jobs: int = -1, **changes: Any) -> Comparison:
    """Run several experiments for the same seeds, so that those with the same network laws meet the same delays.

    Args:
        sources: as in `run`; differences are against the first.
        runs: of each; seeds 0, 1, ...
        jobs: processes on this machine, -1 for one per core.
        changes: path to value, for all of them.

    Raises:
        HilError: if an experiment cannot be run, two have one name, or there are fewer than two.
    """
    refuse_seed(changes)
    checked = [checked_experiment(source, None, None, changes) for source in sources]
    check_named([each.name for each in checked], "hil.sweep", "hil.load_experiment(..., name=...) renames one")
    return compare_experiments({each.name: each for each in checked}, runs, jobs=jobs)
