"""Several media side by side, each with nodes of its own."""

from __future__ import annotations

from collections.abc import Sequence

from transport.medium.medium import Delivery, Medium


class SplitMedium:
    """Hands every node to its own medium; see `transport.medium.medium.Medium`.

    Args:
        parts: (node numbers, their medium, which counts them from 0 in this order); every node stands in one part.
    """

    def __init__(self, parts: Sequence[tuple[Sequence[int], Medium]]) -> None:
        self._parts = [(tuple(nodes), medium) for nodes, medium in parts]
        self._of = {node: (medium, i) for nodes, medium in self._parts for i, node in enumerate(nodes)}

    def may_send(self, node: int, k: int) -> bool:
        """See `Medium.may_send`."""
        medium, own = self._of[node]
        return medium.may_send(own, k)

    def offer(self, node: int, k: int, packet: object) -> None:
        """See `Medium.offer`."""
        medium, own = self._of[node]
        medium.offer(own, k, packet)

    def collect(self, k: int) -> list[Delivery]:
        """See `Medium.collect`."""
        found: dict[int, Delivery] = {}
        for nodes, medium in self._parts:
            found |= zip(nodes, medium.collect(k))
        return [found[node] for node in sorted(found)]
