"""``hil compare``: several experiments under common random numbers."""

from __future__ import annotations

import sys
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hil.cli.completion import CHANGE, EXPERIMENT
from hil.cli.terminal import Working, json_option, print_folded, print_json, print_table, visible
from hil.errors import HilError

if TYPE_CHECKING:
    from design.monte_carlo.confidence import Interval


@click.command()
@click.argument("experiments", type=EXPERIMENT, nargs=-1, required=True)
@click.option("--runs", type=int, default=200, show_default=True, help="Runs of each; seeds 0, 1, ...")
@click.option("--duration", metavar="S", help="Length of a run: 10, 10s, 2min.")
@click.option("--set", "sets", type=CHANGE, multiple=True, metavar="PATH=VALUE", help="Change a field of all of them.")
@click.option("--jobs", type=int, default=-1, show_default=True, help="Processes; -1 for one per core.")
@click.option("-o", "--output", type=click.Path(path_type=Path), help="Write a page with the distributions.")
@click.option("--force", is_flag=True, help="Replace a file that is there; a page always is.")
@json_option()
def command(
    experiments: tuple[str, ...], runs: int, duration: str | None, sets: tuple[str, ...], jobs: int, output: Path | None,
    force: bool, as_json: bool,
) -> None:  # fmt: skip
    """Run EXPERIMENTS for the same seeds; print and plot the distributions of their metrics.

    Streams of random numbers are named, so experiments with the same network laws meet the same delays.
    """
    from hil.cli.sweep import check_jobs
    from hil.experiment import load_experiment
    from hil.files.outputs import check_page, write_output
    from hil.measure.signals import with_unit
    from hil.pages.html.figures import Table
    from hil.pages.many_runs import compare_page
    from hil.sweeps.comparison import compare
    from hil.sweeps.sweep import statistics

    if not 2 <= runs < 2**63:
        raise HilError(f"--runs: {runs} is {'below 2' if runs < 2 else 'not below 2^63'}")
    check_jobs(jobs)
    if duration is not None:
        sets = (*sets, f"duration={duration}")
    if output is not None:
        check_page(output, force=force)  # now, and not after minutes of work
    if len(set(experiments)) < len(experiments):
        raise HilError("the same experiment is named twice")
    checked = {name: load_experiment(name, list(sets)) for name in experiments}
    with Working("runs", runs) as watch:
        comparison = compare(checked, runs, jobs=jobs, progress=lambda name, done: watch.counted(done, what=name))
    if comparison.alone:
        print(f"hil: {comparison.alone}", file=sys.stderr)
    if comparison.interrupted:
        print("hil: interrupted", file=sys.stderr)
        sys.exit(comparison.interrupted)
    names = [quantity.name for quantity in comparison.quantities]
    if output is not None:
        write_output(output, compare_page(comparison))
    first = experiments[0]
    out: dict[str, Any] = {
        name: {
            "stopped_by_safety": int(values["stopped"].sum()),
            "metrics": {m: statistics(values[m]) for m in names},
            "verdict": comparison.verdict(name) if name != first else None,
            "caution": comparison.cautions.get(name),
            "difference": {m: _as_json(comparison.difference(name, m)) for m in names},
        }
        for name, values in comparison.values.items()
    }
    if as_json:
        print_json({"runs": runs, "against": first, "experiments": out, "page": str(output) if output else None})
        return
    for name in experiments[1:]:
        print_folded(comparison.verdict(name))
    for name, caution in comparison.cautions.items():
        print_folded(f"{name}: {caution}")
    rows: list[tuple[str, ...]] = []
    quantities, none = comparison.measured()
    for quantity in quantities:
        rows.append((with_unit(quantity.title, quantity.unit), "", "", "", ""))
        rows += [(f"  {name}", *_numbers(out[name], quantity.name, name == first)) for name in experiments]
    heads = ("metric, experiment", "n", "mean", "difference", "95 % interval")
    note = f"differences are against {first}, run by run on the same delays" + (none and f"; {none}")
    print_table(Table(columns=heads, rows=rows, note=note), folds=True)
    if output is not None:
        print(f"page: {visible(output)}")


def _numbers(found: dict[str, Any], metric: str, first: bool) -> tuple[str, ...]:
    """Return n, mean, difference and its interval of one metric of one experiment."""
    own, gap = found["metrics"][metric], found["difference"][metric]
    mean = "-" if own["mean"] is None else f"{own['mean']:.5g}"
    if first or gap["low"] is None:
        return str(own["n"]), mean, "", ""
    return str(own["n"]), mean, f"{gap['mean']:+.4g}", f"{gap['low']:+.4g} to {gap['high']:+.4g}"


def _as_json(gap: Interval) -> dict[str, float | None]:
    """Return n, mean, low and high; no numbers where there are fewer than two pairs."""
    known = isfinite(gap.half_width)
    return {"n": gap.n, "mean": gap.value, "low": gap.low, "high": gap.high} if known else {
        "n": gap.n, "mean": None, "low": None, "high": None
    }  # fmt: skip
