"""Frames of a recording as lines of an experiment, and what is refused in one line."""

from __future__ import annotations

from pathlib import Path

import pytest

from hil.errors import HilError
from hil.rig import named_files
from hil.rig.named_files import due_of, read_recorded, read_traffic

FRAMES = "(10.004000) can0 123#1122\n(10.000000) can0 18FF0001#R2\n(10.001000) can0 200##1AABBCC\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no frame"),
        ("(1.0) can0 123#11\n(nan) can0 124#11\n", "frame 2: nan is no instant, expected seconds below 1e"),
        ("(1e400) can0 123#11\n", "frame 1: inf is no instant, expected seconds below 1e"),
        ("(1.0) can0 123#11\n(1.0) can0 124#11\n", "every frame has the time stamp 1; a recording with time stamps is needed"),
        (FRAMES + "(10.005000) can0 123#1122\n", "more than 3 frames"),
        ("(1.0) can0 123#11\n(1.7e9) can0 124#11\n", r"frames lie 1\.7e\+09 s apart, expected less than 1e\+09; are"),
        ("  can0  123   [1]  11\n", "is no CAN log: .*; expected lines as `candump -L can0` prints them"),
    ],
)
def test_a_recording_that_is_none_is_refused(text: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(named_files, "MOST", 3)
    path = tmp_path / "car.log"
    path.write_text(text)
    with pytest.raises(HilError, match=f"car.log: {message}"):
        read_recorded(path)


def test_a_recording_begins_at_its_first_frame_and_its_lines_are_frames_again(tmp_path: Path) -> None:
    path = tmp_path / "car.log"
    path.write_text(FRAMES)
    lines = read_recorded(path)
    assert lines == ["0 18FF0001#R2", "1000000 200##1AABBCC", "4000000 123#1122"]
    remote, fast, plain = (due_of(line, 5) for line in lines)
    assert (remote.frame.identifier, remote.frame.extended, remote.frame.remote, remote.frame.dlc) == (0x18FF0001, True, True, 2)
    assert (fast.frame.fd, fast.frame.bitrate_switch, fast.frame.error_state) == (True, True, False)
    assert fast.frame.data == b"\xaa\xbb\xcc"
    assert (plain.frame.extended, plain.frame.fd, plain.frame.data, plain.node) == (False, False, b"\x11\x22", 5)
    path.write_text("(7.5) can0 123#11\n")
    assert read_recorded(path) == ["0 123#11"]


@pytest.mark.parametrize("line", ["", "12 12#11", "x 123#11", "12 123", "12 123#1G"])
def test_a_line_that_is_no_frame_is_refused(line: str) -> None:
    with pytest.raises(ValueError, match="expected nanoseconds and a frame"):
        due_of(line)


def test_a_table_of_traffic_is_known_by_its_ending_and_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(HilError, match=r"a\.txt: the ending '\.txt' names no table of traffic, expected \.csv or \.dbc"):
        read_traffic(tmp_path / "a.txt")
    path = tmp_path / "a.csv"
    path.write_text("can_id,period\n0x12,1\n")
    assert [each.can_id for each in read_traffic(path)[0]] == [0x12]
    (tmp_path / "spreadsheet.csv").write_text("\ufeffcan_id,period\n0x12,1\n")
    assert read_traffic(tmp_path / "spreadsheet.csv") == read_traffic(path)
    (tmp_path / "spreadsheet.csv").write_text("can_id;period\n0x12;1\n")
    assert read_traffic(tmp_path / "spreadsheet.csv") == read_traffic(path)
    for cells, said in (("1;20,5 ms", "period: '20,5 ms', expected a duration"), ("x;1", "can_id: 'x', expected a whole number")):
        (tmp_path / "spreadsheet.csv").write_text(f"can_id;period\n{cells}\n")
        with pytest.raises(HilError, match=f"line 2: {said}"):
            read_traffic(tmp_path / "spreadsheet.csv")
    monkeypatch.setattr(named_files, "LARGEST", len(path.read_text()))
    assert read_traffic(path)[0]
    monkeypatch.setattr(named_files, "LARGEST", len(path.read_text()) - 1)
    with pytest.raises(HilError, match=r"a\.csv: more than 20 characters"):
        read_traffic(path)
    path.write_text("can_id,period\n")
    with pytest.raises(HilError, match=r"a\.csv: no message that is sent again and again"):
        read_traffic(path)
