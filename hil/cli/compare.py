"""``hil compare``, ``hil problems``: several experiments under common random numbers; a controller on ten known loops."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import suppress
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hil.cli.completion import CHANGE, EXPERIMENT
from hil.cli.option_types import PATH
from hil.cli.page_text import print_table
from hil.cli.terminal import Working, answer, json_option, print_folded, print_written
from hil.errors import HilError, unknown_name

if TYPE_CHECKING:
    from hil.sweeps.comparison import Comparison
    from hil.sweeps.problems import Problem, Reached


@click.command()
@click.argument("experiments", type=EXPERIMENT, nargs=-1, required=True)
@click.option("--runs", type=click.IntRange(2), default=200, show_default=True, help="Runs of each; seeds 0, 1, ...")
@click.option("--duration", metavar="S", help="Length of a run: 10, 10s, 2min.")
@click.option("--set", "sets", type=CHANGE, multiple=True, metavar="PATH=VALUE", help="Change a field of all of them.")
@click.option("--jobs", type=int, default=-1, show_default=True, help="Processes; -1 for one per core.")
@click.option("-o", "--output", type=PATH, metavar="PAGE.html", help="Write a page with the distributions.")
@click.option("--force", is_flag=True, help="Replace a file that is there; a page always is.")
@json_option()
def compare(
    experiments: tuple[str, ...], runs: int, duration: str | None, sets: tuple[str, ...], jobs: int, output: Path | None,
    force: bool,
) -> None:  # fmt: skip
    """Run EXPERIMENTS for the same seeds; print and plot the distributions of their metrics.

    Streams of random numbers are named, so experiments with the same network laws meet the same delays.
    """
    from hil.experiment import load_experiment
    from hil.files import check_page, write_output
    from hil.pages.many_runs import compare_page
    from hil.sweeps import statistics
    from hil.sweeps.comparison import check_named, compare
    from hil.sweeps.seeds import refuse_seed
    from hil.sweeps.shown import as_plain

    refuse_seed(sets)
    if duration is not None:
        sets = (*sets, f"duration={duration}")
    check_page(output, force=force)  # now, and not after minutes of work
    check_named(experiments, f"hil sweep {experiments[0]}", "a copy of its file with changes is another experiment")
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
            "difference": {m: as_plain(comparison.difference(name, m)) for m in names},
        }
        for name, values in comparison.values.items()
    }
    said = {"runs": runs, "against": first, "experiments": out, "page": str(output) if output else None}
    answer(said, _show_comparison, comparison, output)


def _show_comparison(comparison: Comparison, output: Path | None) -> None:
    from hil.pages import Table
    from hil.sweeps.shown import SHORTER

    for name in list(comparison.values)[1:]:
        print_folded(comparison.verdict(name))
    for name, caution in comparison.cautions.items():
        print_folded(f"{name}: {caution}")
    rows: list[Sequence[Any]] = []
    for title, of in groupby(comparison.rows(), key=lambda row: row[0]):
        rows += [(title, "", "", "", ""), *((f"  {name}", *cells) for _, name, *cells in of)]
    heads = ("metric, experiment", "runs", "mean", "difference", "95 % interval")
    said = (comparison.measured()[1], SHORTER if comparison.stopped else "")
    note = "; ".join([f"differences are against {comparison.first}, run by run on the same delays", *filter(None, said)])
    print_table(Table(columns=heads, rows=rows, note=note), folds=True)
    print_written(output)


@click.command()
@click.option(
    "--controller", metavar="TABLE|FILE", help="Run this controller against all: \"kind = 'h2'\", or a file with [controller]."
)
@click.option("--only", "names", multiple=True, metavar="PROBLEM", help="Only this problem; repeatable.")
@click.option("--runs", type=click.IntRange(2, 100_000), default=200, show_default=True, help="Seeds 0, 1, ... of each problem.")
@json_option()
def problems(controller: str | None, names: tuple[str, ...], runs: int) -> None:
    """Show the problem set: of each problem the best controller that is known, its mean with a 95 % interval, and a lower bound.

    The objective is the sum of squared errors after one pulse, averaged over the seeds. Nothing is ranked.
    Exit status 1: the controller ran on none of the problems.
    """
    from msgspec import to_builtins

    from hil.sweeps.problems import best_known, problems, reached

    chosen = [problem for problem in problems() if not names or problem.name in names]
    for name in {*names} - {problem.name for problem in chosen}:
        raise unknown_name("problem", name, [problem.name for problem in problems()])
    known = best_known()
    found: dict[str, Reached] = {}
    if controller is not None:
        table = _table(controller)
        with suppress(HilError):  # what does not fit is said below; own modules are watched from a fork, which has one thread
            chosen[0].load(table)
        with Working("problems", len(chosen)) as watch:
            for i, problem in enumerate(chosen):
                watch.counted(i, what=problem.name)
                found[problem.name] = reached(problem, table, runs)
    said = {p.name: {"source": p.source, "experiment": p.experiment, "best_known": known.get(p.name)} for p in chosen}
    yours = {name: {"yours": to_builtins(each)} for name, each in found.items()}
    answer({name: entry | yours.get(name, {}) for name, entry in said.items()}, _show, chosen, known, found)
    if found and all(each.mean is None for each in found.values()):
        raise SystemExit(1)


def _table(said: str) -> str:
    """Return a controller's table as inline TOML.

    Raises:
        HilError: no table, or none with a kind.
    """
    from hil.files import read_regular
    from hil.files.toml_text import parse_toml, toml_value

    path = Path(said)
    try:
        if said.endswith(".toml"):
            made = parse_toml(read_regular(path, 1_000_000, "a file with a controller").decode())
            made = made.get("controller", made)
        else:
            made = parse_toml(f"v = {said}" if said.lstrip().startswith("{") else said)
            made = made.get("v", made)
    except ValueError as error:
        raise HilError(
            f"--controller: {said[:80]!r}: not valid TOML: {error}; expected such as \"kind = 'h2'\", or a file.toml"
        ) from error
    if not isinstance(made, dict) or not isinstance(made.get("kind"), str):
        raise HilError(f"--controller: {said[:80]!r}: kind: missing; expected the table of a controller, such as \"kind = 'h2'\"")
    return toml_value(made)


def _mean(mean: float | None, low: float | None, high: float | None) -> tuple[str, str]:
    interval = "-" if low is None or high is None else f"{low:.5g} to {high:.5g}"
    return "-" if mean is None else f"{mean:.5g}", interval


def _show(chosen: list[Problem], known: dict[str, dict[str, Any]], reached: dict[str, Reached]) -> None:
    from hil.pages import Table
    from hil.sweeps.problems import OBJECTIVE
    from hil.sweeps.seeds import quantities_in

    rows: list[Sequence[str]] = []
    for problem in chosen:
        best, own = known.get(problem.name, {}), reached.get(problem.name)
        unit = next(quantity.unit for quantity in quantities_in(problem.load()) if quantity.name == OBJECTIVE)
        rows.append([f"{problem.name} ({unit})", "", ""])
        rows.append(["  best known", *_mean(best.get("mean"), best.get("low"), best.get("high"))])
        if own is not None:
            rows.append([f"  yours{own.verdict and f', {own.verdict}'}", *_mean(own.mean, own.low, own.high)])
        if best.get("lower_bound") is not None:
            rows.append(["  lower bound", f"{best['lower_bound']:.4g}", ""])
    print_table(Table(columns=("problem", "mean", "95 % interval"), rows=rows), folds=True)
    for problem in chosen:
        by = known.get(problem.name, {}).get("controller", "none").replace(",", ", ")  # a long one folds
        said = reached[problem.name].said if problem.name in reached else f"{problem.source}; best known with controller = {by}"
        if said:
            print_folded(f"{problem.name}: {said}")
