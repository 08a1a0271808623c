"""Results as text on a terminal: the summary of a run, and a page in the words of `hil.pages`, without its figures.

In a summary stands every number with its unit, every verdict with its reason, on 80 columns. A number in a table is never cut,
however narrow the terminal.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from textwrap import fill, wrap
from typing import TYPE_CHECKING, Any, Final

import click

from hil.cli.terminal import NARROWEST, Line, answer, console, print_folded, print_lines, print_written, terminal_columns, visible
from transport.draws import CORRUPTED, CUT, OFF_BUS, REASONS
from transport.links.traits import in_short

if TYPE_CHECKING:
    from rich.text import Text

    from hil.pages import Cell, Table
    from hil.pages.html.page import Page


_NUMBER: Final = r"[-+–.\d][^:,]*$|none$"  # what a cell is that stands right in its column
_TYPED: Final = str.maketrans({"−": "-", "\u202f": ""})  # a number on a terminal can be pasted
_STYLES: Final = {"bad": "red", "warning": "yellow"}


def print_table(table: Table, *, folds: bool = False) -> None:
    """Print a table of a page as wide as its content needs, also where that is wider than the terminal or a pipe's 80 columns.

    A line that the terminal folds can be read; ``1.3081e-…`` cannot. Columns of numbers stand right.

    Args:
        table: what is printed.
        folds: words may go on below themselves where the terminal is narrow, numbers never.
    """
    from rich.box import SIMPLE_HEAD
    from rich.table import Column
    from rich.table import Table as Shown
    from rich.text import Text

    if table.title:  # rich would fold it at the columns of a narrow table
        click.secho(fill(visible(table.title), terminal_columns()), bold=True)
    shown = Shown(box=SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    rows = [[_shown(value) for value in row] for row in table.rows]
    folding: list[tuple[int, Column]] = []
    for head, column in zip(table.columns, zip(*rows) if rows else [()] * len(table.columns)):
        longest = max((len(one.plain) for one in column), default=0)
        if all(re.match(_NUMBER, one.plain) or not one.plain for one in column):
            lines = wrap(visible(head), max(longest, *map(len, head.split(" ")), 1))  # no wider than its numbers
            shown.add_column(Text("\n".join(lines)), justify="right", no_wrap=True)
        else:
            shown.add_column(Text(visible(head)), overflow="fold")
            folding.append((max(longest, len(visible(head))), shown.columns[-1]))
    for i, row in enumerate(rows):
        shown.add_row(*row, style="bold" if i in table.highlight else "")
    out = console()
    whole = out.options.update(max_width=10_000)
    excess = out.measure(shown, options=whole).maximum - out.width if folds else 0
    if excess > sum(max(natural - NARROWEST, 0) for natural, _ in folding):  # one blank between columns then
        shown.padding = 0
        excess = out.measure(shown, options=whole).maximum - out.width
    for natural, words in sorted(folding, key=lambda each: -each[0]):  # rich would narrow one below its least, and crop it
        words.width = max(natural - max(excess, 0), min(natural, NARROWEST))
        excess -= natural - words.width
    out.width = max(out.width, out.measure(shown, options=whole).maximum)
    out.print(shown)
    print_folded(table.note)


def _shown(value: Cell) -> Text:
    """Return a table's cell that shows a text as it is: escaped, and without markup."""
    from rich.text import Text

    from hil.pages import Badge
    from hil.pages.html import text_of

    if isinstance(value, Badge):
        return Text(visible(value.label).translate(_TYPED), style=_STYLES.get(value.state, ""))
    return Text(visible(text_of(value, 6) if isinstance(value, float) else text_of(value)).translate(_TYPED))


def print_page(page: Page) -> None:
    """Print what a page says without its figures: title, facts, verdicts, tables and paragraphs."""
    from hil.pages import Table, Text

    click.secho(visible(page.title), bold=True)
    print_folded(page.subtitle.translate(_TYPED))
    print_folded(", ".join(f"{name} {value}" for name, value in page.facts).translate(_TYPED))
    for badge in page.badges:
        print_folded(badge.label.translate(_TYPED))
    for section in page.sections:
        click.secho(f"\n{visible(section.title)}", bold=True)
        for block in section.blocks:
            if isinstance(block, Table):
                print_table(block, folds=True)
            elif isinstance(block, Text) and not block.code:
                print_folded(block.text.translate(_TYPED))


