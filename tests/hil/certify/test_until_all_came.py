"""A verdict on a loop that acts from slot 0 on, where its input is 0 until a packet of every node has come."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

import hil.certify as certifier
from design.verdict import Verdict
from hil.certify import UNTIL_ALL_CAME, WAITS_TOO_LONG, limited_to_received

CERTIFIED = Verdict(kind="mean-square stability", state="certified", reason="its radius is 0.9", number=0.9, limit=1.0)


def limited(
    monkeypatch: pytest.MonkeyPatch, verdict: Verdict, rate: float, chance: float = 0.5, *, silent: str = "", between: Any = None,
    **more: Any,
) -> Verdict:  # fmt: skip
    """What becomes of a verdict where the plant grows by a rate and packets of node 1 stay away with a chance in every slot."""
    monkeypatch.setattr(certifier, "waiting_chance", lambda chain, waited, outputs: (chance, 1))
    loop: dict[str, Any] = {
        "stacked": SimpleNamespace(A=np.diag([-rate, 0.1])), "silent": silent, "sc": SimpleNamespace(between=between),
        "waited": (0, 1), "model": SimpleNamespace(nodes=SimpleNamespace(outputs=((0,), (1,)), names=("angle", "speed"))),
    }  # fmt: skip
    return limited_to_received(SimpleNamespace(**(loop | more)), verdict)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("rate", "growth", "state"),
    [(rate, *each) for rate in (1.05, 3.0) for each in ((0.99, "certified"), (1.01, "refused"), (1.0, "undecided"))],
)
def test_a_plant_that_grows_faster_than_its_packets_come_is_not_stable(
    rate: float, growth: float, state: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """E|x|^2 while none has come is chance^k rate^(2 k)."""
    found = limited(monkeypatch, CERTIFIED, rate, growth / rate**2)
    assert found.state == state
    if state == "certified":
        assert found is CERTIFIED
        return
    assert found.number == pytest.approx(growth) and (found.limit, found.quantity) == (1.0, UNTIL_ALL_CAME)
    assert found.reason.startswith("certified once it acts; until a packet of every node has come the input is 0")
    assert f"by up to {rate**2:.4g} in a slot" in found.reason and "network.nodes.speed has come" in found.reason
    assert f"less likely by {growth / rate**2:.4g} with every slot" in found.reason


def test_at_its_edge_and_where_the_chain_has_bounds_alone_it_is_undecided(monkeypatch: pytest.MonkeyPatch) -> None:
    for growth, between, state in (
        (1.0 - 0.5 * WAITS_TOO_LONG, None, "undecided"), (1.0 + 0.5 * WAITS_TOO_LONG, None, "undecided"),
        (1.0 - 2.0 * WAITS_TOO_LONG, None, "certified"), (1.0 + 2.0 * WAITS_TOO_LONG, None, "refused"),
        (2.0, "bounds", "undecided"),
    ):  # fmt: skip
        assert limited(monkeypatch, CERTIFIED, 2.0, growth / 4.0, between=between).state == state


def test_what_waits_for_nothing_or_does_not_grow_keeps_its_verdict(monkeypatch: pytest.MonkeyPatch) -> None:
    assert limited(monkeypatch, CERTIFIED, 1.0, 1.0) is CERTIFIED
    for more in ({"sc": None}, {"waited": ()}):
        assert limited(monkeypatch, CERTIFIED, 2.0, 1.0, **more) is CERTIFIED
    refused = replace(CERTIFIED, state="refused")
    assert limited(monkeypatch, refused, 2.0, 1.0) is refused


def test_a_loop_that_may_be_silent_is_not_refused_for_what_the_controller_would_do(monkeypatch: pytest.MonkeyPatch) -> None:
    silent, refused = "its nodes may be silent", replace(CERTIFIED, state="refused")
    found = limited(monkeypatch, refused, 1.0, silent=silent)
    assert found.state == "undecided" and found.details == {"stable": False}
    assert found.reason == f"{CERTIFIED.reason} if the controller acted; {silent}, and until then the input is 0"
    grows = limited(monkeypatch, refused, 1.01, 1.0, silent=silent)
    assert (grows.state, grows.number) == ("refused", pytest.approx(1.01**2)) and grows.reason.endswith(f"in a slot; {silent}")
    assert limited(monkeypatch, refused, 1.01, 0.999, silent=silent) is refused, "the silent node is none that is waited for"
    open_ = replace(CERTIFIED, state="undecided", reason="too many modes")
    assert limited(monkeypatch, open_, 1.01, silent=silent) == replace(open_, reason=f"too many modes; {silent}")
    assert limited(monkeypatch, open_, 1.01) is open_
