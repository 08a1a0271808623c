"""`hil laws` shows what the network of an experiment does, and names what is wrong with it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

import hil
from hil.cli import cli
from hil.cli.laws import command
from hil.errors import HilError
from hil.experiment import load_experiment, shipped
from transport.law_tests import analysis

PACKET = 'network.ca.law={kind="packet", latency={dist="gamma", a=2.0, scale="20 ms"}, loss={p_gb=0.1, p_bg=0.4}}'


def laws(*arguments: str) -> str:
    result = CliRunner().invoke(command, ["dc-motor-hinf", *arguments], catch_exceptions=False)
    assert result.exit_code == 0
    return " ".join(result.output.split()) if "--json" not in arguments else result.output


def test_the_published_chain_is_shown_with_its_stationary_law_and_bursts() -> None:
    text = laws()
    assert "markov law, T = 50 ms" in text
    for number in ("0.6396", "0.3243", "0.0360", "0.5833", "1.25 0.0625", "2.5 0.125"):
        assert number in text


def test_json_holds_both_directions_and_neither_infinity_nor_nan() -> None:
    def refuse(name: str) -> None:
        raise AssertionError(f"{name} is no JSON")

    found = json.loads(laws("--json", "--set", 'network.sc.law={kind="constant", age=1}'), parse_constant=refuse)
    assert found["laws"]["sc"]["mean_bursts"] == [None]
    assert found["laws"]["ca"]["stationary"] == pytest.approx([7 / 12, 5 / 12])
    assert found["laws"]["ca"]["transition_matrix"] == [[0.5, 0.5], [0.7, 0.3]]


def test_a_packet_law_shows_losses_and_the_ages_that_follow() -> None:
    text = laws("--set", PACKET)
    assert "0.2 of the packets" in text
    assert "mean latency 40 ms" in text


def test_recorded_latencies_come_from_beside_the_experiment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(analysis, "SIMULATED_SLOTS", 300)
    (tmp_path / "x.csv").write_text("120 ms\n")
    (tmp_path / "x.toml").write_text(shipped()["dc-motor-hinf"].read_text())
    given = 'network.sc.law={kind="packet", latency={file="x.csv"}}'
    result = CliRunner().invoke(command, [str(tmp_path / "x.toml"), "--set", given], catch_exceptions=False)
    assert "mean latency              120 ms" in result.output


def test_a_full_queue_and_a_mean_that_is_a_bound_are_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(analysis, "SIMULATED_SLOTS", 6000)
    text = laws("--set", 'network.ca.law={kind="packet", latency="120 ms", queue=1}')
    assert "0.6667 of the packets, 0.6667 at the full queue (from 50,000 simulated slots)" in text
    monkeypatch.setattr(analysis, "LONGEST", 1000)
    text = laws("--set", 'network.ca.law={kind="packet", latency="2 h", queue=1000000}')
    assert "older: 1" in text and "mean age above 1000 slots" in text


def test_every_sensor_node_has_the_law_of_its_own_network() -> None:
    of_nodes = CliRunner().invoke(command, ["dc-motor-two-nodes"], catch_exceptions=False).output
    assert "node angle, sensor to controller (sc)" in of_nodes and "node speed, sensor to controller (sc)" in of_nodes
    found = json.loads(CliRunner().invoke(command, ["dc-motor-two-nodes", "--json"], catch_exceptions=False).output)
    law = load_experiment("dc-motor-two-nodes").network.nodes["speed"].law
    assert found["nodes"]["speed"]["transition_matrix"] == [list(row) for row in law.matrix]
    assert [*hil.laws("dc-motor-two-nodes")] == ["angle", "speed", "ca"]
    assert set(found["laws"]) == {"sc", "ca"} and list(json.loads(laws("--json"))["nodes"]) == ["sensor"]


def test_a_faulty_law_is_named_by_its_path() -> None:
    with pytest.raises(HilError, match=r"network\.ca\.law\.matrix\[1\]: row sums to 0\.98, expected 1"):
        laws("--set", 'network.ca.law={kind="markov", matrix=[[0.5, 0.5], [0.5, 0.48]]}')


def test_a_law_of_ones_own_is_called_by_its_file_and_class(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert CliRunner().invoke(cli, ["new", "law", "calm"], catch_exceptions=False).exit_code == 0
    shown = CliRunner().invoke(command, ["calm.toml"], catch_exceptions=False)
    assert shown.exit_code == 0 and "calm:Calm law, T = 50 ms" in shown.output and "0.5000" in shown.output


def test_laws_of_a_bus_need_a_bus(tmp_path: Path) -> None:
    with pytest.raises(HilError, match="no medium of kind 'can'"):
        laws("--from-bus")
    with pytest.raises(HilError, match="-o: belongs to --from-bus"):
        laws("-o", str(tmp_path / "law.toml"))
