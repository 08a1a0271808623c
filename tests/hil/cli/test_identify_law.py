"""`hil identify law`, `hil design --network` and the law's file in an experiment, as a user calls them."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from hil.design_questions.measured_network import measured
from hil.errors import HilError
from hil.experiment import load_experiment
from hil.pages import Figure
from hil.pages.analyses import _section
from tests.hil.cli.conftest import Hil
from transport.law_fit import fit_law
from transport.law_fit.packet_record import PacketRecord

N = 2000


def motor_over(sc: str, ca: str) -> str:
    """The motor over laws that stand in files."""
    source = (Path(load_experiment("dc-motor-packets").folder) / "dc-motor-packets.toml").read_text()
    head, _, _ = source.partition("# Gamma latency")
    laws = "".join(f'[network.{way}]\nlaw = {{ file = "{name}" }}\n' for way, name in (("sc", sc), ("ca", ca)))
    return head + laws


@pytest.fixture
def both_ways(tmp_path: Path) -> list[Path]:
    """Tables of both directions: gamma latencies with loss, and uniform ones of up to a slot and a half of 50 ms."""
    rng = np.random.default_rng(4)
    there = np.where(rng.random(N) < 0.03, np.nan, rng.gamma(2.0, 8e-3, N))
    back = rng.uniform(5e-3, 75e-3, N)
    paths = [tmp_path / "there.csv", tmp_path / "back.csv"]
    for path, values in zip(paths, (there, back)):
        rows = [f"{0.05 * k!r},{'' if np.isnan(v) else repr(v)}" for k, v in enumerate(values.tolist())]
        path.write_text("\n".join(["sent_s,latency_s", *rows]))
    return paths


def test_a_law_is_found_written_and_run(cli: Hil, both_ways: list[Path], tmp_path: Path) -> None:
    status, out, err = cli("identify", "law", *both_ways, "-o", "law.toml", "--page", "page.html")
    assert status == 0 and out.endswith("  written: law.ca.toml\nwritten: page.html\n"), err
    said = " ".join(out.split())
    assert "independent latencies" in out and "is not rejected" in out and "ms on average, 99 % within" in said
    assert re.search(r"latencies: gamma \(a = [\d.]+, scale = [\d.]+ ms, shape p = ", said), said
    text = (tmp_path / "law.sc.toml").read_text()
    assert 'class = "independent"' in text and "[fit]" in text
    page = (tmp_path / "page.html").read_text()
    assert "measured" in page and "fitted: gamma" in page and "Age of the newest packet" in page
    experiment = tmp_path / "mine.toml"
    experiment.write_text(motor_over("law.sc.toml", "law.ca.toml"))
    loaded = load_experiment(str(experiment))
    assert type(loaded.network.sc.law).__name__ == "PacketLaw"
    assert loaded.network.sc.law.discard_older == json.loads(text.partition("discard_older = ")[2].split("\n")[0])  # type: ignore[union-attr]
    status, out, err = cli("run", experiment, "--set", "allow_uncertified=true", "--duration", "5", "-o", "run.mcap", "--json")
    assert status == 0, err
    assert cli("replay", "run.mcap", "--verify")[0] == 0  # the log holds the law, and needs no file
    status, _, err = cli("identify", "law", *both_ways, "-o", "law.toml")
    assert status == 2 and "exists already" in err


def test_the_tail_of_the_fitted_law_is_drawn_down_to_a_tenth_of_a_packet() -> None:
    """A normal law, which is above hardly any of what it shows at the last packet; on a logarithmic axis nothing is 0."""
    latency = np.append(np.random.default_rng(0).normal(5e-3, 1e-4, 2000), 0.04)
    fit = fit_law(PacketRecord(sent_s=0.05 * np.arange(2001), latency_s=latency), 0.05, 0.03)
    said = {"packets": 2001, "lost": 0, "notes": [], "intervals": {}}
    tail = _section("sc", fit, said, []).blocks[1]
    assert isinstance(tail, Figure)
    measured, fitted = (np.asarray(line.y) for line in tail.series)
    assert measured[-1] > 0.0 and fitted.min() >= 0.1 / 2001 and (np.diff(fitted) <= 0.0).all()
    assert (fitted < 0.5).any() and fitted[0] > 0.99


@pytest.mark.parametrize(("text", "said"), [
    (None, "network.sc.law.file:"), ("kind = 'packet'\nlatency = '-1 ms'", "network.sc.law.latency: got -0.001 s"),
    ("latency = '1 ms'", "kind: missing"), ("kind = [", "not valid TOML"),
])  # fmt: skip
def test_a_faulty_file_of_a_law_is_named(cli: Hil, tmp_path: Path, text: str | None, said: str) -> None:
    if text is not None:
        (tmp_path / "law.toml").write_text(text)
    (tmp_path / "mine.toml").write_text(motor_over("law.toml", "law.toml"))
    status, _, err = cli("run", "mine.toml")
    assert status == 2
    assert said in err


def test_too_few_changes_of_age_are_said_to_be_too_few(cli: Hil, tmp_path: Path) -> None:
    values = np.where(np.arange(1000) // 150 % 2, 0.012, 0.002) + np.random.default_rng(0).uniform(0, 1e-3, 1000)
    (tmp_path / "slow.csv").write_text("\n".join(["latency_s", *map(repr, values.tolist())]))
    status, out, _ = cli("identify", "law", "slow.csv", "--period", "10ms")
    said = "these packets depend on each other, and of their ages no chain can be counted: measure for longer, or replay"
    assert status == 1 and said in " ".join(out.split())


def test_none_of_these_is_status_1_and_writes_no_law(cli: Hil, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    late = rng.random(8000) < 0.3 + 0.28 * np.sin(2.0 * np.pi * np.arange(8000) / 60.0)
    values = np.where(late, 0.012, 0.002) + rng.uniform(0, 1e-3, 8000)
    (tmp_path / "rhythm.csv").write_text("\n".join(["latency_s", *map(repr, values.tolist())]))
    status, out, _ = cli("identify", "law", "rhythm.csv", "--period", "10ms", "-o", "law.toml")
    assert status == 1
    assert "none of the laws" in out and "rejected" in out
    assert not (tmp_path / "law.toml").exists()
    record = PacketRecord(sent_s=0.01 * np.arange(8000), latency_s=values)
    with pytest.raises(HilError, match="there is nothing to design for; measure for longer"):
        measured(fit_law(record, 0.01), holds_input=False)


def test_latencies_that_depend_on_each_other_within_a_slot_are_not_called_independent(cli: Hil, tmp_path: Path) -> None:
    values = 0.002 + 0.001 * np.sin(np.arange(1000)) + np.random.default_rng(0).uniform(0, 1e-4, 1000)
    (tmp_path / "wave.csv").write_text("\n".join(["latency_s", *map(repr, values.tolist())]))
    out = cli("identify", "law", "wave.csv", "--period", "10ms")[1]
    assert "independent latencies, as far as slots show; 1000 packets" in out and "losses is rejected" in out


def test_bursts_are_of_slots_only_where_every_slot_has_a_packet(cli: Hil, tmp_path: Path) -> None:
    """A second apart they say nothing of slots of 10 ms; a table without instants has one in every slot, however long it is."""
    lost = np.isin(np.arange(2000) // 8, np.random.default_rng(0).integers(0, 250, 25))
    latency = np.where(lost, "nan", "0.001").tolist()
    (tmp_path / "ping.csv").write_text("\n".join(["sent_s,latency_s", *(f"{k},{each}" for k, each in enumerate(latency))]))
    (tmp_path / "order.csv").write_text("\n".join(["latency_s", *latency]))
    status, out, err = cli("identify", "law", "ping.csv", "--period", "10ms")
    assert (status, out) == (2, "") and "ping.csv: sc: packets: they depend on each other, sent 1 s apart" in err
    spec = [json.loads(cli("identify", "law", "order.csv", "--period", each, "--json")[1]) for each in ("10ms", "5s")]
    assert spec[0]["sc"]["law"]["loss"] == spec[1]["sc"]["law"]["loss"] and spec[0]["sc"]["fit"]["packets"] == 2000


def test_what_comes_at_an_age_has_no_interval_where_losses_come_in_bursts(cli: Hil, tmp_path: Path) -> None:
    lost = np.isin(np.arange(2000) // 8, np.random.default_rng(0).integers(0, 250, 25))
    (tmp_path / "bursts.csv").write_text("\n".join(["latency_s", *np.where(lost, "nan", "0.001").tolist()]))
    out = " ".join(cli("identify", "law", "bursts.csv", "--page", "law.html")[1].split())
    assert "losses in bursts" in out and "up to 20 packets apart" in out
    share = f"{1.0 - lost.mean():.5g}"
    assert f"comes at age 0, if not before: {share}, no interval, as packets are not independent" in out
    assert "<td>-</td><td>-</td>" in (tmp_path / "law.html").read_text()
    assert cli("identify", "law", "bursts.csv", "--page", "law.html")[0] == 0, "a page is replaced"
    status, out, err = cli("identify", "law", "bursts.csv", "--page", "law.pdf")
    assert (status, out) == (2, "") and "law.pdf: a page is written here; expected a name that ends in .html" in err


def test_too_few_packets_are_refused_with_the_number_that_would_do(cli: Hil, tmp_path: Path) -> None:
    (tmp_path / "few.csv").write_text("\n".join(["latency_s", *["0.001"] * 20]))
    status, out, err = cli("identify", "law", "few.csv", "-o", "law.toml")
    assert status == 2 and not out
    assert "20 packets, expected at least 299" in err
    assert not (tmp_path / "law.toml").exists()



def test_packets_sent_in_bursts_ask_for_the_length_of_a_slot(cli: Hil, tmp_path: Path) -> None:
    bursts = (f"{0.05 * (k // 20)!r},{0.001 * (1 + k % 7)!r}" for k in range(400))
    (tmp_path / "bursts.csv").write_text("\n".join(["sent_s,latency_s", *bursts]))
    status, out, err = cli("identify", "law", "bursts.csv", "-o", "law.toml")
    assert status == 2 and not out and "half of the packets or more have one time stamp; add --period" in err
    assert not (tmp_path / "law.toml").exists()


def test_a_design_needs_both_directions(cli: Hil, tmp_path: Path) -> None:
    (tmp_path / "one.csv").write_text("\n".join(["latency_s", *["0.001"] * 400]))
    assert "up to 8 packets apart" in " ".join(cli("identify", "law", "one.csv")[1].split())  # one in 50 of them
    status, _, err = cli("design", "dc-motor", "--network", "one.csv")
    assert status == 2
    assert "needs both directions" in err
