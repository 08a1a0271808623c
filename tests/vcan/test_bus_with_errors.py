"""A vcan behind which a bus with time stands: SocketCAN programs see arbitration, error frames and bus-off."""

from __future__ import annotations

import shutil
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic_ns

import can
import pytest

from tests.links.test_timed_bus_faults import BUS_OFF, RESTARTED, error_frames
from tests.links.test_vcan_faults import bus as own_vcan
from tests.waiting import LIMIT_S, ended, until
from transport.can_bus_model.disturbances import BusFault
from transport.links.can_bus import HilBus

pytestmark = pytest.mark.vcan

bus = own_vcan
FOR_EVER_NS = 10**18


@contextmanager
def bridged(name: str, *options: str) -> Iterator[HilBus]:
    """`hil can bridge` between the bus `wire` and an interface; yields another participant of the bus."""
    command = [sys.executable, "-m", "hil", "can", "bridge", "wire", name, "--bitrate", "500k", *options]
    with ended(subprocess.Popen(command, stdout=subprocess.PIPE, text=True)) as process:
        assert process.stdout is not None and "error frames" in process.stdout.readline()
        with can.Bus("wire", interface="hil", timed=True, bitrate="500k") as other:
            assert isinstance(other, HilBus)
            yield other
        process.terminate()
        assert process.wait(LIMIT_S) == 143


@contextmanager
def candump(name: str) -> Iterator[list[str]]:
    """The lines of `candump -e`, with error frames in words."""
    if shutil.which("candump") is None:
        pytest.skip("no candump: apt-get install can-utils")
    lines: list[str] = []
    command = ["stdbuf", "-oL", "candump", "-e", f"{name},0:0,#FFFFFFFF"]
    with ended(subprocess.Popen(command, stdout=subprocess.PIPE, text=True)) as process:

        def read() -> None:
            assert process.stdout is not None
            lines.extend(iter(process.stdout.readline, ""))

        reader = threading.Thread(target=read)
        reader.start()
        try:
            yield lines
        finally:
            process.terminate()
            reader.join()


def said(of: int) -> Callable[[list[can.Message]], bool]:
    """Whether one of the error frames is of a class."""
    return lambda found: any(each.arbitration_id & of for each in found)


def test_disturbed_frames_of_a_socketcan_program_end_in_bus_off_which_candump_shows(bus: str) -> None:
    with bridged(bus) as other, candump(bus) as lines, can.Bus(bus, interface="socketcan") as program:
        other.frames.plan([BusFault(0, FOR_EVER_NS, identifier=0x123)], 0, [])
        marker = can.Message(arbitration_id=0x700, is_extended_id=False)
        until(lambda: program.send(marker) or bool(lines), "candump")  # type: ignore[func-returns-value]
        program.send(can.Message(arbitration_id=0x123, data=b"12345678", is_extended_id=False))
        found = error_frames(program, said(BUS_OFF))
        until(lambda: any("bus-off" in line for line in lines), "candump's line")
        program.send(can.Message(arbitration_id=0x100, is_extended_id=False))
        other.send(can.Message(arbitration_id=0x200, is_extended_id=False))
        until(lambda: other.state is can.BusState.PASSIVE, "no acknowledgement of the node that is off")
    broken = [each for each in found if each.arbitration_id == 0x088]
    states = [each.data[1] for each in found if each.arbitration_id == 0x004]
    assert len(broken) == 32 and states == [0x08, 0x20] and found[-1].arbitration_id == BUS_OFF
    text = "".join(lines)
    assert text.count("protocol-violation") >= 32 and "tx-error-passive" in text and "ERRORFRAME" in text


def test_a_controller_that_may_restart_comes_back_and_the_frame_gets_through(bus: str) -> None:
    with bridged(bus, "--restart-ms", "10") as other, can.Bus(bus, interface="socketcan") as program:
        other.frames.plan([BusFault(0, monotonic_ns() + 1_000_000_000, identifier=0x123)], 0, [])
        program.send(can.Message(arbitration_id=0x123, data=b"12345678", is_extended_id=False))
        found = error_frames(program, said(RESTARTED))
        assert [each.arbitration_id & BUS_OFF for each in found if each.arbitration_id in (BUS_OFF, 0x104)] == [BUS_OFF, 0]
        while (each := other.recv(LIMIT_S)) is not None and each.is_error_frame:
            pass
        assert each is not None and each.arbitration_id == 0x123
        other.send(can.Message(arbitration_id=0x18FF0001, data=b"back", is_extended_id=True))
        while (each := program.recv(LIMIT_S)) is not None and each.is_error_frame:
            pass
        assert each is not None and (each.arbitration_id, bytes(each.data)) == (0x18FF0001, b"back")
