"""What the start of a command costs: modules that a run does not need, and garbage that is looked for among modules."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

TRY = """
import gc, json, sys
from hil.__main__ import main
sys.argv = ["hil", *sys.argv[1:]]
try:
    main()
except SystemExit as end:
    assert not end.code, end.code
print("\\n" + json.dumps([sorted(sys.modules), gc.isenabled(), gc.get_freeze_count(), len(gc.get_objects())]))
"""


@pytest.mark.parametrize("arguments", [["run", "dc-motor-hinf", "--duration", "0.1", "--quiet"], ["list"]])
def test_garbage_is_looked_for_again_and_not_among_modules(arguments: list[str], tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-c", TRY, *arguments], cwd=tmp_path, capture_output=True, text=True, check=True)
    loaded, enabled, frozen, others = json.loads(done.stdout.splitlines()[-1])
    assert enabled and frozen > 5000, "what the modules left is set aside"
    if arguments[0] == "run":
        assert others < frozen
        unneeded = {"importlib.metadata", "importlib.resources", "email", "scipy", "pandas", "matplotlib", "rich", "can", "zenoh"}
        unneeded |= {"control", "csv", "difflib", "socket", "mcap", "threadpoolctl", "html", "shutil", "tempfile"}
        unneeded |= {"hil.notebook", "click.shell_completion", "hil.rig.named_files"}
        unneeded |= {"plants.parts.flow", "transport.laws.semi_markov", "design.controllers.scheduled_gain"}
        unneeded |= {"hil.runtime.real.supervisor", "hil.runtime.real.child", "hil.runtime.real.rig_process"}  # of real time
        unneeded |= {"design.requests.tracking", "transport.laws.latency", "transport.can_bus_model.bus"}  # of other experiments
        assert unneeded.isdisjoint(loaded), unneeded & set(loaded)


def test_a_program_that_calls_the_command_line_keeps_its_own_way_with_garbage(tmp_path: Path) -> None:
    call = "import atexit, gc\natexit.register(lambda: print('frozen', gc.get_freeze_count()))\n"
    call += "from hil.cli import main\nmain(['list'])"
    done = subprocess.run([sys.executable, "-c", call], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "frozen 0"


def test_who_certifies_stored_gains_does_not_load_what_would_look_for_others(tmp_path: Path) -> None:
    arguments = ["run", "multisensor-ours", "--duration", "0.1", "--quiet"]
    done = subprocess.run([sys.executable, "-c", TRY, *arguments], cwd=tmp_path, capture_output=True, text=True, check=True)
    loaded = json.loads(done.stdout.splitlines()[-1])[0]
    assert "design.historical_data.guaranteed_cost" in loaded and "scipy.optimize" not in loaded
