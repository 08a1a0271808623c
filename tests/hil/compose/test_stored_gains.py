"""What decides stored gains: every number of a request and of its loop, and nothing that a text leaves out."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from design.controllers import LoopModel, Turns
from design.requests.tracking import Designed, DesignTask
from hil.compose.stored_gains import NoDigest, _said, problem_digest


@dataclass(frozen=True)
class Part:
    number: float = 0.0
    text: str = ""
    rows: tuple[float, ...] = ()
    table: dict[str, Any] = field(default_factory=dict)
    nothing: None = None
    derived: int = field(default=7, init=False)


def test_a_problem_is_said_by_what_it_states_and_nothing_else() -> None:
    assert _said(Part()) == {"class": "Part", "number": 0.0}
    part = Part(rows=(1.0, 2.0), table={"a": np.array([[True]]), "b": np.int64(3)})
    assert _said({1: part, "turns": Turns(order=(0, 1), loss=0.5)}) == {
        "1": {"class": "Part", "number": 0.0, "rows": [1.0, 2.0], "table": {"a": [[True]], "b": 3}},
        "turns": {"class": "Turns", "order": [0, 1], "phase": 0, "loss": 0.5},
    }
    with pytest.raises(NoDigest, match="the problem holds a function"):
        _said([Part(table={"law": test_a_problem_is_said_by_what_it_states_and_nothing_else})])
    with pytest.raises(NoDigest, match="the problem holds a type"):
        _said(Part)


def test_every_number_of_request_and_loop_decides_the_digest_and_no_folder_does() -> None:
    one = np.eye(1)
    model = LoopModel(A=one, B=one, C=one, period_s=0.1, tau_max=1, d_max=0)
    task = DesignTask(model=model, folder="here")
    same = problem_digest(Designed(), task)
    assert same == problem_digest(Designed(), DesignTask(model=model, folder="there", chainless="why"))
    others = [
        problem_digest(Designed(design_seed=1), task), problem_digest(Designed(input_weight=np.nextafter(0.01, 1.0)), task),
        problem_digest(Designed(), DesignTask(model=LoopModel(A=2 * one, B=one, C=one, period_s=0.1, tau_max=1, d_max=0))),
        problem_digest(Designed(), DesignTask(model=model, initial_state=np.zeros(1))),
    ]  # fmt: skip
    assert len({same, *others}) == 5
