"""What a controller process asks of its link."""

from __future__ import annotations

import pytest

from hil.compose import compose
from hil.experiment import load_experiment
from hil.runtime.real.controller_process import Stopped, serve


def test_a_controller_says_to_its_link_how_long_its_rig_is_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    """By it a link with a key knows a slot of a slow loop from a rig that has ended."""
    asked: list[tuple[str, str, float]] = []

    def opened(uri: str, role: str, period_s: float = 0.0) -> None:
        asked.append((uri, role, period_s))
        raise Stopped

    monkeypatch.setattr("hil.runtime.real.controller_process.open_link", opened)
    loop = compose(load_experiment("dc-motor-local"))
    with pytest.raises(Stopped):
        serve(loop, "can:hil:x")
    assert asked == [("can:hil:x", "controller", float(loop.experiment.period))]
