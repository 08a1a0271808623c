"""What the processes of a session load: each takes its import's time between ``hil run`` and slot 0."""

from __future__ import annotations

import json
import pickle
import subprocess

import pytest

from hil.compose.loop import compose
from hil.experiment import load_experiment
from hil.runtime.real.child import PYTHON

TRY = """
import json, pickle, sys
from importlib import import_module
import_module(sys.argv[1])
from transport.links.opening import open_link
loop = pickle.load(sys.stdin.buffer)
loop.start_controller()
open_link("can:hil:loads" + sys.argv[2], "rig").close()
print(json.dumps(sorted(sys.modules)))
"""
OTHERS = ("can", "scipy", "difflib", "importlib.resources", "click", "rich", "hil.compose", "hil.certify", "hil.session")
OTHERS += ("importlib.metadata", "email", "design.networked_loop", "design.jump_linear", "design.requests")
OTHERS += ("transport.laws.latency", "transport.can_bus_model.bus", "transport.links.timed_sender")


@pytest.mark.parametrize("name", ["rig", "controller"])
def test_a_process_of_a_session_loads_neither_certifiers_nor_python_can(name: str) -> None:
    job, module = pickle.dumps(compose(load_experiment("dc-motor-hinf"))), f"hil.runtime.real.{name}_process"
    done = subprocess.run([*PYTHON, "-c", TRY, module, name], input=job, capture_output=True, check=True)
    loaded = {module for module in json.loads(done.stdout) if module.startswith(OTHERS)}
    unneeded = {module for module in loaded if module in OTHERS or module.startswith(tuple(f"{other}." for other in OTHERS))}
    assert not unneeded
