"""What a program or a notebook calls: the functions behind ``import hil``, each a few lines over the rooms."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.api.experiment_source import Source, checked_experiment, object_of
from hil.compose.loop import Loop, compose
from hil.design_questions.design_problem import problem_for, tracking_target
from hil.errors import HilError
from hil.files.outputs import check_output, write_output
from hil.log.read.run import read_run
from hil.log.run import Run
from hil.measure.view import view_of
from hil.replay.replay import Verdict as LogVerdict
from hil.replay.replay import experiment_of
from hil.replay.replay import verify as verify_run
from hil.session import ClockName, Session, run_session
from hil.session import simulate as simulate_loop
from hil.sweeps.comparison import Comparison
from hil.sweeps.comparison import compare as compare_experiments
from hil.sweeps.seeds import Sweep, here, run_sweep

if TYPE_CHECKING:
    from design.tracking.synthesis import Design


def verify(
    log: str | Path, *, plant: object = None, controller: object = None, laws: Mapping[str, object] | None = None,
    folder: str | Path | None = None,
) -> LogVerdict:  # fmt: skip
    """Run controller and plant of a log again on what was recorded; compare every record, bit for bit.

    Args:
        log: the file.
        plant, controller: what ran, where it was built in Python.
        laws: network laws that were built in Python, by their paths, such as ``{"links.sc.law": Mine()}``.
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
    checked = checked_experiment(source, seed, duration, changes)
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
    return replace(session, log=lambda: run, summary=summary)


def report(
    source: Session | str | Path,
    *,
    output: str | Path | None = None,
    force: bool = False,
    figures: str | Path | None = None,
    folder: str | Path | None = None,
) -> tuple[Path, ...]:
    """Make one self-contained HTML page of a run: its sections, and those that the experiment's plug-ins draw.

    Args:
        source: a session, or the file of a log.
        output: the page, a file; beside the log by default, with the ending ``.html``.
        force: replace a page that is there already.
        figures: a folder in which every plot is written as SVG and PDF too.
        folder: where the files of own modules stand that the log names; without it none of them is run, and they draw nothing.

    Returns:
        the files that were written, the page first.

    Raises:
        HilError: the log cannot be read, or the page or the figures cannot be written.
    """
    from hil.pages.paper import write_figures
    from hil.pages.run.run_page import render_report
    from hil.pages.run.sections import sections_of

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
    check_output(target, page=True, fresh=not force, remedy="choose another -o (in Python output=..., or force=True)")
    write_output(target, render_report(view))
    return (target, *([] if figures is None else write_figures(view.once(sections_of), Path(figures))))


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
    return run_sweep(checked_experiment(source, None, None, changes), range(first_seed, first_seed + runs), workers=here(jobs))


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
    checked = [checked_experiment(source, None, None, changes) for source in sources]
    named = {experiment.name: experiment for experiment in checked}
    if not named or len(named) < len(checked):
        raise HilError(f"compare: {len(checked)} experiments have {len(named)} names; expected one name each")
    if runs < 2:
        raise HilError(f"compare: {runs} runs of each; expected at least 2")
    return compare_experiments(named, runs, jobs=jobs)


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
