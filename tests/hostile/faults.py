"""One fault at a random instant of a session: a signal, frames of another program, a second controller, or a log that is gone."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Final

import can
import zenoh

from transport.links.can_bus import HilBus
from transport.links.contract import control
from transport.links.zenoh_link import config, zenoh_directory

SIGNALS: Final = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGSTOP, signal.SIGHUP, signal.SIGQUIT)
ENDED: Final = {0, 1, 2, 3, 5, 6, -signal.SIGKILL, *(128 + each for each in SIGNALS[1:] if each != signal.SIGSTOP)}


@dataclass(frozen=True, slots=True, kw_only=True)
class Aim:
    """Where a fault comes.

    Args:
        folder: of the session; its log is x.mcap.
        uri: of its link.
        session: its process.
        draw: decides everything.
    """

    folder: Path
    uri: str
    session: int
    draw: Random


Put = Callable[[bytes, bool], None]


def children(pid: int) -> list[int]:
    """Return the children of a process."""
    try:
        return [int(each) for each in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except OSError:
        return []


def by_signal(aim: Aim) -> str:
    """A signal to the session or one of its processes; a stopped one goes on after a while."""
    pids = children(aim.session)
    target, number = aim.draw.choice([aim.session, *pids]), aim.draw.choice(SIGNALS)
    with suppress(ProcessLookupError):
        os.kill(target, number)
        if number == signal.SIGSTOP:
            time.sleep(aim.draw.uniform(0.0, 1.5))
            os.kill(target, signal.SIGCONT)
    return f"{signal.Signals(number).name} to {'the session' if target == aim.session else 'a child'}"


@contextmanager
def on_the_link(uri: str, received: list[bytes]) -> Iterator[Put]:
    """Send on a link as another program: bytes, and whether as the controller; keep what the rig says."""
    if uri.startswith("can:hil:"):
        with HilBus(uri.rpartition(":")[2]) as bus:

            def put(data: bytes, as_controller: bool) -> None:
                with suppress(can.CanError, OSError):
                    bus.frames.send_frame(0x140 if as_controller else 0x100, data)
                    while (frame := bus.frames.recv_frame(0.0)) is not None:
                        received.append(frame[2])

            yield put
    else:
        endpoint = f"unixsock-stream/{zenoh_directory()}/{uri.rpartition('=')[2]}"
        with zenoh.open(config("controller", endpoint, {})) as session:
            took = zenoh.handlers.Callback(lambda sample: received.append(sample.payload.to_bytes()), indirect=False)
            session.declare_subscriber("hil/*/sensor", took)
            name = uri.rpartition("=")[2]
            yield lambda data, as_controller: session.put(f"hil/{name}/{'control' if as_controller else 'sensor'}", data)


def by_frames(aim: Aim) -> str:
    """Half a second of frames: garbage, answers to nothing, the rig's own frames again, and old questions."""
    received: list[bytes] = []
    with on_the_link(aim.uri, received) as put:
        end = time.monotonic() + 0.5
        while time.monotonic() < end:
            own = aim.draw.choice(received) if received else b""
            kind = aim.draw.randrange(4)
            if kind == 0:
                put(aim.draw.randbytes(aim.draw.choice([0, 1, 8, 32, 48, 64])), bool(aim.draw.getrandbits(1)))
            elif kind == 1:
                put(control(aim.draw.choice([0, 1, 2**31, 2**32 - 1, 2**32 - 2])), True)
            else:
                put(own, kind == 2)
            time.sleep(0.002)
    return "frames of another program"


def by_a_second_controller(aim: Aim) -> str:
    """Another controller of ours on the same link, on another machine as far as claims go."""
    (aim.folder / "claims").mkdir(mode=0o700)
    command = [sys.executable, "-P", "-m", "hil", "controller", "dc-motor-hinf", "--link", aim.uri]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL, env=os.environ | {
        "HIL_CLAIM_DIR": str(aim.folder / "claims"),
    }) as process:  # fmt: skip
        with suppress(subprocess.TimeoutExpired):
            process.wait(4.0)
        process.kill()
    return "a second controller"


def by_a_log_that_is_gone(aim: Aim) -> str:
    """The log's name is taken away, or given to another file."""
    log = aim.folder / "x.mcap"
    with suppress(OSError):
        if aim.draw.getrandbits(1):
            log.unlink()
        else:
            (aim.folder / "other").write_bytes(b"not a log")
            (aim.folder / "other").replace(log)
    return GONE


GONE: Final = "a log that is gone"

KINDS: Final[tuple[Callable[[Aim], str], ...]] = (by_signal, by_signal, by_signal, by_frames, by_a_second_controller,
                                                  by_a_log_that_is_gone)  # fmt: skip
"""Half of all faults are signals."""


def fault(aim: Aim) -> str:
    """Let one come; return what it was, `GONE` first where it is that."""
    alone = aim.uri.startswith("local")
    kind = aim.draw.choice([each for each in KINDS if not (alone and each in (by_frames, by_a_second_controller))])
    return f"{kind(aim)} over {aim.uri}"
