"""Pages of runs: what stands in them whatever a run says, the commands that write them, and the page of a folder of logs."""

from __future__ import annotations

import os
import shutil
import warnings
from pathlib import Path

import numpy as np
import pytest

import hil
from hil.cli import main
from hil.experiment import Experiment, load_experiment
from hil.log.read import Run
from hil.measure.summary import summarise
from hil.measure.view import view_of
from hil.pages import Badge, Table
from hil.pages.many_runs import compare_page
from hil.pages.run_page import render_report
from hil.pages.sections.summary import events
from hil.pages.sections.time_panels import markers, output_panels
from hil.sweeps.comparison import Comparison, common_quantities
from hil.sweeps.seeds import columns_of, quantities_in
from tests.hil.pages import chromium
from tests.hil.pages.runs import run_of

pytestmark = pytest.mark.usefixtures("short_theory")


def report(run: Run) -> str:
    return render_report(view_of(run))


def test_user_text_cannot_become_markup() -> None:
    run = run_of("dc-motor-hinf", "duration=1", 'name="<script>alert(1)<"', 'description="</script><img src=x onerror=alert(1)>"')
    run.events.append({"slot": 1, "t_s": 0.05, "kind": "<b>", "severity": "<i>", "message": "</td><script>x", "data": {}})
    page = report(run)
    assert "<script>alert" not in page and "<img" not in page and "<b>" not in page and "<i>" not in page
    assert "</td><script>x" not in page
    assert page.count("<script") == page.count("</script>") == 3


@pytest.mark.slow
def test_page_of_twenty_seconds_at_one_kilohertz_stays_below_three_megabytes() -> None:
    assert len(report(run_of("dc-motor-1khz", timed=True)).encode()) < 3_000_000


def test_page_of_a_comparison_takes_its_units_from_the_plants() -> None:
    vtol, motor = (load_experiment(name) for name in ("vtol-hinf", "dc-motor-hinf"))
    values = {name: {m: np.arange(3.0) for m in columns_of(motor)} for name in ("a", "b")}

    def page(*of: Experiment) -> str:
        return compare_page(Comparison(runs=3, values=values, quantities=common_quantities([quantities_in(e) for e in of])))

    assert "squared tracking error (kn\\u00b2 s)" in page(vtol, vtol) and "(rad" not in page(vtol, vtol)
    assert '"largest input"' in page(vtol, vtol), "an input of a pure number has no unit"
    assert "(rad\\u00b2 s)" in page(motor) and "squared" not in page(vtol, motor), "knots and radians have no difference"


def test_report_shows_verdicts_numbers_law_test_and_experiment_text() -> None:
    page = report(run_of("dc-motor-hinf", "duration=20", certify=True))
    for part in ("virtual time", "safety not tripped", "mean-square stable", "agrees with its law", "Squared tracking error"):
        assert part in page
    assert "[[disturbance]]" in page and "reference step" in page
    assert "Lateness" not in page, "a virtual run has no measured times"


def test_report_of_a_timed_run_shows_lateness_and_marks_late_slots() -> None:
    run = run_of("dc-motor-1khz", 'duration="4.1 s"', timed=True)
    page = report(run)
    assert "timing valid" in page and "Round trip" in page and "SCHED_FIFO 60" in page
    late = [m for m in markers(view_of(run)) if m.state == "warning"]
    assert [m.x for m in late] == pytest.approx([1.999, 3.999])
    assert [bool(m.label) for m in late] == [True, False], "the event names the first, slots mark the others"


def test_report_of_a_stopped_run_says_why() -> None:
    page = report(run_of("dc-motor-local", certify=True))
    assert "stopped by safety" in page and "not mean-square stable" in page and "beyond its limit" in page


