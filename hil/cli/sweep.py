"""``hil sweep``: one experiment, many seeds, all cores, no log files."""

from __future__ import annotations

import json
import sys
import time

import click

from hil.errors import HilError


@click.command()
@click.argument("experiment")
@click.option("--runs", type=int, default=100, show_default=True, help="Number of runs; seeds 0, 1, ...")
@click.option("--first-seed", type=int, default=0, show_default=True)
@click.option("--jobs", type=int, default=-1, show_default=True, help="Processes; -1 for one per core.")
@click.option("--set", "sets", multiple=True, metavar="PATH=VALUE", help="Change a field.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def command(experiment: str, runs: int, first_seed: int, jobs: int, sets: tuple[str, ...], as_json: bool) -> None:
    """Run EXPERIMENT in virtual time for many seeds; print mean, spread and percentiles of its metrics.

    Ctrl-C prints what was done so far and exits with 130.
    """
    from rich.console import Console
    from rich.progress import Progress, TimeRemainingColumn
    from rich.table import Table

    from hil.experiment import load_experiment
    from hil.sweep import METRICS, statistics, sweep

    if runs < 1:
        raise HilError(f"--runs: {runs} is below 1")
    if first_seed < 0:
        raise HilError(f"--first-seed: {first_seed} is negative")
    if jobs == 0 or jobs < -1:
        raise HilError(f"--jobs: {jobs}; expected -1 or a positive number")
    checked = load_experiment(experiment, sets)
    begun = time.perf_counter()
    err = Console(stderr=True)
    with Progress(*Progress.get_default_columns()[:-1], TimeRemainingColumn(), console=err, disable=not err.is_terminal) as bar:
        task = bar.add_task(checked.name, total=runs)
        found = sweep(
            checked,
            range(first_seed, first_seed + runs),
            jobs=jobs,
            progress=lambda done: bar.update(task, completed=done),
        )
    done = int(found["seed"].size)
    out = {
        "experiment": checked.name,
        "runs": done,
        "requested": runs,
        "first_seed": first_seed,
        "wall_s": round(time.perf_counter() - begun, 3),
        "stopped_by_safety": int(found["stopped"].sum()),
        "metrics": {name: statistics(found[name]) for name in METRICS},
    }
    if as_json:
        print(json.dumps(out, indent=2))
    else:
        table = Table(title=f"{checked.name}: {done} runs in {out['wall_s']} s, {out['stopped_by_safety']} stopped by safety")
        for head in ("metric", "n", "mean", "sd", "5 %", "50 %", "95 %"):
            table.add_column(head, justify="left" if head == "metric" else "right")
        for name, s in out["metrics"].items():  # type: ignore[attr-defined]
            values = [s["mean"], s["sd"], *(s["percentiles"].get(p) for p in ("5", "50", "95"))]
            table.add_row(name, str(s["n"]), *("-" if v is None else f"{v:.5g}" for v in values))
        Console().print(table)
    if done < runs:
        sys.exit(130)
