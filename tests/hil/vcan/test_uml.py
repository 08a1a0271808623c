"""What goes into a user-mode kernel and comes out: in its place a program that writes where it would. tests/vcan boots one."""

from __future__ import annotations

import json
import os
import signal
import sys
from ast import literal_eval
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from hil.vcan import uml
from hil.vcan.kernel import Kernel
from hil.vcan.supervise import RUNNER_FAILED, Wanted

KERNEL = f"""#!{sys.executable}
import os, sys
said = dict(word.partition("=")[::2] for word in sys.argv[1:])
out, err = (int(said[f"con{{n}}"].rpartition(":")[2]) for n in (1, 2))
came = b""
if "con3" in said:
    read, ask = (int(each.rpartition(":")[2]) for each in said["con3"].split(","))
    while os.write(ask, b"+") and (left := int(os.read(read, 6), 16)):
        while left:
            came += (some := os.read(read, left))
            left -= len(some)
print("last words")
os.write(err, repr((sys.argv[1:], sorted(os.environ))).encode())
for _ in range(REPEATS):
    os.write(out, came.upper() or b"x" * 4096)
open(said["uml_dir"] + "/status", "w").write(STATUS)
"""


def order(tmp_path: Path, *, status: str = "7\n", repeats: int = 1, virtual: bool = False) -> str:
    (tmp_path / "kernel").write_text(KERNEL.replace("STATUS", repr(status)).replace("REPEATS", str(repeats)))
    (tmp_path / "kernel").chmod(0o755)
    there, gone = str(tmp_path), str(tmp_path / "gone")
    return json.dumps({
        "kernel": f"{tmp_path}/kernel", "backend": "uml", "modules": ["/m/overlay.ko", "/m/vcan.ko"], "virtual_time": virtual,
        "readable": [there, gone], "writable": ["/w"], "command": ["echo", "a b"], "work": there, "memory": "/memory",
    })  # fmt: skip


@contextmanager
def descriptor(number: int, instead: int) -> Iterator[None]:
    """Have a descriptor of this process be another one for a while."""
    kept = os.dup(number)
    os.dup2(instead, number)
    os.close(instead)
    try:
        yield
    finally:
        os.dup2(kept, number)
        os.close(kept)


