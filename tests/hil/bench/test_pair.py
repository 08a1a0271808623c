"""Two processes between which a link is measured."""

from __future__ import annotations

import os
import sys
from contextlib import ExitStack
from pathlib import Path

import pytest

from hil.bench import open_pair

CHILD = (sys.executable, "-c", "import os, sys; print('ready', flush=True)\nfor _ in sys.stdin: print(os.getpid(), flush=True)")


def test_a_pair_that_is_closed_has_ended() -> None:
    with ExitStack() as stack:
        ask = open_pair(stack, lambda: (CHILD, CHILD))
        assert not isinstance(ask, str)
        (number,) = ask("1")
    with pytest.raises(ProcessLookupError):
        os.kill(number, 0)


def test_a_pair_of_which_one_does_not_begin_says_why_and_the_other_has_ended(tmp_path: Path) -> None:
    program = f"import os; open({str(tmp_path / 'pid')!r}, 'w').write(str(os.getpid())); print('ready', flush=True); input()"
    first = (sys.executable, "-c", program)
    with ExitStack() as stack:
        assert open_pair(stack, lambda: (first, (sys.executable, "-c", "print('no such bus')"))) == "no such bus"
        with pytest.raises(ProcessLookupError):
            os.kill(int((tmp_path / "pid").read_text()), 0)
