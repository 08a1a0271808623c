"""The emulated networks of a run: from every sensor node to the controller, and from the controller to the actuator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from hil.log.append_column import AppendColumn, pieces
from hil.log.run import Run
from hil.log.topics import CA, SC
from hil.measure.view import RunView
from transport.laws.protocols import NetworkLaw

Draws = npt.NDArray[np.void]


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkPath:
    """One emulated network.

    Args:
        side: sc, from a sensor node to the controller; ca, from the controller to the actuator.
        node: name of the sensor node; empty for ca.
        law: its network law, None where the experiment cannot be made again here.
        kind: name of the law's plug-in.
        draws: what the law decided, None where the run keeps no records of it.
    """

    side: Literal["sc", "ca"]
    node: str
    law: NetworkLaw | None
    kind: str
    draws: Draws | None


def network_paths(view: RunView) -> tuple[NetworkPath, ...]:
    """Return the networks from the sensor nodes, by number, then the one to the actuator."""
    rig, arrays = view.rig, view.run.arrays
    sc, ca = arrays.get(SC.name), arrays.get(CA.name)
    if rig is None:
        kinds = law_kinds(view.run)
        return (
            NetworkPath(side="sc", node="sensor", law=None, kind=kinds["sc"], draws=sc),
            NetworkPath(side="ca", node="", law=None, kind=kinds["ca"], draws=ca),
        )
    return (
        *(
            NetworkPath(
                side="sc", node=sensor.name, law=sensor.law, kind=sensor.law_kind,
                draws=None if sc is None else draws_of(sc, number),
            )
            for number, sensor in enumerate(rig.sensors)
        ),
        NetworkPath(side="ca", node="", law=rig.ca_law, kind=rig.ca_kind, draws=ca),
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