def show_page(page: Page, document: object, path: Path | None, table: Path | None = None) -> None:
    """Write a page where a path is given; print it without its figures, or as JSON.

    Args:
        page: the answer.
        document: the same as JSON values.
        path: of the page; None: none is written.
        table: a file that was written before, to be named, too.

    Raises:
        HilError: the file cannot be written.
    """
    from hil.files import write_output

    if path is not None:
        write_output(path, page.html())

    def show() -> None:
        print_page(page)
        print_written(path, table)

    answer(document, show)


UNLIKELY: Final = 0.01
"""Below it, as on the page, a record does not fit its law: so it is in one right run of a hundred."""
BROKEN: Final = tuple(REASONS[code] for code in (CUT, CORRUPTED, OFF_BUS))
"""What became of packets under a fault on the time line."""


def print_summary(summary: dict[str, Any]) -> None:
    """Print a summary.

    Args:
        summary: what ``hil run --json`` prints.
    """
    lines: list[Line] = []

    def row(name: str, value: object, colour: str | None = None, coloured: int | None = None) -> None:
        lines.append(Line(name=name, value=str(value), colour=colour, coloured=coloured))

    over = f", {in_short(summary['link'])}" if summary["clock"] == "real" else ""  # in virtual time no frame leaves the process
    row("experiment", f"{summary['experiment']}, seed {summary['seed']}, {summary['clock']} time{over}")
    took = f", in {summary['wall_s']:.2f} s" if summary["clock"] == "virtual" else ""  # real time waits for its controller, too
    row("ran", f"{summary['slots']} slot{'s' * (summary['slots'] != 1)}, {summary['duration_s']:g} s{took}")
    units, titles = summary.get("units", {}), summary.get("titles", {})
    single = summary["metrics"].get("outputs", {})
    for name, value in summary["metrics"].items():
        if name != "outputs" and not (value is None and any(numbers.get(name) is not None for numbers in single.values())):
            row(titles.get(name, name), _with_unit(value, units.get(name, "")))
    for output, numbers in single.items():
        known = {key: _with_unit(value, units.get(f"{key}.{output}", "")) for key, value in numbers.items() if value is not None}
        row(f"  {output}", ", ".join(f"{titles.get(key, key)} {text}" for key, text in known.items()) or "-")
    nodes = summary["network"]["nodes"]
    ways = {f"{name} to controller" if len(nodes) > 1 else "to controller": found for name, found in nodes.items()}
    for name, n in (ways | {"to actuator": summary["network"]["ca"]}).items():
        row(
            name,
            f"{n['through']}{in_modes(n['mode_counts'])}{fits(n['p_value'], len(n['mode_counts']))}; "
            f"lost {n['lost']}, late {n['late']}, duplicated {n['duplicated']}"
            + "".join(f", {fate} {n['fates'][fate]}" for fate in BROKEN if n["fates"].get(fate)),
        )
    bus = summary["network"].get("bus")
    if bus is not None:
        row("bus", f"{bus['name']}, {bus['bitrate']:,} bit/s: load {100 * bus['load']:.1f} %, {bus['frames']} frames, "
            f"{bus['errors']} destroyed")  # fmt: skip
        if bus["stated_load"] > 1:
            needed = f"the messages need {100 * bus['stated_load']:.1f} % of it"
            row("", f"{needed}: those of low priority are not sent, or ever later", "red")
        for each in bus["messages"]:
            if each["node"] in bus["own_nodes"]:
                row(f"  {each['name']}", f"{each['can_id']:#x}, mean wait {number(each['waited_ms'])} ms, longest "
                    f"{number(each['waited_worst_ms'])} ms; longest response {number(each['response_worst_ms'])} ms, bound "
                    f"{number(each['bound_ms'])} ms")  # fmt: skip
    if summary["clock"] == "real":
        for name, value in timing_rows(summary["timing"]):
            row(name, value, "red" if value.startswith("NOT VALID") else None)
    claim = summary.get("certificate")
    if summary.get("controller") == "external":
        row("controller", "external: not the experiment's", "yellow")
    if claim:
        state = str(claim.get("state", "no verdict"))
        colour = {"certified": "green", "refused": "red"}.get(state, "yellow")
        row("certificate", f"{state}, {claim.get('kind')}: {claim.get('reason')}", colour, len(state))
        if claim.get("bound_full_state") is not None:
            row("least cost", least_cost(claim))
    else:
        row("certificate", "none")
    gains = summary.get("gains")
    if gains is not None:
        row("gains", gains["origin"] + (f": {gains['note']}" if "note" in gains else ""))
    if summary.get("safety"):
        row("safety", summary["safety"], "red")
    if "accepted_from" in summary and summary["clock"] == "real":
        row("commands from", summary["accepted_from"])
    counted = summary.get("link_counters")
    if counted:
        row("link", ", ".join(f"{name.replace('_', ' ')} {value}" for name, value in counted.items()))
    for name, value in summary.get("problems", {}).items():
        row(name.replace("_", " "), value, "red")
    log = summary["log"]
    row("log", f"{log['path']} ({log['messages']} messages, {log['dropped']} dropped)")
    print_lines(lines)


