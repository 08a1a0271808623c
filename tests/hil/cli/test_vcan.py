"""`hil vcan`: what it refuses, what it would execute, and which way it takes; the kernels themselves boot in tests/vcan."""

from __future__ import annotations

import errno
import json
import os
import re
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any, Never

import pytest

from hil import vcan
from hil.vcan import RunnerError, Wanted, kernel, supervise, uml, what_would_run
from hil.vcan.kernel import Kernel
from tests.hil.cli.conftest import Hil

PLAIN = Wanted(command=("true",))


def test_a_machine_without_ip_is_refused_with_the_name_of_its_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernel.platform, "machine", lambda: "x86_64")
    monkeypatch.setattr(kernel.shutil, "which", lambda program: None)
    with pytest.raises(RunnerError, match="missing here: iproute2"):
        kernel.need_machine(install=False)
    monkeypatch.setattr(kernel.platform, "machine", lambda: "aarch64")
    with pytest.raises(RunnerError, match="needs x86-64 Linux, this is linux on aarch64"):
        kernel.need_machine(install=False)


class NoCan(socket.socket):
    """What a kernel without CAN says."""

    def __init__(self, *_: object) -> None:
        raise OSError(errno.EAFNOSUPPORT, os.strerror(errno.EAFNOSUPPORT))


class Can(socket.socket):
    """A kernel with CAN and a vcan0."""

    def __init__(self, *_: object) -> None:
        super().__init__()

    def bind(self, _: object) -> None:
        pass


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ([], "COMMAND"),
        (["--timeout", "5"], "COMMAND"),
        (["--timeout", "0", "--", "true"], "--timeout"),
        (["--virtual-time", "--backend", "native", "--", "true"], "no virtual time"),
        (["--rw", "nosuch", "--", "true"], "nosuch"),
        (["--source", "nosuch.tar.xz", "--", "true"], "nosuch.tar.xz"),
    ],
)
def test_what_is_asked_wrongly_is_refused(cli: Hil, arguments: list[str], says: str) -> None:
    status, _, err = cli("vcan", *arguments)
    assert status == 2 and says in err


def test_the_commands_own_options_are_its_own(cli: Hil, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    asked: list[tuple[Wanted, float | None]] = []
    monkeypatch.setattr("hil.vcan.run_beside_vcan", lambda wanted, timeout: asked.append((wanted, timeout)) or 7)  # type: ignore[func-returns-value]
    (tmp_path / "kept").mkdir()
    status, _, _ = cli("vcan", "--timeout", "3", "--rw", "kept", "pytest", "-x", "--timeout", "9", "--", "a")
    ((wanted, timeout),) = asked
    assert status == 7 and timeout == 3
    assert wanted.command == ("pytest", "-x", "--timeout", "9", "--", "a")
    assert wanted.writable == (str(tmp_path), str(tmp_path / "kept"))


def test_status_is_125_with_a_line_for_each_way_where_there_is_none(cli: Hil, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "socket", NoCan)
    monkeypatch.setattr("platform.machine", lambda: "aarch64")
    status, _, err = cli("vcan", "--", "true")
    assert status == 125
    assert [line.split(": ")[:2] for line in err.splitlines()[1:]] == [["hil vcan", name] for name in ("native", "uml", "debian")]
    assert "this kernel has no CAN" in err and "needs x86-64 Linux" in err


def test_a_kernel_with_vcan_gives_the_command_a_network_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "socket", Can)
    monkeypatch.setattr(vcan, "works", lambda argv: True)
    monkeypatch.setattr(supervise, "works", lambda argv: True)
    argv = vcan.start(Wanted(command=("candump", "vcan0")))
    assert argv[0] == "unshare" and {"--net", "--pid", "--mount"} < set(argv) and argv[-2:] == ["candump", "vcan0"]
    assert "ip link add dev vcan0 type vcan" in argv[-4]
    assert what_would_run() == (True, "this kernel's own vcan", "")


def test_a_kernel_without_vcan_is_refused_with_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "socket", Can)
    monkeypatch.setattr(Can, "bind", NoCan.__init__)
    monkeypatch.setattr(vcan.shutil, "which", lambda program: program)
    monkeypatch.setattr(supervise, "works", lambda argv: True)
    monkeypatch.setattr(vcan, "works", lambda argv: False)
    with pytest.raises(RunnerError, match="this kernel makes no vcan here"):
        vcan.native(PLAIN)


def test_where_namespaces_are_refused_the_vcan0_that_is_there_must_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "socket", Can)
    monkeypatch.setattr(supervise, "works", lambda argv: False)
    assert vcan.start(PLAIN) == ["env", "VCAN_BACKEND=native", "true"]
    monkeypatch.setattr(Can, "bind", NoCan.__init__)
    with pytest.raises(RunnerError, match="refuses new net, pid, mount namespaces"):
        vcan.native(PLAIN)


def test_a_kernel_is_booted_on_what_the_command_needs_of_tmp(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(sys, "prefix", "/tmp/venv")
    monkeypatch.setenv("PATH", f"/tmp/venv/bin:/tmp/tools:{tmp_path}/bin:/usr/bin")
    wanted = Wanted(command=("a", "b"), virtual_time=True, writable=(str(tmp_path),))
    argv = uml.argv(wanted, lambda _: Kernel(path=Path("/k"), backend="uml"))
    order = json.loads(argv[-1])
    assert order["command"] == ["a", "b"] and order["kernel"] == "/k" and order["virtual_time"] is True
    assert {"/tmp/venv", "/tmp/tools"} <= set(order["readable"]) and f"{tmp_path}/bin" not in order["readable"]


def test_doctor_says_what_would_be_taken(doctor: list[dict[str, Any]], monkeypatch: pytest.MonkeyPatch) -> None:
    def nothing(*_: object, **__: object) -> Never:
        raise RunnerError("missing here: gcc")

    monkeypatch.setattr(socket, "socket", NoCan)
    refused = f"this kernel has no CAN ({os.strerror(errno.EAFNOSUPPORT)})"
    monkeypatch.setattr(kernel, "built", lambda: Path("/cache/linux"))
    assert what_would_run()[:2] == (True, f"a user-mode kernel, as {refused}: /cache/linux")
    monkeypatch.setattr(kernel, "built", lambda: None)
    monkeypatch.setattr(kernel, "need_for_build", lambda _: None)
    assert what_would_run()[0] and "the first use builds it" in what_would_run()[1]
    monkeypatch.setattr(kernel, "need_for_build", nothing)
    assert not what_would_run()[0] and what_would_run()[2] == "missing here: gcc"
    monkeypatch.undo()
    (line,) = (check for check in doctor if check["what"] == "hil vcan")
    assert line["ok"] is what_would_run()[0]


def test_the_kernel_is_built_on_all_cores_though_hil_computes_on_one_thread() -> None:
    """nproc says what OMP_NUM_THREADS says, and the command line sets that to 1 for its own process."""
    script = (kernel.HERE / "build_kernel").read_text()
    (jobs,) = re.findall(r'^make ARCH=um -j"(.*)" linux$', script, flags=re.M)
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    said = subprocess.run(["sh", "-c", f"echo {jobs}"], env=environment, capture_output=True, text=True, check=True)
    assert int(said.stdout) == len(os.sched_getaffinity(0))
