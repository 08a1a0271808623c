"""Moments of a loop, from which a region follows, are computed once for the room, and to low degrees where that does."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from typing import Any

import pytest

import design.jump_linear.leaving as moments


@pytest.fixture(scope="session", autouse=True)
def moments_once() -> Iterator[None]:
    """Moments of a loop are the same wherever its run begins."""
    compute, found = moments.leaving, dict[bytes, moments.Leaving]()

    def leaving(*given: Any, **named: Any) -> moments.Leaving:
        key = pickle.dumps((given, named, moments.MOST_PRODUCTS))
        if key not in found:
            found[key] = compute(*given, **named)
        return found[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(moments, "leaving", leaving)
        yield


@pytest.fixture
def moments_of_low_degree(monkeypatch: pytest.MonkeyPatch) -> None:
    """A region by moments of few terms, for tests that ask for another verdict, or for whether there is one."""
    monkeypatch.setattr(moments, "MOST_PRODUCTS", 1_300_000)
