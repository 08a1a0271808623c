from pathlib import Path

import numpy as np
import pytest

from hil.cli import main
from hil.experiment import Experiment, load_experiment
from hil.log.read.run import Run
from hil.measure.summary import summarise
from hil.measure.view import view_of
from hil.pages.html.figures import Badge, Table
from hil.pages.many_runs import compare_page
from hil.pages.run_page import render_report
from hil.pages.sections.summary import events
from hil.pages.sections.time_panels import markers, output_panels
from hil.sweeps.comparison import Comparison, common_quantities
from hil.sweeps.seeds import columns_of, quantities_in
from tests.hil.pages.runs import run_of


def report(run: Run) -> str:
    return render_report(view_of(run))


def test_report_shows_verdicts_numbers_law_test_and_experiment_text() -> None:
    page = report(run_of("dc-motor-hinf"))
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
    page = report(run_of("dc-motor-local"))
    assert "stopped by safety" in page and "not mean-square stable" in page and "beyond its limit" in page


def test_report_shows_packet_laws_by_their_fates_and_measured_ages() -> None:
    law = 'network.sc.law={kind="packet", latency="60 ms", loss={p_gb=0.1, p_bg=0.5}, duplication=0.2}'
    page = report(run_of("dc-motor-smith", law, "network.sc.max_age=8", "allow_uncertified=true"))
    assert "age of what was used" in page and "copied" in page and "ages that the chain does not distinguish" in page


def test_report_sets_sojourns_of_a_semi_markov_law_beside_it() -> None:
    page = report(run_of("dc-motor-bursty", 'duration="20 s"'))
    assert "how long mode 0 lasted" in page and "sojourn law" in page


def test_user_text_cannot_become_markup() -> None:
    run = run_of("dc-motor-hinf", 'name="<script>alert(1)<"', 'description="</script><img src=x onerror=alert(1)>"')
    run.events.append({"slot": 1, "t_s": 0.05, "kind": "<b>", "severity": "<i>", "message": "</td><script>x", "data": {}})
    page = report(run)
    assert "<script>alert" not in page and "<img" not in page and "<b>" not in page and "<i>" not in page
    assert "</td><script>x" not in page
    assert page.count("<script") == page.count("</script>") == 3


@pytest.mark.slow
def test_page_of_twenty_seconds_at_one_kilohertz_stays_below_three_megabytes() -> None:
    assert len(report(run_of("dc-motor-1khz", timed=True)).encode()) < 3_000_000


def test_law_test_of_a_few_slots_gives_no_verdict() -> None:
    run = run_of("dc-motor-hinf", 'duration="0.3 s"')
    assert summarise(view_of(run))["network"]["sc"]["p_value"] is None
    page = report(run)
    assert "too few slots" in page and "agrees with its law" not in page


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


@pytest.mark.parametrize(("severity", "state"), MARKS)
def test_an_event_is_marked_by_its_severity(severity: str | None, state: str) -> None:
    run = run_of("dc-motor-hinf", 'duration="0.2 s"')
    said = {"severity": severity} if severity else {}
    run.events[:] = [{"slot": 1, "t_s": 0.05, "data": {}, "kind": "note", "message": "m", **said}]
    section = events(view_of(run))
    assert section is not None and isinstance(table := section.blocks[0], Table)
    assert table.rows == [[0.05, Badge(label=severity or "info", state=state), "note", "m"]]  # type: ignore[arg-type]


def test_page_of_a_comparison_takes_its_units_from_the_plants() -> None:
    vtol, motor = (load_experiment(name) for name in ("vtol-hinf", "dc-motor-hinf"))
    values = {name: {m: np.arange(3.0) for m in columns_of(motor)} for name in ("a", "b")}

    def page(*of: Experiment) -> str:
        return compare_page(Comparison(runs=3, values=values, quantities=common_quantities([quantities_in(e) for e in of])))

    assert "squared tracking error (kn\\u00b2 s)" in page(vtol, vtol) and "(rad" not in page(vtol, vtol)
    assert '"largest input"' in page(vtol, vtol), "an input of a pure number has no unit"
    assert "(rad\\u00b2 s)" in page(motor) and "error (kn" not in page(vtol, motor)


def test_run_of_one_slot_and_torn_run_are_reported() -> None:
    assert "<!doctype html>" in report(run_of("dc-motor-hinf", 'duration="50 ms"'))
    torn = run_of("dc-motor-hinf", 'duration="2 s"')
    for topic in torn.arrays:
        torn.arrays[topic] = torn.arrays[topic][:0]
    assert "<!doctype html>" in report(torn)


def hil(*args: str) -> int:
    with pytest.raises(SystemExit) as exit:
        main(list(args))
    return int(exit.value.code or 0)


def test_command_writes_the_page_beside_the_log(tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    assert hil("run", "dc-motor-hinf", "--clock", "virtual", "--duration", "3", "-o", str(log), "--json") == 0
    before = log.read_bytes()
    assert hil("report", str(log)) == 0
    page = (tmp_path / "run.html").read_text(encoding="utf-8")
    assert page.startswith("<!doctype html>") and log.read_bytes() == before


@pytest.mark.parametrize("content", [None, b"", b"garbage" * 100, b"\x89MCAP0\r\n" + bytes(200)])
def test_command_refuses_what_is_no_log(tmp_path: Path, capsys: pytest.CaptureFixture[str], content: bytes | None) -> None:
    log, page = tmp_path / "run.mcap", tmp_path / "page.html"
    if content is not None:
        log.write_bytes(content)
    assert hil("report", str(log), "-o", str(page)) == 2
    assert str(log) in capsys.readouterr().err and not page.exists()


def test_command_never_overwrites_the_log_itself(tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    hil("run", "dc-motor-hinf", "--clock", "virtual", "--duration", "1", "-o", str(log), "--json")
    before = log.read_bytes()
    assert hil("report", str(log), "-o", str(log)) == 2 and log.read_bytes() == before
    assert hil("report", str(log), "-o", str(tmp_path / "absent" / "page.html")) == 2
