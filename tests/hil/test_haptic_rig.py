"""The haptic rig: what is refused, what diverges when it is let, and what stays stable over a bad link."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.cli import main
from hil.compose import compose
from hil.errors import ExperimentError
from hil.experiment import load_experiment
from hil.runtime.virtual import simulate
from hil.session import run_session

WAY = 'network.sc.law={kind="constant", age=5}', 'network.ca.law={kind="constant", age=5}'


def states(name: str, *sets: str, duration: str | None = None, seed: int = 0) -> Any:
    e = load_experiment(name, list(sets), duration=duration)
    return simulate(compose(e), seed).arrays["/plant/state"]


@pytest.mark.parametrize(("material", "depth"), [(0, 0.134816), (1, 0.135066), (2, 0.135066)])
def test_a_newton_ends_where_the_wall_and_the_coupler_say(material: int, depth: float) -> None:
    """Figure 6.8: materials 2 and 3 of the thesis at one depth, 0.25 mm deeper than material 1; oscillation decays."""
    x = states("omni-push", f"controller.wall.material={material}")
    assert x["position"][-1] == pytest.approx(depth, abs=1e-6)
    assert x["position"].max() == pytest.approx(0.219, abs=2e-3)
    assert x["given"].max() == 0.0


@pytest.mark.parametrize(
    ("words", "number"),
    [
        (["omni-theorem61"], "spectral radius 1.1527"),
        (["omni-push", "--set", "controller.coupler.delays=[2]"], "spectral radius 1.0683"),  # for two samples, run over six
        (["omni-push", "--set", "plant.inertia=-0.7943"], "-0.7943"),
    ],
)
def test_what_is_refused_ends_with_status_2_and_the_number_and_writes_nothing(
    words: list[str], number: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as end:
        main(["run", *words])
    assert end.value.code == 2 and number in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_theorem_61_diverges_when_it_is_let_and_the_observer_stops_it_before_the_position_does(tmp_path: Path) -> None:
    bounded = run_session(load_experiment("omni-theorem61", ["allow_uncertified=true"]), path=tmp_path / "a.mcap")
    assert bounded.status == 3 and "given" in bounded.summary["safety"]
    assert np.abs(bounded.arrays["/plant/state"]["position"]).max() < 0.2
    limits = "limits={state={position=0.5}}"
    later = run_session(load_experiment("omni-theorem61", ["allow_uncertified=true", limits]), path=tmp_path / "b.mcap")
    assert later.status == 3 and "position" in later.summary["safety"]
    assert later.summary["slots"] > bounded.summary["slots"]


def test_equalised_delays_are_one_delay_whatever_the_network_does() -> None:
    """Over ages of 1 to 5 in bursts the device moves exactly as over constant ages of 5."""
    random, constant = (states("omni-wifi", *sets, duration="3 s") for sets in ((), WAY))
    for name in ("position", "speed", "y", "z"):
        assert np.array_equal(random[name], constant[name])
    plain = states("omni-wifi", "controller.coupler.equalise=false", "allow_uncertified=true", duration="3 s")
    assert not np.array_equal(plain["position"], constant["position"])


@pytest.mark.parametrize("name", ["omni-push", "omni-slide", "omni-1khz", "omni-materials", "omni-paces", "omni-wifi"])
def test_the_shipped_walls_are_certified_and_give_no_energy_away(name: str) -> None:
    e = load_experiment(name, duration={"omni-1khz": "1 s", "omni-materials": "2 s"}.get(name, "8 s"))
    loop = compose(e)
    assert loop.verdict is not None and loop.verdict.certified and loop.verdict.kind == "passivity"
    for seed in (0, 1):
        x = simulate(loop, seed).arrays["/plant/state"]
        assert x["given"].max() < 1e-12
        assert np.abs(x["position"]).max() < 0.25


def test_the_arm_presses_45_mm_deep_while_it_slides() -> None:
    """45.0 +- 2.2 mm of 50 mm intended, with the coupler that counts on the bare device alone."""
    x = states("omni-slide", "controller.coupler.damping_n_s_per_m=1.9857", duration="30 s")["position"][200:]
    assert x.mean() == pytest.approx(0.045, abs=1.5e-3)
    assert x.std() < 4e-3


@pytest.mark.parametrize(
    ("sets", "message"),
    [
        (('controller.coupler={method="taps", taps_m_per_n=[0.0881]}',), r"(refused|undecided): .*(radius|needs)"),
        (("plant.hand.damping_n_s_per_m=-1",), r"plant\.hand\.damping_n_s_per_m: -1"),
        (("controller.coupler.stiffness_n_per_m=12", "controller.coupler.delays=[6]"), r"ceiling 2 b/\(\(nd \+ 1\) T\) = 11\.34"),
        (("plant.inertia=-0.7",), r"plant\.inertia: -0\.7"),
        (("controller.wall.materials=[{stiffness_n_per_m=-5}]",), r"stiffness_n_per_m: -5"),
        (("controller.coupler.method=soft",), "controller.coupler.method"),
        (('controller.coupler={method="taps", taps_m_per_n=[-0.001, 0.5]}',), r"taps_m_per_n\[0\]: -0\.001; .* above -0\.00096"),
        (("plant={kind='dc-motor'}", "limits={}"), r"controller\.wall: needs"),
        (("network.sc.law.age=6", "controller.coupler.delays=[6]"), r"9 samples"),
        (("plant.encoder_step_m=0.0001",), "an encoder that rounds"),
        (('controller.wall={switching="plain", chain=[[0.4, 0.3, 0.3], [0.3, 0.4, 0.3], [0.15, 0.15, 0.7]]}',), "switching"),
        (("controller.wall.chain=[[0.4, 0.3, 0.2], [0.3, 0.4, 0.3], [0.15, 0.15, 0.7]]",), r"chain\[0\]: .*sum 0\.9"),
    ],
)
def test_bad_input_is_refused_with_what_decides(sets: tuple[str, ...], message: str) -> None:
    with pytest.raises(ExperimentError, match=message):
        compose(load_experiment("omni-push", list(sets)))


def test_a_pattern_with_a_gap_is_refused_with_its_area() -> None:
    half = "[{y_m=0, z_m=0, width_m=0.04, height_m=0.02, material=0}]"
    with pytest.raises(ExperimentError, match=r"patches: leave a gap of 0\.0008 m\^2"):
        load_experiment("omni-slide", [f"controller.wall.pattern.patches={half}"])


def test_materials_may_follow_the_published_chain() -> None:
    """Second moments enter the certificate; the run changes materials as the chain says."""
    chain = "[[0.4, 0.3, 0.3], [0.3, 0.4, 0.3], [0.15, 0.15, 0.7]]"
    loop = compose(load_experiment("omni-push", [f"controller.wall.chain={chain}"]))
    assert loop.verdict is not None and loop.verdict.certified
    assert loop.verdict.details["mean_square_radius"] == pytest.approx(0.957, abs=1e-3)
    contact = loop.start_controller()
    visited = []
    for k in range(4000):
        contact.rows(k, 0, (0.1, 0.0, 0.0), (0.0, 0.0, 0.0))
        visited.append(contact.contact.material)  # type: ignore[attr-defined]
    share = np.bincount(visited, minlength=3) / 4000
    assert share == pytest.approx([0.25, 0.25, 0.5], abs=0.05)  # 5 sd of a share at this memory
