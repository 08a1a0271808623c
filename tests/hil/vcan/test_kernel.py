"""Which user-mode kernel is taken, from which place, and what is said while one is built."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path

import pytest

from hil.vcan import kernel, what_would_run
from hil.vcan.kernel import Kernel, debian
from hil.vcan.supervise import RunnerError, Wanted


@pytest.fixture
def program(tmp_path: Path) -> Path:
    """A kernel that says its version."""
    path = tmp_path / "linux"
    path.write_text("#!/bin/sh\necho 6.1.9\n")
    path.chmod(0o755)
    return path


def test_a_kernel_says_what_it_is(program: Path) -> None:
    assert Kernel(path=program, backend="uml").describe() == f"our small user-mode kernel 6.1.9 ({program})"
    assert Kernel(path=program, backend="debian").describe() == f"Debian's user-mode kernel 6.1.9 ({program})"


def test_modules_of_debian_come_after_what_they_depend_on_and_each_once(
    program: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in modules.dep of a distribution: a module, and behind the colon all that it depends on, nearest first."""
    asked: list[object] = []
    monkeypatch.setattr(kernel, "need_machine", lambda *, install: asked.append(install))
    monkeypatch.setattr(kernel, "need", lambda packages, *, install: asked.append((packages, install)))
    monkeypatch.setattr(kernel, "DEBIAN", program)
    monkeypatch.setattr(kernel, "DEBIAN_MODULES", tmp_path)
    (tmp_path / "6.1.9").mkdir()
    (tmp_path / "6.1.9/modules.dep").write_text(
        "net/can/can.ko:\nnet/can/can-raw.ko: net/can/can.ko\ndrivers/vcan.ko: drivers/can-dev.ko net/can/can.ko\n"
        "drivers/can-dev.ko: net/can/can.ko\nfs/other.ko: fs/more.ko\n"
    )
    found = debian(Wanted(command=("true",), install=True))
    names = ("net/can/can.ko", "drivers/can-dev.ko", "drivers/vcan.ko", "net/can/can-raw.ko")
    assert found == Kernel(path=program, backend="debian", modules=tuple(tmp_path / "6.1.9" / name for name in names))
    assert asked == [True, (["user-mode-linux", "kmod"], True)]


class Screen(io.StringIO):
    def __init__(self, terminal: bool) -> None:
        super().__init__()
        self.isatty = lambda: terminal  # type: ignore[method-assign]


@pytest.mark.parametrize(
    ("terminal", "step_s", "lines", "said"),
    [
        (False, 20.0, 5, "hil vcan: kernel 0 %, 40 s\nhil vcan: kernel 0 %, 80 s\n"),
        (False, 30.0, 2, "hil vcan: kernel 0 %, 60 s\n"),
        (True, 0.15, 3, f"\r{'hil vcan: kernel 0 %, 0 s':<60}\r"),
        (True, 0.25, 2, f"\r{'hil vcan: kernel 0 %, 0 s':<60}\r{'hil vcan: kernel 0 %, 0 s':<60}\r"),
        (False, 0.1, 701, "hil vcan: kernel 26 %, 30 s, about 87 s left\nhil vcan: kernel 51 %, 60 s, about 57 s left\n"),
    ],
)  # fmt: skip
def test_a_build_says_how_far_it_is_now_and_then(
    monkeypatch: pytest.MonkeyPatch, terminal: bool, step_s: float, lines: int, said: str
) -> None:
    now_s, screen = 100.0, Screen(terminal)

    def made() -> Iterator[bytes]:
        nonlocal now_s
        for _ in range(lines):
            now_s = round(now_s + step_s, 6)
            yield b"  CC\n"

    monkeypatch.setattr(kernel.time, "monotonic", lambda: now_s)
    monkeypatch.setattr(kernel.sys, "stderr", screen)
    kernel._show_progress(made())
    assert screen.getvalue() == said


def test_a_kernel_is_kept_by_what_it_is_made_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HILRIG_KERNEL_CACHE", str(tmp_path))
    source, absent = tmp_path / "linux-6.12.1.tar.xz", tmp_path / "absent"
    source.write_bytes(bytes(7))
    first = kernel._cached(source)
    assert first.parent == tmp_path / "hilrig" and first.name.startswith("linux-vcan-") and first.name.endswith("-linux-6.12.1-7")
    monkeypatch.setattr(kernel, "SOURCE", absent)
    assert kernel._cached(None).name.endswith("-none") and kernel.built() is None
    first.parent.mkdir()
    first.touch()
    assert kernel._cached(None) == kernel.built() == first
    monkeypatch.setattr(kernel, "SOURCE", source)
    monkeypatch.setattr(kernel, "_source_version", lambda: "6.12-3")
    assert kernel._cached(None).name == f"{first.name.rpartition('-linux')[0]}-6.12-3"
    monkeypatch.setattr(kernel, "HERE", tmp_path)
    for name in ("kernel.config", "build_kernel"):
        (tmp_path / name).write_text("another")
    assert kernel._cached(source).name[:24] != first.name[:24]


def test_a_kernel_that_another_user_can_write_is_not_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HILRIG_KERNEL_CACHE", str(tmp_path))
    monkeypatch.setattr(kernel, "SOURCE", tmp_path / "absent")
    kept = kernel._cached(None)
    kept.parent.mkdir(mode=0o755)
    kept.touch(mode=0o755)
    assert kernel.built() == kept
    for place, mode in ((kept, 0o757), (kept.parent, 0o777)):
        place.chmod(mode)
        with pytest.raises(RunnerError, match=rf"^{place}: another user can write it"):
            kernel.built()
        place.chmod(0o755)
    monkeypatch.setattr(kernel.os, "geteuid", lambda: kept.stat().st_uid + 1)
    if kept.stat().st_uid:  # root's own kernel is everybody's
        with pytest.raises(RunnerError, match="another user can write it"):
            kernel.built()


@pytest.mark.parametrize("query", ["exit 1", ""], ids=["another package manager", "no dpkg"])
def test_a_source_of_no_package_is_said(query: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if query:
        (tmp_path / "dpkg-query").write_text(f"#!/bin/sh\n{query}\n")
        (tmp_path / "dpkg-query").chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(kernel, "SOURCE", tmp_path)
    with pytest.raises(RunnerError, match=rf"is of no package that dpkg-query knows; build from it with --source {tmp_path}"):
        kernel.built()


def test_a_user_without_a_home_keeps_no_kernel_and_reads_why(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("HILRIG_KERNEL_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", "~")
    works, _, remedy = what_would_run()
    assert works or "set XDG_CACHE_HOME" in remedy  # this machine's own kernel may have a vcan
    with pytest.raises(RunnerError, match="set XDG_CACHE_HOME"):
        kernel.built()
