"""The page of a folder: every log in it is read, its own page is made where it lacks, and all are listed in one."""

from __future__ import annotations

from pathlib import Path

from hil.errors import HilError
from hil.files.outputs import check_output, write_output
from hil.log.read.run import read_run
from hil.measure.view import RunView, view_of
from hil.pages.run.run_page import render_report
from hil.pages.runs_page import MOST_DRAWN, LoggedRun, logged_run, runs_page

MOST_LOGS = 2000


def report_runs(folder: Path, output: Path | None, *, force: bool) -> tuple[Path, ...]:
    """Write the page of a folder of logs, and the page of each log that has none or an older one.

    Args:
        folder: its ``*.mcap`` are listed by name; folders below it are not read.
        output: the page, ``index.html`` in the folder by default; elsewhere it links to no page of a run.
        force: replace a page of the folder that is there already.

    Returns:
        the files that were written, the page of the folder first.

    Raises:
        HilError: there is no log, there are too many, or the page cannot be written.
    """
    logs = sorted(path for path in folder.glob("*.mcap") if path.is_file())
    if not logs:
        raise HilError(f"{folder}: holds no .mcap file; hil run EXPERIMENT -o {folder}/a.mcap writes one")
    if len(logs) > MOST_LOGS:
        raise HilError(f"{folder}: holds {len(logs)} logs, at most {MOST_LOGS} stand in one page; move some to another folder")
    remedy = "choose another -o (in Python output=..., or force=True)"
    target = check_output(output or folder / "index.html", page=True, fresh=not force, remedy=remedy)
    beside = target.resolve().parent == folder.resolve()
    found: list[LoggedRun] = []
    written: list[Path] = []
    for i, log in enumerate(logs):
        try:
            view = view_of(read_run(log))
            page = _page_of(log, view, target, written) if beside else ""
            found.append(logged_run(log.name, page, view, drawn=i < MOST_DRAWN))
        except HilError as error:
            found.append(LoggedRun(name=log.name, failure=str(error).removeprefix(f"{log}: "), numbers={}))
    write_output(target, runs_page(folder.resolve().name, found))
    return (target, *written)


def _page_of(log: Path, view: RunView, index: Path, written: list[Path]) -> str:
    page = log.with_suffix(".html")
    if page == index or ":" in page.name or "\\" in page.name:
        return ""
    try:
        check_output(page, page=True)
    except HilError:  # another file stands in its place
        return ""
    if page.exists() and page.stat().st_mtime_ns >= log.stat().st_mtime_ns:
        return page.name
    write_output(page, render_report(view))
    written.append(page)
    return page.name
