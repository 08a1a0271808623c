"""What this code takes, always beside a peer in the same run: `python -m tests.bench all` and `page` make the guide's figures."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import click

from hil.cli.bench import show_table, status_line
from hil.cli.interrupts import signals_as_exceptions
from hil.errors import HilError
from hil.files.outputs import check_output, write_output

FOLDER = click.Path(exists=True, file_okay=False, path_type=Path)


@click.group()
def command() -> None:
    """Measure what commands, designs, logs and sweeps take, each beside its peer."""


def _show(as_json: bool, parts: dict[str, tuple[str, list[dict[str, Any]]]]) -> None:
    """Print tables, each by its title; or as JSON, each by its key."""
    if as_json:
        print(json.dumps({key: rows for key, (_, rows) in parts.items()}, indent=2))
        return
    for title, rows in parts.values():
        show_table(title, rows)


@command.command(name="all")
@click.option("--only", multiple=True, metavar="NAME", help="Only this part, several allowed: start, sweeps, real-time, ...")
@click.option("--quick", is_flag=True, help="Measure smaller things, some seconds a part; nothing is judged.")
@click.option("--compiled", type=FOLDER, help="The wheel with the compiled loop, unpacked: what loops is measured in both forms.")
@click.option("--before", type=FOLDER, help="Sources of 3aeb887, beside which a virtual slot is set.")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def everything(only: tuple[str, ...], quick: bool, compiled: Path | None, before: Path | None, as_json: bool) -> None:
    """Every figure with its peer, their ratio, and whether it reaches its goal; takes some 20 minutes on two quiet CPUs.

    What a machine lacks (cyclictest, dask) is said in the row that needs it. Ctrl-C prints what was measured until then.
    """
    from tests.bench.other_code import check_before, check_compiled
    from tests.bench.run_parts import chosen, run_parts

    parts = chosen(only)
    if compiled is not None:
        check_compiled(compiled)
    if before is not None:
        check_before(before)
    found, interrupt = run_parts(
        parts, lambda text: click.echo(text, err=True), quick=quick, compiled=compiled, before=before
    )
    if as_json:
        print(json.dumps(found, indent=2, ensure_ascii=False, allow_nan=False))
    else:
        _show_figures(found)
    if interrupt is not None:
        raise interrupt


def _show_figures(found: dict[str, Any]) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from tests.bench.page import HEADS, cells, machine_line, remark

    table = Table(title=machine_line(found))
    for head in HEADS:
        table.add_column(head, justify="left" if head in ("what", "goal") else "right")
    part = None
    for row in found["figures"]:
        if part not in (None, row["part"]):
            table.add_section()
        part = row["part"]
        table.add_row(*map(escape, cells(row)))
    console = Console()
    if not console.is_terminal:
        console.width = 200  # a file has no edge to wrap at
    console.print(table)
    for row in found["figures"]:
        console.print(remark(row), markup=False, highlight=False)


@command.command()
@click.argument("figures", nargs=-1, required=True, type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("-o", "--output", type=click.Path(dir_okay=False, path_type=Path), metavar="PAGE.md", help="File [stdout].")
def page(figures: tuple[Path, ...], output: Path | None) -> None:
    """Make a page of FIGURES, what `python -m tests.bench all --json` has printed on one machine or several: in Markdown."""
    from tests.bench.page import page_of, section_of

    if output is not None:
        check_output(output)
    machines = []
    for path in figures:
        try:
            machines.append(json.loads(path.read_text(encoding="utf-8")))
            section_of(machines[-1])
        except (ValueError, KeyError, TypeError) as error:
            why = f"{type(error).__name__}: {error}"
            raise HilError(f"{path}: not what `python -m tests.bench all --json` prints: {why}") from None
    text = page_of(machines)
    if output is None:
        sys.stdout.write(text)
    else:
        write_output(output, text)


@command.command()
@click.option("--json", "as_json", is_flag=True)
def design(as_json: bool) -> None:
    """Every synthesis with its time and its certificate, beside the route of the thesis."""
    from tests.bench.design import bench_design, bench_scheduled

    tracking, scheduled = bench_design(progress=status_line), bench_scheduled(progress=status_line)
    _show(as_json, {
        "tracking": ("tracking over a network (Chapter 7), beside the iterated LMIs (ccl)", tracking),
        "scheduled": ("scheduled state feedback (Chapters 2 to 4)", scheduled),
    })  # fmt: skip


@command.command()
@click.option("--json", "as_json", is_flag=True)
def montecarlo(as_json: bool) -> None:
    """The batch engine beside a numpy loop and scipy's solve_ivp."""
    from tests.bench.montecarlo import bench_montecarlo

    rows = bench_montecarlo(progress=status_line)
    print(json.dumps(rows, indent=2)) if as_json else show_table("Monte Carlo", rows)


