"""Generated controllers as processes, and a rig in virtual time that asks them over a real link, slot by slot.

The rig waits for every answer, so no result depends on how fast the machine is.
"""

from __future__ import annotations

import shutil
import struct
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest

from hil.cli.new_external import Language, LinkKind, external_controller, program_files
from hil.log.read import Run
from hil.log.topics import channels_of
from hil.log.write import MemorySink
from hil.rig.loop import Loop
from hil.rig.session_link import link_of
from hil.runtime.clock import monotonic_ns
from hil.runtime.nodes import KEY_BYTES, session_wire
from hil.runtime.nodes.rig import Rig
from hil.runtime.real.exchange import Handshake
from hil.runtime.slot import OnFrame, Slot
from tests.forked_program import forked
from transport.links import Link
from transport.links.can_bus import HilBus
from transport.links.can_identifiers import filters
from transport.links.opening import open_link

PATIENCE_S = 60.0
FRAME = struct.Struct("=IBBBB64s")  # struct canfd_frame


def generate(
    folder: Path, loop: Loop, language: Language, kind: LinkKind = "can", keyed: bool = False, level: str = "-O0"
) -> list[str]:
    """Write the program of a loop's controller, compile it where it is C; return the words that start it, all but the link.

    Args:
        folder: of the program.
        loop: composed.
        language: of the program.
        kind: of its link.
        keyed: it has a key.
        level: of the compiler: ``-O2`` takes three times as long, so that it is asked for where it matters.
    """
    folder.mkdir(parents=True, exist_ok=True)
    files = program_files(external_controller(loop, loop.experiment.name, kind, keyed), "drive", language)
    for name, text in files.items():
        (folder / name).write_text(text)
    if language == "python":
        return [sys.executable, str(folder / "drive.py")]
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        pytest.skip("no C compiler: apt-get install gcc libc6-dev")
    words = [compiler, "-std=c99", "-Wall", "-Wextra", "-Werror", level, "-o", "drive", "drive.c", "hilrig.c"]
    subprocess.run(words, cwd=folder, check=True)
    return [str(folder / "drive")]


@contextmanager
def runs(words: Sequence[str], fresh: bool = False) -> Iterator[None]:
    """A program beside the block, ended with it; one in Python is forked where nothing asks for a fresh start."""
    if words[0] == sys.executable and not fresh:
        with forked(words[1:]):
            yield
        return
    with subprocess.Popen(words) as process:
        try:
            yield
        finally:
            process.kill()


@contextmanager
def c_on_hil(words: Sequence[str], loop: Loop, channel: str, options: str = "") -> Iterator[None]:
    """A program in C whose standard input and output are the frames of a channel of `can:hil`."""
    link = link_of(loop.rig, f"can:hil:{channel}{options}")
    ids, framing = link.identifiers, link.traits.can
    assert ids is not None and framing is not None
    with (
        HilBus(channel, can_filters=filters(ids.sensors), fd=framing.fd) as bus,
        subprocess.Popen([*words, "-"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0) as program,
    ):
        ended = threading.Event()
        to, of = program.stdin, program.stdout
        assert to is not None and of is not None

        def to_it() -> None:
            while not ended.is_set():
                frame = bus.frames.recv_frame(0.1)
                if frame is not None:
                    to.write(FRAME.pack(frame[0], len(frame[2]), 0, 0, 0, frame[2]))

        def from_it() -> None:
            while len(data := of.read(FRAME.size)) == FRAME.size:
                identifier, length, _, _, _, payload = FRAME.unpack(data)
                bus.frames.send_frame(identifier, payload[:length])

        threads = [threading.Thread(target=each) for each in (to_it, from_it)]
        for thread in threads:
            thread.start()
        try:
            yield
        finally:
            ended.set()
            threads[0].join()
            program.kill()
            threads[1].join()


class _Asking:
    """Asks over a link, each frame so many times, and waits for the answer to this slot."""

    def __init__(self, link: Link, period_ns: int, times: int) -> None:
        self._link, self._period_ns, self._times = link, period_ns, times

    def ask(self, t_ns: int, frames: Sequence[bytes]) -> None:
        for frame in frames:
            for _ in range(self._times):
                self._link.send(frame)

    def answer(self, t_ns: int, on_frame: OnFrame) -> None:
        limit = monotonic_ns() + round(1e9 * PATIENCE_S)
        while (left := limit - monotonic_ns()) > 0:
            frame = self._link.receive(left / 1e9)
            if frame is not None and on_frame(frame):
                return
        raise AssertionError(f"slot {t_ns // self._period_ns}: no answer within {PATIENCE_S:g} s")


def asked_over(loop: Loop, seed: int, uri: str, times: int = 1) -> Run:
    """Run a loop's rig in virtual time; whoever is on the link answers.

    Args:
        loop: composed.
        seed: of the run.
        uri: of the link.
        times: so often comes each frame.
    """
    e = loop.experiment
    sink = MemorySink(channels_of(loop))
    wire = session_wire(bytes(KEY_BYTES), e.slots)
    with open_link(link_of(loop.rig, uri).uri, "rig") as link:
        assert Handshake(link, PATIENCE_S, lambda: False, monotonic_ns, wire).greet().answered
        rig = Rig(loop, seed, sink, channels_of(loop), lambda: None, wire)
        slot = Slot(rig, _Asking(link, e.period_ns, times), sink.commit)
        for k in range(e.slots):
            slot.run(k * e.period_ns)
    return Run.from_memory(sink, summary=dict(rig.outcome()))
