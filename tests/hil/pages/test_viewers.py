"""A run over the Foxglove WebSocket protocol: a client reads what the log says, and no run waits for one that reads nothing."""

from __future__ import annotations

import json
import logging
import socket
import struct
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.errors import HilError
from hil.experiment import load_experiment
from hil.log.read import read_run
from hil.log.records import CDR_HEADER
from hil.pages.live import Side
from hil.pages.viewers import Beside, Foxglove
from hil.runtime.clock import PacedClock
from hil.session import run_session
from tests.ports import free_port
from tests.waiting import until
from tests.websocket import BINARY, TEXT, Client, connected

PROTOCOL = "foxglove.sdk.v1"


def channels(client: Client) -> dict[str, dict[str, Any]]:
    """Return the offered channels by topic, once all are there."""
    found: dict[str, dict[str, Any]] = {}
    while "/plant/measurement" not in found:
        kind, data = client.receive()
        if kind == TEXT and (said := json.loads(data))["op"] == "advertise":
            found |= {channel["topic"]: channel for channel in said["channels"]}
    return found


def test_a_client_reads_the_values_of_a_running_rig(tmp_path: Path) -> None:
    side = Side(PacedClock(paused=True), acts=True)
    with Foxglove(0) as server:
        experiment = load_experiment("dc-motor-hinf", ["duration=600"])
        run = threading.Thread(
            target=run_session, args=(experiment,), kwargs={"path": tmp_path / "a.mcap", "onlooker": Beside(side, server)}
        )
        run.start()
        until(lambda: side.status == "running", "the run")
        assert side.clock is not None
        with connected(int(server.url.rpartition(":")[2]), PROTOCOL) as client:
            channel = channels(client)["/plant/measurement"]
            assert (channel["encoding"], channel["schemaEncoding"]) == ("cdr", "ros2msg") and "float64 angle" in channel["schema"]
            client.send({"op": "subscribe", "subscriptions": [{"id": 1, "channelId": channel["id"]}]})
            side.clock.set(speed=10.0, paused=False)  # until the subscription has come, slots pass unseen
            reported: list[tuple[int, float]] = []
            while len(reported) < 30:
                kind, data = client.receive()
                if kind == BINARY and data[0] == 1:
                    _, number, t_ns = struct.unpack_from("<BIQ", data)
                    assert number == 1 and data[13:17] == CDR_HEADER
                    reported.append((t_ns, struct.unpack_from("<d", data, 17)[0]))
            side.stop()
            run.join(60)
    log = read_run(tmp_path / "a.mcap").arrays["/plant/measurement"]
    first = reported[0][0] // experiment.period_ns
    np.testing.assert_array_equal([v for _, v in reported], log["angle"][first : first + 30])
    assert [t for t, _ in reported] == (log["t_ns"][first : first + 30]).tolist()


def test_a_run_with_a_client_that_reads_nothing_is_the_same_run(tmp_path: Path) -> None:
    experiment = load_experiment("dc-motor-hinf", ["duration=100"])
    alone = run_session(experiment, path=tmp_path / "a.mcap").summary["log"]["sha256"]
    with Foxglove(0) as server, connected(int(server.url.rpartition(":")[2]), PROTOCOL) as client:
        client.send({"op": "subscribe", "subscriptions": [{"id": i, "channelId": i} for i in range(1, 3)]})
        beside = run_session(experiment, path=tmp_path / "b.mcap", onlooker=server)
    assert beside.summary["log"]["sha256"] == alone


def test_a_client_in_the_middle_of_its_handshake_keeps_no_run_from_its_end() -> None:
    """Ctrl-C did nothing for as long as it stayed there, and then each of them was a line on the terminal."""
    server = Foxglove(0)
    with socket.create_connection(("127.0.0.1", int(server.url.rpartition(":")[2]))) as half:
        half.sendall(b"GET / HTTP/1.1\r\n")
        end = threading.Thread(target=server.__exit__, daemon=True)
        end.start()
        end.join(20)
        assert not end.is_alive()
    assert any(isinstance(each, logging.NullHandler) for each in logging.getLogger("foxglove").handlers)


def test_a_taken_port_is_one_message() -> None:
    with Foxglove(free_port()) as server, pytest.raises(HilError, match="--foxglove 0 takes a free port"):
        Foxglove(int(server.url.rpartition(":")[2]))
