"""Process replay of the controllers of others: each one's own log beside what its program answers now.

    python -m tests.process_replay             # compare; a line for each field that differs, status 1
    python -m tests.process_replay --update    # record the logs anew: a wanted change, seen in review

A log is a session of two seconds in real time over `can:hil`. Only the answers are compared, question by question, so neither
machine nor load matters (`hil.session.replay.over_link`).
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from hil.log.read import read_run
from hil.session.replay.over_link import AnswerComparison, ask_process
from tests.forked_program import forked

DATA: Final = Path(__file__).with_name("data")
PROGRAMS: Final = {"foreign_controller": Path(__file__).with_name("foreign_controller.py")}
"""Log to the program that answered in it: the guide's own external controller."""

EXPERIMENT: Final = ("dc-motor-hinf", "--set", "reference.0.at=0.2", "--set", "limits.watchdog_slots=40", "--duration", "2")


@contextmanager
def answering(program: Path) -> Iterator[str]:
    """Run a controller's program; give the URI of its link."""
    channel = f"replay{os.getpid()}"
    with forked([str(program), channel]):
        yield f"can:hil:{channel}"


def asked(name: str, program: Path | None = None) -> AnswerComparison:
    """Put a log's questions to its program, or to another one."""
    with answering(program or PROGRAMS[name]) as uri:
        return ask_process(read_run(DATA / f"{name}.mcap"), uri, name)


def record(name: str) -> None:
    """Record a log anew."""
    with answering(PROGRAMS[name]) as uri:
        subprocess.run(
            [sys.executable, "-m", "hil", "run", *EXPERIMENT, "--clock", "real", "--external", "--link", uri, "--quiet",
             "--force", "-o", str(DATA / f"{name}.mcap")], check=True,
        )  # fmt: skip


def main(words: Sequence[str]) -> int:
    """Compare, or record with `--update`; return 1 if an answer differs."""
    different = 0
    for name in PROGRAMS:
        if "--update" in words:
            record(name)
        found = asked(name)
        print(*found.differences, f"{name}: {found.different} of {found.compared} answers differ", sep="\n")
        different += found.different
    return int(bool(different))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
