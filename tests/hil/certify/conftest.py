"""What verdicts of several tests rest on is computed once for the room: moments of a loop to low degrees where that does,
bounds, couplers and the norm of a jump system.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator
from typing import Any

import pytest

import design.jump_linear.leaving as moments
from design.passivity import synthesis
from design.semi_markov_loop import fault_tolerant_analysis


@pytest.fixture(scope="session", autouse=True)
def computed_once() -> Iterator[None]:
    """The same of the same, wherever a run begins."""

    def once(compute: Callable[..., Any]) -> Callable[..., Any]:
        found: dict[bytes, Any] = {}

        def computed(*given: Any, **named: Any) -> Any:
            key = pickle.dumps((given, named, moments.MOST_PRODUCTS))
            if key not in found:
                found[key] = compute(*given, **named)
            return found[key]

        return computed

    with pytest.MonkeyPatch.context() as patch:
        for module, name in (
            (moments, "leaving"), (moments, "ultimate_bound"), (synthesis, "stiffest_coupler"),
            (fault_tolerant_analysis, "analyse_fault_tolerant"),
        ):  # fmt: skip
            patch.setattr(module, name, once(getattr(module, name)))
        yield


@pytest.fixture
def moments_of_low_degree(monkeypatch: pytest.MonkeyPatch) -> None:
    """A region by moments of few terms, for tests that ask for another verdict, or for whether there is one."""
    monkeypatch.setattr(moments, "MOST_PRODUCTS", 500_000)
