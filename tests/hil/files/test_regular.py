"""Files of the user's are read only where they are regular and of bounded size, and written only where nothing is lost."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from hil.errors import HilError
from hil.files import read_regular, written_whole


def test_a_regular_file_is_read_whole(tmp_path: Path) -> None:
    (tmp_path / "x").write_bytes(b"abc")
    assert read_regular(tmp_path / "x", 3, "an x") == b"abc"


def test_what_has_no_end_or_no_beginning_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")  # a reader that waits for its writer would hang here
    (tmp_path / "zero").symlink_to("/dev/zero")
    (tmp_path / "large").write_bytes(b"abcd")
    for name, says in (("pipe", "no regular file, not an x"), ("zero", "no regular file"), (".", "is a folder, not an x"),
                       ("large", "more than 3 bytes"), ("absent", "No such file"), ("a\0b", "cannot be read"),
                       ("/proc/self/mem", "cannot be read: Input/output error")):  # fmt: skip
        with pytest.raises(HilError, match=says):
            read_regular(tmp_path / name, 3, "an x")


def test_a_new_file_takes_its_place_whole_and_through_nobodys_link(tmp_path: Path) -> None:
    victim, target = tmp_path / "victim", tmp_path / "out.csv"
    victim.write_text("precious")
    target.symlink_to(victim)
    with pytest.raises(HilError, match="exists already"), written_whole(target, replace=False) as part:
        part.write_text("new")
    with written_whole(target, replace=True) as part:
        assert part.suffix == ".csv"
        part.write_text("new")
    assert victim.read_text() == "precious" and not target.is_symlink() and target.read_text() == "new"
    assert sorted(os.listdir(tmp_path)) == ["out.csv", "victim"]


def test_a_file_that_came_during_the_work_is_kept(tmp_path: Path) -> None:
    target = tmp_path / "out"
    with pytest.raises(HilError, match="exists already"), written_whole(target, replace=False) as part:
        part.write_text("ours")
        target.write_text("theirs")
    assert target.read_text() == "theirs" and os.listdir(tmp_path) == ["out"]


def test_a_failure_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), written_whole(tmp_path / "out", replace=True) as part:
        part.write_text(str(1 / 0))
    assert os.listdir(tmp_path) == []


def test_a_device_is_not_replaced(tmp_path: Path) -> None:
    target = tmp_path / "pipe"  # as a device, which only root can make
    os.mkfifo(target)
    with pytest.raises(HilError, match="pipe: cannot be written: it is no"), written_whole(target, replace=True) as part:
        part.write_text("new")
    assert target.is_fifo() and [*tmp_path.iterdir()] == [target]


def test_a_name_with_a_zero_byte_is_no_file_to_write(tmp_path: Path) -> None:
    """A topic of a foreign log names a table of its export."""
    with pytest.raises(HilError, match="a name with a zero byte"), written_whole(tmp_path / "a\0b", replace=True):
        pass
    assert not any(tmp_path.iterdir())
