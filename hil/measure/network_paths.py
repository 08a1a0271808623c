"""The emulated networks of a run, from sensor nodes to controller and from there to the actuator: their draws and their load.

In a run with changes a network may have had several laws.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final, Literal, TypeAlias

import numpy as np
import numpy.typing as npt
from msgspec import Struct
from msgspec.structs import replace

from hil.log import CHANGE
from hil.log.append_column import AppendColumn, pieces
from hil.log.run import Run
from hil.log.topics import CA, SC
from hil.measure.view import MEASUREMENT, RunView
from hil.rig import RigSpec
from transport.draws import DELIVERED, DISORDERED, LOST, REASONS, SUPERSEDED
from transport.law_tests import law_p_value, transition_counts
from transport.laws import ChainLaw, NetworkLaw
from transport.laws.delay_states import long_run, mode_transitions
from transport.wire import sensor_length

Draws: TypeAlias = npt.NDArray[np.void]

MOST_MODES: Final = 256
"""Modes beyond which they are not counted: a foreign log may name any number as a mode, and pairs take its square."""


def mode_sequence(draws: Draws) -> npt.NDArray[np.int64]:
    """Return the modes that the law drew, one per slot in slot order (rows with mode < 0 book a packet's fate)."""
    parts = [modes[modes >= 0].astype(np.int64) for modes in (piece["mode"] for piece in pieces(draws))]
    return np.concatenate(parts) if parts else np.empty(0, np.int64)


def network_metrics(
    draws: Draws | None, law: NetworkLaw | None, kind: str, *, late: int = 0, reasons: Sequence[str] = REASONS,
    slot: tuple[float, float] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Return the network part of a summary, for one direction.

    It is counted from the records of the draws.

    Args:
        draws: records of `/network/sc` or `/network/ca`; None if they were not kept.
        law: the network law's parameters, None if they cannot be made again here (its plug-in is gone).
        kind: its plug-in name.
        late: packets that missed the slot's deadline (they count as lost on the way to the actuator).
        reasons: names of the codes in `draws["reason"]`.
        slot: its length and when it closes, s; None where that is not known.

    Returns:
        law (its kind), mode_counts, transition_counts (row: from; both empty above `MOST_MODES`), p_value (None where the law
        has no test or the record is too short), lost (by the loss law or a full queue), late, duplicated, fates (reason: count).
    """
    found: dict[str, Any] = {"law": kind, "mode_counts": [], "transition_counts": [], "p_value": None}
    fates: dict[str, int] = {}
    if draws is not None and len(draws):
        modes = mode_sequence(draws)
        expected = expected_frequencies(law)
        size = max(0 if expected is None else len(expected), int(modes.max(initial=-1)) + 1)
        if 0 < size <= MOST_MODES:
            found["mode_counts"] = np.bincount(modes, minlength=size).tolist()
            found["transition_counts"] = transition_counts(modes, size).tolist()
        found["p_value"] = _p_value(law, modes, draws, slot)
        counts = np.sum([np.bincount(piece["reason"], minlength=256) for piece in pieces(draws)], axis=0)
        fates = {reasons[c] if c < len(reasons) else str(c): int(counts[c]) for c in np.flatnonzero(counts).tolist()}
    found["lost"] = fates.get("lost", 0) + fates.get("overflow", 0)
    found["late"] = late
    found["duplicated"] = fates.get("duplicated", 0)
    found["fates"] = fates
    return found


def expected_transitions(law: NetworkLaw | None) -> npt.NDArray[np.float64] | None:
    """Return the transition matrix that the law states for its modes, None where it is no Markov chain."""
    return _stated(law, mode_transitions)


def expected_frequencies(law: NetworkLaw | None) -> npt.NDArray[np.float64] | None:
    """Return the stationary frequency of every mode that the law states, None where it states none."""
    return _stated(law, lambda law: None if (found := long_run(law)) is None else found[0])


def _stated(law: NetworkLaw | None, of: Callable[[object], npt.NDArray[np.float64] | None]) -> npt.NDArray[np.float64] | None:
    try:
        return of(law)
    except ValueError:  # for instance a chain with several closed classes has no single stationary law
        return None


def _p_value(
    law: NetworkLaw | None, modes: npt.NDArray[np.int64], draws: Draws, slot: tuple[float, float] | None
) -> float | None:  # fmt: skip
    if law is None:
        return None
    try:
        p_value = law_p_value(law, modes, pieces(draws), slot)
    except ValueError:  # a recorded trace whose file is no longer where it was
        return None
    return p_value if math.isfinite(p_value) else None


class NetworkPath(Struct, frozen=True, kw_only=True):
    """One emulated network.

    Args:
        side: sc, from a sensor node to the controller; ca, from the controller to the actuator.
        node: name of the sensor node; empty for ca.
        law: its network law, None where the experiment cannot be made again here.
        kind: name of the law's plug-in.
        medium: what its packets take before, in words; empty where they share nothing.
        changed: whether another law took over in the run: what was drawn is then compared with none.
        draws: what the law decided, None where the run keeps no records of it.
    """

    side: Literal["sc", "ca"]
    node: str
    law: NetworkLaw | None
    kind: str
    medium: str
    draws: Draws | None
    changed: bool = False

    @property
    def through(self) -> str:
        """Medium and network law in words; a law of age 0 behind a medium adds nothing, and is not named."""
        ages = self.law.mode_ages if isinstance(self.law, ChainLaw) else ()
        law = f"{self.kind} law" + (", changed in the run" if self.changed else f", age {ages[0]}" if len(ages) == 1 else "")
        if not self.medium:
            return law
        return self.medium if tuple(ages) == (0,) else f"{self.medium}, then {law}"


class ChangedField(Struct, frozen=True, kw_only=True):
    """A change of a run.

    Args:
        slot: from which it acts.
        path: of the field.
        certificate: kind, state and reason of what is claimed from then on; empty where nothing is.
    """

    slot: int
    path: str
    certificate: dict[str, Any]


def changed_fields(run: Run) -> tuple[ChangedField, ...]:
    """Return the changes of a run, in order; that it was ended is none."""
    said = [(event.get("slot"), event.get("data")) for event in run.events if event.get("kind") == CHANGE]
    return tuple(
        ChangedField(slot=int(slot or 0), path=str(data.get("path")), certificate=data["certificate"])
        for slot, data in said
        if isinstance(data, dict) and isinstance(data.get("certificate"), dict) and data.get("path") != "end"
    )


def law_was_changed(changes: Iterable[ChangedField], side: str, node: str) -> bool:
    """Return whether the network law of a direction, or of a sensor node, is among the changes of a run."""
    paths = (f"network.{side}.", f"network.nodes.{node}.")
    return any(f"{each.path}.".startswith(paths) for each in changes)


def network_paths(view: RunView) -> tuple[NetworkPath, ...]:
    """Return the networks from the sensor nodes, by number, then the one to the actuator."""
    paths, changes = _stated_paths(view), changed_fields(view.run)
    return tuple(replace(p, law=None, changed=True) if law_was_changed(changes, p.side, p.node) else p for p in paths)


def _stated_paths(view: RunView) -> tuple[NetworkPath, ...]:
    rig, arrays = view.rig, view.run.arrays
    sc, ca = arrays.get(SC.name), arrays.get(CA.name)
    if rig is None:
        kinds = law_kinds(view.run)
        return (
            NetworkPath(side="sc", node="sensor", law=None, kind=kinds["sc"], medium="", draws=sc),
            NetworkPath(side="ca", node="", law=None, kind=kinds["ca"], medium="", draws=ca),
        )
    bus = next((medium for medium in rig.media if medium.table.kind == "can" and medium.table.control), None)
    return (
        *(
            NetworkPath(
                side="sc", node=sensor.name, law=sensor.law, kind=sensor.law_kind,
                medium=next((shared.table.in_words() for shared in rig.media if number in shared.nodes), ""),
                draws=None if sc is None else draws_of(sc, number),
            )
            for number, sensor in enumerate(rig.sensors)
        ),
        NetworkPath(
            side="ca", node="", law=rig.ca_law, kind=rig.ca_kind, medium="" if bus is None else bus.table.in_words(),
            draws=ca,
        ),
    )  # fmt: skip


def law_kinds(run: Run) -> dict[str, str]:
    """Return the kind of the network law of each direction, as a log states it."""
    network = run.resolved.get("network", {})
    return {side: str(network.get(side, {}).get("law", {}).get("kind", "?")) for side in ("sc", "ca")}


def draws_of(draws: Draws, number: int) -> Draws:
    """Return the records about one sensor node: all of them where the log does not number them, as there is one node then.

    Args:
        draws: records of `/network/sc`.
        number: number of the node.
    """
    if "node" not in (draws.dtype.names or ()):
        return draws
    own = AppendColumn(draws.dtype)
    for piece in pieces(draws):
        own.extend(piece[piece["node"] == number])
    return own.array()


class Load(Struct, frozen=True, kw_only=True):
    """What one node sent.

    Args:
        node: its name.
        packets: packets that arrived or were lost on the way; what was still on its way at the end is not counted.
        lost: of these lost on the way.
        packets_per_s: mean over the run.
        bits_per_s: mean over the run, of whole packets.
    """

    node: str
    packets: int
    lost: int
    packets_per_s: float
    bits_per_s: float


def loads(view: RunView) -> tuple[Load, ...]:
    """Return the load of every sensor node; empty where the run keeps no draws or cannot be made again here."""
    draws, rig = view.run.arrays.get(SC.name), view.rig
    if draws is None or rig is None or not len(draws):
        return ()
    slots = len(view.run.arrays.get(MEASUREMENT, ())) or max(int(piece["slot"].max()) for piece in pieces(draws)) + 1
    fates = [sent_packets(path.draws) for path in view.once(network_paths) if path.side == "sc" and path.draws is not None]
    return node_loads(rig, [sent for sent, _ in fates], slots * view.period_s, [lost for _, lost in fates])


def node_loads(rig: RigSpec, packets: Sequence[int], seconds: float, lost: Sequence[int] = ()) -> tuple[Load, ...]:
    """Return the load of every sensor node from what it sent.

    It counts packets and bits per second, lost ones included.

    Args:
        rig: whose nodes they are.
        packets, lost: how many each node sent, and how many of them were lost.
        seconds: length of the run.
    """
    found = []
    for sensor, sent, gone in zip(rig.sensors, packets, lost or [0] * len(packets)):
        bits = 8 * sensor_length(len(sensor.outputs) * sensor.buffer + len(rig.outputs))
        found.append(
            Load(node=sensor.name, packets=sent, lost=gone, packets_per_s=sent / seconds, bits_per_s=sent * bits / seconds)
        )
    return tuple(found)


def sent_packets(draws: npt.NDArray[np.void]) -> tuple[int, int]:
    """Return how many packets a node sent as far as their fate is known, and how many of them were lost."""
    came = lost = 0
    for piece in pieces(draws):
        came += int(np.isin(piece["reason"], (DELIVERED, DISORDERED, SUPERSEDED)).sum())
        lost += int((piece["reason"] == LOST).sum())
    return came + lost, lost
