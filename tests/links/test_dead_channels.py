"""What killed processes left is cleared at the next start; what runs is not touched."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path, PosixPath

import hil
from transport.links.private_directory import clear_dead_channels, private_directory
from transport.links.unix_mesh import Mesh

KILLED = """
import os, signal, sys
from pathlib import Path
from transport.links.unix_mesh import Mesh
mesh = Mesh(Path(sys.argv[1]))
os.kill(os.getpid(), signal.SIGKILL)
"""


def killed_in(channel: Path) -> None:
    assert subprocess.run([sys.executable, "-P", "-c", KILLED, str(channel)]).returncode == -9
    assert [*channel.glob("*.sock")]


def test_a_channel_of_killed_processes_is_removed_and_a_live_one_stays(bus_directory: Path) -> None:
    buses = bus_directory / "buses"
    buses.mkdir(mode=0o700)
    for name in ("dead", "mixed", "foreign"):
        killed_in(buses / name)
    (buses / "foreign" / "mine.txt").write_text("keep")
    with Mesh(buses / "mixed") as live:
        killed_in(buses / "mixed")
        clear_dead_channels(buses)
        assert sorted(path.name for path in buses.iterdir()) == ["foreign", "mixed"]
        assert [path.name.partition("-")[0] for path in (buses / "mixed").glob("*.sock")] == [str(os.getpid())]
        assert (buses / "foreign" / "mine.txt").read_text() == "keep"
        assert live.dropped == live.lost == 0


def test_a_folder_that_is_no_channel_stays_and_so_does_a_file_of_another_name(bus_directory: Path) -> None:
    """`HIL_CAN_DIR` may be a private folder with others in it, such as /run/user/1000."""
    for name in ("empty", "bus", "rig0"):
        (bus_directory / name).mkdir(mode=0o700)
    for path in (bus_directory / "bus" / "bus.0", bus_directory / "rig0" / "bus.py"):
        path.write_text("mine")
    with Mesh(bus_directory / "rig0"):
        pass
    killed_in(bus_directory / "rig0")
    clear_dead_channels(bus_directory)
    assert sorted(path.name for path in bus_directory.iterdir()) == ["bus", "empty", "rig0"]
    assert (bus_directory / "bus" / "bus.0").exists() and (bus_directory / "rig0" / "bus.py").read_text() == "mine"


def test_a_socket_at_which_another_container_listens_stays(bus_directory: Path) -> None:
    channel = bus_directory / "far"
    channel.mkdir(mode=0o700)
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
        listener.bind(str(channel / "4999999-0.sock"))  # no process of this number can be here
        listener.listen()
        clear_dead_channels(bus_directory)
        assert (channel / "4999999-0.sock").exists()


def test_the_next_session_clears_what_a_killed_one_left(tmp_path: Path, bus_directory: Path, monkeypatch) -> None:
    buses = bus_directory / "b"
    buses.mkdir(mode=0o700)
    monkeypatch.setenv("HIL_CAN_DIR", str(buses))
    killed_in(buses / "gone")
    hil.run(hil.load_experiment("dc-motor-hinf", duration=0.2), clock="real", link="local:", log=tmp_path / "x.mcap")
    assert not (buses / "gone").exists()


class ClearedOnce(PosixPath):
    """A folder that another process removes, once, just after it was made."""

    cleared = False

    def mkdir(self, mode: int = 0o777, parents: bool = False, exist_ok: bool = False) -> None:
        super().mkdir(mode, parents, exist_ok)
        if not ClearedOnce.cleared:
            ClearedOnce.cleared = True
            self.rmdir()


def test_a_folder_that_another_session_clears_while_it_is_opened_is_made_again(tmp_path: Path) -> None:
    folder = ClearedOnce(tmp_path / "busy")
    assert private_directory(folder).is_dir()
    assert ClearedOnce.cleared
