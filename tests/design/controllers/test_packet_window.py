"""The last packets: every outcome has its phase, and the chain of the phases is that of all paths."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from design.controllers.sensor_nodes import PacketWindow, SensorNodes, Turns, window_of
from design.historical_data import DelayedPlant, close
from design.historical_data.guaranteed_cost import average_start, cost
from design.historical_data.least_cost import synthesise
from design.historical_data.sensor_schedule import window_chain, window_mask, window_start, window_undecided
from plants.delayed_states import DelayedStates

CYCLE = Turns(order=(0, 2, 1), phase=1, loss=0.3)
ALIKE = Turns(transition=((0.2, 0.8), (0.2, 0.8)), initial=(0.5, 0.5), loss=0.4)
MARKOV = Turns(transition=((0.2, 0.8), (0.6, 0.4)), initial=(0.1, 0.9))


def paths(turns: Turns, slots: int) -> list[tuple[float, list[int | None]]]:
    """Every path of outcomes with its probability: whose packet came in each slot."""
    found = []
    nodes = [0] if turns.order else range(len(turns.transition))
    for drawn, lost in product(product(nodes, repeat=slots), product((False, True), repeat=slots)):
        share, received = 1.0, []
        for k, (node, gone) in enumerate(zip(drawn, lost)):
            if not turns.order:
                share *= turns.initial[node] if k == 0 else turns.transition[drawn[k - 1]][node]
            share *= turns.loss if gone else 1.0 - turns.loss
            who = turns.order[(k + turns.phase) % len(turns.order)] if turns.order else node
            received.append(None if gone else who)
        found.append((share, received))
    return found


@pytest.mark.parametrize("turns", [CYCLE, ALIKE, MARKOV], ids=["cycle", "alike", "markov"])
@pytest.mark.parametrize("length", [1, 2, 3])
def test_the_chain_gives_every_window_the_share_of_all_paths_that_end_in_it(turns: Turns, length: int) -> None:
    window = PacketWindow(turns=turns, length=length)
    assert window_of(turns, window.phases).length == length
    share = window_start(window)
    assert share.sum() == pytest.approx(1) and np.allclose(window_chain(window).sum(axis=1), 1)
    for k in range(4):
        counted = np.zeros(window.phases)
        for each, received in paths(turns, k + 1):
            phase = window.phase(k, received.__getitem__)
            counted[phase] += each
            if each:
                assert window.outcomes(phase)[: k + 1] == tuple(received[k - e] for e in range(min(length, k + 1)))
        np.testing.assert_allclose(share, counted, atol=1e-14)
        share = share @ window_chain(window)


def test_what_the_window_does_not_cover_is_refused_or_undecided() -> None:
    with pytest.raises(ValueError, match="uses: the last packets differ where"):
        PacketWindow(turns=Turns(order=(0, 1)), length=2)
    with pytest.raises(ValueError, match="window: 9 slots have 1536 outcomes"):
        PacketWindow(turns=CYCLE, length=9)
    with pytest.raises(ValueError, match="gains: 7 phases, but the last packets of this schedule have 6"):
        window_of(CYCLE, 7)
    nodes = SensorNodes(names=("a", "b"), outputs=((0,), (1,)), buffers=(1, 1), delays=(0, 0), turns=ALIKE)
    assert window_undecided(nodes, PacketWindow(turns=ALIKE, length=2)) == ""
    hidden = Turns(transition=MARKOV.transition, initial=MARKOV.initial, loss=0.1)
    assert "hides whose turn" in window_undecided(nodes, PacketWindow(turns=hidden, length=2))


@pytest.mark.slow
def test_the_last_two_packets_of_independent_turns_cost_less_than_the_last_one() -> None:
    """2.1497 on the mean with 16 phases, against 2.3843 with the packet of the slot alone."""
    example = DelayedStates()
    model = example.model()
    plant = DelayedPlant(A=model.A, delayed=example.state_delays(), B=model.B, weight=example.cost_weights()[0])
    turns = Turns(transition=((0.25,) * 4,) * 4, initial=(0.25,) * 4)
    nodes = SensorNodes(
        names=("a", "b", "c", "d"), outputs=((0,), (1,), (2,), (3,)), buffers=(3,) * 4, delays=(0,) * 4, turns=turns
    )
    window = PacketWindow(turns=turns, length=2)
    chain, start = window_chain(window), average_start(4, 16)
    gains = synthesise(plant, window_mask(nodes, window, 3), start, transition=chain)
    assert cost(close(plant, gains, chain), start) == pytest.approx(2.1497, abs=2e-4)
