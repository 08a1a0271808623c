"""The network from the sensor nodes to the controller, as an experiment describes it."""

from __future__ import annotations

from collections.abc import Sequence

from hil.compose.loop import Loop
from hil.compose.sensors import Shared
from hil.runtime.streams import rng_for
from transport.medium.draws import DELIVERED, DISORDERED, DUPLICATED
from transport.medium.independent import impair
from transport.medium.medium import Delivery, IndependentChannels, Medium
from transport.medium.scheduled import RandomTurns, RoundRobin, ScheduledMedium, Turns

_CAME = frozenset((DELIVERED, DISORDERED, DUPLICATED))


def uplink_of(loop: Loop, seed: int, period_s: float, deadline_s: float) -> Medium:
    """Return the medium between the sensor nodes and the controller; every node and every shared medium has its own stream.

    Args:
        loop: the composed experiment.
        seed: seed of the run.
        period_s: sample period T, s.
        deadline_s: seconds after the start of a slot at which it closes; packet laws only.
    """
    channels = [impair(s.law, rng_for(seed, s.stream), period_s, deadline_s) for s in loop.sensors]
    if not loop.media:
        return IndependentChannels(channels)
    return ScheduledMedium(channels, [(shared.nodes, _turns(shared, seed)) for shared in loop.media])


def _turns(shared: Shared, seed: int) -> Turns:
    table, rng = shared.table, rng_for(seed, f"medium.{shared.name}")
    if table.kind == "round-robin":
        return RoundRobin(shared.nodes, table.phase, table.loss, rng)
    return RandomTurns(shared.nodes, table.transition(), table.shares(), table.loss, rng)


def fresh(sent: Sequence[Delivery]) -> list[Delivery]:
    """Return what arrived for the first time in this slot: a node that is silent repeats nothing."""
    return [
        (draws, [(g, packet) for g, packet in arrivals if any(d.packet_tick == g and d.reason in _CAME for d in draws)])
        for draws, arrivals in sent
    ]
