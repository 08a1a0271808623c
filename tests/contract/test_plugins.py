"""Every plug-in that is installed passes its check, ours through the same door as a user's."""

from __future__ import annotations

import pickle
from typing import Any

import pytest

from hil.compose import compose
from hil.experiment import load_experiment, parse_plugin, shipped
from hil.plugins import registry
from hil.plugins.checks import check_controller, check_law
from plants.parts.check import check_plant
from transport.laws import prepare

PLANTS = {  # every other one is made from its defaults
    "state-space": ["A=[[-1.0]]", "B=[[2.0]]", "C=[[1.0]]"],
    "transfer-function": ["num=[2.0]", "den=[1.0, 1.0]"],
}
LAWS: dict[str, list[str]] = {
    "constant": ["age=2"],
    "iid": ["probabilities=[0.7, 0.3]"],
    "markov": ["matrix=[[0.6, 0.4, 0.0], [0.7, 0.2, 0.1], [0.8, 0.1, 0.1]]"],
    "semi-markov": [
        "matrix=[[0.0, 1.0], [1.0, 0.0]]",
        'sojourn=[{law="geometric", p=0.2}, {law="uniform", low=2, high=5}]',
    ],
    "trace": ["ages=[0, 1, 2, 0, 1]"],
    "packet": ['latency={dist="gamma", a=2.0, scale="6 ms"}', "loss=0.1", "duplication=0.1"],
}


# An FMU is what its file is: tests/plants/fmu/test_fmu.py runs some.
@pytest.mark.parametrize("name", [name for name in registry.names("hil.plants") if name != "fmu"])
def test_plant_keeps_its_contract(name: str) -> None:
    plant = parse_plugin("hil.plants", name, PLANTS.get(name, ()))
    check_plant(plant)
    assert pickle.loads(pickle.dumps(plant)) == plant  # the rig is another process


LONG = {"dc-motor-ours-hinf", "dc-motor-ours-integral", "dc-motor-ours-mixed", "vtol-delayed"}  # others have their controllers


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] * (n in LONG)) for n in sorted(shipped())])
def test_shipped_controller_and_plant_keep_their_contracts(name: str) -> None:
    loop = compose(load_experiment(name), certify=False)
    check_plant(loop.experiment.plant)
    check_controller(loop.controller, loop.model)


@pytest.mark.parametrize("name", registry.names("hil.laws"))
def test_law_keeps_its_contract(name: str) -> None:
    law: Any = parse_plugin("hil.laws", name, LAWS.get(name, ()))
    said = check_law(prepare(law))
    assert said[0].endswith("it can run in a loop")
