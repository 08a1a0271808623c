"""Controllers with the key that know nothing of ours but the guide: in Python over python-can, in C over SocketCAN's frames."""

from __future__ import annotations

import os
import shutil
import struct
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest

from hil.files.keys import make_keys
from tests.foreign_session import drive
from transport.links.can_bus import HilBus

pytestmark = pytest.mark.realtime

HERE = Path(__file__).parents[1]
FRAME = struct.Struct("=IBBBB64s")  # struct canfd_frame


def drive_keyed(folder: Path, channel: str) -> dict[str, Any]:
    """Let whoever answers on the channel with the key drive the motor for 3 s."""
    summary = drive(folder, "dc-motor-hinf", f"can:hil:{channel}?auth={folder}/keys/frames.key")
    assert summary["link_counters"]["refused"] == 0
    return summary


def test_a_keyed_controller_in_python_drives_the_rig(tmp_path: Path) -> None:
    make_keys(tmp_path / "keys")
    channel = f"py{os.getpid()}"
    program = [sys.executable, str(HERE / "foreign_controller_keyed.py"), str(tmp_path / "keys/frames.key"), channel]
    with subprocess.Popen(program) as foreign:
        try:
            drive_keyed(tmp_path, channel)
        finally:
            foreign.kill()


def test_a_keyed_controller_in_c_drives_the_rig(tmp_path: Path) -> None:
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        pytest.skip("no C compiler: apt-get install gcc libc6-dev")
    make_keys(tmp_path / "keys")
    channel, binary = f"c{os.getpid()}", tmp_path / "keyed"
    source = HERE / "foreign_controller_keyed.c"
    subprocess.run([compiler, "-O2", "-Wall", "-Wextra", "-Werror", "-o", binary, source], check=True)
    program = [str(binary), str(tmp_path / "keys/frames.key"), "-"]
    with (
        HilBus(channel, can_filters=[{"can_id": 0x100, "can_mask": 0x7C0, "extended": False}]) as bus,
        subprocess.Popen(program, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0) as foreign,
    ):
        ended = threading.Event()

        def to_it() -> None:
            assert foreign.stdin is not None
            while not ended.is_set():
                frame = bus.recv_frame(0.1)
                if frame is not None:
                    foreign.stdin.write(FRAME.pack(frame[0], len(frame[2]), 0, 0, 0, frame[2]))

        def from_it() -> None:
            assert foreign.stdout is not None
            while len(data := foreign.stdout.read(FRAME.size)) == FRAME.size:
                identifier, length, _, _, _, payload = FRAME.unpack(data)
                bus.send_frame(identifier, payload[:length])

        threads = [threading.Thread(target=each) for each in (to_it, from_it)]
        for thread in threads:
            thread.start()
        try:
            drive_keyed(tmp_path, channel)
        finally:
            ended.set()
            threads[0].join()
            foreign.kill()
            threads[1].join()
