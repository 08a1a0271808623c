"""In which order sensor nodes count: by their number, and by the CAN identifier that decides the arbitration."""

from __future__ import annotations

from collections.abc import Sequence

from hil.experiment.tables import Experiment
from transport.links.can_identifiers import FRAGMENTS, derived
from transport.links.traits import CanFraming


def ordered_names(e: Experiment) -> list[str]:
    """Return the names of the nodes by their number."""
    names = list(e.network.nodes)
    return sorted(names, key=lambda name: names.index(name) if e.network.nodes[name].id is None else e.network.nodes[name].id)  # type: ignore[arg-type,return-value]


def first_identifiers(given: Sequence[int | None], framing: CanFraming) -> list[int]:
    """Return the CAN identifier of each node's first frame, by number.

    Args:
        given: of each node, that of the experiment; None for that of the link's base.
        framing: of the link.
    """
    count, base = len(given), framing.base
    many = count > FRAGMENTS
    below = [range(base + n, base + n + 1) for n in range(count)] if many else derived(base, framing.fd, count).sensors
    return [own[0] if told is None else told for told, own in zip(given, below)]
