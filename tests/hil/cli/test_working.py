"""What computes for long says so on a terminal while it does, and ends with Ctrl-C."""

from __future__ import annotations

import os
import pty
import re
import signal
import subprocess
import threading
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from select import select

import pytest

from hil.api import face
from hil.cli.terminal import Working
from tests.hil.cli.conftest import Hil
from tests.waiting import LIMIT_S, until
from tests.warm_hil import hil_command

LARGE = """
name = "large"
period = "50 ms"
duration = "5 s"
allow_uncertified = true
[plant]
kind = "dc-motor"
[controller]
kind = {controller}
[network.sc.law]
kind = "semi-markov"
matrix = [[0.0, 1.0], [1.0, 0.0]]
sojourn = [{{ law = "geometric", p = 0.5 }}, {{ law = "discrete-weibull", q = 0.6, beta = 0.8 }}]
[network.ca.law]
kind = "semi-markov"
matrix = [[0.0, 1.0], [1.0, 0.0]]
sojourn = [{{ law = "geometric", p = 0.5 }}, {{ law = "discrete-weibull", q = 0.6, beta = {tail} }}]
"""
"""A network of many modes: with `tail = 1.1` its certificate takes more than half a minute."""
AGES = 28
CLIMBING = str([[0.9 * (j == min(i + 1, AGES - 1)) + 0.1 * (j == 0) for j in range(AGES)] for i in range(AGES)])
CROWDED = f'''
name = "crowded"
period = "50 ms"
duration = "5 s"
allow_uncertified = true
[plant]
kind = "dc-motor"
[controller]
kind = "local"
gain = [[-0.005]]
[network]
sc.law = {{ kind = "markov", matrix = {CLIMBING} }}
ca.law = {{ kind = "markov", matrix = {CLIMBING} }}
'''
"""784 modes of 56 states: no eigenvalue is looked for, and sums of powers take some twenty seconds."""


@contextmanager
def in_a_terminal(folder: Path, *arguments: str) -> Iterator[tuple[Future[subprocess.CompletedProcess[str]], int]]:
    """Run ``hil ARGUMENTS`` in a terminal of its own beside the block; give its end to come, and the terminal's other side."""
    ours, theirs = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "120"}
    with ThreadPoolExecutor(1) as beside:
        asked = partial(hil_command, cwd=folder, env=environment, terminal=os.ttyname(theirs), errors_too=True)
        done = beside.submit(asked, *arguments)
        try:
            yield done, ours
        finally:
            if not done.done():
                os.killpg(os.tcgetpgrp(ours), signal.SIGKILL)
            done.result()
            os.close(theirs)
            os.close(ours)


def read(terminal: int) -> str:
    """Return what came on a terminal; nothing where nothing comes for a while, or where it was closed."""
    try:
        return os.read(terminal, 1 << 16).decode(errors="replace") if select([terminal], [], [], 0.05)[0] else ""
    except OSError:
        return ""


@pytest.mark.parametrize(
    ("title", "arguments"),
    [
        ("large: its loop", ("controller", "large.toml", "--link", "zenoh:tcp/127.0.0.1:7455")),
        ("dc-motor h2 applied", ("design", "large.toml")),
        ("dc-motor, lqr without a network", ("design", "large.toml", "--local", "lqr")),
        ("gains of large", ("solve", "designed.toml")),
        ("computing", ("run", "large.toml", "-o", "large.mcap")),
        ("computing", ("run", "crowded.toml", "-o", "large.mcap")),
        ("large", ("sweep", "large.toml", "--runs", "50")),
    ],
)
def test_a_long_computation_is_seen_on_a_terminal_and_ends_with_ctrl_c(
    tmp_path: Path, title: str, arguments: tuple[str, ...]
) -> None:
    (tmp_path / "large.toml").write_text(LARGE.format(controller='"h2"', tail=1.1))
    (tmp_path / "designed.toml").write_text(LARGE.format(controller='"designed"\nobjective = "h2"', tail=1.1))
    (tmp_path / "crowded.toml").write_text(CROWDED)
    made = set(tmp_path.iterdir())
    with in_a_terminal(tmp_path, *arguments) as (done, terminal):
        seen = ""

        def shown() -> bool:
            nonlocal seen
            seen += read(terminal)
            assert not done.done(), seen
            return title in seen

        until(shown, f"{title!r} on the terminal")
        group = os.tcgetpgrp(terminal)
        os.write(terminal, b"\x03")  # as Ctrl-C comes: to every process of the command
        until(lambda: read(terminal) == "" and done.done(), "its end", LIMIT_S)
        assert done.result().returncode == 130
    with pytest.raises(ProcessLookupError):
        os.killpg(group, 0)  # nothing that it started is left
    assert set(tmp_path.iterdir()) == made


def test_in_a_pipe_a_line_says_now_and_then_how_far_it_is(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:  # fmt: skip
    said, working = "", Working("motor, gains", 3)
    soon = working._done.wait
    monkeypatch.setattr(working._done, "wait", lambda _: soon(0.001))

    def told(text: str) -> bool:
        nonlocal said
        said += capsys.readouterr().err
        return text in said

    before = threading.active_count()
    with working as watch:
        until(lambda: told("hil: motor, gains ("), "the title")
        watch.counted(2, what="a\nb")
        until(lambda: told("hil: motor, gains, a\\nb: 2 of 3 ("), "a count")
        lasted, left = re.findall(r"2 of 3 \((\d+) s, about (\d+) s left\)\n", said)[0]
        assert int(lasted) == 2 * int(left), "a third is left"
        watch("h2", 1, 4, 0.123456789)
        until(lambda: told("hil: motor, gains: h2 norm 0.123457 ("), "a norm")
    assert threading.active_count() == before
    assert capsys.readouterr().out == "" and said.endswith(" s left)\n")


def test_a_page_with_own_modules_has_one_thread_as_they_are_watched_from_a_fork(
    cli: Hil, tmp_path: Path, hil_log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:  # fmt: skip
    threads = []
    monkeypatch.setattr(face, "report", lambda *_, **__: threads.append(threading.active_count()) or [hil_log])
    assert cli("report", str(hil_log), "--folder", str(tmp_path))[0] == 0
    assert threads == [threading.active_count()]


def test_nothing_is_drawn_where_no_browser_looks(cli: Hil) -> None:
    status, _, err = cli("design", "wall", "--delay", "0", "--json")
    assert (status, err) == (0, "")
