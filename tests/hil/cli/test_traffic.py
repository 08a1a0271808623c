"""`hil traffic`: the messages of a bus's other nodes, in their periods; what it refuses."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from itertools import takewhile
from pathlib import Path

import can
import pytest

from tests.waiting import LIMIT_S

DBC = """VERSION ""

BU_: Bench Drive Door

BO_ 100 Speed: 4 Bench
 SG_ V : 0|16@1+ (0.01,0) [0|0] "km/h" Drive

BO_ 300 DoorState: 2 Door
 SG_ Open : 0|1@1+ (1,0) [0|1] "" Drive
 SG_ Angle : 8|8@1- (1,0) [0|0] "" Drive
 SG_ Level : 1|7@1+ (1,0) [0|0] "" Drive

BO_ 2147484050 Window: 8 Door
 SG_ X : 0|32@1- (1,0) [0|0] "" Drive
 SG_ Y : 32|16@1+ (1,0) [0|0] "" Drive

BO_ 301 Once: 2 Door
 SG_ Z : 0|1@1+ (1,0) [0|1] "" Drive

BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_ SG_ "GenSigStartValue" FLOAT -1000000 1000000;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_DEF_DEF_ "GenSigStartValue" 0;
BA_ "GenMsgCycleTime" BO_ 100 5;
BA_ "GenMsgCycleTime" BO_ 300 20;
BA_ "GenMsgCycleTime" BO_ 2147484050 20;
BA_ "GenSigStartValue" SG_ 300 Open 1;
BA_ "GenSigStartValue" SG_ 300 Angle -500;
BA_ "GenSigStartValue" SG_ 300 Level 3.6;
BA_ "GenSigStartValue" SG_ 2147484050 X 2.5;
SIG_VALTYPE_ 2147484050 X : 1;
"""
WINDOW = bytes.fromhex("0000204000000000")
"""2.5 as a number of 32 bits."""


@pytest.fixture
def dbc(tmp_path: Path) -> Path:
    path = tmp_path / "car.dbc"
    path.write_text(DBC, encoding="cp1252")
    return path


def test_messages_are_sent_in_their_periods_with_their_start_values_until_a_signal(dbc: Path) -> None:
    channel = f"traffic{os.getpid()}"
    words = [sys.executable, "-m", "hil", "traffic", str(dbc), f"can:hil:{channel}", "--without", "Bench"]
    with can.Bus(channel, interface="hil") as bus, subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        frames = list(takewhile(lambda frame: frame is not None, (bus.recv(LIMIT_S) for _ in range(20))))
        process.send_signal(signal.SIGTERM)
        out = process.communicate(timeout=LIMIT_S)[0]
    assert len(frames) == 20
    seen = {(frame.arbitration_id, frame.is_extended_id, bytes(frame.data)) for frame in frames if frame is not None}
    assert seen == {(300, False, bytes((1 | 4 << 1, 0x80))), (402, True, WINDOW)}, "-500 is -128 at least, 3.6 is 4"
    assert frames[-1].timestamp - frames[0].timestamp > 0.15, "two in 20 ms, the first up to 20 ms late; slower is the machine's"  # type: ignore[union-attr]
    assert process.returncode == 143
    first, last = out.splitlines()
    assert first == f"2 messages onto can:hil:{channel}; Ctrl-C ends it"
    assert int(re.fullmatch(r"(\d+) frames sent, 0 found no room", last)[1]) >= 20  # type: ignore[index]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("can:hil:t", "--without", "Dor"), "--without: none of the messages of {dbc} is sent by 'Dor' (its nodes: Bench, Door)"),
        (("can:hil:t", "--without", "Bench", "--without", "Door"), "--without: nothing is left of {dbc}"),
        (("zenoh:",), "link 'zenoh:': expected can:INTERFACE:CHANNEL, such as can:socketcan:vcan0"),
        (("can:hil",), "link 'can:hil': no channel, expected can:<interface>:<channel>, as in can:hil:rig0"),
        (("can:hil:t?bitrte=3",), "link 'can:hil:t?bitrte=3': no option is called 'bitrte', did you mean 'bitrate'?"),
        (("can:hil:t?timed=1",), "link 'can:hil:t?timed=1': hil: channel 't': bitrate: missing; a bus that takes time has one, "
                                 "such as 500k"),
    ],
)  # fmt: skip
def test_what_cannot_be_sent_is_refused(
    cli: Callable[..., tuple[int, str, str]], dbc: Path, words: tuple[str, ...], said: str
) -> None:
    status, out, err = cli("traffic", str(dbc), *words)
    assert (status, out, err.strip()) == (2, "", f"hil: {said.format(dbc=dbc)}")