def _with_unit(value: object, unit: str) -> str:
    return number(value) + (f" {unit}" if unit and value is not None else "")


def in_modes(counts: Sequence[int]) -> str:
    """Return how many slots a law spent in each of its modes; nothing where it has no choice.

    >>> in_modes([130, 64, 6]), in_modes([200])
    (', modes 0/1/2 in 130/64/6 slots', '')
    """
    if len(counts) < 2:
        return ""
    return f", modes {'/'.join(map(str, range(len(counts))))} in {'/'.join(map(str, counts))} slots"


def fits(p_value: float | None, modes: int) -> str:
    """Return what the test of the record says of its law; of a law of one mode only that it does not fit.

    >>> fits(0.908, 3), fits(1e-6, 3), fits(1.0, 1), fits(None, 0)
    ('; fits its law (p = 0.91)', '; does not fit its law (p = 1e-06)', '', '')
    """
    if p_value is None or (modes == 1 and p_value >= UNLIKELY):
        return ""
    return f"; {'fits' if p_value >= UNLIKELY else 'does not fit'} its law (p = {p_value:.2g})"


def least_cost(claim: dict[str, Any]) -> str:
    """Return what a certificate says of the cost and of what no controller goes below.

    Args:
        claim: with `bound_full_state`, and `cost` where it is known.

    >>> least_cost({"bound_full_state": 54.7557, "cost": 55.1974})
    'no controller below 54.756 from this start, over any network; this one 55.197, 0.81 % above'
    >>> least_cost({"bound_full_state": 54.7557})
    'no controller below 54.756 from this start, over any network'
    """
    bound, cost = float(claim["bound_full_state"]), claim.get("cost")
    text = f"no controller below {number(bound)} from this start, over any network"
    if cost is None:
        return text
    return f"{text}; this one {number(float(cost))}" + (f", {100 * (float(cost) / bound - 1):.2f} % above" if bound > 0 else "")


def timing_rows(timing: dict[str, Any]) -> list[tuple[str, str]]:
    """Return the lines on timing: the verdict with its reasons, and what was measured.

    Args:
        timing: part of a summary; see `hil.measure.summary.timing_metrics`.

    >>> timing_rows({"valid": False, "why": ["9 of 20 slots overran"], "scheduler": "SCHED_OTHER", "overruns": 9,
    ...     "first_late_slot": None, "lateness_us": {"p50": 1.5}, "round_trip_us": {"p50": None}})[0]
    ('timing', 'NOT VALID: 9 of 20 slots overran; SCHED_OTHER')
    """
    late = timing.get("first_late_slot")
    verdict = "valid" if timing["valid"] else f"NOT VALID: {'; '.join(timing['why'])}"
    return [
        ("timing", f"{verdict}; {timing['scheduler'] or 'no slot was run'}"),
        *((f"{name[:-3].replace('_', ' ')}, µs",
           "  ".join(f"{q} {number(v)}" for q, v in timing[name].items() if v is not None) or "-")
          for name in ("lateness_us", "round_trip_us")),
        ("overruns", f"{timing['overruns']}; first late slot: {'none' if late is None else late}"),
    ]  # fmt: skip


def number(value: object) -> str:
    """Return a value for people, with five digits; a dash where there is none.

    >>> number(0.0034246648), number(3), number(None)
    ('0.0034247', '3', '-')
    """
    if value is None:
        return "-"
    return f"{value:.5g}" if isinstance(value, float) else str(value)
