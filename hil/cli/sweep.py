"""``hil sweep``: one experiment, many seeds, all cores or many machines, no log files."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hil.cli.completion import CHANGE, EXPERIMENT
from hil.cli.option_types import PATH
from hil.cli.page_text import print_table
from hil.cli.terminal import Working, answer, json_option, print_folded, print_written, visible
from hil.errors import HilError, located, nearest

if TYPE_CHECKING:
    from design.monte_carlo import Workers
    from design.monte_carlo.confidence import StopRule
    from hil.sweeps import Sweep
    from hil.sweeps.parameters import ParameterSweep
    from hil.sweeps.points import Points


@click.command()
@click.argument("experiment", type=EXPERIMENT)
@click.option("--runs", type=click.IntRange(1), default=100, show_default=True, help="Runs (--until: at most) of seeds 0, 1, ...")
@click.option("--first-seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of the first run.")
@click.option("--duration", metavar="S", help="Length of a run: 10, 10s, 2min.")
@click.option("--grid", "grids", type=CHANGE, multiple=True, metavar="KEY=A,B,...", help="Run at all combinations of them.")
@click.option("--range", "ranges", type=CHANGE, multiple=True, metavar="KEY=LOW:HIGH", help="With --points: over these ranges.")
@click.option("--points", type=int, metavar="N", help="Number of points of a Latin hypercube over the ranges.")
@click.option("-o", "--output", type=PATH, metavar="PAGE.html", help="Write a page with the distributions.")
@click.option("--csv", "table", type=PATH, metavar="FILE.csv", help="Write a row per run.")
@click.option("--force", is_flag=True, help="Replace a file that is there; a page always is.")
@click.option(
    "--until", metavar="METRIC=HALFWIDTH", help="Stop when the interval of this metric's mean (sd:METRIC: deviation) is narrow."
)
@click.option("--level", type=float, help="Confidence of that interval at the stop [0.95].")
@click.option("--resume", type=PATH, help="Keep finished runs in this file, go on from it.")
@click.option("--metric", "own", multiple=True, metavar="MODULE:FUNCTION", help="A number of your own: a function of a RunView.")
@click.option("--backend", type=click.Choice(["loky", "dask"]), default="loky", show_default=True,
              help="loky: processes of this machine; dask: the workers of --scheduler.")  # fmt: skip
@click.option("--scheduler", metavar="ADDRESS", help="The dask scheduler, e.g. tcp://10.0.0.1:8786.")
@click.option("--jobs", type=int, default=-1, show_default=True, help="Processes; -1 for one per core.")
@click.option("--set", "sets", type=CHANGE, multiple=True, metavar="PATH=VALUE", help="Change a field.")
@json_option()
def command(
    experiment: str,
    runs: int,
    first_seed: int,
    duration: str | None,
    grids: tuple[str, ...],
    ranges: tuple[str, ...],
    points: int | None,
    output: Path | None,
    table: Path | None,
    force: bool,
    until: str | None,
    level: float | None,
    resume: Path | None,
    own: tuple[str, ...],
    backend: str,
    scheduler: str | None,
    jobs: int,
    sets: tuple[str, ...],
) -> None:
    """Run EXPERIMENT in virtual time for many seeds; print mean, spread and percentiles of its metrics.

    With --grid, or --range and --points, it runs at many points with the same seeds at each (--resume is a folder then):
    hil sweep dc-motor-hinf --grid period=10ms,25ms --grid plant.gain=150,170 --runs 50 -o page.html --csv runs.csv

    The numbers do not depend on the number of processes and machines. Ctrl-C prints what was done so far and exits with
    130 (SIGTERM: 143); with --resume the same command goes on from there. If --runs did not suffice for --until, the status is 1.
    """

    from design.monte_carlo import Workers
    from hil.compose import compose
    from hil.experiment import load_experiment
    from hil.files import check_output, check_page, write_output
    from hil.sweeps import SweepStore, statistics
    from hil.sweeps.seeds import columns_of, here, refuse_seed, run_sweep, seeds_of

    seeds = seeds_of(runs, first_seed)
    refuse_seed((*sets, *grids, *ranges))
    if level is not None and until is None:
        raise HilError("--level: only with --until; it is the confidence of that interval")
    if duration is not None:
        sets = (*sets, f"duration={duration}")
    if (scheduler is None) == (backend == "dask"):
        raise HilError("--scheduler: --backend dask needs the address of its scheduler; no other backend takes one")
    workers = Workers(backend="dask", scheduler=scheduler) if backend == "dask" else here(jobs)
    if own:
        sets = (*sets, measures_with(experiment, sets, own))
    check_page(output, force=force)
    check_output(table, "a table", ".csv", force=force)  # now, and not after the work
    if grids or ranges or points is not None:
        if until is not None:
            raise HilError("--until: not with --grid or --range, where every point has the same runs")
        run_points(
            experiment, points_of(grids, ranges, points), sets=sets, seeds=seeds, resume=resume, workers=workers, page=output,
            table=table, force=force,
        )  # fmt: skip
        return
    checked = load_experiment(experiment, sets)
    columns = columns_of(checked)
    metrics = columns[1:]
    rule = stop_rule(until, 0.95 if level is None else level, metrics) if until is not None else None
    begun = time.perf_counter()
    with ExitStack() as stack:
        watch = stack.enter_context(Working(checked.name, runs))
        loop = compose(checked)
        store = stack.enter_context(SweepStore(resume, checked, columns, loop)) if resume is not None else None
        found = run_sweep(checked, seeds, workers=workers, progress=watch.counted, store=store, until=rule, loop=loop)
    values = found.values
    if found.alone:
        print(f"hil: {found.alone}", file=sys.stderr)
    out: dict[str, Any] = {
        "experiment": checked.name,
        "runs": int(values["seed"].size),
        "requested": runs,
        "first_seed": first_seed,
        "wall_s": round(time.perf_counter() - begun, 3),
        "stopped_by_safety": int(values["stopped"].sum()),
        "metrics": {name: statistics(values[name]) for name in metrics},
        "caution": found.caution or None,
    }
    if rule is not None:
        seen = found.interval
        out["until"] = {
            "metric": rule[0],
            "statistic": rule[1].statistic,
            "half_width": rule[1].half_width,
            "level": rule[1].level,
            "reached": found.reached,
            "interval": None if seen is None or not seen.bounded else seen._asdict(),
        }
    if table is not None:
        write_output(table, found.csv_text(), replace=force)
    if output is not None and out["runs"]:
        from hil.pages.many_runs import sweep_page

        write_output(output, sweep_page(found))
    written = (table, output if out["runs"] else None)
    answer(out, _show, out, found, written)
    end_interrupted(found.interrupted, resume, "FILE")
    if rule is not None and not found.reached:
        sys.exit(1)


def run_points(
    experiment: str, points: Points, *, sets: Sequence[str], seeds: range, workers: Workers, resume: Path | None,
    page: Path | None, table: Path | None, force: bool,
) -> None:  # fmt: skip
    """Run an experiment at many points; print a table, and write a page and a CSV file, a row per run, where asked to."""
    from hil.experiment import load_experiment
    from hil.files import write_output
    from hil.pages.many_runs import parameter_page
    from hil.sweeps.parameters import load_points, sweep_parameters
    from hil.sweeps.shown import as_plain, interval_of

    experiments = load_points(lambda changes: load_experiment(experiment, [*sets, *changes]), points)
    begun = time.perf_counter()
    with Working(f"{len(points.values)} points", len(seeds) * len(points.values)) as watch:
        found = sweep_parameters(experiments, points, seeds=seeds, workers=workers, folder=resume, progress=watch.counted)
    if found.alone:
        print(f"hil: {found.alone}", file=sys.stderr)
    if table is not None:
        write_output(table, found.csv_text(), replace=force)
    if page is not None and found.columns:
        write_output(page, parameter_page(found))
    out: dict[str, Any] = {
        "experiment": experiment,
        "runs": len(seeds),
        "wall_s": round(time.perf_counter() - begun, 3),
        "points": [
            {
                "changes": dict(zip(points.keys, points.values[number])),
                "stopped_by_safety": int(columns["stopped"].sum()),
                "caution": found.cautions.get(number),
                "metrics": {q.name: as_plain(interval_of(columns[q.name])) for q in found.quantities},
            }
            for number, columns in enumerate(found.columns)
        ],
    }
    answer(out, _show_points, out, found, page, table)
    end_interrupted(found.interrupted, resume, "FOLDER")


def end_interrupted(status: int, resume: Path | None, kept: str) -> None:
    """End with a status that is not 0, and say how the same command goes on.

    Args:
        status: of Ctrl-C or of another signal; 0: none came.
        resume: what keeps finished runs.
        kept: what `--resume` takes.
    """
    if status:
        how = f"the same command goes on from {resume}" if resume is not None else f"--resume {kept} would keep what is finished"
        print(f"hil: interrupted; {how}", file=sys.stderr)
        sys.exit(status)


def _show_points(out: dict[str, Any], sweep: ParameterSweep, page: Path | None, table: Path | None) -> None:
    from hil.measure.signals import with_unit
    from hil.pages import Table
    from hil.sweeps.shown import measured

    print(f"{visible(out['experiment'])}: {out['runs']} runs at each of {len(out['points'])} points in {out['wall_s']} s")
    for quantity in measured(sweep.quantities, sweep.columns)[0]:
        heads = (*sweep.points.keys, "runs", "mean", "95 % interval")
        rows = [row[: len(heads)] for row in sweep.table(quantity)[1]]
        print_table(Table(title=with_unit(quantity.title, quantity.unit), columns=heads, rows=rows))
    for said in (*(sweep.answer(q.name) for q in sweep.judged()[:1]), *sweep.said()):
        print_folded(said)
    print_written(page, table)


def points_of(grids: Sequence[str], ranges: Sequence[str], count: int | None) -> Points:
    """Return the points that the options ask for.

    Raises:
        HilError: for both kinds at once, a number of points without a range, or the reverse.
    """
    from hil.sweeps.points import grid, latin_hypercube

    if grids and ranges:
        raise HilError("--grid and --range: one or the other; a grid takes all combinations, ranges a Latin hypercube")
    if bool(ranges) != (count is not None):
        raise HilError("--range and --points N belong together: N points of a Latin hypercube over the ranges")
    return grid(grids) if grids else latin_hypercube(ranges, count or 0)


def measures_with(experiment: str, sets: tuple[str, ...], own: tuple[str, ...]) -> str:
    """Return the change that adds functions of the user's own to what an experiment is judged by.

    Raises:
        HilError: one that is no ``module:function``.
    """
    from hil.experiment import load_experiment
    from hil.plugins import is_own

    for name in own:
        if not is_own(name):
            raise HilError(f"--metric {name!r:.60}: expected module:function, such as my_module:peak of my_module.py")
    measures = [*load_experiment(experiment, sets).report.measures, *own]
    return f"report.measures={json.dumps(measures)}"


def stop_rule(text: str, level: float, metrics: tuple[str, ...]) -> tuple[str, StopRule]:
    """The metric and the rule that ``METRIC=HALFWIDTH`` or ``sd:METRIC=HALFWIDTH`` asks for.

    Raises:
        HilError: if it is not of this form.
    """
    from design.monte_carlo.confidence import StopRule

    name, equals, width = text.partition("=")
    if not equals:
        raise HilError(f"--until {text!r}: expected METRIC=HALFWIDTH, such as {metrics[0]}=0.1")
    statistic, _, metric = name.rpartition(":")
    if metric not in metrics:
        raise HilError(f"--until: {metric!r} is not one of {', '.join(metrics)}{nearest(metric, metrics)}")
    try:
        number = float(width)
    except ValueError:
        raise HilError(f"--until: {width!r} is not a number; expected METRIC=HALFWIDTH") from None
    with located("--until", ValueError):
        return metric, StopRule(half_width=number, statistic=statistic or "mean", level=level)  # type: ignore[arg-type]


def _show(out: dict[str, Any], found: Sweep, written: Sequence[Path | None]) -> None:
    print(f"{visible(out['experiment'])}: {out['runs']} runs in {out['wall_s']} s, {out['stopped_by_safety']} stopped by safety")
    if out["runs"]:
        _show_metrics(out, found)
    else:
        print("no run ended, so there is nothing to show")
    print_written(*written)


def _show_metrics(out: dict[str, Any], found: Sweep) -> None:
    from hil.measure.signals import with_unit
    from hil.pages import Table
    from hil.sweeps import HEADS
    from hil.sweeps.shown import SHORTER, measured

    print_folded(found.caution)
    none = measured(found.quantities, [found.values])[1]
    note = "; ".join(filter(None, (none, SHORTER if out["stopped_by_safety"] else "")))
    rows = [[f"{cell:.4g}" if isinstance(cell, float) else cell for cell in row] for row in found.rows() if row[1]]
    no_interval = [[*row[:3], *row[4:]] for row in (HEADS, *rows)]  # for which a terminal has no room
    print_table(Table(columns=no_interval[0], rows=no_interval[1:], note=note), folds=True)
    wanted = out.get("until")
    if wanted and not wanted["interval"]:
        what = "mean" if wanted["statistic"] == "mean" else "deviation, whose sample is too small for its tails"
        what += " or has equal values" if wanted["statistic"] == "sd" else ": all values are equal"
        print(f"{wanted['statistic']} of {wanted['metric']}: no interval of the {what}")
    if wanted and wanted["interval"]:
        seen = wanted["interval"]
        title = next(with_unit(q.title, q.unit) for q in found.quantities if q.name == wanted["metric"])
        print_folded(
            f"{wanted['statistic']} of {title}: {seen['value']:.6g} in [{seen['low']:.6g}, {seen['high']:.6g}] "
            f"with {wanted['level']:.6g} confidence, whenever it stops"
            + (", if these runs show its tails" if wanted["statistic"] == "sd" else "")
            + f" ({seen['n']} runs"
            + (")" if seen["n"] == out["runs"] else f" of {out['runs']}: those that have it)")
            + ("" if wanted["reached"] else f"; {seen['n']} runs did not suffice for +-{wanted['half_width']:g}")
        )
