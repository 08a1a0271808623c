"""``hil bench``: what this machine and this code do, always two things in one run, always with their ratio."""

from __future__ import annotations

import json
from typing import Any, get_args

import click

from hil.cli import bench_all
from hil.experiment.tables import Affinity

SECONDS = (0.001, 86_400)


@click.group()
def command() -> None:
    """Measure timing, links, designs and Monte Carlo on this machine."""


command.add_command(bench_all.everything)
command.add_command(bench_all.page)


def _status(text: str) -> None:
    click.echo(text, err=True)


def _check(option: str, value: float, low: float, high: float) -> None:
    from hil.errors import HilError

    if not low <= value <= high:
        raise HilError(f"{option}: {value:g}; expected a number from {low:g} to {high:g}")


def _table(title: str, rows: list[dict[str, Any]]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title)
    for i, head in enumerate(rows[0] if rows else []):
        table.add_column(head, justify="left" if i == 0 else "right", no_wrap=i > 0)
    for row in rows:
        table.add_row(*("-" if v is None else f"{v:.4g}" if isinstance(v, float) else str(v) for v in row.values()))
    console = Console()
    if not console.is_terminal:
        console.width = 160  # a file has no edge to wrap at
    console.print(table)


def _show(as_json: bool, parts: dict[str, tuple[str, list[dict[str, Any]]]]) -> None:
    """Print tables, each by its title; or as JSON, each by its key."""
    if as_json:
        print(json.dumps({key: rows for key, (_, rows) in parts.items()}, indent=2))
        return
    for title, rows in parts.values():
        _table(title, rows)


@command.command()
@click.option("--duration", type=float, default=20.0, show_default=True, help="Seconds for each link.")
@click.option("--turns", type=click.IntRange(1, 100), default=4, show_default=True, help="Sessions that share these.")
@click.option("--link", "links", multiple=True, help="URI; several allowed.")
@click.option("--experiment", "experiments", multiple=True, metavar="NAME|FILE",
              help="Experiment; several are measured in turns [dc-motor-1khz].")  # fmt: skip
@click.option("--set", "sets", multiple=True, metavar="PATH=VALUE", help="Change it, e.g. timing.idle=awake.")
@click.option("--affinity", "affinities", multiple=True, type=click.Choice(get_args(Affinity)),
              help="CPUs of rig and controller; several are measured in turns.")  # fmt: skip
@click.option("--json", "as_json", is_flag=True)
def timing(
    duration: float, turns: int, links: tuple[str, ...], experiments: tuple[str, ...], sets: tuple[str, ...],
    affinities: tuple[str, ...], as_json: bool,
) -> None:  # fmt: skip
    """Run the rig (by default at 1 kHz) beside cyclictest at the same priority."""
    from hil.bench.timing import EXPERIMENT, LINKS, bench_timing

    _check("--duration", duration, *SECONDS)
    _check("--duration over --turns", duration / turns, *SECONDS)
    rows = bench_timing(
        duration_s=duration, turns=turns, links=links or LINKS, experiments=experiments or (EXPERIMENT,), sets=sets,
        affinities=affinities, progress=_status,
    )  # fmt: skip
    if as_json:
        print(json.dumps(rows, indent=2))
        return
    flat = []
    for row in rows:
        shown = {
            "rig": row["lateness_us"],
            "cyclictest": row["cyclictest_us"],
            "ratio": row["ratio"],
        }
        for name, values in shown.items():
            points = {q: float(values[q]) for q in ("p50", "p99", "p99_9", "max")}
            flat.append({"experiment": row["experiment"], "link": row["link"], "lateness in us": name, **points})
    _table("wake-up lateness", flat)
    of = f"of {rows[-1]['link']}"
    _table("round trips and overruns", [
        {"experiment": row["experiment"], "link": row["link"], "affinity": row["affinity"],
         **{f"{q} us": v for q, v in row["round_trip_us"].items()},
         f"p50 {of}": row["round_trip_ratio"],
         "late": f"{row['late_share']:.3%}", "overruns": f"{row['overrun_share']:.3%}",
         "missed by cyclictest": f"{row['cyclictest_missed_share']:.3%}", "records dropped": row["dropped_records"]}
        for row in rows
    ])  # fmt: skip
    print(f"{rows[0]['ticks']} slots for each link; {rows[0]['scheduler']}")


@command.command()
@click.option("--rate", type=float, default=1000.0, show_default=True, help="Round trips per second.")
@click.option("--duration", type=float, default=10.0, show_default=True, help="Seconds for each link.")
@click.option("--json", "as_json", is_flag=True)
def links(rate: float, duration: float, as_json: bool) -> None:
    """Round trips of all links side by side, with C over UDP as the floor."""
    from hil.bench.links import bench_links

    _check("--rate", rate, 1, 100_000)
    _check("--duration", duration, *SECONDS)
    rows = bench_links(rate_hz=rate, duration_s=duration)
    if as_json:
        print(json.dumps(rows, indent=2))
    else:
        _table(f"round trips at {rate:g} Hz, us", rows)


