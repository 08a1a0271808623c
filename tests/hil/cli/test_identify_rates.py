"""`hil identify rates`: rates of faults and of their detection, from logs."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from design.identification.jump_rates import JumpRate
from tests.hil.cli.conftest import Hil


def test_the_command_reads_logs_and_refuses_one_without_modes(cli: Hil, hil_log: Path) -> None:
    assert cli("run", "vtol-fault", "--duration", "1", "--seed", "2", "-o", "1.mcap")[0] == 0
    shutil.copy("1.mcap", "2.mcap")
    status, out, _ = cli("identify", "rates", "1.mcap", "2.mcap", "--edge", "0.3s", "--json")
    found = [JumpRate(**each) for each in json.loads(out)["rates"]]
    assert status == 0 and found[0].fault is None and {each.after_s for each in found} == {0.0, 0.3}
    of_fault = {(each.source, each.after_s): each.exposure_s for each in found if each.fault is None}
    assert sum(of_fault.values()) == pytest.approx(2.0, abs=0.01)
    assert "1/s, 95 %" in cli("identify", "rates", "1.mcap")[1]
    status, _, err = cli("identify", "rates", "1.mcap", "--detected", "pitch_rate")
    assert status == 2 and "pitch_rate is no mode" in err
    status, _, err = cli("identify", "rates", hil_log)
    assert status == 2 and "no mode 'fault_mode'" in err and "angle" in err
