"""What verdicts of several tests rest on is computed once for the room: moments of a loop to low degrees where that does,
bounds, couplers, radii and norms, and whether a plant of ours moves as it says.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable
from itertools import count
from typing import Any

import pytest

import design.jump_linear.leaving as moments
from design.networked_loop import certify as send_all
from design.passivity import synthesis
from design.semi_markov_loop import fault_tolerant_analysis, sampled
from hil.certify import CertificationProblem, conformance
from hil.plugins import is_ours
from hil.rig import bus_delays

OTHERS = count()


def of_plant(loop: CertificationProblem) -> Any:
    """What the motion of a plant of ours is compared by; each that a test writes is compared on its own."""
    return (loop.plant, loop.model, loop.motion, loop.input_limits, loop.state_limits) if is_ours(loop.plant) else next(OTHERS)


def once(module: Any, name: str, of: Callable[..., Any] = lambda *given, **named: (given, named)) -> tuple[Any, str, Any]:
    """A function that computes the same of the same once."""
    compute, found = getattr(module, name), dict[bytes, Any]()

    def computed(*given: Any, **named: Any) -> Any:
        key = pickle.dumps((of(*given, **named), moments.MOST_PRODUCTS))
        if key not in found:
            found[key] = compute(*given, **named)
        return found[key]

    return module, name, computed


ONCE = (
    once(moments, "leaving"), once(moments, "ultimate_bound"), once(synthesis, "stiffest_coupler"),
    once(send_all, "certify_loop"), once(fault_tolerant_analysis, "analyse_fault_tolerant"), once(sampled, "sampled_verdict"),
    once(bus_delays, "bus_chains"), once(conformance, "plant_check", of_plant),
)  # fmt: skip


@pytest.fixture(autouse=True)
def computed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same of the same, wherever a run begins."""
    for module, name, computed in ONCE:
        monkeypatch.setattr(module, name, computed)


@pytest.fixture
def moments_of_low_degree(monkeypatch: pytest.MonkeyPatch) -> None:
    """A region by moments of few terms, for tests that ask for another verdict, or for whether there is one."""
    monkeypatch.setattr(moments, "MOST_PRODUCTS", 100_000)
