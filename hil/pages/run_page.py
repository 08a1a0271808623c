"""The pages that `hil report` writes: of one run; and of a folder of logs a table to filter, with the output of each run."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from hil.errors import HilError
from hil.files import check_page, write_output
from hil.log.run import Run
from hil.measure import Quantity, in_one_row, quantities_of, run_measures
from hil.measure.signals import with_unit
from hil.measure.summary import page_summary
from hil.measure.view import RunView, view_of
from hil.pages import Badge, Block, Cell, Figure, Link, Section, Series, State, Table, Tile
from hil.pages.html import capital, text_of
from hil.pages.html.page import Page
from hil.pages.sections import sections_of
from hil.pages.sections.time_panels import output_panels
from transport.links.traits import in_short

MOST_LOGS = 2000
MOST_FOLDERS = 10_000
MOST_DRAWN = 60
"""Runs whose outputs are drawn; the table names all."""

MOST_NUMBERS = 5
"""Columns of numbers: those that most runs have."""

_WORST = ("bad", "warning", "neutral", "good")


@np.errstate(all="ignore")
def render_report(view: RunView) -> str:
    """Return the report of a run as one self-contained HTML page; numbers of a log that are beyond all others are no news.

    Args:
        view: the run.
    """
    run = view.run
    summary = view.once(page_summary)
    description = str(run.resolved.get("description", ""))
    return Page(
        str(summary["experiment"] or "Run"),
        view.once(sections_of),
        kicker="hilrig · run report",
        subtitle=description,
        badges=verdicts(run, summary),
        tiles=_tiles(view, summary["metrics"]),
        facts=_facts(view, summary),
        footer=f"Written by hilrig {run.versions.get('hilrig', '')} from the log alone. Drag across a plot to zoom all "
        "time axes, double-click to reset.",
    ).html()


_COLOURS: Mapping[str, State] = {"certified": "good", "refused": "bad"}


def verdicts(run: Run, summary: Mapping[str, Any]) -> list[Badge]:
    """Return the verdicts on a run: its timing, its safety, its certificate, its log."""
    timing, found = summary["timing"], []
    if summary["clock"] == "virtual":
        found.append(Badge(label="virtual time", state="good", detail="times are exact"))
    elif timing["valid"]:
        name = "max" if timing["lateness_us"]["p99"] is None else "p99"
        worst = text_of(timing["lateness_us"][name], 3)
        found.append(Badge(label="timing valid", state="good", detail=f"lateness {name} {worst} µs"))
    else:
        found.append(Badge(label="timing not valid", state="bad", detail="; ".join(timing["why"])))
    if summary.get("safety"):
        found.append(Badge(label="stopped by safety", state="bad", detail=str(summary["safety"])))
    else:
        found.append(Badge(label="safety not tripped", state="good"))
    certificate = summary.get("certificate")
    if summary.get("controller") == "external":
        found.append(Badge(label="external controller", state="warning", detail="another program answered, not the experiment's"))
    if certificate is None:
        found.append(Badge(label="no certificate", state="warning", detail="the run asked for none"))
    else:
        state = str(certificate.get("state", "no verdict"))
        label, detail = f"{state}: {certificate.get('kind', 'certificate')}", str(certificate.get("reason", ""))
        found.append(Badge(label=label, state=_COLOURS.get(state, "warning"), detail=detail))
    dropped = summary.get("log", {}).get("dropped", 0)
    if dropped:
        found.append(Badge(label="log incomplete", state="warning", detail=f"{text_of(dropped)} records dropped"))
    found += [
        Badge(label=str(name).replace("_", " "), state="bad", detail=str(value))
        for name, value in summary.get("problems", {}).items()
    ]
    return found


def _tiles(view: RunView, metrics: Mapping[str, Any]) -> list[Tile]:
    """Return a tile for each number but those that only single outputs have: they stand in the table."""
    quantities = quantities_of(view.once(run_measures), view.signals)
    known = [q for q in quantities if metrics[q.name] is not None or q.needs or not (q.per_output and "outputs" in metrics)]
    return [_tile(view, each, metrics[each.name]) for each in known]


def _tile(view: RunView, quantity: Quantity, value: float | None) -> Tile:
    label = capital(quantity.title)
    if value is None and quantity.needs and not any(mark.label == quantity.needs for mark in view.marks):
        return Tile(label=label, value=None, unit=quantity.unit, note=f"no {quantity.needs.rpartition(' ')[2]}")
    if value is None and quantity.absent:
        return Tile(label=label, value=None, unit=quantity.unit, note=quantity.absent, state="warning")
    return Tile(label=label, value=_rounded(value), unit=quantity.unit, note=quantity.note)


def _rounded(value: float | None) -> float | str | None:
    # Below a millionth the digits say nothing; "1e-8" set large would look like a finding.
    return value if value is None or value == 0.0 or abs(value) >= 1e-6 else "≈ 0"


def _facts(view: RunView, summary: Mapping[str, Any]) -> list[tuple[str, str]]:
    run, resolved, slots = view.run, view.run.resolved, int(summary["slots"])
    found = [
        ("Plant", str(resolved.get("plant", {}).get("kind", ""))),
        ("Controller", str(summary["controller"])),
        ("Clock", str(summary["clock"])),
        ("Link", in_short(summary["link"]) if summary["clock"] == "real" else ""),  # in virtual time no frame leaves the process
        ("Sample period", f"{text_of(1e3 * view.period_s)} ms"),
        ("Duration", f"{text_of(float(summary['duration_s']))} s, {text_of(slots)} slot{'s' * (slots != 1)}"),
        ("Seed", str(summary["seed"])),
    ]
    if run.session.get("started"):
        found.append(("Started", run.session["started"]))
    return [(name, value) for name, value in found if value]


class LoggedRun(Struct, frozen=True, kw_only=True):
    """What the page says of one log.

    Attributes:
        name: of the file.
        page: the file of its own page, beside this one.
        failure: why it could not be read; then the rest is empty.
        cells: experiment, seed and clock.
        verdict: certificate, and what went wrong.
        numbers: title with unit to value.
        output: its first output and the reference, None where it has none.
    """

    name: str
    page: str = ""
    failure: str = ""
    cells: tuple[Cell, ...] = (None, None, None)
    verdict: Badge | None = None
    numbers: dict[str, float | None]
    output: Figure | None = None


def logged_run(name: str, page: str, view: RunView, *, drawn: bool) -> LoggedRun:
    """Return what the page says of a run.

    Args:
        name: of its log.
        page: the file of its own page.
        view: the run.
        drawn: whether its output is drawn too.
    """
    summary, panels = view.once(page_summary), output_panels(view) if drawn else []
    titles, units = summary["titles"], summary["units"]
    metrics = in_one_row(summary["metrics"])
    numbers = {with_unit(titles.get(key, key), units.get(key, "")): value for key, value in metrics.items()}
    said = sorted(verdicts(view.run, summary), key=lambda badge: _WORST.index(badge.state))
    wrong = [badge for badge in said if badge.state != "good"]
    certificate = next((badge for badge in said if badge.label.startswith("certified")), None)
    verdict = replace(wrong[0], label=", ".join(badge.label for badge in wrong)) if wrong else certificate or said[0]
    return LoggedRun(
        name=name, page=page, cells=(str(summary["experiment"]), str(summary["seed"]), str(summary["clock"])),
        verdict=replace(verdict, detail=""), numbers=numbers,
        output=replace(panels[0], markers=(), sync=None, height_px=130, note="") if panels else None,
    )  # fmt: skip


def runs_page(folder: str, runs: Sequence[LoggedRun]) -> str:
    """Return the page of a folder as one self-contained HTML page.

    Args:
        folder: its name.
        runs: of its logs, in the order of the table.
    """
    common = Counter(title for run in runs for title, value in run.numbers.items() if value is not None)
    titles = [title for title, _ in common.most_common(MOST_NUMBERS)]
    rows: list[list[Cell]] = []
    for run in runs:
        name = Link(label=run.name, href=quote(os.fsencode(run.page))) if run.page else run.name
        verdict = Badge(label="not read", state="bad") if run.failure else run.verdict
        rows.append([name, *run.cells, verdict, *(run.numbers.get(title) for title in titles)])
    table = Table(columns=["log", "experiment", "seed", "clock", "verdict", *titles], rows=rows, wide=True, searched=True)
    drawn = [(run.name, run.output) for run in runs if run.output is not None]
    intro = "Tick runs to see them alone in one plot; the first two are compared."
    sections = [Section(title="Runs", blocks=(table,), intro=intro)]
    if drawn:
        left = f" The first {MOST_DRAWN} of {len(runs)} are drawn." if len(runs) > MOST_DRAWN else ""
        sections += [
            Section(title="Chosen runs", blocks=_together(drawn)),
            Section(title="Every run", intro=f"The first output of each run and its reference.{left}", columns=3,
                    blocks=tuple(replace(figure, title=name) for name, figure in drawn)),
        ]  # fmt: skip
    failed = [[run.name, run.failure] for run in runs if run.failure]
    if failed:
        sections.append(Section(title="Not read", blocks=(Table(columns=["log", "reason"], rows=failed),)))
    certified = sum(run.verdict is not None and run.verdict.label.startswith("certified") for run in runs)
    tiles = [Tile(label="Logs", value=len(runs)), Tile(label="Certified, nothing wrong", value=certified)]
    tiles += [Tile(label="Not read", value=len(failed), state="bad")] if failed else []
    return Page(f"Runs in {folder}", sections, kicker="hilrig · runs of a folder", tiles=tiles, scripts=("runs.js",),
                footer="Written by hil report from the logs alone.").html()  # fmt: skip


def _together(drawn: Sequence[tuple[str, Figure]]) -> tuple[Block, ...]:
    """One figure for each kind of output, with a curve for each run."""
    kinds: dict[tuple[str, str], list[Series]] = {}
    for name, figure in drawn:
        curve = replace(figure.series[-1], label=name, colour=None, halo=False)
        kinds.setdefault((figure.y_label, figure.y_unit), []).append(curve)
    return tuple(
        Figure(title=capital(label), y_label=label, y_unit=unit, sync=None, height_px=300,
               series=tuple(replace(each, colour=i) for i, each in enumerate(curves)))
        for (label, unit), curves in kinds.items()
    )  # fmt: skip


def report_runs(folder: Path, output: Path | None, *, force: bool) -> tuple[Path, ...]:
    """Write the page of a folder of logs, and the page of each log that has none or an older one.

    Args:
        folder: its ``*.mcap`` are listed by name; where it has none, those below it, as ``pytest --hil-logs`` keeps them.
        output: the page, ``index.html`` in the folder by default; elsewhere it links to no page of a run.
        force: replace a file that is there already and is no page; a page always is replaced.

    Returns:
        the files that were written, the page of the folder first.

    Raises:
        HilError: there is no log, there are too many, or the page cannot be written.
    """
    from hil.log.read import read_run  # of a run in memory there is nothing to read

    logs = sorted(filter(Path.is_file, folder.glob("*.mcap"))) or sorted(filter(Path.is_file, _logs_below(folder)))
    if not logs:
        raise HilError(f"{folder}: holds no .mcap file; hil run EXPERIMENT -o {folder}/a.mcap writes one")
    if len(logs) > MOST_LOGS:
        raise HilError(f"{folder}: holds {len(logs)} logs, at most {MOST_LOGS} stand in one page; move some to another folder")
    remedy = "choose another -o (in Python output=...), or add --force (force=True)"
    target = output or folder / "index.html"
    check_page(target, force=force, remedy=remedy)
    beside = target.resolve().parent == folder.resolve()
    found: list[LoggedRun] = []
    written: list[Path] = []
    for i, log in enumerate(logs):
        name = log.relative_to(folder).as_posix()
        try:
            view = view_of(read_run(log))
            linked = beside and not {*":\\"} & {*name} and _has_page(log, view, target, written)
            page = name.removesuffix("mcap") + "html" if linked else ""
            found.append(logged_run(name, page, view, drawn=i < MOST_DRAWN))
        except HilError as error:
            found.append(LoggedRun(name=name, failure=str(error).removeprefix(f"{log}: "), numbers={}))
    write_output(target, runs_page(folder.resolve().name, found))
    return (target, *written)


def _logs_below(folder: Path) -> Iterator[Path]:
    for where, _, names in islice(os.walk(folder), MOST_FOLDERS):
        yield from (Path(where, name) for name in names if name.endswith(".mcap"))


def _has_page(log: Path, view: RunView, index: Path, written: list[Path]) -> bool:
    page = log.with_suffix(".html")
    if page == index:
        return False
    try:
        check_page(page)
    except HilError:  # another file stands in its place
        return False
    if not page.exists() or page.stat().st_mtime_ns < log.stat().st_mtime_ns:
        write_output(page, render_report(view))
        written.append(page)
    return True
