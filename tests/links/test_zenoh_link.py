"""Zenoh: what can go wrong with the other end, and who may connect at all."""

from __future__ import annotations

import os
import select
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from time import monotonic

import pytest

from tests.ports import free_port
from tests.waiting import LIMIT_S, until
from transport import Link, TransportError, open_link
from transport.links.contract import SEND_LIMIT_S, control, expect, meet, sensor
from transport.links.zenoh_link import LARGEST, config

ECHO = """
import sys
from transport import open_link
link = open_link(sys.argv[1], sys.argv[2])
print("up", flush=True)
while True:
    packet = link.receive(1.0)
    if packet is not None:
        link.send(packet)
"""


THREADS = """
import ctypes, sys
from pathlib import Path
from transport import open_link
from transport.links.contract import meet
python = ctypes.pythonapi
for function in (python.PyInterpreterState_Get, python.PyInterpreterState_ThreadHead, python.PyThreadState_Next):
    function.restype = ctypes.c_void_p
    function.argtypes = [ctypes.c_void_p] if function is not python.PyInterpreterState_Get else []
with open_link(sys.argv[1], "rig") as rig, open_link(sys.argv[1], "controller") as controller:
    meet(rig, controller)
    states, state = 0, python.PyInterpreterState_ThreadHead(python.PyInterpreterState_Get())
    while state:
        states, state = states + 1, python.PyThreadState_Next(state)
    print(states, *sorted(task.joinpath("comm").read_text().strip() for task in Path("/proc/self/task").iterdir()))
"""


