"""Of a run whose controller is an external program nothing is claimed: in the verdict, the log, the page and a test's report.

The program is the guide's own with another gain: the plant leaves its limits.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from hil import report
from hil.log.read import read_run
from hil.measure.summary import summarise
from hil.measure.view import view_of

pytest_plugins = ["pytester"]

PROGRAM = Path(__file__).parents[1] / "foreign_controller.py"
CHANGES = ("reference.0.at=0.2", "limits.watchdog_slots=40")
UNDECIDED = "the controller is not the experiment's: an external program answers on the link, not 'hinf'"


@contextmanager
def diverging(folder: Path, channel: str) -> Iterator[None]:
    """The guide's controller with a gain that no loop of the motor is stable with."""
    program, changed = re.subn(r"GAIN, PERIOD_NS = -0\.08,", "GAIN, PERIOD_NS = -0.6,", PROGRAM.read_text(encoding="utf-8"))
    assert changed == 1
    (folder / "controller.py").write_text(program, encoding="utf-8")
    foreign = subprocess.Popen([sys.executable, str(folder / "controller.py"), channel])
    try:
        yield
    finally:
        foreign.kill()
        foreign.wait()


def test_a_run_that_an_external_controller_drives_out_of_its_limits_is_nowhere_called_certified(tmp_path: Path) -> None:
    channel, log = f"ext{os.getpid()}", tmp_path / "run.mcap"
    with diverging(tmp_path, channel):
        done = subprocess.run(
            [sys.executable, "-m", "hil", "run", "dc-motor-hinf", "--clock", "real", "--external", "--link", f"can:hil:{channel}",
             "--quiet", "-o", str(log), *(word for change in CHANGES for word in ("--set", change))],
            cwd=tmp_path, capture_output=True, text=True, timeout=200, env={**os.environ, "COLUMNS": "200"},
        )  # fmt: skip
    assert done.returncode == 3, done.stderr  # stopped by safety
    said = {line.split()[0]: line.split(maxsplit=1)[-1] for line in done.stdout.splitlines() if line and line[0] != " "}
    assert said["controller"] == "external: not the experiment's"
    assert said["certificate"] == f"undecided, mean-square stability: {UNDECIDED}"
    assert "link_controller" not in said

    summary = summarise(view_of(read_run(log)))
    assert summary["controller"] == "external" and summary["safety"] and summary["slots"] > 0
    certificate = summary["certificate"]
    assert (certificate["state"], certificate["reason"], certificate["stable"]) == ("undecided", UNDECIDED, False)
    assert certificate.get("number") is None
    assert certificate["the named controller would be"].startswith("certified, mean-square stability: ")

    page = re.sub(r"(?s)<(script|style).*?</\1>", "", report(log)[0].read_text(encoding="utf-8"))
    assert "external controller" in page and UNDECIDED.replace("'", "&#x27;") in page
    assert "Theory and emulation" not in page and "from the gains that ran" not in page
    the_named_one = page.count("certified, mean-square stability: the loop is")
    assert len(re.findall(r"\bcertified\b", page)) == 1 == the_named_one


def test_a_test_may_ask_for_an_external_controller_and_its_report_says_whose_it_was(
    pytester: pytest.Pytester, tmp_path: Path
) -> None:
    channel = f"extpy{os.getpid()}"
    pytester.makepyfile(
        f"""
        def test_my_controller(hil):
            session = hil.run("dc-motor-hinf", set={list(CHANGES)!r}, clock="real", link="can:hil:{channel}", external=True)
            assert session.summary["controller"] == "external"
            assert session.status == 0
        """
    )
    with diverging(tmp_path, channel):
        result = pytester.runpytest_subprocess("-p", "no:cacheprovider", "-p", "no:hypothesispytest", "--junitxml=report.xml")
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(["*status 3, real time*", "*safety:*"])
    assert 'name="hil_verdict" value="undecided"' in (pytester.path / "report.xml").read_text(encoding="utf-8")