@command.command()
@click.option("--json", "as_json", is_flag=True)
def auth(as_json: bool) -> None:
    """A code in every frame: microseconds and bytes beside the same frames without."""
    from tests.bench.auth import bench_auth

    rows = bench_auth()
    print(json.dumps(rows, indent=2)) if as_json else show_table("one packet sent and heard, with a code and without", rows)


@command.command()
@click.option("--json", "as_json", is_flag=True)
def engines(as_json: bool) -> None:
    """A sweep beside run by run, a log beside mcap's own writer: CPU time."""
    from tests.bench.engines import bench_log, bench_memory, bench_sweep

    sweeps, logs, memory = bench_sweep(status_line), bench_log(status_line), bench_memory(status_line)
    _show(as_json, {
        "sweep": ("a sweep in lockstep, beside run by run", sweeps),
        "log": ("one slot in virtual time, with a log, beside mcap's own writer", logs),
        "memory": ("memory that every further slot holds, beside mcap's own writer", memory),
    })  # fmt: skip


@command.command()
@click.option("--h2", multiple=True, type=click.IntRange(1, 8), default=(1, 2, 3, 4, 8), show_default=True, metavar="DELAY",
              help="Largest delay of both directions; several allowed.")  # fmt: skip
@click.option("--hinf", multiple=True, type=click.IntRange(1, 8), default=(1, 2, 3, 4), show_default=True, metavar="DELAY",
              help="The same for H-infinity.")  # fmt: skip
@click.option("--json", "as_json", is_flag=True)
def modes(h2: tuple[int, ...], hinf: tuple[int, ...], as_json: bool) -> None:
    """Designs and certificates over many modes, beside the plain way, ARPACK and python-control: CPU time."""
    from tests.bench.modes import bench_certificates, bench_modes

    designs, certificates = bench_modes(status_line, h2=h2, hinf=hinf), bench_certificates(status_line)
    _show(as_json, {
        "designs": ("designs over many modes (the gain knows both delays, one start)", designs),
        "certificates": ("certificates over many modes, norms of one", certificates),
    })  # fmt: skip


@command.command()
@click.option("--runs", type=click.IntRange(1, 1_000_000), default=1000, show_default=True, help="Runs of each sweep.")
@click.option("--json", "as_json", is_flag=True)
def commands(runs: int, as_json: bool) -> None:
    """Whole commands, each in a process of its own: run, report, sweeps, a session in real time; CPU and wall time."""
    from tests.bench.commands import bench_commands

    rows = bench_commands(status_line, runs=runs)
    print(json.dumps(rows, indent=2)) if as_json else show_table('commands, beside python -c "import numpy"', rows)


def main(arguments: list[str] | None = None) -> None:
    """Run a command; exit status 2 for what the user can mend, 130 for an interrupt."""
    try:
        with signals_as_exceptions():
            command.main(arguments, prog_name="python -m tests.bench", standalone_mode=False)
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except (click.Abort, KeyboardInterrupt):
        sys.exit(130)
    except HilError as error:
        print(f"tests.bench: {error}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
