"""A real-time session whose controller is an external program, which must be running already."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from tests.warm_hil import hil_command


def drive(folder: Path, experiment: str, link: str, *changes: str, duration_s: int = 3) -> dict[str, Any]:
    """Return the summary of a session in which whoever answers on a link drives the plant: it moves it, and settles it."""
    # without priority: a busy machine may pause it for long
    sets = ["reference.0.at=0.2", *changes, "limits.watchdog_slots=40"]
    done = hil_command("run", experiment, "--clock", "real", "--external", "--link", link, "--duration", str(duration_s),
                       *(word for change in sets for word in ("--set", change)), "--json", cwd=folder)  # fmt: skip
    assert done.returncode == 0, done.stderr
    summary: dict[str, Any] = json.loads(done.stdout)
    assert summary["metrics"]["max_abs_u"] > 0.1 and not summary["problems"]
    if summary["timing"]["valid"]:  # a machine that pauses the foreign program makes it another loop
        assert abs(summary["metrics"]["steady_state_error"]) < 0.3
    return summary
