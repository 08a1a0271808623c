"""Opening a link by its URI, and what a wrong one is answered."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

import transport
from transport import Link, LinkCounters, TransportError, memory_pair, open_link
from transport.installed import Folder, Point
from transport.links.contract import QUEUE_LIMIT


@pytest.mark.parametrize(
    ("uri", "hint"),
    [
        ("", "no scheme, expected one of can, local, memory, zenoh"),
        ("rig0", "no scheme"),
        (":rig0", "no scheme"),
        ("zenho:tcp/127.0.0.1:7447", "did you mean 'zenoh:tcp/127.0.0.1:7447'?"),
        ("http://x", "no link is called 'http', expected one of can, local, memory, zenoh"),
        ("memory:", "can:hil:rig0 between processes"),
        ("can:", "expected can:<interface>:<channel>"),
        ("can:hil:", "expected can:<interface>:<channel>"),
        ("can:sockecan:vcan0", "did you mean 'socketcan'?"),
        ("can:hil:../rig0", "expected up to 32 letters"),
        ("can:hil:rig0?fd=2", "fd=2, expected 1 (CAN FD) or 0 (classic CAN)"),
        ("can:hil:rig0?pad=yes", "pad=yes, expected 1"),
        ("can:hil:rig0?fd=0&pad=1", "classic frames have no padding"),
        ("can:hil:rig0?base=0x110", "base: expected a multiple of 0x100"),
        ("can:hil:rig0?base=ten", "base: expected a multiple of 0x100"),
        ("can:hil:rig0?base=0x800", "base: expected a multiple of 0x100"),
        ("can:hil:rig0?fd=1&fd=0", "named twice"),
        ("can:hil:rig0?fd", "not name=value"),
        ("can:hil:rig0?bas=0x200", "no option is called 'bas', did you mean 'base'?"),
        ("can:hil:rig0?bogus=1", "no option is called 'bogus', expected fd, pad, base"),
        ("can:hil:rig0?can_filters=3", "no option is called 'can_filters'"),
        ("can:hil:rig0?channel=x", "no option is called 'channel'"),
        ("can:hil:rig0?ignore_config=0", "no option is called 'ignore_config'"),
        ("can:socketcan:vcan0?bitrat=1", "did you mean 'bitrate'?"),
        ("can:virtual:x?rx_queue=1", "did you mean 'rx_queue_size'?"),
        ("can:socketcan:nosuchcan0", ""),
    ],
)
def test_a_bad_uri_is_refused_with_the_uri_and_a_hint(uri: str, hint: str) -> None:
    with pytest.raises(TransportError) as caught:
        open_link(uri, "rig")
    assert hint in str(caught.value) and repr(uri) in str(caught.value)


def link_point(name: str, value: str) -> Point:
    return Point("hil.links", name, value, Folder(""))


def test_a_role_that_is_none_is_refused() -> None:
    with pytest.raises(TransportError, match="'observer', expected 'rig' or 'controller'"):
        open_link("can:hil:rig0", "observer")  # type: ignore[arg-type]


def test_a_users_link_comes_in_by_the_same_entry_point(monkeypatch: pytest.MonkeyPatch) -> None:
    mine, broken = link_point("mine", "transport.links.contract:MemoryLink"), link_point("broken", "nowhere:Link")
    monkeypatch.setattr("transport.links.opening.points", lambda begin: (mine, broken))

    def begin(self: object, uri: str, role: str) -> None:
        self.uri, self.counters = uri + role, LinkCounters()  # type: ignore[attr-defined]

    monkeypatch.setattr("transport.links.contract.MemoryLink.__init__", begin)
    assert open_link("mine:x", "rig").uri == "mine:xrig"
    with pytest.raises(TransportError, match=r"plug-in broken = nowhere:Link, .*NotFoundError: No module named 'nowhere'$"):
        open_link("broken:x", "rig")
    monkeypatch.setattr("tests.transport.links.test_link.LinkCounters", dict)
    with pytest.raises(TransportError, match=r"MemoryLink\.counters: a dict, expected a transport\.LinkCounters"):
        open_link("mine:x", "rig")


@pytest.mark.parametrize(("option", "times"), [("", 0), ("?auth=KEY", 1)])
def test_a_users_link_that_raises_when_it_is_asked_what_it_has_is_one_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, option: str, times: int
) -> None:
    key = tmp_path / "frames.key"
    key.write_text("00" * 16)
    key.chmod(0o600)
    asked = []
    mine = link_point("mine", "transport.links.contract:MemoryLink")
    monkeypatch.setattr("transport.links.opening.points", lambda begin: (mine,))

    def fails(self: object) -> str:
        asked.append(1)
        if len(asked) > times:
            raise RuntimeError("no address")
        return "mine:x"

    def begin(self: object, uri: str, role: str) -> None:
        self.counters = LinkCounters()  # type: ignore[attr-defined]

    monkeypatch.setattr("transport.links.contract.MemoryLink.__init__", begin)
    monkeypatch.setattr("transport.links.contract.MemoryLink.uri", property(fails), raising=False)
    with pytest.raises(TransportError, match=r"plug-in mine = transport.*MemoryLink, of .*: RuntimeError: no address \(.*line"):
        open_link(f"mine:x{option.replace('KEY', str(key))}", "rig")


def test_importing_the_package_imports_neither_can_nor_zenoh_nor_numpy() -> None:
    program = "import sys, transport; print(*{'can', 'zenoh', 'cantools', 'numpy'} & set(sys.modules))"
    assert subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout == "\n"


def test_every_public_name_is_there() -> None:
    for name in transport.__all__:
        assert getattr(transport, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        transport.nothing  # noqa: B018


@pytest.fixture
def pair() -> Iterator[tuple[Link, Link]]:
    rig, controller = memory_pair()
    with rig, controller:
        yield rig, controller


def test_memory_holds_its_stated_number_of_packets_and_counts_the_rest(pair: tuple[Link, Link]) -> None:
    rig, controller = pair
    for number in range(QUEUE_LIMIT + 10):
        rig.send(number.to_bytes(2, "little"))
    assert (rig.counters.sent, rig.counters.dropped) == (QUEUE_LIMIT, 10)
    got = [controller.receive(0) for _ in range(QUEUE_LIMIT + 1)]
    assert got == [*(number.to_bytes(2, "little") for number in range(QUEUE_LIMIT)), None]


def test_memory_wakes_a_thread_that_waits(pair: tuple[Link, Link]) -> None:
    rig, controller = pair

    def answer() -> None:
        while (packet := controller.receive(10)) not in (None, b"stop"):
            controller.send(packet)

    thread = threading.Thread(target=answer)
    thread.start()
    for number in range(500):
        rig.send(str(number).encode())
        assert rig.receive(10) == str(number).encode()
    rig.send(b"stop")
    thread.join(10)
    assert not thread.is_alive()


def test_closing_memory_ends_a_wait(pair: tuple[Link, Link]) -> None:
    _, controller = pair
    thread = threading.Thread(target=lambda: controller.receive(60))
    thread.start()
    while not controller._waiting:  # type: ignore[attr-defined]
        pass
    controller.close()
    thread.join(10)
    assert not thread.is_alive()
