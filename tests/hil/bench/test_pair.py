"""Two processes between which a link is measured."""

from __future__ import annotations

import os
import sys

import pytest

from hil.bench import Pair

CHILD = (sys.executable, "-c", "import os, sys; print('ready', flush=True)\nfor _ in sys.stdin: print(os.getpid(), flush=True)")


def test_a_pair_that_is_closed_has_ended() -> None:
    pair = Pair(CHILD, CHILD)
    (number,) = pair.drive(1)
    pair.close()
    with pytest.raises(ProcessLookupError):
        os.kill(number, 0)
