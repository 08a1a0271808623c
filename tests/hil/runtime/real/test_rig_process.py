"""The end of the rig's process."""

from __future__ import annotations

import subprocess
import sys

from hil.runtime.real.ending import ENDED

NEVER_CLOSED = """
import threading
from contextlib import ExitStack
from hil.runtime.real.ending import ENDED
from hil.runtime.real.rig_process import _leave
with ExitStack() as link:
    link.callback(threading.Event().wait)
    _leave(ENDED)
"""


def test_a_link_that_never_closes_does_not_keep_the_rig_from_its_end() -> None:
    assert subprocess.run([sys.executable, "-c", NEVER_CLOSED], timeout=60).returncode == ENDED
