from pathlib import Path

import numpy as np
import pytest

from hil.cli import main
from hil.experiment import Experiment, load_experiment
from hil.log.read.run import Run
from hil.measure.view import view_of
from hil.pages.many_runs import compare_page
from hil.pages.run_page import render_report
from hil.sweeps.comparison import Comparison, common_quantities
from hil.sweeps.seeds import columns_of, quantities_in
from tests.hil.pages.runs import run_of


def report(run: Run) -> str:
    return render_report(view_of(run))


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


def test_run_without_a_step_is_not_blamed_for_not_settling() -> None:
    page = report(run_of("smjls-robust-published", 'duration="1 s"'))
    assert "no step" in page and "not settled" not in page and 'class="tile warning"' not in page
    assert "not settled" in report(run_of("dc-motor-hinf", 'duration="2 s"'))


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
