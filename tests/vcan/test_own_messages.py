"""The guide's drive, with CAN messages of its own on a real vcan0: in virtual time nothing is late, every command exact."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from hil.session.replay.over_link import ask_process
from tests.realtime.test_own_messages import ONE_BIT_V, bench, block, drive, laws_and_commands, run_of

pytest_plugins = ["pytester"]
pytestmark = pytest.mark.vcan


@pytest.mark.usefixtures("virtual_time")
def test_over_a_real_vcan_each_sample_has_the_command_of_its_law_and_the_motor_tracks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session = run_of(tmp_path, "can:socketcan:vcan0", "duration=8")
    assert session.status == 0 and session.summary["timing"]["valid"]
    last = 0.0
    for slot, (law, command) in sorted(laws_and_commands(session.run).items()):
        last = command if law is not None else last
        assert math.isclose(command, last if law is None else law, abs_tol=ONE_BIT_V), slot
    assert session.metrics["sse_after_5s"] < 0.06
    monkeypatch.chdir(tmp_path)  # a log says no folder
    with drive(tmp_path, "socketcan", "vcan0"):  # begun anew, and asked what was asked
        again = ask_process(session.run, "can:socketcan:vcan0")
    assert again.compared > 100 and again.different == 0, again.differences


@pytest.mark.usefixtures("virtual_time")
def test_the_test_of_the_guide_passes_over_a_real_vcan(pytester: pytest.Pytester) -> None:
    experiment = bench(pytester.path)
    experiment.write_text(experiment.read_text().replace('"can:hil:bench"', '"can:socketcan:vcan0"'))
    pytester.makepyfile(block("python", 1).replace('"hil", "bench"', '"socketcan", "vcan0"'))
    pytester.runpytest_subprocess("-p", "no:cacheprovider", "-p", "no:hypothesispytest").assert_outcomes(passed=1)
