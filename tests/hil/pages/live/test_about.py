"""What the live page shows of a run: which network laws may change, by the path of their tables."""

from __future__ import annotations

import numpy as np
import pytest

from hil.api.experiment_source import load_experiment
from hil.compose.loop import compose
from hil.experiment import Experiment
from hil.pages.live.about import about, controllers, controllers_of, presets
from hil.pages.live.side import Side
from hil.runtime.clock import PacedClock
from plants.parts.protocols import GoesOn
from transport.laws import ChainLaw


@pytest.mark.parametrize(
    ("name", "paths"),
    [
        ("dc-motor-two-nodes", {"ca", "nodes.angle", "nodes.speed"}), ("dc-motor-smith", {"ca", "sc"}),
        ("dc-motor-packets", {"ca", "sc"}), ("dc-motor-busy-can", set()),
    ],
)  # fmt: skip
def test_each_node_has_the_law_of_its_own_way_and_a_single_one_that_of_the_network(name: str, paths: set[str]) -> None:
    """With its chain where it has one; none on a shared medium."""
    side, loop = Side(), compose(load_experiment(name), certify=False)
    side.begin(loop, {})
    laws = {"ca": ("to the actuator", loop.rig.ca_law), "sc": ("to the controller", loop.rig.sensors[0].law)}
    laws |= {f"nodes.{node.name}": (f"{node.name} to the controller", node.law) for node in loop.rig.sensors}
    found = about([side], "here")["runs"][0]["network"]
    assert set(found) == paths
    for path, each in found.items():
        label, law = laws[path]
        assert (each["label"], each["law"]["kind"]) == (label, law.kind) and each["presets"] == presets(each["longest"])
        if isinstance(law, ChainLaw):
            assert np.array_equal(each["chain"], law.transition_matrix())
            assert each["law"]["kind"] != "markov" or each["law"]["matrix"] == each["chain"]
        else:
            assert each["chain"] is None


def test_a_page_draws_a_wall_where_the_controller_renders_one() -> None:
    for name, kinds, materials in (("omni-push", ("omni", "virtual-wall-taps"), 3), ("dc-motor-h2", ("dc-motor", "h2"), 0)):
        side = Side()
        side.begin(compose(load_experiment(name), certify=False), {})
        found = about([side], "here")["runs"][0]
        assert (found["plant"], found["controller"]) == kinds
        assert len((found["wall"] or {}).get("materials", ())) == materials


def test_a_plant_that_is_a_table_of_lists_may_change_entry_by_entry() -> None:
    side, plant = Side(PacedClock(), acts=True), {"kind": "state-space", "A": [[0.0]], "B": [[1.0, 2.0]], "C": [[1.0]]}
    changes = {"plant": plant | {"saturation": [3.0, 4.0]}, "controller": {"kind": "local", "gain": [[0.1]] * 2}}
    made = load_experiment("dc-motor-h2", reference=[], disturbance=[], limits={}, **changes)
    side.begin(compose(made, certify=False), {})
    assert about([side], "here")["runs"][0]["fields"] == {"plant.saturation.0": 3.0, "plant.saturation.1": 4.0}


@pytest.mark.parametrize("side", [Side(), Side(acts=True), Side(PacedClock(), acts=True)], ids=["seen", "real", "virtual"])
def test_the_page_offers_what_a_run_takes(side: Side) -> None:
    """Speed where virtual time is paced; changes where the run acts on them, in real time those of the plant's own way."""
    loop = compose(load_experiment("dc-motor-smith"))
    side.begin(loop, {})
    found = about([side], "here")["runs"][0]
    assert (found["paced"], found["controllable"]) == (side.clock is not None, side.acts)
    assert isinstance(loop.experiment.plant, GoesOn)
    names = loop.experiment.plant.own_way() if side.clock is None else loop.experiment.plant.may_change()
    assert {path.split(".")[1] for path in found["fields"]} == ({*names} if side.acts else set())


def test_the_page_waits_for_no_other_experiment(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a page is drawn from loads nothing; the controllers that it offers come behind it."""
    side = Side(PacedClock(), acts=True)
    assert about([side], "here")["runs"] == [{"name": "", "traces": [], "waits": ""}] and controllers_of(side) == {}
    side.begin(compose(load_experiment("dc-motor-hinf")), {})
    loaded: list[str] = []

    def load(name: str) -> Experiment:
        loaded.append(name)
        return load_experiment(name)

    monkeypatch.setattr(f"{about.__module__}.load_experiment", load)
    controllers.cache_clear()
    assert about([side], "here")["runs"][0]["name"] == "dc-motor-hinf" and not loaded
    offered = controllers_of(side)
    assert "dc-motor-h2" in offered and "dc-motor-h2" in loaded
    assert not {"dc-motor-h2-fast", "dc-motor-two-nodes", "omni-push"} & set(offered)  # another period, outputs, plant