@command.command()
@click.option("--json", "as_json", is_flag=True)
def design(as_json: bool) -> None:
    """Every synthesis with its time and its certificate, beside the route of the thesis."""
    from hil.bench.design import bench_design, bench_scheduled

    tracking, scheduled = bench_design(progress=_status), bench_scheduled(progress=_status)
    _show(as_json, {
        "tracking": ("tracking over a network (Chapter 7), beside the iterated LMIs (ccl)", tracking),
        "scheduled": ("scheduled state feedback (Chapters 2 to 4)", scheduled),
    })  # fmt: skip


@command.command()
@click.option("--json", "as_json", is_flag=True)
def montecarlo(as_json: bool) -> None:
    """The batch engine beside a numpy loop and scipy's solve_ivp."""
    from hil.bench.montecarlo import bench_montecarlo

    rows = bench_montecarlo(progress=_status)
    print(json.dumps(rows, indent=2)) if as_json else _table("Monte Carlo", rows)


@command.command()
@click.option("--json", "as_json", is_flag=True)
def auth(as_json: bool) -> None:
    """A code in every frame: microseconds and bytes beside the same frames without."""
    from hil.bench.auth import bench_auth

    rows = bench_auth()
    print(json.dumps(rows, indent=2)) if as_json else _table("one packet sent and heard, with a code and without", rows)


@command.command()
@click.option("--for", "duration", default="10min", show_default=True, metavar="TIME", help="Length of the long session.")
@click.option("--sessions", type=click.IntRange(0, 1000), default=0, show_default=True, help="Short sessions in a row.")
@click.option("--at-once", type=click.IntRange(0, 64), default=0, show_default=True, help="Short sessions at the same time.")
@click.option("--json", "as_json", is_flag=True)
def soak(duration: str, sessions: int, at_once: int, as_json: bool) -> None:
    """Endurance at 1 kHz over can:hil: memory of each process, log, overruns beside cyclictest.

    Exit status 0: it holds. 1: it does not. 4: undecided, the machine was too busy to tell.
    """
    import re

    from hil.bench.soak import bench_soak
    from hil.bench.soak_verdict import STATUS
    from hil.errors import HilError
    from hil.experiment.tables import Seconds

    try:
        duration_s = float(Seconds.parse(re.sub(r"(?<=\d)(?=[a-z])", " ", duration.strip())))
    except ValueError as error:
        raise HilError(f"--for: {error}") from None
    _check("--for", duration_s, 5.0, 7 * 86_400)
    row = bench_soak(duration_s=duration_s, sessions=sessions, at_once=at_once, progress=_status)
    if as_json:
        print(json.dumps(row, indent=2))
    else:
        _soak(row)
    raise SystemExit(STATUS[row["verdict"]])


def _soak(row: dict[str, Any]) -> None:
    _table("memory while it runs, slope with its 95 % confidence interval", row["memory"])
    print(f"exit status {row['status']}, {row['ticks']} of {row['ticks_expected']} slots, {row['dropped']} records dropped")
    ratio = f"{row['log_ratio']:.3f} of the {row['log_predicted'] / 1e6:.1f} MB that its second tenth predicts"
    print(f"log {row['log_bytes'] / 1e6:.1f} MB, {ratio}")
    print(f"overruns {row['overrun_share']:.3%}, late answers {row['late']}, lateness {_us(row['lateness_us'])}")
    beside = row["cyclictest_us"]
    told = "no cyclictest here: apt-get install rt-tests"
    print(told if beside is None else f"cyclictest missed {row['cyclictest_missed_share']:.3%}, lateness {_us(beside)}")
    for how, dropped in row["short_dropped"].items():
        statuses = ", ".join(f"{count} ended with status {s}" for s, count in row[how.replace(" ", "_")].items())
        print(f"{how}: {statuses}; {dropped} records dropped")
    print(row["verdict"] + "".join(f"\n  {reason}" for reason in row["why"]))


def _us(lateness: dict[str, float | None]) -> str:
    return ", ".join(f"{q.replace('_', '.')} {'-' if us is None else f'{us:.0f}'} us" for q, us in lateness.items())


@command.command()
@click.option("--json", "as_json", is_flag=True)
def engines(as_json: bool) -> None:
    """A sweep beside run by run, a log beside mcap's own writer: CPU time."""
    from hil.bench.engines import bench_log, bench_memory, bench_sweep

    sweeps, logs, memory = bench_sweep(_status), bench_log(_status), bench_memory(_status)
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
    from hil.bench.modes import bench_certificates, bench_modes

    designs, certificates = bench_modes(_status, h2=h2, hinf=hinf), bench_certificates(_status)
    _show(as_json, {
        "designs": ("designs over many modes (the gain knows both delays, one start)", designs),
        "certificates": ("certificates over many modes, norms of one", certificates),
    })  # fmt: skip


@command.command()
@click.option("--runs", type=click.IntRange(1, 1_000_000), default=1000, show_default=True, help="Runs of each sweep.")
@click.option("--json", "as_json", is_flag=True)
def commands(runs: int, as_json: bool) -> None:
    """Whole commands, each in a process of its own: run, report, sweeps, a session in real time; CPU and wall time."""
    from hil.bench.commands import bench_commands

    rows = bench_commands(_status, runs=runs)
    print(json.dumps(rows, indent=2)) if as_json else _table('commands, beside python -c "import numpy"', rows)
