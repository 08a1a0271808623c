"""In which order sensor nodes count: by their number, and by the CAN identifier that decides the arbitration."""

from __future__ import annotations

from hil.experiment.tables import Experiment
from transport.links.can_identifiers import BASE, FRAGMENTS, base_of, derived
from transport.links.link import TransportError, split_uri


def ordered_names(e: Experiment) -> list[str]:
    """Return the names of the nodes by their number."""
    names = list(e.nodes)
    return sorted(names, key=lambda name: names.index(name) if e.nodes[name].id is None else e.nodes[name].id)  # type: ignore[arg-type,return-value]


def first_identifiers(e: Experiment, uri: str | None = None) -> list[int]:
    """Return the CAN identifier of each node's first frame, by number: that of the experiment, else that of the link's base.

    Where no node is named there is one all the same.

    Args:
        e: the experiment.
        uri: of a link; the experiment's own by default. One that is no CAN link, or says no base, has the base 0x100.
    """
    base, fd = framing(e.links.uri if uri is None else uri)
    given = [e.nodes[name].can_id for name in ordered_names(e)] or [None]
    count = len(given)
    below = derived(base, fd, count).sensors if count <= FRAGMENTS else [range(base + n, base + n + 1) for n in range(count)]
    return [own[0] if told is None else told for told, own in zip(given, below)]


def framing(uri: str) -> tuple[int, bool]:
    """Return a link's base and whether its frames are CAN FD; 0x100 and CAN FD for what is no CAN link."""
    try:
        scheme, _, options = split_uri(uri)
        if scheme == "can":
            return base_of(uri, options), options.get("fd", "1") == "1"
    except TransportError:
        pass  # opening the link says so
    return BASE, True
