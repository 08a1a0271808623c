"""Whom zenoh turns away is counted, one by one, in a process that leaves its standard output to that: a rig's."""

from __future__ import annotations

import select
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path

import pytest
import zenoh

from hil.files.keys import make_keys
from tests.links.test_zenoh_access import tls_entries, zenoh_intruder
from tests.ports import free_port
from tests.waiting import until
from transport import Link, open_link
from transport.links.contract import control, sensor
from transport.links.zenoh_link import config

RIG = """
import os, sys
from transport.links.zenoh_refusals import standard_output_is_free
standard_output_is_free()
from transport import Link, open_link
from transport.links.contract import sensor
with open_link(sys.argv[1], "rig") as rig:
    assert os.get_inheritable(1), "what a control law starts has a standard output"
    for line in sys.stdin:
        rig.send(sensor(1))
        print(getattr(rig.counters, sys.argv[2]), file=sys.stderr, flush=True)
"""
WRITES = 20


@contextmanager
def rig_of(uri: str, reasons: list[str] | None = None, counter: str = "refused") -> Iterator[Callable[[], int]]:
    """A rig's end in a process of its own; what is yielded asks it how many it has counted."""
    command, reasons = [sys.executable, "-c", RIG, uri, counter], [] if reasons is None else reasons
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None and process.stdout is not None and process.stderr is not None
        asked, said = process.stdin, process.stderr

        def refused() -> int:
            asked.write("\n")
            asked.flush()
            while (line := said.readline()).startswith("hil: zenoh refused"):
                reasons.append(line)
            return int(line)

        assert refused() == 0  # it is up
        yield refused
        asked.close()
        assert process.stdout.read() == ""  # zenoh's log reaches no stream


def receives(controller: Link, ask: Callable[[], int]) -> bool:
    """Whether the controller receives from the rig, which sends whenever it is asked."""
    ask()
    return controller.receive(0.05) == sensor(1)


def test_the_controller_alone_is_never_counted(tmp_path: Path) -> None:
    for uri in uris(tmp_path).values():
        with rig_of(uri) as refused, open_link(uri, "controller") as controller:
            until(partial(receives, controller, refused), "the rig")
            for seq in range(1, 6):
                controller.send(control(seq))
            assert refused() == 0
            until(partial(receives, controller, refused), "the rig again")


def uris(folder: Path) -> dict[str, str]:
    """A URI with certificates, and one with passwords."""
    make_keys(folder / "keys")
    (folder / "users").write_text("controller:letmein\nobserver:look\n")
    (folder / "users").chmod(0o600)
    return {
        "tls": f"zenoh:tls/127.0.0.1:{free_port()}?keys={folder}/keys",
        "tcp": f"zenoh:tcp/127.0.0.1:{free_port()}?users={folder}/users",
    }


def port_of(uri: str) -> int:
    return int(uri.partition("?")[0].rpartition(":")[2])


@pytest.mark.parametrize("protocol", ["tls", "tcp"])
def test_each_write_of_a_peer_outside_the_list_is_counted(tmp_path: Path, protocol: str) -> None:
    uri = uris(tmp_path)[protocol]
    login = {"transport/auth/usrpwd": {"user": "observer", "password": "look"}}
    entries = tls_entries(tmp_path / "keys", "rig") if protocol == "tls" else login
    with rig_of(uri) as refused, zenoh_intruder(port_of(uri), entries, protocol) as (session, received):
        publisher = session.declare_publisher("hil/rig0/control")
        until(lambda: publisher.matching_status.matching, "word that the rig listens")
        at_first = 3 if protocol == "tls" else 2  # its two subscriptions, and over tls its connection
        until(lambda: refused() >= at_first, "its subscriptions to be refused")
        before = refused()
        for seq in range(WRITES):
            publisher.put(control(seq + 1))
        until(lambda: refused() >= before + WRITES, "its writes to be counted")
        assert refused() == before + WRITES and received == []


@pytest.mark.parametrize("kind", ["another authority", "no certificate", "no password", "a wrong password"])
def test_a_refused_login_is_counted(tmp_path: Path, kind: str) -> None:
    both = uris(tmp_path)
    make_keys(tmp_path / "others")
    protocol, entries = {
        "another authority": ("tls", tls_entries(tmp_path / "others", "controller")),
        "no certificate": ("tls", {"transport/link/tls/root_ca_certificate": f"{tmp_path}/keys/ca.pem"}),
        "no password": ("tcp", {}),
        "a wrong password": ("tcp", {"transport/auth/usrpwd": {"user": "controller", "password": "guess"}}),
    }[kind]
    reasons: list[str] = []
    said = {"another authority": kind, "no certificate": "showed no certificate"}.get(kind, "a password is missing or wrong")
    uri = both[protocol]
    with rig_of(uri, reasons) as refused, zenoh_intruder(port_of(uri), dict(entries), protocol) as (session, received):
        until(lambda: refused() >= 2, "two tries to be counted")
        session.put("hil/rig0/control", control(1))
        assert received == []
    assert len(reasons) == 1 and said in reasons[0], reasons


def test_connections_that_are_no_session_are_counted_and_none_that_says_nothing_is_closed() -> None:
    """zenoh's thread stands still while it closes one; by default it closes those beyond a hundred, and each after 10 s."""
    port, silent, nonsense = free_port(), 105, 3
    uri = f"zenoh:tcp/127.0.0.1:{port}"
    with rig_of(uri, counter="unopened") as unopened, ExitStack() as held, open_link(uri, "controller") as controller:
        until(partial(receives, controller, unopened), "the rig")
        connections = [held.enter_context(socket.create_connection(("127.0.0.1", port))) for _ in range(silent + nonsense)]
        for each in connections[silent:]:
            each.sendall(bytes.fromhex("0200ffff"))
            while each.recv(64):  # a farewell
                pass
        until(lambda: unopened() == silent + nonsense, "all but the controller's to be counted")
        assert select.select(connections[:silent], (), (), 0)[0] == []
        until(partial(receives, controller, unopened), "the rig again")
    assert int(config("rig", "tcp/127.0.0.1:1", {}).get_json("transport/unicast/accept_timeout")) > 86_400_000


def test_a_flood_of_denied_writes_does_not_keep_the_controller_from_the_rig(tmp_path: Path) -> None:
    """More lines than the pipe holds: what the controller says afterwards still comes, and every write is counted."""
    uri, writes = uris(tmp_path)["tls"], 20_000
    with rig_of(uri) as refused, zenoh_intruder(port_of(uri), tls_entries(tmp_path / "keys", "rig")) as (session, _):
        publisher = session.declare_publisher("hil/rig0/control", congestion_control=zenoh.CongestionControl.BLOCK)
        until(lambda: publisher.matching_status.matching, "word that the rig listens")
        for seq in range(writes):
            publisher.put(control(seq + 1))
        until(lambda: refused() >= writes, "its writes to be counted")
        with open_link(uri, "controller") as controller:
            until(partial(receives, controller, refused), "the rig")
