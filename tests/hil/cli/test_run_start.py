"""What the start of a command costs: modules that a run does not need, and garbage that is looked for among modules."""

from __future__ import annotations

import gc
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.hil.cli.conftest import Hil

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


def tried(folder: Path, program: str, *arguments: str) -> Any:
    words = [sys.executable, "-P", "-c", program, *arguments]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def test_garbage_is_looked_for_again_and_not_among_modules(tmp_path: Path) -> None:
    loaded, enabled, frozen, others = tried(tmp_path, TRY, "run", "dc-motor-hinf", "--duration", "0.1", "--quiet")
    assert enabled and 5000 < frozen > others, "what the modules left is set aside"
    unneeded = {"importlib.metadata", "importlib.resources", "email", "scipy", "pandas", "matplotlib", "rich", "can", "zenoh"}
    unneeded |= {"control", "csv", "difflib", "socket", "mcap", "threadpoolctl", "html", "shutil", "tempfile"}
    unneeded |= {"hil.notebook", "click.shell_completion"}
    unneeded |= {"plants.parts.flow", "transport.laws.semi_markov", "design.controllers.scheduled_gain"}
    unneeded |= {"hil.runtime.real.supervisor", "hil.runtime.real.child", "hil.runtime.real.rig_process"}  # of real time
    unneeded |= {"design.requests.tracking", "transport.laws.latency", "transport.can_bus_model.bus"}  # of other experiments
    unneeded |= {f"hil.certify.{kind}" for kind in ("historical_loop", "jump_loop", "wall_loop", "region", "saturation")}
    unneeded |= {"hil.runtime.nodes.jump_watch", "hil.runtime.nodes.answer_watch", "hil.rig.bus_delays", "hil.rig.received_ages"}
    unneeded |= {"design.controllers.one_row", "hil.compose.stored_gains", "hil.runtime.changes", "transport.laws.sojourn"}
    assert unneeded.isdisjoint(loaded), unneeded & set(loaded)


@pytest.mark.parametrize("looked_for", [False, True])
def test_a_caller_of_the_command_line_keeps_its_garbage_collection(cli: Hil, looked_for: bool) -> None:
    """A program looks for it as it did; `hil` begins without, and the modules of any command are set aside."""
    if not looked_for:
        gc.disable()
    known = [[] for _ in range(10_000)]
    frozen = gc.get_freeze_count()
    assert cli("list")[0] == 0 and gc.isenabled()
    # What was set aside before and is let go meanwhile makes a few less.
    assert (gc.get_freeze_count() < frozen + len(known)) is looked_for


COMPARED = """
import hil, hil.cli.design, design.identification.output_error
from hil.compose import compose
compose(hil.load_experiment("dc-motor-packets"))
hil.compare("dc-motor-hinf", "dc-motor-h2", runs=2, jobs=1, duration=1)
print(json.dumps(sorted(sys.modules)))
"""


def test_what_needs_no_part_of_scipy_loads_none(tmp_path: Path) -> None:
    """Half a second of CPU each: who certifies stored gains looks for no others; a law is fitted to a measured network alone, a
    comparison in which no run was stopped tests nothing, an axis that is identified has filters of two states, and quantiles of
    common latencies are a line each.
    """
    loaded = tried(tmp_path, TRY + COMPARED, "run", "multisensor-ours", "--duration", "0.1", "--quiet")
    assert "design.historical_data.guaranteed_cost" in loaded
    assert {"scipy.optimize", "scipy.signal", "scipy.stats"}.isdisjoint(loaded)
