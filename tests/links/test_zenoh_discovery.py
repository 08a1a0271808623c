"""Zenoh: who joins sees both directions, and learns who is there and what runs; where names are asked for none does."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest
import zenoh

from hil.cli.one_end import discover as command
from hil.experiment import load_experiment
from hil.rig import rig_of
from hil.rig.session_link import about_rig
from tests.hil.cli.conftest import run_main
from tests.ports import free_port
from tests.waiting import until
from transport import open_link
from transport.links import Discoverable
from transport.links.contract import control, meet, sensor
from transport.links.zenoh_link import ENCODING, config
from transport.links.zenoh_observers import discover


@pytest.mark.parametrize("mode", ["peer", "client"])
def test_an_observer_sees_both_directions_with_slot_and_session(mode: str) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with open_link(f"zenoh:{endpoint}", "rig") as rig, open_link(f"zenoh:{endpoint}", "controller") as controller:
        meet(rig, controller)
        seen: dict[str, list[zenoh.Sample]] = {}
        with zenoh.open(config("controller", endpoint, {"mode": mode})) as joined:
            joined.declare_subscriber("hil/rig0/*", lambda sample: seen.setdefault(str(sample.key_expr), []).append(sample))

            def both() -> bool:
                rig.send(sensor(7))
                controller.send(control(7))
                rig.receive(0.1)
                time.sleep(0.01)
                return {"hil/rig0/sensor", "hil/rig0/received"} <= set(seen)

            until(both, "both directions")
        for key, packet in (("sensor", sensor(7)), ("received", control(7))):
            sample = seen[f"hil/rig0/{key}"][-1]
            assert sample.payload.to_bytes() == packet and str(sample.encoding) == ENCODING
            slot, session = sample.attachment.to_string().split(";")  # type: ignore[union-attr]
            assert slot == "slot=7" and len(session) == len("session=") + 16


def test_a_rig_and_its_controller_are_found_with_what_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("HIL_ZENOH_DIR", str(tmp_path))
    assert run_main("discover") == 1 and "no rig or controller found" in capsys.readouterr().out
    with open_link("zenoh:?name=mine", "rig") as rig, open_link("zenoh:?name=mine", "controller") as controller:
        meet(rig, controller)
        assert isinstance(rig, Discoverable)
        rig.announce(about_rig(rig_of(load_experiment("multisensor-published"))))
        assert run_main("discover", "--json", "--wait", "30") == 0
        [found] = json.loads(capsys.readouterr().out)
        assert found["name"] == "mine" and found["alive"] == ["controller", "rig"]
        info = found["info"]
        assert (info["experiment"], info["period_ns"], info["nodes"][0]) == ("multisensor-published", 50_000_000, "first")
        assert "BO_ 256 Sensor_first_" in info["dbc"] and len(info["session"]) == 16
        assert run_main("discover", "--wait", "30") == 0
        assert "mine at " in (said := capsys.readouterr().out) and "multisensor-published, period 50 ms" in said
    assert command.name == "discover" and discover(f"unixsock-stream/{tmp_path}/mine", 0.2) == []


def test_a_link_with_a_password_announces_nothing(tmp_path: Path) -> None:
    users = tmp_path / "users"
    users.write_text("controller:secret\n")
    users.chmod(0o600)
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with open_link(f"zenoh:{endpoint}?users={users}", "rig") as rig:
        assert isinstance(rig, Discoverable)
        rig.announce({"experiment": "secret", "period_ns": 1})
        assert discover(endpoint, 0.5) == []


@pytest.mark.parametrize("about", [
    {"experiment": 7, "period_ns": "x"}, {"experiment": "x", "period_ns": 10**400}, {"experiment": "x", "period_ns": 0},
])  # fmt: skip
def test_an_answer_of_another_form_is_no_rig(about: dict[str, object]) -> None:
    """A period of 400 digits ended `hil discover`: no float is so large."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with open_link(f"zenoh:{endpoint}", "rig") as rig:
        assert isinstance(rig, Discoverable)
        rig.announce({**about, "session": "s"})
        [found] = discover(endpoint, 30)
        assert found["alive"] == ["rig"] and found["info"] is None


def test_a_link_of_another_kind_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_main("discover", "can:hil:rig0") == 2 and "expected a link of zenoh" in capsys.readouterr().err
