"""The kernel's cache: built once by whoever comes first, whole or not at all; and clear words where it cannot be."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hil import vcan
from hil.vcan import RunnerError, Wanted, kernel
from tests.waiting import LIMIT_S

# A stand-in for the build, of which only the time it takes is left out; it notes that it ran.
FAST_BUILD = """#!/bin/sh
mkdir -p "$2"
echo built >>"$(dirname "$3")/builds"
while [ -e "$(dirname "$3")/hold" ]; do sleep 0.05; done
echo '#!/bin/sh' >"$3"
chmod +x "$3"
"""

SMALL = """
import sys
from pathlib import Path
from hil.vcan import Wanted, kernel
kernel.HERE, kernel.need, kernel._source_version = Path(sys.argv[1]), lambda packages, install: None, lambda: "1"
kernel.SOURCE = Path(sys.argv[1]) / "source"
print(kernel.small(Wanted(command=("true",))).path)
"""


@pytest.fixture
def place(tmp_path: Path) -> Path:
    (tmp_path / "build_kernel").write_text(FAST_BUILD)
    (tmp_path / "build_kernel").chmod(0o755)
    (tmp_path / "kernel.config").write_text("CONFIG_CAN=y\n")
    (tmp_path / "source").touch()
    (tmp_path / "cache" / "hilrig").mkdir(parents=True)
    return tmp_path


def builder(place: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", SMALL, str(place)],
        env={**os.environ, "XDG_CACHE_HOME": str(place / "cache"), "HILRIG_KERNEL_CACHE": ""},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def wait_for(path: Path) -> None:
    limit = time.monotonic() + LIMIT_S
    while not path.exists():
        assert time.monotonic() < limit, f"{path} never came"
        time.sleep(0.01)


def test_two_runs_at_once_build_one_kernel(place: Path) -> None:
    cache = place / "cache" / "hilrig"
    (cache / "hold").touch()
    first = builder(place)
    wait_for(cache / "builds")
    second = builder(place)
    assert "another run is building" in second.stderr.readline()  # type: ignore[union-attr]
    (cache / "hold").unlink()
    paths = {run.communicate(timeout=LIMIT_S)[0] for run in (first, second)}
    assert len(paths) == 1
    assert (cache / "builds").read_text() == "built\n"
    assert not (cache / "build").exists()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_killed_build_leaves_no_kernel_and_no_process_and_the_next_one_succeeds(place: Path, number: int) -> None:
    cache = place / "cache" / "hilrig"
    (cache / "hold").touch()
    killed = builder(place)
    wait_for(cache / "builds")
    killed.send_signal(number)
    killed.communicate(timeout=LIMIT_S)
    assert not list(cache.glob("linux-vcan-*"))
    assert (cache / "build").exists() == (number == signal.SIGKILL), "what may clear up does so, Ctrl-C and SIGTERM"
    limit = time.monotonic() + LIMIT_S
    while (left := processes_that_name(str(place))) and time.monotonic() < limit:
        time.sleep(0.01)
    assert not left
    (cache / "hold").unlink()
    out, err = builder(place).communicate(timeout=LIMIT_S)
    assert Path(out.strip()).exists(), err


def test_what_a_killed_build_left_is_removed_by_the_next_run_of_any_kind(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache = place / "cache" / "hilrig"
    monkeypatch.setenv("HILRIG_KERNEL_CACHE", str(place / "cache"))
    monkeypatch.setattr(vcan, "ways", lambda wanted: [("native", lambda wanted: ["true"])])
    (cache / "hold").touch()
    building = builder(place)
    wait_for(cache / "builds")
    vcan.start(Wanted(command=("true",)))
    assert (cache / "build").exists(), "a build that runs is left alone"
    building.kill()
    building.communicate(timeout=LIMIT_S)
    limit = time.monotonic() + LIMIT_S
    while (cache / "build").exists() and time.monotonic() < limit:  # until the last of its processes has let the lock go
        vcan.start(Wanted(command=("true",)))
    assert not (cache / "build").exists()


def test_failed_build_says_why(place: Path) -> None:
    (place / "build_kernel").write_text("#!/bin/sh\necho 'CONFIG_CAN did not take' >&2\nexit 1\n")
    _, err = builder(place).communicate(timeout=LIMIT_S)
    assert "CONFIG_CAN did not take" in err
    assert not list((place / "cache" / "hilrig").glob("linux-vcan-*"))
    (place / "build_kernel").write_text("#!/bin/sh\nprintf %03000d 0 >&2\necho CONFIG_CAN did not take >&2\nexit 1\n")
    _, err = builder(place).communicate(timeout=LIMIT_S)
    assert ":\n" + 1976 * "0" + "CONFIG_CAN did not take" in err, "the last 2000 characters of its log"


def test_kernel_is_named_after_what_it_is_made_of(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernel, "HERE", place)
    monkeypatch.setattr(kernel, "SOURCE", place / "source")
    monkeypatch.setattr(kernel, "_source_version", lambda: "6.12.1")
    before = kernel._cached(None)
    monkeypatch.setattr(kernel, "_source_version", lambda: "6.12.2")
    assert kernel._cached(None) != before
    monkeypatch.undo()
    monkeypatch.setattr(kernel, "HERE", place)
    (place / "kernel.config").write_text("CONFIG_CAN=y\nCONFIG_CAN_ISOTP=y\n")
    assert kernel._cached(None).name.split("-")[2] != before.name.split("-")[2]


@pytest.fixture
def debian(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A Debian without a mirror, on which only coreutils is installed; it notes what apt-get was asked for."""
    programs = {"dpkg-query": '[ "$4" != coreutils ] || printf "install ok installed"',
                "apt-get": f'echo "$@" >>{tmp_path}/asked; exit 1'}  # fmt: skip
    for name, does in programs.items():
        (tmp_path / name).write_text(f"#!/bin/sh\n{does}\n")
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    return tmp_path