def test_report_shows_packet_laws_by_their_fates_and_measured_ages() -> None:
    law = 'network.sc.law={kind="packet", latency="60 ms", loss={p_gb=0.1, p_bg=0.5}, duplication=0.2}'
    run = run_of("dc-motor-smith", law, "duration=10", "network.sc.max_age=8", "allow_uncertified=true", certify=True)
    page = report(run)
    assert "age of what was used" in page and "copied" in page and "ages that the chain does not distinguish" in page
    answers = run.arrays["/controller/rows"].copy()
    answers["tau"][-2:] = 30_000, -5
    run.arrays["/controller/rows"] = answers
    assert len(report(run)) < len(page) + 1000, "an age that a foreign controller says and that is none is not counted"


def test_numbers_beyond_all_others_are_shown_without_a_warning() -> None:
    run = run_of("dc-motor-hinf", 'duration="1.5 s"')
    for topic, field in (("/plant/measurement", "angle"), ("/plant/state", "angle")):
        records = run.arrays[topic].copy()
        records[field][-3:] = 1e308, -1e308, np.inf
        run.arrays[topic] = records
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert "1e+308" in report(run) or "inf" in report(run)


def test_report_sets_sojourns_of_a_semi_markov_law_beside_it() -> None:
    page = report(run_of("dc-motor-bursty", 'duration="20 s"'))
    assert "how long mode 0 lasted" in page and "sojourn law" in page


def test_law_test_of_a_few_slots_gives_no_verdict() -> None:
    run = run_of("dc-motor-hinf", 'duration="0.3 s"')
    assert summarise(view_of(run))["network"]["sc"]["p_value"] is None
    page = report(run)
    assert "too few slots" in page and "agrees with its law" not in page


def test_a_law_of_one_mode_may_be_random_and_what_is_before_it_too() -> None:
    """Losses and latencies of a packet law are tested; turns that are drawn, and lose a tenth, are not what the law says."""
    laws = [f'network.{way}.law={{kind="packet", latency="20 ms", loss=0.1}}' for way in ("sc", "ca")]
    assert "nothing is random" not in report(run_of("dc-motor-local", "duration=5", "allow_uncertified=true", *laws))
    lossy = run_of("multisensor-lossy", 'duration="1 s"'), load_experiment("multisensor-lossy")  # with the gains on its file
    page = render_report(view_of(*lossy))
    assert page.count("nothing is random") == 1 and page.count("for random turns, loss 0.1") == 4  # that of the actuator


def test_run_without_a_step_is_not_blamed_for_not_settling() -> None:
    page = report(run_of("smjls-robust-published", 'duration="1 s"'))
    assert "no step" in page and "not settled" not in page and 'class="tile warning"' not in page
    assert "not settled" in report(run_of("dc-motor-hinf", 'duration="2 s"'))


def test_measured_mode_is_held_and_has_no_reference() -> None:
    panels = {p.title: p for p in output_panels(view_of(run_of("vtol-fault-published", 'duration="1 s"')))}
    assert [s.style for s in panels["Detected mode"].series] == ["step"]
    assert [s.label for s in panels["Pitch rate"].series] == ["reference", "pitch rate"]


@pytest.mark.parametrize(
    ("name", "units"),
    [
        ("dc-motor-hinf", ("× T (rad² s)", "last tenth (rad)", "largest input (V)")),
        ("vtol-hinf", ("× T (kn² s)", "last tenth (kn)", "largest input<")),
        ("vtol-fault-published", ("× T (unit² s)", "last tenth (unit)", "horizontal velocity (kn)", "pitch rate (deg/s)")),
    ],
)
def test_summary_states_units(name: str, units: tuple[str, ...]) -> None:
    page = report(run_of(name, 'duration="0.5 s"'))
    assert all(unit in page for unit in units)


def test_events_stand_in_the_order_of_time() -> None:
    run = run_of("dc-motor-hinf", 'duration="1 s"')
    event = {"slot": 1, "severity": "info", "data": {}, "kind": "note"}
    run.events[:] = [{**event, "t_s": 0.7, "message": "the second"}, {**event, "t_s": 0.2, "message": "the first"}]
    page = report(run)
    assert page.index("the first") < page.index("the second")


