"""An intruder that answers in the controller's place: what is sent ahead never commands, what races is said, exit status 5."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np
import pytest
import zenoh

from hil.experiment import shipped
from hil.files.keys import make_keys
from hil.log.read import Run, read_run
from tests.links.test_zenoh_access import tls_entries, zenoh_intruder
from tests.ports import free_port
from tests.warm_hil import hil_command
from transport.links.contract import control

pytestmark = pytest.mark.realtime

THEIRS = -4.0  # volt; our controller never asks for it


@contextmanager
def intruder(uri: str, way: str) -> Iterator[None]:
    """The program `intruder.py`, once it is on the link; it ends with the test."""
    program = Path(__file__).with_name("intruder.py")
    with subprocess.Popen([sys.executable, str(program), uri, way], stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None and process.stdout.readline() == b"up\n"
            yield
        finally:
            process.kill()


def session(folder: Path, uri: str, experiment: str = "dc-motor-hinf", seconds: int = 2) -> tuple[int, dict[str, Any], Run]:
    done = hil_command("run", experiment, "--clock", "real", "--link", uri, "--json", "--duration", str(seconds),
                       "--set", "reference.0.at=0.2", "-o", "run.mcap", "--force", cwd=folder)  # fmt: skip
    assert "Traceback" not in done.stderr and done.stdout, done.stderr
    return done.returncode, json.loads(done.stdout), read_run(folder / "run.mcap")


def reported(status: int, _summary: dict[str, Any]) -> bool:
    return status == 5


def raided(
    folder: Path, uri: str, experiment: str = "dc-motor-hinf", seen: Callable[[int, dict[str, Any]], bool] = reported
) -> tuple[int, dict[str, Any], Run]:
    """A session in which the intruder is seen, as a second controller by default; longer where two seconds leave it no time."""
    for seconds in (2, 10, 50):
        status, summary, run = session(folder, uri, experiment, seconds)
        if seen(status, summary):
            break
    return status, summary, run


def refused(_status: int, summary: dict[str, Any]) -> bool:
    return bool(summary["link_counters"]["refused"] > 10)


def applied(run: Run) -> np.ndarray[Any, Any]:
    return np.asarray(run.arrays["/actuator/applied"]["voltage"])


@pytest.mark.parametrize(("link", "way"), [("can", "ahead"), ("zenoh", "fill")])
def test_answers_sent_ahead_never_command_and_are_said(tmp_path: Path, link: str, way: str) -> None:
    uri = f"can:hil:who{os.getpid()}" if link == "can" else f"zenoh:tcp/127.0.0.1:{free_port()}"
    with intruder(uri, way):
        status, summary, run = raided(tmp_path, uri)
    assert status == 5 and "second controller" in summary["problems"]["second_controller"]
    assert sum(event["kind"] == "second controller" for event in run.events) == 1
    assert not (applied(run) == THEIRS).any()


def test_a_second_controller_with_the_nonce_is_reported(tmp_path: Path) -> None:
    """Who receives the question can echo its nonce: without a key that is a command, but always a reported one."""
    uri = f"zenoh:tcp/127.0.0.1:{free_port()}"
    with intruder(uri, "race"):
        status, summary, _ = raided(tmp_path, uri)
    said = summary["problems"]["second_controller"]  # the latter: the first question was empty, and no sample had left
    assert status == 5 and ("answered twice, differently" in said or "which was never sent" in said), said
    assert summary["accepted_from"] == "any process on this machine (no key set)"


def test_a_holder_of_the_controllers_role_prevents_a_run_and_is_named(tmp_path: Path) -> None:
    """Who can connect without a key can also do that; no slot of the plant runs, and the message says whom to stop."""
    uri = f"zenoh:tcp/127.0.0.1:{free_port()}"
    with intruder(uri, "role"):
        for _ in range(30):  # until the intruder was first: who of the two is, chance decides
            done = hil_command("run", "dc-motor-hinf", "--clock", "real", "--link", uri, "-o", "x.mcap", "--duration", "0.2",
                               "--force", cwd=tmp_path)  # fmt: skip
            if done.returncode != 0:
                break
            (tmp_path / "x.mcap").unlink()
    assert done.returncode == 2 and "the rig has another controller already, process " in done.stderr, done.stderr
    assert not any(tmp_path.iterdir())


def test_with_a_key_a_second_controller_is_refused_counted_and_reported(tmp_path: Path) -> None:
    """The key stands in the experiment file; the intruder echoes every nonce and is always there first, without a code."""
    make_keys(tmp_path / "keys")
    text = shipped()["dc-motor-hinf"].read_text() + '\n[links.auth]\nkey_file = "keys/frames.key"\n'
    (tmp_path / "mine.toml").write_text(text)
    uri = f"can:hil:keyed{os.getpid()}"
    with intruder(uri, "race"):
        status, summary, run = raided(tmp_path, uri, "mine.toml", refused)
    assert status in (0, 3)  # 3: a machine so busy that the watchdog trips; no other program commanded
    assert refused(status, summary) and "refused" in summary["problems"]
    assert summary["accepted_from"] == "holders of the key keys/frames.key"
    assert not (applied(run) == THEIRS).any() and not any(event["kind"] == "second controller" for event in run.events)
    assert np.abs(applied(run)).max() > 0.1  # our controller did


def test_over_tls_the_session_runs_and_names_the_possible_commanders(tmp_path: Path) -> None:
    make_keys(tmp_path / "keys")
    status, summary, run = session(tmp_path, f"zenoh:tls/127.0.0.1:{free_port()}?keys=keys")
    assert status in (0, 3) and np.abs(applied(run)).max() > 0.1
    assert summary["accepted_from"] == "holders of a certificate of keys/ca.pem that is called controller"
    assert summary["link_counters"]["refused"] == 0 and summary["link_counters"]["received"] > 20


def test_over_tls_each_write_of_another_name_is_refused_counted_and_said(tmp_path: Path) -> None:
    """A certificate of the same authority, but not the controller's, and twenty commands a second for the motor."""
    make_keys(tmp_path / "keys")
    port, over = free_port(), Event()

    def write(session: zenoh.Session) -> None:
        publisher = session.declare_publisher("hil/rig0/control")
        while not over.wait(0.05):
            publisher.put(control(1, rows=4))

    with zenoh_intruder(port, tls_entries(tmp_path / "keys", "rig")) as (zenoh_session, _), ThreadPoolExecutor(1) as pool:
        writing = pool.submit(write, zenoh_session)
        try:
            status, summary, run = raided(tmp_path, f"zenoh:tls/127.0.0.1:{port}?keys=keys", seen=refused)
        finally:
            over.set()
            writing.result()
    assert status in (0, 3) and np.abs(applied(run)).max() > 0.1  # our controller commanded
    assert refused(status, summary) and "refused" in summary["problems"]
