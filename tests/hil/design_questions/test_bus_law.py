"""`hil laws --from-bus`: the network laws of a CAN bus, exact where its ages repeat and estimated elsewhere."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from hil.cli.laws import command
from hil.design_questions import bus_law
from hil.errors import HilError
from hil.experiment import load_experiment
from transport.law_tests import analysis

BUSY = "dc-motor-busy-can"
TWO = '{name="a", can_id=1, data="0102", period="50 ms"}, {name="b", can_id=2, length=0, period="25 ms"}'
KNOWN = f"network.media.bus.traffic=[{TWO}]"


def bus_laws(*arguments: str) -> str:
    result = CliRunner().invoke(command, [BUSY, "--from-bus", *arguments], catch_exceptions=False)
    assert result.exit_code == 0
    return result.output


def test_the_law_of_a_bus_is_exact_where_its_ages_repeat() -> None:
    slow = ("--set", KNOWN, "--set", "network.media.bus.bitrate=10000", "--json")
    found = json.loads(bus_laws(*slow))["laws"]
    assert found["sc"]["exact"] and found["ca"]["exact"] and found["sc"]["packets"] == 0
    assert found["sc"]["spec"] == {"kind": "constant", "age": 1} and found["ca"]["spec"] == {"kind": "constant", "age": 0}
    assert 10.0 < found["sc"]["worst_ms"] < 60.0 and found["sc"]["largest_age"] == 1


def test_the_law_of_the_busy_bus_is_estimated_with_a_bound_and_an_experiment_includes_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its shares are those of the run: ages 1 in a third of the slots; and a loop without the bus runs under the file."""
    monkeypatch.setattr(bus_law, "LEAST_SLOTS", 300)
    text = bus_laws("--set", "duration=15", "-o", str(tmp_path / "law.toml"))
    assert "estimated: ages that are a semi-Markov chain, from 300 packets" in text and "no age is above 1" in text
    assert "at most 30.256 ms" in text and f'ca.law = {{ file = "{tmp_path}/law.ca.toml" }}' in text
    base = ("network.media={}", f"network.sc={{law={{file={str(tmp_path / 'law.sc.toml')!r}}}, max_age=2}}")
    one = load_experiment(BUSY, (*base, f"network.ca={{law={{file={str(tmp_path / 'law.ca.toml')!r}}}, max_age=1}}"))
    assert one.network.sc.law.mode_ages == (0, 1)
    shares = analysis.analyse_law(one.network.sc.law, 0.05, 0.01).age_shares
    assert shares[1] == pytest.approx(0.328, abs=0.02)
    assert analysis.analyse_law(one.network.ca.law, 0.05, 0.01).age_shares == (1.0,)
    assert "largest_age = 1" in (tmp_path / "law.sc.toml").read_text()
    with pytest.raises(HilError, match=r"law\.sc\.toml"):
        bus_laws("--set", KNOWN, "-o", str(tmp_path / "law.toml"))


def test_a_bus_with_bit_errors_leaves_no_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bus_law, "LEAST_SLOTS", 300)
    disturbed = ("--set", KNOWN, "--set", "network.media.bus.bit_error_rate=1e-5", "--set", "duration=15", "--json")
    unbounded = json.loads(bus_laws(*disturbed))["laws"]["sc"]
    assert unbounded["worst_ms"] is None and "bit_error_rate" in unbounded["no_bound"]
