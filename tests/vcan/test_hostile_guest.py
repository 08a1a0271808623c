"""What a command in `hil vcan` can do to us: its words, its environment, what it leaves where its status stands."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from hil.vcan import RunnerError, guest, uml
from hil.vcan.kernel import Kernel
from hil.vcan.supervise import RUNNER_FAILED
from hil.vcan.wanted import Wanted


def order(*command: str, writable: tuple[str, ...] = ()) -> list[str]:
    return uml.argv(Wanted(command=command, writable=writable), lambda wanted: Kernel(path=Path("/bin/true"), backend="uml"))


def in_a_shell(script: str, environ: dict[str, str]) -> subprocess.CompletedProcess[bytes]:
    """Run the script that becomes the command, as the guest does, in this machine's shell."""
    return subprocess.run(["sh", "-c", os.fsencode(script)], env=environ, capture_output=True)


@pytest.mark.parametrize("name", ["é", "OPTIND", "PPID", "UID", "a-b", "BASH_FUNC_x%%", "1x"])
def test_no_name_of_a_variable_ends_the_shell(name: str) -> None:
    script = guest.command(["sh", "-c", "echo $FINE"], {name: "x y", "FINE": "yes", "PATH": os.environ["PATH"]}, "uml", False)
    done = in_a_shell(script, {"PATH": os.environ["PATH"]})
    assert (done.returncode, done.stdout) == (0, b"yes\n"), done.stderr


@pytest.mark.parametrize("word", ["$(touch ran)", "`touch ran`", "'; touch ran #", "a\nb", "\udcff\udcfe", "-", "*", "\\"])
def test_every_argument_and_value_comes_as_it_is(word: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    script = guest.command(["printenv", "V"], {"V": word, "PATH": os.environ["PATH"]}, "uml", False)
    assert in_a_shell(script, {"PATH": os.environ["PATH"]}).stdout == os.fsencode(word) + b"\n"
    script = guest.command(["printf", "%s", word], {"PATH": os.environ["PATH"]}, "uml", False)
    assert in_a_shell(script, {"PATH": os.environ["PATH"]}).stdout == os.fsencode(word)
    assert not list(tmp_path.iterdir())


def test_what_would_not_come_to_the_guest_whole_is_refused() -> None:
    with pytest.raises(RunnerError, match=r"take \d+ bytes, 131072 at most; put the command into a script"):
        order("echo", *["x" * 100] * 2000)
    with pytest.raises(RunnerError, match="a comma or backslash in a directory's name"):
        order("true", writable=("/tmp/a,/etc",))


@pytest.mark.parametrize("left", [b"", b"x\n", b"-1\n", b"256\n", b"1" * 9, "٣\n".encode(), b"0", b"1_0\n"])
def test_a_status_that_is_none_is_said(left: bytes, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "kernel.log").write_bytes(b"its last words")
    (tmp_path / "status").write_bytes(left)
    assert uml._status(tmp_path) == RUNNER_FAILED and capfd.readouterr().err.startswith("hil vcan: the guest ")


def test_a_pipe_for_a_status_is_not_waited_for_and_last_words_are_few(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    os.mkfifo(tmp_path / "status")
    (tmp_path / "kernel.log").write_bytes(b"a" * 1_000_000)
    assert uml._status(tmp_path) == RUNNER_FAILED and len(capfd.readouterr().err) < 4_100
    (tmp_path / "status").unlink()
    (tmp_path / "status").write_text("130\n")
    assert uml._status(tmp_path) == 130
