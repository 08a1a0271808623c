"""What a medium with losses does to packets of one node."""

from __future__ import annotations

from transport.draws import LOST
from transport.medium import Medium


def lost_and_came(shared: Medium, slots: int) -> tuple[int, int]:
    """Offer a packet of the only node in every slot; count those booked as lost and those that arrive: always one of both."""
    lost = came = 0
    for k in range(slots):
        shared.offer(0, k, k)
        ((draws, arrivals),) = shared.collect(k)
        gone = [d for d in draws if d.reason == LOST]
        assert bool(gone) != any(g == k for g, _ in arrivals)
        lost, came = lost + len(gone), came + any(g == k for g, _ in arrivals)
    return lost, came
