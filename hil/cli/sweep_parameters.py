"""What ``hil sweep --grid`` and ``--range`` do: many points, the same seeds at each."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.cli.page_text import print_table
from hil.cli.terminal import Working, answer, print_folded, print_written, visible
from hil.errors import HilError

if TYPE_CHECKING:
    from design.monte_carlo import Workers
    from hil.sweeps.parameters import ParameterSweep
    from hil.sweeps.points import Points


def run_points(
    experiment: str,
    points: Points,
    *,
    sets: Sequence[str],
    seeds: range,
    workers: Workers,
    resume: Path | None,
    page: Path | None,
    table: Path | None,
    force: bool,
) -> None:
    """Run an experiment at many points; print a table, and write a page and a CSV file where asked to.

    Args:
        experiment: shipped name or TOML file.
        points: where.
        sets: changes of all points.
        seeds: of each point, a run each.
        workers: where the runs are computed.
        resume: folder of finished runs.
        page: HTML page to write.
        table: CSV file to write, a row per run.
        force: replace a table that is there.

    Raises:
        HilError: if a point is no valid experiment, or a file cannot be written.
    """
    from hil.experiment import load_experiment
    from hil.files import check_output, check_page, write_output
    from hil.pages.many_runs import parameter_page
    from hil.sweeps.parameters import load_points, sweep_parameters
    from hil.sweeps.shown import as_plain, interval_of

    if page is not None:
        check_page(page, force=force)
    if table is not None:
        check_output(table, force=force)
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
    answer(out, _show, out, found, page, table)
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


def _show(out: dict[str, Any], sweep: ParameterSweep, page: Path | None, table: Path | None) -> None:
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
