"""One contract for all links: memory, our CAN bus, python-can's, zenoh, and a real vcan where there is one."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from tests.ports import free_port
from transport import Link, TransportError, memory_pair, open_link
from transport.links.contract import CHECKS, Pair, check_clause


def has_multicast() -> bool:
    with suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton("239.74.163.2") + bytes(4))
        return True
    return False


multicast = pytest.mark.skipif(not has_multicast(), reason="no multicast route: ip route add 224.0.0.0/4 dev lo")

LINKS = [
    pytest.param("memory:", id="memory"),
    pytest.param("can:hil:contract", id="hil-fd"),
    pytest.param("can:hil:contract?fd=0&base=0x300", id="hil-classic"),
    pytest.param("can:hil:contract?pad=1", id="hil-padded"),
    pytest.param("can:hil:contract?timed=1&bitrate=1M&dbitrate=8M", id="hil-timed"),
    pytest.param("can:hil:contract?fd=0&timed=1&bitrate=1M", id="hil-timed-classic"),
    pytest.param("can:virtual:contract", id="virtual"),
    pytest.param("can:udp_multicast:239.74.163.2?port={port}", id="udp-multicast", marks=multicast),
    pytest.param("zenoh:tcp/127.0.0.1:{port}", id="zenoh-tcp"),
    pytest.param("zenoh:unixsock-stream/{directory}/z", id="zenoh-unix"),
    pytest.param("can:socketcan:vcan0", id="vcan-fd", marks=pytest.mark.vcan),
    pytest.param("can:socketcan:vcan0?fd=0", id="vcan-classic", marks=pytest.mark.vcan),
]


def pair(template: str, directory: Path) -> Pair:
    if template == "memory:":
        return memory_pair()
    uri = template.format(port=free_port(), directory=directory)
    rig: Link = open_link(uri, "rig")
    return rig, open_link(uri, "controller")


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
@pytest.mark.parametrize("template", LINKS)
def test_link_keeps_the_contract(template: str, check: Callable[[Link, Link], None], bus_directory: Path) -> None:
    check_clause(check, lambda: pair(template, bus_directory))
    assert not (bus_directory / "contract").exists() or os.listdir(bus_directory / "contract") == []


@multicast
def test_another_port_of_a_multicast_group_is_another_bus() -> None:
    port = free_port()
    one, other = (f"can:udp_multicast:239.74.163.2?port={each}" for each in (port, port - 1))
    with open_link(one, "rig"), open_link(other, "rig"), pytest.raises(TransportError, match="is another rig running there"):
        open_link(one, "rig")
