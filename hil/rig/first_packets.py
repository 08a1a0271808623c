"""What of a loop's packets never comes, and how long a loop waits for the first packet of a node."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from design.controllers import Controller, HistoryGains, ages_distinguished
from hil.rig.spec import RigSpec

if TYPE_CHECKING:
    from design.processes.delay_chain import DelayChain


def never_received(sc: DelayChain | None, ca: DelayChain | None, rig: RigSpec) -> str:
    """Return what of a loop's packets never comes where it is waited for, and why; empty: of each kind some come."""
    if sc is not None:
        held = sc.held_outputs(len(rig.outputs))[_lasting(sc)]
        for n, sensor in enumerate(rig.sensors):
            if held[:, list(sensor.outputs)].all():
                shared = any(n in medium.nodes for medium in rig.media)
                cause = "on its medium others send in every slot" if shared else "none is in time under its law"
                return f"no sample of {sensor.path} ever comes to the controller: {cause}"
    if ca is not None and ca.holds[_lasting(ca)].all():
        return "no command ever comes to the actuator: none is in time under the law of network.ca"
    return ""


def _lasting(chain: DelayChain) -> np.ndarray:
    """The modes of a chain but those of the first slots, to which none leads."""
    lasts, follows = np.zeros(chain.modes, dtype=np.bool_), chain.bounds[1] > 0.0
    after = ~lasts
    while not np.array_equal(lasts, after):
        lasts, after = after, after & follows[after].any(axis=0)
    return lasts


def waited_for(controller: Controller, rig: RigSpec) -> tuple[int, ...]:
    """Return the nodes, by number, without whose first packet a controller of several nodes answers zeros.

    Of one node alone, no sample and a sample of zeros are the same to what is linear. Gains over historical data wait for none:
    what has not arrived is zero.

    Args:
        controller: what runs.
        rig: its laws' files read.
    """
    if len(rig.sensors) == 1 or isinstance(controller, HistoryGains):
        return ()
    by_nodes = len(ages_distinguished(controller)) > 1
    silent = rig.nodes.silent if by_nodes else [s.name for s in rig.sensors if s.trigger.kind != "every-slot"]
    return tuple(n for n, sensor in enumerate(rig.sensors) if sensor.name not in silent)


def waiting_chance(sc: DelayChain, waited: Sequence[int], outputs: Sequence[Sequence[int]]) -> tuple[float, int]:
    r"""Return c and the node that is waited for longest: none of its packets has come by slot k with a probability like c^k.

    c is the spectral radius of the chain within the modes in which the node's sample is held: without a first packet it is in
    these but for the first slots.

    Args:
        sc: the chain of the ages of all nodes.
        waited: nodes that are waited for, by number.
        outputs: of each node, the outputs that it measures.
    """
    chances, held = {-1: 0.0}, sc.held_outputs(sum(map(len, outputs)))
    for node in waited:
        inside = np.flatnonzero(held[:, list(outputs[node])].all(axis=1))
        if len(inside):
            chances[node] = float(np.abs(np.linalg.eigvals(sc.bounds[1][np.ix_(inside, inside)])).max())
    longest = max(chances, key=lambda node: chances[node])
    return chances[longest], longest