def test_bytes_go_into_a_kernel_and_come_out_with_the_status(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    read, write = os.pipe()
    os.write(write, b"hello " * 1000)
    os.close(write)
    with descriptor(0, read):
        assert uml.boot(order(tmp_path)) == 7
    out, err = capfd.readouterr()
    assert out == "HELLO " * 1000
    words, environ = literal_eval(err)
    said = dict(word.partition("=")[::2] for word in words)
    numbers = {said.pop(name).rpartition(":")[2] for name in ("con0", "con1", "con2", "con3")}
    assert len(numbers) == 4 and {"PATH", "TMPDIR"} <= {*environ} and "HOME" not in environ
    assert said == {
        "mem": "2048M", "rootfstype": "hostfs", "rootflags": "/", "ro": "", "init": f"{tmp_path}/init", "uml_dir": str(tmp_path),
        "umid": "uml", "con": "null", "ssl": "null", "quiet": "", "loglevel": "4", "panic": "-1", "noreboot": "",
    }  # fmt: skip
    assert (tmp_path / "command").read_text().endswith("exec echo 'a b'\n")
    init = (tmp_path / "init").read_text()
    assert os.access(tmp_path / "init", os.X_OK) and "con3" not in init and "/dev/tty3" in init
    assert f"mount -t hostfs -o ro,{tmp_path} none {tmp_path}" in init and "gone" not in init and "rw,/w" in init
    assert init.index("insmod /m/overlay.ko") < init.index("pivot_root") < init.index("insmod /run/old/m/vcan.ko")


def test_in_virtual_time_no_byte_comes_in_and_the_clock_begins_at_its_own_instant(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert uml.boot(order(tmp_path, virtual=True)) == 7
    out, err = capfd.readouterr()
    words, _ = literal_eval(err)
    assert out == "x" * 4096 and not any(word.startswith("con3") for word in words)
    assert words[-2:] == ["time-travel=inf-cpu", "time-travel-start=1735689600000000000"]
    assert "exec </dev/null" in (tmp_path / "init").read_text()


@pytest.mark.parametrize("status", ["", "256\n", "-1\n", "7", "x\n"])
def test_what_is_no_status_is_said(tmp_path: Path, capfd: pytest.CaptureFixture[str], status: str) -> None:
    assert uml.boot(order(tmp_path, status=status, virtual=True)) == RUNNER_FAILED
    assert f"the guest left {status.encode()!r}" in capfd.readouterr().err


def test_a_guest_that_dies_leaves_its_last_words(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    text = order(tmp_path, virtual=True)
    (tmp_path / "kernel").write_text(f"#!{sys.executable}\nprint('x' * 5000 + 'last words')")
    assert uml.boot(text) == RUNNER_FAILED
    err = capfd.readouterr().err
    assert "the guest died; its last words:" in err and err.endswith("xlast words\n") and len(err) < 4100


def test_a_guest_whose_reader_has_left_is_ended(tmp_path: Path) -> None:
    text = order(tmp_path, repeats=10**9, virtual=True)
    read, write = os.pipe()
    os.close(read)
    with descriptor(1, write):
        assert uml.boot(text) == 128 + signal.SIGPIPE


def test_memory_lies_where_there_is_room_and_programs_may_run(monkeypatch: pytest.MonkeyPatch) -> None:
    places = {"/dev/shm": (os.ST_NOEXEC, 1 << 20), "/t": (0, 1 << 18), "/var/tmp": (0, (1 << 18) + 1)}
    monkeypatch.setattr(uml.tempfile, "gettempdir", lambda: "/t")

    def statvfs(place: str) -> os.statvfs_result:
        flags, blocks = places[place]
        return os.statvfs_result((4096, 4096, 0, 0, blocks, 0, 0, 0, flags, 255))

    monkeypatch.setattr(uml.os, "statvfs", statvfs)
    assert uml._roomy_directory() == "/var/tmp"
    places["/var/tmp"] = places["/t"]
    with pytest.raises(uml.RunnerError, match="/dev/shm needs 1 GB, not noexec"):
        uml._roomy_directory()


def test_a_closed_or_empty_stdin_is_none() -> None:
    with descriptor(0, os.open(os.devnull, os.O_RDONLY)):
        assert not uml._has_stdin()
        os.close(0)
        assert not uml._has_stdin()
    read, write = os.pipe()
    with descriptor(0, read):
        assert uml._has_stdin()
    os.close(write)


def test_what_the_machine_lacks_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = order(tmp_path)
    (tmp_path / "command").mkdir()
    assert uml.boot(text) == RUNNER_FAILED
    assert capsys.readouterr().err.startswith("hil vcan: the kernel cannot be started: [Errno 21] Is a directory: ")


def test_without_namespaces_a_kernel_works_in_a_folder_that_goes_with_us(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*namespaces: str, allow_user: bool) -> list[str]:
        raise uml.RunnerError("no")

    gone: list[tuple[object, ...]] = []
    monkeypatch.setattr(uml, "unshare", refused)
    monkeypatch.setattr(uml, "_roomy_directory", lambda: "/roomy")
    monkeypatch.setattr(uml.atexit, "register", lambda *words, **_: gone.append(words))
    *command, text = uml.argv(Wanted(command=("true",)), lambda wanted: Kernel(path=Path("/bin/true"), backend="uml"))
    said = json.loads(text)
    assert command == [sys.executable, "-ISc", uml.BOOT, str(uml.ROOT)] and said["memory"] == "/roomy"
    assert gone == [(uml.shutil.rmtree, said["work"])] and not list(Path(said["work"]).iterdir())
    Path(said["work"]).rmdir()
