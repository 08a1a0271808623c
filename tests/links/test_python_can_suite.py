"""python-can's own test of two buses back to back, over `interface="hil"`, without time and with.

The test stands in python-can's source archive and not in its wheel: PYTHON_CAN_SOURCE names where it was unpacked, as `.ci/run`
does. It is under the LGPL and no part of this project.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

OURS = '''
import can
from .back2back_test import Back2BackTestCase

OPTIONS = {options!r}


class TestHil(Back2BackTestCase):
    INTERFACE_1 = INTERFACE_2 = "hil"
    CHANNEL_1 = CHANNEL_2 = "suite"
    TIMEOUT = 5.0  # theirs is 0.1 s, and this machine may be busy
    test_send_periodic_duration = None  # whether a thread starts within 10 ms is the machine's affair

    def setUp(self):
        join = lambda: can.Bus("suite", interface="hil", fd=True, bitrate=self.BITRATE, single_handle=True, **OPTIONS)
        self.bus1, self.bus2 = join(), join()


del Back2BackTestCase
'''


SOURCE = os.environ.get("PYTHON_CAN_SOURCE", "")


@pytest.mark.skipif(not SOURCE, reason="PYTHON_CAN_SOURCE names no source of python-can, see .ci/run")
@pytest.mark.parametrize("options", [{}, {"timed": True, "data_bitrate": 2_000_000}], ids=["untimed", "timed"])
def test_two_buses_back_to_back_as_python_can_tests_its_own(options: dict[str, object], tmp_path: Path) -> None:
    source, test = Path(SOURCE), tmp_path / "test"
    test.mkdir()
    for name in ("__init__.py", "back2back_test.py", "config.py"):
        (test / name).write_text((source / "test" / name).read_text())
    (test / "test_hil.py").write_text(OURS.format(options=options))
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-c", os.devnull, "--rootdir", tmp_path]
    environment = {**os.environ, "CI": "1"}
    done = subprocess.run(
        [*command, "test/test_hil.py"], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=500
    )  # fmt: skip
    passed = re.search(r"(\d+) passed", done.stdout)
    assert done.returncode == 0 and passed is not None and int(passed[1]) >= 12, done.stdout[-4000:] + done.stderr[-2000:]
