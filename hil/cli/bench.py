"""``hil bench``, ``hil probe``: what this machine and this code do beside a peer, with their ratio; and what a real link does."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any, get_args

import click

from hil.cli.option_types import OUTPUT, Duration, Questions, Within
from hil.cli.page_text import print_table
from hil.cli.terminal import Working, answer, json_option
from hil.errors import HilError
from hil.experiment.tables import Affinity

LENGTH = Duration(0.001, 86_400)
MOST_FRAMES = 5_000_000


@click.group(cls=Questions)
def bench() -> None:
    """Measure timing, links and endurance on this machine."""


def status_line(text: str) -> None:
    click.echo(text, err=True)


def show_table(title: str, rows: list[dict[str, Any]]) -> None:
    from hil.pages import Table

    cells = [[f"{v:.4g}" if isinstance(v, float) else v for v in row.values()] for row in rows]
    print_table(Table(title=title, columns=list(rows[0]) if rows else (), rows=cells))


@bench.command()
@click.option("--duration", type=LENGTH, default="20s", show_default=True, help="Length of the sessions over each link.")
@click.option("--turns", type=click.IntRange(1, 100), default=4, show_default=True, help="Number of sessions that share it.")
@click.option("--link", "links", multiple=True, help="URI; several allowed.")
@click.option("--experiment", "experiments", multiple=True, metavar="NAME|FILE",
              help="Experiment; several are measured alternately [dc-motor-1khz].")  # fmt: skip
@click.option("--set", "sets", multiple=True, metavar="PATH=VALUE", help="Change a field, such as timing.idle=awake.")
@click.option("--affinity", "affinities", multiple=True, type=click.Choice(get_args(Affinity)),
              help="CPUs of rig and controller; several are measured alternately.")  # fmt: skip
@click.option("--live", is_flag=True, help="Instead: lateness with no, one and three readers of the live page.")
@json_option("Print JSON.")
def timing(
    duration: float, turns: int, links: tuple[str, ...], experiments: tuple[str, ...], sets: tuple[str, ...],
    affinities: tuple[str, ...], live: bool,
) -> None:  # fmt: skip
    """Run the rig (by default at 1 kHz) beside cyclictest at the same priority."""
    from hil.bench.timing import EXPERIMENT, LINKS, bench_timing

    if duration / turns < LENGTH.least:
        raise HilError(f"--duration over --turns: {duration / turns:g} s; expected {LENGTH.least:g} s at least")
    if live:
        _live(duration, turns, (links or LINKS)[0], (experiments or (EXPERIMENT,))[0])
        return
    rows = bench_timing(
        duration_s=duration, turns=turns, links=links or LINKS, experiments=experiments or (EXPERIMENT,), sets=sets,
        affinities=affinities, progress=status_line,
    )  # fmt: skip
    answer(rows, _show_timing, rows)


def _show_timing(rows: list[dict[str, Any]]) -> None:
    show_table("wake-up lateness", [
        {"experiment": row["experiment"], "link": row["link"], "lateness in us": name,
         **{q: row[key][q] for q in ("p50", "p99", "p99_9", "max")}}
        for row in rows for name, key in (("rig", "lateness_us"), ("cyclictest", "cyclictest_us"), ("ratio", "ratio"))
    ])  # fmt: skip
    of = f"of {rows[-1]['link']}"
    show_table("round trips and overruns", [
        {"experiment": row["experiment"], "link": row["link"], "affinity": row["affinity"],
         **{f"{q} us": v for q, v in row["round_trip_us"].items()},
         f"p50 {of}": row["round_trip_ratio"],
         "late": f"{row['late_share']:.3%}", "overruns": f"{row['overrun_share']:.3%}",
         "missed by cyclictest": f"{row['cyclictest_missed_share']:.3%}", "records dropped": row["dropped_records"]}
        for row in rows
    ])  # fmt: skip
    print(f"{rows[0]['slots']} slots for each link; {rows[0]['scheduler']}")


def _live(duration: float, turns: int, link: str, experiment: str) -> None:
    from hil.bench.timing import bench_live

    rows = bench_live(duration_s=duration, turns=turns, link=link, experiment=experiment, progress=status_line)
    answer(rows, show_table, f"lateness of {experiment} over {link}, in us", [
        {"readers": row["readers"], **row["lateness_us"], **{f"{q}, ratio": v for q, v in row["ratio"].items()},
         "late or over": row["missed"], "dropped": row["dropped_records"], "pictures": row["pictures"]}
        for row in rows
    ])  # fmt: skip


@bench.command()
@click.option("--rate", type=Within(1, 100_000), default=1000.0, show_default=True, help="Round trips per second.")
@click.option("--duration", type=LENGTH, default="10s", show_default=True, help="Length of the measurement on each link.")
@click.option("--can", "buses", is_flag=True, help="Instead: CAN buses, with the bus model off and on.")
@json_option("Print JSON.")
def links(rate: float, duration: float, buses: bool) -> None:
    """Round trips of all links side by side, with C over UDP as the floor."""
    from hil.bench.links import bench_links

    if buses:
        from hil.bench.can_buses import bench_can_buses

        rows = bench_can_buses(duration, progress=status_line)
        answer(rows, _show_buses, rows)
        return
    rows = bench_links(rate_hz=rate, duration_s=duration)
    answer(rows, show_table, f"round trips at {rate:g} Hz, us", rows)


def _show_buses(rows: list[dict[str, Any]]) -> None:
    show_table("frames per second between two programs of python-can", [
        {"bus": row["bus"], "frames/s": row["frames_s"], "ratio": row["times_off"], "lost": row["lost"], "note": row["note"][:60]}
        for row in rows
    ])  # fmt: skip
    show_table("round trips, and the error of frame times beside cyclictest, in us", [
        {"bus": row["bus"], "p50": row["p50_us"], "p99": row["p99_us"], "p50, ratio": row["trip_times_off"],
         "error p50": row["late_p50_us"], "error p99": row["late_p99_us"], "cyclictest p99": row["cyclictest_p99_us"],
         "ratio ": row["late_of_cyclictest"]}
        for row in rows
    ])  # fmt: skip


@bench.command()
@click.option("--for", "duration", type=Duration(5.0, 7 * 86_400), default="10min", show_default=True,
              help="Length of the long session.")  # fmt: skip
@click.option("--sessions", type=click.IntRange(0, 1000), default=0, show_default=True, help="Short sessions in a row.")
@click.option("--at-once", type=click.IntRange(0, 64), default=0, show_default=True, help="Short sessions at the same time.")
@json_option("Print JSON.")
def soak(duration: float, sessions: int, at_once: int) -> None:
    """Endurance at 1 kHz over can:hil: memory of each process, log, overruns beside cyclictest.

    Exit status 0: it holds. 1: it does not. 4: undecided, the machine was too busy to tell.
    """
    from hil.bench.soak import STATUS, bench_soak

    row = bench_soak(duration_s=duration, sessions=sessions, at_once=at_once, progress=status_line)
    answer(row, _soak, row)
    raise SystemExit(STATUS[row["verdict"]])


def _soak(row: dict[str, Any]) -> None:
    show_table("memory while it runs, slope with its 95 % confidence interval", row["memory"])
    print(f"exit status {row['status']}, {row['slots']} of {row['slots_expected']} slots, {row['dropped']} records dropped")
    ratio = f"{row['log_ratio']:.3f} of the {row['log_predicted'] / 1e6:.1f} MB that its second tenth predicts"
    print(f"log {row['log_bytes'] / 1e6:.1f} MB, {ratio}")
    print(f"overruns {row['overrun_share']:.3%}, late answers {row['late']}, lateness {_us(row['lateness_us'])}")
    beside = row["cyclictest_us"]
    message = "no cyclictest here: apt-get install rt-tests"
    print(message if beside is None else f"cyclictest missed {row['cyclictest_missed_share']:.3%}, lateness {_us(beside)}")
    for how, dropped in row["short_dropped"].items():
        statuses = ", ".join(f"{count} ended with status {s}" for s, count in row[how.replace(" ", "_")].items())
        print(f"{how}: {statuses}; {dropped} records dropped")
    print(row["verdict"] + "".join(f"\n  {reason}" for reason in row["why"]))


def _us(lateness: dict[str, float | None]) -> str:
    return ", ".join(f"{q.replace('_', '.')} {'-' if us is None else f'{us:.0f}'} us" for q, us in lateness.items())


@click.command()
@click.argument("link", metavar="LINK")
@click.option("--seconds", "--for", "seconds", type=Duration(0.1, 86_400), default="30s", show_default=True, help="For how long.")
@click.option("--rate", type=Within(0.1, 10_000), default=100.0, show_default=True, help="Frames per second.")
@click.option("-o", "--output", type=OUTPUT, metavar="FILE.mcap", help="Write the log here [link.mcap].")
@click.option("--answer", "answers", is_flag=True, help="Be the other end: answer until Ctrl-C, and log nothing.")
@click.option("--both", is_flag=True, help="Be both ends, for a link within this machine.")
@click.option("--force", is_flag=True, help="Replace a file that is there.")
def probe(link: str, seconds: float, rate: float, output: Path | None, answers: bool, both: bool, force: bool) -> None:
    """Measure LINK, such as zenoh:tcp/10.0.0.2:7447 or can:socketcan:can0, with our own frames, and write a log.

    At the other end runs `hil probe LINK --answer`. The log is for `hil identify law` and `hil design --network`. Exit status 5:
    two processes answered; the log is of the faster answers.
    """
    from contextlib import nullcontext

    from hil.bench.probe import answer, answering, probe, write_probe_log
    from hil.files import check_output
    from hil.rig.session_link import opened, refuse_one_process
    from hil.session.finished import INTRUSIONS
    from transport.links.traits import traits_of
    from transport.links.zenoh_refusals import standard_output_is_free

    if answers and (both or output is not None):
        raise HilError("--answer: the other end measures nothing; expected no --both and no -o")
    refuse_one_process(link, traits_of(link))
    if answers:
        standard_output_is_free()
        with opened(link, "controller") as end:
            print(f"hil: answering on {link}; Ctrl-C ends it", file=sys.stderr)
            answer(end)
    if rate * seconds > MOST_FRAMES:
        raise HilError(f"--seconds: {rate * seconds:.0f} frames, at most {MOST_FRAMES}; lower --rate")
    path = output or Path("link.mcap")
    check_output(path, "a log", ".mcap", force=force)
    standard_output_is_free()
    with answering(link) if both else nullcontext(), opened(link, "rig") as end, Working(link) as watch:
        trips, one_clock, again = probe(end, rate, seconds, watch.counted)
    write_probe_log(path, link, rate, trips, one_clock)
    came = sorted((t.received_ns - t.sent_ns) / 1e6 for t in trips if t.received_ns)
    if came:
        middle = f"median round trip {came[len(came) // 2]:.4g} ms, longest {came[-1]:.4g} ms"
        clocks = "one clock" if one_clock else "two clocks"
        print(f"{path}: {len(came)} of {len(trips)} round trips came back; {middle}; {clocks}", file=sys.stderr)
    else:
        print(f"{path}: none of {len(trips)} round trips came back", file=sys.stderr)
    if again:
        what = f"link {link!r}: {again} of {len(trips)} frames were answered twice, at two instants: two processes answer there"
        print(f"hil: {what}; times are of the faster one; end one of them and measure again", file=sys.stderr)
        raise SystemExit(INTRUSIONS["second controller"])
