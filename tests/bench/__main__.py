"""What this code takes, always beside a peer in the same run: `python -m tests.bench all` and `page` make the guide's figures."""

from __future__ import annotations

import json
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import click

from hil.cli.bench import show_table, status_line
from hil.cli.guard import signals_as_exceptions
from hil.errors import HilError
from hil.files import check_output, write_output

FOLDER = click.Path(exists=True, file_okay=False, path_type=Path)


@click.group()
def command() -> None:
    """Measure what commands, designs, logs and sweeps take, each beside its peer."""


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
    found, interrupt = run_parts(parts, lambda text: click.echo(text, err=True), quick=quick, compiled=compiled, before=before)
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
        check_output(output, force=True)
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


SUBJECTS: dict[str, tuple[str, tuple[tuple[str, str], ...]]] = {
    "design": ("Every synthesis with its time and its certificate, beside the route of the thesis.", (
        ("tracking over a network (Chapter 7), beside the iterated LMIs (ccl)", "design.bench_design"),
        ("scheduled state feedback (Chapters 2 to 4)", "design.bench_scheduled"),
    )),
    "montecarlo": ("The batch engine beside a numpy loop and scipy's solve_ivp.", (
        ("Monte Carlo", "montecarlo.bench_montecarlo"),
    )),
    "auth": ("A code in every frame: microseconds and bytes beside the same frames without.", (
        ("one packet sent and received, with a code and without", "auth.bench_auth"),
    )),
    "engines": ("A sweep beside run by run, a log beside mcap's own writer: CPU time.", (
        ("a sweep in lockstep, beside run by run", "engines.bench_sweep"),
        ("one slot in virtual time, with a log, beside mcap's own writer", "engines.bench_log"),
        ("memory that every further slot holds, beside mcap's own writer", "engines.bench_memory"),
    )),
    "modes": ("Designs and certificates over many modes, beside the plain way, ARPACK and python-control: CPU time.", (
        ("designs over many modes (the gain knows both delays, one start)", "modes.bench_modes"),
        ("certificates over many modes, norms of one", "modes.bench_certificates"),
    )),
}  # fmt: skip
"""Single subjects: what each measures, and of its tables the title and the function of this folder that measures it."""


def _subject(name: str) -> None:
    """Add the command of a subject: its tables, or in JSON their rows by the function's name."""
    about, tables = SUBJECTS[name]

    @command.command(name=name, help=about)
    @click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
    def measure(as_json: bool) -> None:
        found = {}
        for title, place in tables:
            module, function = place.split(".")
            found[function.removeprefix("bench_")] = title, getattr(import_module(f"tests.bench.{module}"), function)(status_line)
        if as_json:
            print(json.dumps({key: rows for key, (_, rows) in found.items()}, indent=2))
        else:
            for title, rows in found.values():
                show_table(title, rows)


for _name in SUBJECTS:
    _subject(_name)


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