@pytest.mark.parametrize(("user", "says"), [(1000, "As root: apt-get"), (0, "--install, or: apt-get")])
def test_missing_package_is_named_with_the_command_and_installed_only_when_asked(
    debian: Path, monkeypatch: pytest.MonkeyPatch, user: int, says: str
) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: user)
    kernel.need(["coreutils"], install=False)
    with pytest.raises(RunnerError, match="missing here: no-such-package") as why:
        kernel.need(["coreutils", "no-such-package"], install=False)
    assert says in str(why.value) and "apt-get install --no-install-recommends no-such-package" in str(why.value)
    assert not (debian / "asked").exists()


def test_install_that_fails_says_so(debian: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    with pytest.raises(RunnerError, match="could not install no-such-package"):
        kernel.need(["coreutils", "no-such-package"], install=True)
    assert (debian / "asked").read_text() == "update\n"


def test_elsewhere_than_on_debian_the_programs_are_looked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "gcc").write_text("")
    (tmp_path / "gcc").chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    kernel.need(["gcc", "libelf-dev"], install=False)
    with pytest.raises(RunnerError, match=r"missing here: xz-utils \(Debian's names"):
        kernel.need(["gcc", "xz-utils"], install=False)


def test_missing_source_names_the_other_way(debian: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernel, "SOURCE", debian / "none")
    with pytest.raises(RunnerError, match=r"linux-source-6.12 gcc .*--source FILE, an archive linux-6.12"):
        kernel.need_for_build(None)
    with pytest.raises(RunnerError) as why:
        kernel.need_for_build(debian / "linux-6.12.30.tar.xz")
    assert "linux-source" not in str(why.value) and "--source" not in str(why.value)


def test_kernel_of_a_given_source_has_a_place_of_its_own(place: Path) -> None:
    archive = place / "linux-6.12.30.tar.xz"
    archive.write_bytes(b"1234")
    assert kernel._cached(archive).name.endswith("-linux-6.12.30-4") and kernel._cached(archive) != kernel._cached(None)


def test_no_place_for_the_cache_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("HILRIG_KERNEL_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc/no-such-place")
    with pytest.raises(RunnerError, match="XDG_CACHE_HOME"):
        kernel.small(Wanted(command=("true",)))


def processes_that_name(token: str) -> list[str]:
    """Command lines in which the token occurs."""
    found = []
    for file in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            line = file.read_bytes().replace(b"\0", b" ").decode(errors="replace")
        except OSError:
            continue
        if token in line:
            found.append(line)
    return found