MARKS = [("warning", "warning"), ("error", "bad"), ("info", "neutral"), (None, "neutral")]


def test_an_event_is_marked_by_its_severity() -> None:
    run = run_of("dc-motor-hinf", 'duration="0.2 s"')
    said = [{"severity": severity} if severity else {} for severity, _ in MARKS]
    run.events[:] = [{"slot": 1, "t_s": 0.05, "data": {}, "kind": "note", "message": "m", **each} for each in said]
    section = events(view_of(run))
    assert section is not None and isinstance(table := section.blocks[0], Table)
    assert table.rows == [[0.05, Badge(label=severity or "info", state=state), "note", "m"] for severity, state in MARKS]  # type: ignore[arg-type]


def test_run_of_one_slot_and_torn_run_are_reported() -> None:
    assert "<!doctype html>" in report(run_of("dc-motor-hinf", 'duration="50 ms"'))
    torn = run_of("dc-motor-hinf", 'duration="2 s"')
    for topic in torn.arrays:
        torn.arrays[topic] = torn.arrays[topic][:0]
    assert "<!doctype html>" in report(torn)


def status_of(*args: str) -> int:
    with pytest.raises(SystemExit) as exit:
        main(list(args))
    return int(exit.value.code or 0)


def test_command_writes_the_page_beside_the_log(tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    assert status_of("run", "dc-motor-hinf", "--clock", "virtual", "--duration", "3", "-o", str(log), "--json") == 0
    before = log.read_bytes()
    assert status_of("report", str(log)) == 0
    page = (tmp_path / "run.html").read_text(encoding="utf-8")
    assert page.startswith("<!doctype html>") and log.read_bytes() == before


@pytest.mark.parametrize("content", [None, b"", b"garbage" * 100, b"\x89MCAP0\r\n" + bytes(200)])
def test_command_refuses_what_is_no_log(tmp_path: Path, capsys: pytest.CaptureFixture[str], content: bytes | None) -> None:
    log, page = tmp_path / "run.mcap", tmp_path / "page.html"
    if content is not None:
        log.write_bytes(content)
    assert status_of("report", str(log), "-o", str(page)) == 2
    assert str(log) in capsys.readouterr().err and not page.exists()


def test_command_never_overwrites_the_log_itself(tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    status_of("run", "dc-motor-hinf", "--clock", "virtual", "--duration", "1", "-o", str(log), "--json")
    before = log.read_bytes()
    assert status_of("report", str(log), "-o", str(log)) == 2 and log.read_bytes() == before
    assert status_of("report", str(log), "-o", str(tmp_path / "absent" / "page.html")) == 2


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("runs")
    for seed in (0, 1):
        hil.run("dc-motor-hinf", seed=seed, duration=2, log=found / f"motor-{seed}.mcap")
    hil.run("omni-push", duration=1, log=found / "omni.mcap")
    (found / "torn.mcap").write_bytes(b"no log" * 9)
    return found


def test_a_folder_has_a_page_and_each_log_its_own(folder: Path) -> None:
    written = hil.report(folder, force=True)
    assert written[0] == folder / "index.html"
    page = written[0].read_text()
    for name in ("motor-0", "motor-1", "omni"):
        assert f'<a href="{name}.html">{name}.mcap</a>' in page and (folder / f"{name}.html").exists()
    assert "torn.mcap" in page and "is no MCAP file" in page and not (folder / "torn.html").exists()
    assert "certified: passivity" in page and "squared tracking error (rad² s)" in page


def test_pages_are_made_again_only_where_the_log_is_newer_and_never_over_other_files(folder: Path) -> None:
    hil.report(folder, force=True)
    index = folder / "index.html"
    index.write_text("my notes")
    with pytest.raises(hil.HilError, match="exists already and is no report"):
        hil.report(folder)
    assert index.read_text() == "my notes"
    assert len(hil.report(folder, force=True)) == 1
    log = folder / "omni.mcap"
    os.utime(log, ns=(log.stat().st_mtime_ns + 10**12,) * 2)
    assert hil.report(folder, force=True)[1:] == (folder / "omni.html",)
    (folder / "omni.html").write_text("my notes")
    os.utime(folder / "omni.html", ns=(0, 0))
    assert len(hil.report(folder, force=True)) == 1
    assert (folder / "omni.html").read_text() == "my notes" and 'href="omni.html"' not in (folder / "index.html").read_text()
    os.utime(folder / "omni.html")  # newer than the log, and still no page of it
    hil.report(folder, force=True)
    assert 'href="omni.html"' not in (folder / "index.html").read_text()
    (folder / "omni.html").unlink()
    (elsewhere,) = hil.report(folder, output=folder.parent / "all.html", force=True)
    assert "href=" not in elsewhere.read_text().split("<main>")[1].split("<footer>")[0]


def test_logs_in_folders_below_are_listed_where_a_folder_has_none_itself(folder: Path, tmp_path: Path) -> None:
    """``pytest --hil-logs`` keeps them in folders named after the tests."""
    below = tmp_path / "logs" / "test_a.py" / "test_step[3]"
    below.mkdir(parents=True)
    shutil.copy(folder / "omni.mcap", below / "omni-0.mcap")
    (tmp_path / "logs" / "not.mcap").mkdir()
    written = hil.report(tmp_path / "logs")
    assert written == (tmp_path / "logs" / "index.html", below / "omni-0.html")
    link = '<a href="test_a.py/test_step%5B3%5D/omni-0.html">test_a.py/test_step[3]/omni-0.mcap</a>'
    assert link in written[0].read_text()
    shutil.copy(folder / "omni.mcap", tmp_path / "logs" / "top.mcap")
    assert len(hil.report(tmp_path / "logs")) == 2 and "test_a.py" not in written[0].read_text()


def test_a_folder_without_logs_and_options_of_one_run_are_refused(tmp_path: Path) -> None:
    with pytest.raises(hil.HilError, match=r"holds no \.mcap file"):
        hil.report(tmp_path)
    with pytest.raises(hil.HilError, match="figures: belongs to the page of a run"):
        hil.report(tmp_path, figures=tmp_path)


@pytest.mark.chromium
def test_rows_are_filtered_and_choose_curves(folder: Path, browser: chromium.Page) -> None:
    index, *_ = hil.report(folder, force=True)
    browser.size(390, 900)
    browser.open(index)
    assert browser.evaluate("document.querySelector('td:has(input)').clientWidth") < 50, "a tick takes no room of its log"
    assert browser.evaluate("document.querySelector('.search [role=status]').getClientRects().length") == 1, "on one line"
    assert browser.evaluate("document.documentElement.scrollWidth <= innerWidth")
    browser.size(1280, 900)
    browser.open(index)
    rows = "[...document.querySelectorAll('table[data-searched] tbody tr')]"
    seen = f"{rows}.filter(r => !r.hidden).map(r => r.cells[1].textContent)"
    assert browser.evaluate(seen) == ["motor-0.mcap", "motor-1.mcap", "omni.mcap", "torn.mcap"]
    field = "document.querySelector('[type=search]')"
    browser.evaluate(f"(i => {{ i.value = 'hinf motor-1'; i.dispatchEvent(new Event('input')); }})({field})")
    assert browser.evaluate(seen) == ["motor-1.mcap"]
    shown = "hilPlots().slice(0, 2).map(p => p.series.slice(1).map(s => s.show))"
    assert browser.evaluate(shown) == [[True, True], [True]]
    browser.evaluate(f"{rows}[1].querySelector('input').click()")
    assert browser.evaluate(shown) == [[False, True], [False]]
    browser.evaluate(f"{rows}[0].querySelector('input').click()")
    said = browser.evaluate("document.querySelector('.differences').textContent")
    assert said.startswith("motor-0.mcap minus motor-1.mcap: ") and "squared tracking error (rad² s) " in said
    assert browser.evaluate("document.documentElement.scrollWidth <= innerWidth")