@contextmanager
def other_end(uri: str, role: str) -> Iterator[subprocess.Popen[bytes]]:
    """A process that sends back whatever it receives."""
    with subprocess.Popen([sys.executable, "-c", ECHO, uri, role], stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None and process.stdout.readline() == b"up\n"
            yield process
        finally:
            process.kill()


def answered(link: Link, within_s: float) -> bool:
    end = monotonic() + within_s
    while monotonic() < end:
        link.send(control(1))
        if link.receive(0.02) is not None:
            return True
    return False


@pytest.fixture(params=["tcp", "unix"])
def uri(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    return f"zenoh:tcp/127.0.0.1:{free_port()}" if request.param == "tcp" else f"zenoh:unixsock-stream/{tmp_path}/z"


def test_a_payload_longer_than_a_packet_is_counted_and_not_kept(uri: str) -> None:
    """A queue of 256 of them, each of a gigabyte, would take all memory of a rig."""
    import zenoh

    with open_link(uri, "rig") as rig:
        endpoint = uri.removeprefix("zenoh:")
        with zenoh.open(config("controller", endpoint, {"mode": "client", "connect/exit_on_failure": True})) as peer:
            publish = peer.declare_publisher("hil/rig0/control", congestion_control=zenoh.CongestionControl.BLOCK)
            until(lambda: publish.matching_status.matching, "the rig")
            for size in (LARGEST + 1, 5_000_000, LARGEST):
                publish.put(bytes(size))
            assert rig.receive(LIMIT_S) == bytes(LARGEST) and rig.receive(0) is None
            assert rig.counters.malformed >= 1 and rig.counters.received == 1


def test_controller_may_come_first_and_finds_a_rig_that_was_killed_and_restarted(uri: str) -> None:
    with open_link(uri, "controller") as link:
        with other_end(uri, "rig") as rig:
            assert answered(link, LIMIT_S)
            rig.kill()
            rig.wait()
            while link.receive(0.2) is not None:
                pass  # what it had answered before, to the end of the queue
            assert not answered(link, 0.3)
        with other_end(uri, "rig"):
            assert answered(link, LIMIT_S)


def test_a_stopped_controller_never_blocks_the_rig(uri: str) -> None:
    with open_link(uri, "rig") as link, other_end(uri, "controller") as controller:
        assert answered(link, LIMIT_S)
        os.kill(controller.pid, signal.SIGSTOP)
        slowest = 0.0
        for seq in range(30_000):
            begin = monotonic()
            link.send(sensor(seq))
            slowest = max(slowest, monotonic() - begin)
        assert slowest < SEND_LIMIT_S
        os.kill(controller.pid, signal.SIGCONT)
        assert answered(link, LIMIT_S)


class Forwarder:
    """A TCP connection through a cable that can be cut."""

    def __init__(self, port: int) -> None:
        self._target = ("127.0.0.1", port)
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self._wake, self._alarm = socket.socketpair()
        self._pairs: dict[socket.socket, socket.socket] = {}
        self._whole = True
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def cut(self) -> None:
        self._whole = False
        self._alarm.send(b"!")

    def mend(self) -> None:
        self._whole = True

    def _run(self) -> None:
        while True:
            ready, _, _ = select.select([self._listener, self._wake, *self._pairs], [], [])
            if self._wake in ready and not self._wake.recv(64):
                return
            if not self._whole:
                for end in self._pairs:
                    end.close()
                self._pairs.clear()
            if self._listener in ready:
                near, _ = self._listener.accept()
                if self._whole:
                    with suppress(OSError):
                        far = socket.create_connection(self._target)
                        self._pairs |= {near: far, far: near}
                else:
                    near.close()
            for end in ready:
                if end not in self._pairs:  # its other side was closed a moment ago
                    continue
                with suppress(OSError):
                    if data := end.recv(65536):
                        self._pairs[end].sendall(data)
                        continue
                for side in (end, self._pairs.pop(end)):
                    side.close()
                    self._pairs.pop(side, None)

    def close(self) -> None:
        self._alarm.close()
        self._thread.join()
        for end in (self._listener, self._wake, *self._pairs):
            end.close()


def test_a_packet_wakes_one_thread_of_zenoh_which_keeps_its_python_thread_state(tmp_path: Path) -> None:
    environment = os.environ | {"ZENOH_RUNTIME": "what no zenoh reads"}
    program = [sys.executable, "-c", THREADS, f"zenoh:unixsock-stream/{tmp_path}/z"]
    said = subprocess.run(program, env=environment, capture_output=True, text=True, timeout=LIMIT_S, check=True).stdout.split()
    states, threads = int(said[0]), said[1:]
    assert {name.partition("-")[0] for name in threads} & {"app", "acc", "net", "tx", "rx"} == {"app"}, threads
    assert states >= 2, "the thread that calls back has one of its own, beside the main thread, also while it does not call"


def test_a_cut_cable_is_survived_and_both_ends_meet_again() -> None:
    port = free_port()
    forwarder = Forwarder(port)
    try:
        with (
            open_link(f"zenoh:tcp/127.0.0.1:{port}", "rig") as rig,
            open_link(f"zenoh:tcp/127.0.0.1:{forwarder.port}", "controller") as controller,
        ):
            meet(rig, controller)
            forwarder.cut()
            deadline = monotonic() + LIMIT_S
            while controller.receive(0.05) is not None or rig.receive(0.05) is not None:
                assert monotonic() < deadline
            for seq in range(200):
                rig.send(sensor(seq))
                controller.send(control(seq))
            assert rig.receive(0.1) is None and controller.receive(0.1) is None
            forwarder.mend()
            meet(rig, controller)
            rig.send(sensor(7))
            expect(controller, sensor(7))
    finally:
        forwarder.close()


@pytest.mark.parametrize("end", ["raise RuntimeError", "sys.exit(0)", "pass"])
@pytest.mark.parametrize("role", ["rig", "controller"])
def test_a_process_that_never_closes_its_link_ends_all_the_same(role: str, end: str, uri: str) -> None:
    program = f"import sys\nfrom transport import open_link\nlink = open_link({uri!r}, {role!r})\n{end}"
    subprocess.run([sys.executable, "-c", program], stderr=subprocess.DEVNULL, timeout=LIMIT_S, check=False)


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.0.7", "[::]", "[fe80::1]", "example.org", "127.0.0.1.example.org"])
@pytest.mark.parametrize("role", ["rig", "controller"])
def test_other_machines_are_refused_unless_the_uri_allows_them(host: str, role: str) -> None:
    with pytest.raises(TransportError, match=r"not this machine alone.*append \?lan=1"):
        open_link(f"zenoh:tcp/{host}:7447", role)  # type: ignore[arg-type]


def test_lan_opens_the_endpoint_to_other_machines() -> None:
    with open_link(f"zenoh:tcp/0.0.0.0:{free_port()}?lan=1", "rig") as rig:
        assert rig.receive(0) is None


def test_the_controller_listens_nowhere() -> None:
    port = free_port()
    with open_link(f"zenoh:tcp/127.0.0.1:{port}", "controller"):
        tables = [Path(f"/proc/self/net/{name}").read_text().splitlines()[1:] for name in ("tcp", "tcp6", "udp", "udp6")]
        own = {os.readlink(f"/proc/self/fd/{fd}") for fd in os.listdir("/proc/self/fd") if Path(f"/proc/self/fd/{fd}").exists()}
    listening = [line for table in tables for line in table if line.split()[3] in ("0A", "07")]
    assert not [line for line in listening if f"socket:[{line.split()[9]}]" in own]


def test_a_taken_port_is_refused_with_a_hint() -> None:
    uri = f"zenoh:tcp/127.0.0.1:{free_port()}"
    with open_link(uri, "rig"), pytest.raises(TransportError, match=r"in use.*is another rig running there\?$") as caught:
        open_link(uri, "rig")
    assert ".rs:" not in str(caught.value)  # where in zenoh's source it arose says nothing to our user


@pytest.mark.parametrize(
    ("uri", "hint"),
    [
        ("zenoh:127.0.0.1:7447", "as in tcp/127.0.0.1:7447"),
        ("zenoh:tcp/127.0.0.1", "expected host:port"),
        ("zenoh:tcp/127.0.0.1:x", "expected host:port"),
        ("zenoh:tcp/127.0.0.1:99999", "expected host:port"),
        ("zenoh:tcp/127.0.0.1:0", "expected host:port"),
        ("zenoh:quic/127.0.0.1:7447", "begins with tcp/, tls/, udp/, ws/, unixsock-stream/"),
        ("zenoh:tls/127.0.0.1:7447", "tls/ needs ca, cert and key, or keys=DIR"),
        ("zenoh:tls/127.0.0.1:7447?ca=x&cert=y", "tls/ needs ca, cert and key"),
        ("zenoh:tls/127.0.0.1:7447?keys=/no/such", "/no/such/ca.pem: a certificate in PEM cannot be read: No such file"),
        ("zenoh:tls/127.0.0.1:7447?keys=a%00b", "ca.pem: a certificate in PEM cannot be read: "),
        (f"zenoh:tls/127.0.0.1:7447?keys={'m' * 5000}", "File name too long"),
        ("zenoh:tcp/127.0.0.1:7447?keys=/tmp", "certificates need an endpoint tls/host:port"),
        ("zenoh:tcp/127.0.0.1:7447?users=/no/such", "/no/such: the file of passwords cannot be read"),
        ("zenoh:tcp/127.0.0.1:7447?users=/dev/zero", "/dev/zero: is no regular file"),
        ("zenoh:unixpipe//tmp/x", "begins with tcp/"),
        ("zenoh:tcp/0.0.0.0:7447?lan=true", "lan=true, expected 1"),
        ("zenoh:unixsock-stream//no/such/folder", "No such file or directory"),
        ("zenoh:tcp/127.0.0.1:7447?nam=x", "'nam', expected name or lan"),
        ("zenoh:tcp/127.0.0.1:7447?name=a/b", "name 'a/b'"),
        ("zenoh:tcp/127.0.0.1:7447?name=**", "name"),
        ("zenoh:tcp/127.0.0.1:7447?lan", "not name=value"),
    ],
)
def test_a_bad_uri_is_refused_with_a_hint(uri: str, hint: str) -> None:
    with pytest.raises(TransportError) as caught:
        open_link(uri, "rig")
    assert hint in str(caught.value) and repr(uri) in str(caught.value)


@pytest.mark.parametrize("name", ["mine", "mine.lock"])
@pytest.mark.parametrize("kind", ["file", "link", "folder"])
def test_no_file_is_removed_for_a_socket(tmp_path: Path, name: str, kind: str) -> None:
    """zenoh removes whatever is called as its socket or its lock are: a URI, as any experiment has one, would delete a file."""
    place, other = tmp_path / name, tmp_path / "other"
    other.write_text("precious")
    if kind == "folder":
        place.mkdir()
    else:
        place.write_text("precious") if kind == "file" else place.symlink_to(other)
    for options in ("", "#so_rcvbuf=4096"):
        with pytest.raises(TransportError, match=rf"{name}: is in the way of the socket .*/mine, and none of zenoh's"):
            open_link(f"zenoh:unixsock-stream/{tmp_path}/mine{options}", "rig")
    with pytest.raises(TransportError, match="is in the way of the socket"):
        config("rig", f"unixsock-stream/{tmp_path}/mine", {})
    assert place.is_dir() if kind == "folder" else place.read_text() == "precious"
    config("controller", f"unixsock-stream/{tmp_path}/mine", {})


@pytest.mark.parametrize("endpoint", ["", "tcp/127.0.0.1:{port}", "tcp/localhost:{port}"])
def test_a_second_controller_is_refused_until_the_first_has_gone(endpoint: str) -> None:
    port, name = free_port(), f"two{os.getpid()}"
    first = f"zenoh:tcp/127.0.0.1:{port}?name={name}" if endpoint else f"zenoh:?name={name}"
    second = f"zenoh:{endpoint.format(port=port)}?name={name}"
    with open_link(first, "controller"):
        with pytest.raises(TransportError, match=r"is another controller running there\? Stop it, or choose another name"):
            open_link(second, "controller")
        open_link(second.replace(name, f"{name}-b"), "controller").close()
        open_link(second, "rig").close()
    open_link(second, "controller").close()
