"""How much each sensor node puts on the network: packets and bits per second, lost ones included."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from design.controllers import packet_samples
from hil.experiment.sensor_order import ordered_names
from hil.log.growing import Growing, pieces
from hil.measure.network import network_metrics
from hil.measure.view import MEASUREMENT, RunView
from transport.medium.draws import DELIVERED, DISORDERED, LOST, SUPERSEDED
from transport.wire.version2 import sensor_length


@dataclass(frozen=True, slots=True, kw_only=True)
class Load:
    """What one node sent.

    Args:
        node: its name; ``sensor`` where none is named.
        packets: packets that arrived or were lost on the way; what was still on its way at the end is not counted.
        lost: of these lost on the way.
        packets_per_s: mean over the run.
        bits_per_s: mean over the run, of whole packets in wire version 2.
    """

    node: str
    packets: int
    lost: int
    packets_per_s: float
    bits_per_s: float


def loads(view: RunView) -> tuple[Load, ...]:
    """Return the load of every sensor node; empty where the run keeps no draws or cannot be made again here."""
    draws, e = view.run.arrays.get("/network/sc"), view.experiment
    if draws is None or e is None or not len(draws):
        return ()
    slots = len(view.run.arrays.get(MEASUREMENT, ())) or max(int(piece["tick"].max()) for piece in pieces(draws)) + 1
    seconds, outputs = slots * view.period_s, len(e.plant.outputs)
    found = []
    for number, name in enumerate(ordered_names(e) or ["sensor"]):
        own = of_node(draws, number) if e.nodes else draws
        width = len(e.nodes[name].outputs) * e.nodes[name].buffer if e.nodes else outputs * packet_samples(e.controller)
        sent, lost = sent_packets(own)
        bits = 8 * sensor_length(width + outputs)
        found.append(
            Load(node=name, packets=sent, lost=lost, packets_per_s=sent / seconds, bits_per_s=sent * bits / seconds)
        )
    return tuple(found)


def of_node(draws: npt.NDArray[np.void], number: int) -> npt.NDArray[np.void]:
    """Return the draws of one node."""
    own = Growing(draws.dtype)
    for piece in pieces(draws):
        own.extend(piece[piece["node"] == number])
    return own.array()


def sent_packets(draws: npt.NDArray[np.void]) -> tuple[int, int]:
    """Return how many packets a node sent as far as their fate is known, and how many of them were lost."""
    came = lost = 0
    for piece in pieces(draws):
        came += int(np.isin(piece["reason"], (DELIVERED, DISORDERED, SUPERSEDED)).sum())
        lost += int((piece["reason"] == LOST).sum())
    return came + lost, lost


def node_metrics(view: RunView, reasons: Sequence[str]) -> dict[str, Any]:
    """Return the network part of a summary for every named node: `network_metrics` and its load.

    Args:
        view: a run of an experiment with named nodes.
        reasons: names of the codes in `draws["reason"]`.
    """
    draws, e = view.run.arrays.get("/network/sc"), view.experiment
    found: dict[str, Any] = {}
    if draws is None or e is None:
        return found
    load = {each.node: each for each in loads(view)}
    for number, name in enumerate(ordered_names(e)):
        own = e.nodes[name].law is not None
        law = e.nodes[name].law if own else e.links.sc.law
        kind = e.kinds.get(f"nodes.{name}.law" if own else "links.sc.law", "?")
        found[name] = network_metrics(of_node(draws, number), law, kind, reasons=reasons)
        if name in load:
            found[name] |= {key: value for key, value in asdict(load[name]).items() if key != "node" and key != "lost"}
    return found


def several_nodes(network: Mapping[str, Any]) -> dict[str, Any]:
    """Return the summary of a direction that several channels share: their packets together, and no test of one law."""
    return {**network, "mode_counts": [], "transition_counts": [], "p_value": None}
