"""One controller of a rig over zenoh, though the other one is on another machine: it sees no claim of this one's user."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from hil.files.keys import make_keys
from tests.ports import free_port
from tests.waiting import LIMIT_S, until
from transport import open_link
from transport.links import OneOfARole, TransportError
from transport.links.contract import control, meet, sensor

CONTROLLER = """
import sys
from transport import TransportError, open_link
from transport.links.contract import control
with open_link(sys.argv[1], "controller") as link:
    print("up", flush=True)
    while True:
        packet = link.receive(0.05)
        if packet is not None:
            link.send(packet)
            print("heard", flush=True)
        if len(sys.argv) > 2:
            link.send(control(int(sys.argv[2])))
        try:
            link.check_alone()
        except TransportError as error:
            sys.exit(f"hil: {error}")
"""


@contextmanager
def elsewhere(folder: Path, uri: str, *more: str, within: tuple[str, ...] = ()) -> Iterator[subprocess.Popen[str]]:
    """A controller on another machine, as far as claims go: it has a directory of its own."""
    folder.mkdir(exist_ok=True)
    command = [*within, sys.executable, "-c", CONTROLLER, uri, *more]
    environment = os.environ | {"HIL_CLAIM_DIR": str(folder / "claims")}
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None and process.stdout.readline() == "up\n", process.communicate()
            yield process
        finally:
            process.kill()


def answered(rig: object, seq: int) -> bool:
    rig.send(sensor(seq))  # type: ignore[attr-defined]
    return rig.receive(0.05) is not None  # type: ignore[attr-defined]


@pytest.fixture(params=["tcp", "tls", "users"])
def uri(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    if request.param == "users":
        (tmp_path / "users").write_text("controller:letmein\n")
        (tmp_path / "users").chmod(0o600)
        return f"zenoh:tcp/127.0.0.1:{free_port()}?users={tmp_path}/users"
    if request.param == "tls":
        make_keys(tmp_path / "keys")
        return f"zenoh:tls/127.0.0.1:{free_port()}?keys={tmp_path}/keys"
    return f"zenoh:tcp/127.0.0.1:{free_port()}"


def test_a_second_controller_from_another_machine_is_refused_and_a_death_frees_the_role(uri: str, tmp_path: Path) -> None:
    with open_link(uri, "rig") as rig, elsewhere(tmp_path / "a", uri) as first:
        until(lambda: answered(rig, 1), "the first controller")
        with elsewhere(tmp_path / "b", uri) as second:
            out, said = second.communicate(timeout=LIMIT_S)
            assert second.returncode == 1 and f"the rig has another controller already, process {first.pid} on " in said, said
            assert "received" not in out  # it took no packet, so it answered none
        until(lambda: answered(rig, 2), "the first controller still")
        first.kill()
        first.wait()
        with elsewhere(tmp_path / "b", uri):
            until(lambda: answered(rig, 3), "the next controller")


def test_what_a_refused_controller_says_before_it_knows_reaches_no_process(tmp_path: Path) -> None:
    uri = f"zenoh:tcp/127.0.0.1:{free_port()}"
    with open_link(uri, "rig") as rig, elsewhere(tmp_path / "a", uri):
        until(lambda: answered(rig, 1), "the first controller")
        while rig.receive(0.1) is not None:
            pass
        with elsewhere(tmp_path / "b", uri, "77") as second:
            second.communicate(timeout=LIMIT_S)
        received = []
        while (packet := rig.receive(0.1)) is not None:
            received.append(packet)
        assert control(77) not in received and rig.counters.refused > 3


def test_of_controllers_that_wait_for_one_rig_one_is_received(tmp_path: Path) -> None:
    uri = f"zenoh:tcp/127.0.0.1:{free_port()}"
    with ExitStack() as stack:
        waiting = [stack.enter_context(elsewhere(tmp_path / f"{n}", uri)) for n in range(3)]
        rig = stack.enter_context(open_link(uri, "rig"))
        until(lambda: answered(rig, 1), "one of them")
        until(lambda: sum(each.poll() is not None for each in waiting) == 2, "two to be refused")
        [received] = [each for each in waiting if each.poll() is None]
        for each in waiting:
            if each is not received:
                assert each.returncode == 1 and f"process {received.pid} on " in each.communicate()[1]
        until(lambda: answered(rig, 2), "the one that is left")


def test_with_a_key_the_message_still_names_the_holder_of_the_role(tmp_path: Path) -> None:
    make_keys(tmp_path / "keys")
    uri = f"zenoh:tcp/127.0.0.1:{free_port()}?auth={tmp_path}/keys/frames.key"
    with open_link(uri.partition("?")[0], "rig") as rig, elsewhere(tmp_path / "a", uri.partition("?")[0]) as first:
        until(lambda: answered(rig, 1), "the first controller")
        with open_link(uri, "controller") as second:
            assert isinstance(second, OneOfARole)

            def refused() -> bool:
                try:
                    second.check_alone()
                except TransportError as error:
                    return f"process {first.pid} on " in str(error)
                return False

            until(refused, "to be refused")


@pytest.fixture
def machine() -> Iterator[tuple[str, tuple[str, ...]]]:
    """An address that another network namespace reaches, and what runs a command there."""
    name = f"hil{os.getpid() % 100_000}"
    made = subprocess.run(["ip", "netns", "add", name], capture_output=True)
    if made.returncode:
        pytest.skip(f"no network namespaces here (ip netns add: {made.stderr.decode()[:80]!r}); run it as root")
    octet = os.getpid() % 250
    try:
        for command in (
            f"ip link add {name} type veth peer name eth0 netns {name}", f"ip addr add 10.213.{octet}.1/24 dev {name}",
            f"ip link set {name} up", f"ip -n {name} addr add 10.213.{octet}.2/24 dev eth0", f"ip -n {name} link set eth0 up",
            f"ip -n {name} link set lo up",
        ):  # fmt: skip
            done = subprocess.run(command.split(), capture_output=True)
            if done.returncode:
                pytest.skip(f"no virtual cable here ({command}: {done.stderr.decode()[:80]!r})")
        yield f"10.213.{octet}.1", ("ip", "netns", "exec", name)
    finally:
        subprocess.run(["ip", "netns", "del", name], check=True)
        subprocess.run(["ip", "link", "del", name], capture_output=True)


def test_a_controller_in_another_network_is_refused_too(machine: tuple[str, tuple[str, ...]], tmp_path: Path) -> None:
    address, there = machine
    uri = f"zenoh:tcp/{address}:{free_port()}?lan=1"
    with open_link(uri, "rig") as rig, open_link(uri, "controller") as first:
        meet(rig, first)
        with elsewhere(tmp_path / "b", uri, within=there) as second:
            _, said = second.communicate(timeout=LIMIT_S)
            assert second.returncode == 1 and f"process {os.getpid()} on " in said, said
