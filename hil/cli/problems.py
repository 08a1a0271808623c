"""``hil problems``: ten loops of networked control, what is known of each, and a controller against all of them."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hil.cli.terminal import json_option, print_json, print_table, visible
from hil.errors import HilError, nearest

if TYPE_CHECKING:
    from hil.sweeps.problems import Problem, Reached


@click.command()
@click.option(
    "--controller", metavar="TABLE|FILE", help="Run this controller against all: \"kind = 'h2'\", or a file with [controller]."
)
@click.option("--only", "names", multiple=True, metavar="PROBLEM", help="Only this problem; repeatable.")
@click.option("--runs", type=click.IntRange(2, 100_000), default=200, show_default=True, help="Seeds 0, 1, ... of each problem.")
@click.option("--write", is_flag=True, help="Run the controllers that were tried, and store the best of each problem.")
@json_option()
def command(controller: str | None, names: tuple[str, ...], runs: int, write: bool, as_json: bool) -> None:
    """Show the problem set: of each problem the best controller that is known, its mean with a 95 % interval, and a lower bound.

    The objective is the sum of squared errors after one pulse, in the mean over the seeds. Nothing is ranked.
    Exit status 1: the controller ran on none of the problems.
    """
    from hil.sweeps.problems import best_known, problems, reached

    chosen = [problem for problem in problems() if not names or problem.name in names]
    names_of = [problem.name for problem in problems()]
    unknown = set(names) - set(names_of)
    if unknown:
        hint = nearest(min(unknown), names_of) or "."
        raise HilError(f"--only: no problem is called {min(unknown)!r}{hint} There are: {', '.join(names_of)}")
    if write:
        if controller is not None:
            raise HilError("--write: stores what the set itself tried, and takes no --controller")
        _write(chosen)
        return
    table = None if controller is None else _table(controller)
    known = best_known()
    found = {} if table is None else {problem.name: _run(problem, table, runs, reached) for problem in chosen}
    if as_json:
        from msgspec import to_builtins

        said = {p.name: {"source": p.source, "experiment": p.experiment, "best_known": known.get(p.name)} for p in chosen}
        print_json({name: entry | ({"yours": to_builtins(found[name])} if name in found else {}) for name, entry in said.items()})
    else:
        _show(chosen, known, found)
    if found and all(each.mean is None for each in found.values()):
        raise SystemExit(1)


def _run(problem: Problem, table: str, runs: int, reached: Any) -> Reached:
    if sys.stderr.isatty():
        print(f"hil: {problem.name}", file=sys.stderr)
    result: Reached = reached(problem, table, runs)
    return result


def _table(said: str) -> str:
    """Return a controller's table as inline TOML.

    Raises:
        HilError: no table, or none with a kind.
    """
    from hil.files.regular import read_regular
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


def _write(chosen: list[Problem]) -> None:
    from hil.files.outputs import write_output
    from hil.sweeps.problems import RUNS, as_plain, best_known, best_of, folder, lower_bound, reached

    path = folder() / "best.json"
    stored = best_known() if path.exists() else {}
    for problem in chosen:
        tried = [reached(problem, table, RUNS) for table in problem.tried]
        for each in tried:
            print(f"{problem.name}: {each.controller}: {_mean(each.mean, each.low, each.high)} {each.verdict} {each.said}")
        best = best_of(tried)
        if best is None:
            raise HilError(f"{problem.name}: none of the controllers that are named ran")
        stored[problem.name] = dict(as_plain(best, lower_bound(problem)))
    write_output(path, json.dumps(dict(sorted(stored.items())), indent=1) + "\n")


def _mean(mean: float | None, low: float | None, high: float | None) -> str:
    return "-" if mean is None or low is None or high is None else f"{mean:.5g} ({low:.5g} to {high:.5g})"


def _show(chosen: list[Problem], known: dict[str, dict[str, Any]], found: dict[str, Reached]) -> None:
    from hil.pages.html.figures import Table

    rows = []
    for problem in chosen:
        best, own = known.get(problem.name, {}), found.get(problem.name)
        bound = best.get("lower_bound")
        row = [problem.name, _mean(best.get("mean"), best.get("low"), best.get("high")), "-" if bound is None else f"{bound:.4g}"]
        rows.append(row + ([best.get("controller", "-")] if own is None else [_mean(own.mean, own.low, own.high), own.verdict]))
    heads = ("problem", "best known (95 %)", "lower bound", *(("yours (95 %)", "verdict") if found else ("controller",)))
    print_table(Table(columns=heads, rows=rows), folds=True)
    for problem in chosen:
        said = found[problem.name].said if problem.name in found else problem.source
        if said:
            print(visible(f"{problem.name}: {said}"))
