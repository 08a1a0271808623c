"""Out of file descriptors: a newcomer waits, and the link's counters say so, as the summary of a run does."""

from __future__ import annotations

import os
import resource
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from transport import open_link


@pytest.fixture
def few_descriptors() -> Iterator[None]:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    yield
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


@pytest.mark.usefixtures("few_descriptors")
def test_a_participant_without_a_descriptor_is_counted_by_the_link(bus_directory: Path) -> None:
    with open_link("can:hil:few", "rig") as rig, socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as newcomer:
        (path,) = (bus_directory / "few").glob("*.sock")
        newcomer.connect(str(path))
        assert rig.counters.turned_away == 0
        _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        lowest_free = os.dup(0)
        os.close(lowest_free)
        resource.setrlimit(resource.RLIMIT_NOFILE, (lowest_free, hard))
        for _ in range(5):
            assert rig.receive(0) is None
        assert rig.counters.turned_away == 1
