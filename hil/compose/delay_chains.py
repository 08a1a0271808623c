"""The network laws of an experiment as the delay chains over which its controller is designed, certified and predicted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from design.controllers import GainTable, LoopModel, sojourns_told
from design.errors import FieldError
from hil.experiment import Experiment
from transport.laws.delay_states import delay_states
from transport.laws.protocols import SemiMarkovLaw


def delay_chains(e: Experiment) -> tuple[Any | None, Any | None]:
    """Return the delay chains of both directions, with the labels that the controller tells apart.

    Raises:
        ValueError: the controller asks for more than it can measure over this law.
    """
    return delay_chain(e.links.sc.law, sojourns_told(e.controller)), delay_chain(e.links.ca.law)


def delay_chain(law: Any, sojourns: int | Sequence[int] = ()) -> Any | None:
    """Return the chain of the delay that the receiver measures under a network law, None where the law states no chain.

    A receiver keeps the newest packet: where the law's age may grow by more than one per slot it measures another delay.

    Args:
        law: the network law.
        sojourns: semi-Markov laws: so many lengths of stay get labels of their own, in all or per delay 0, 1, ...

    Raises:
        ValueError: lengths of stay that nobody can measure, or that say nothing over this law.
    """
    from design.processes.delay_chain import DelayChain

    most = sojourns if isinstance(sojourns, int) else max(sojourns, default=1)
    if most > 1 and not isinstance(law, SemiMarkovLaw):
        raise FieldError(
            "sojourns", "for a semi-Markov law only; over any other the delay says what its length of stay could"
        )
    states = delay_states(law)
    if states is None:
        return None
    between = None if np.array_equal(states.low, states.high) else (states.low, states.high)
    if most == 1:
        return DelayChain(transition=states.matrix, delays=states.ages, between=between)
    if len(set(law.mode_ages)) < len(law.mode_ages):
        raise FieldError("sojourns", f"modes share a delay (ages {list(law.mode_ages)}), whose length of stay is not theirs")
    if states.has_gaps:
        raise FieldError("sojourns", "this delay may grow by more than one per slot, and the receiver measures another stay")
    delays, slots = states.ages, states.slots
    longest = [int(slots[delays == d].max(initial=0)) for d in range(int(delays.max()) + 1)]
    counts = [min(n, most) for n in longest] if isinstance(sojourns, int) else list(sojourns)
    if len(counts) < len(longest) or any(n > 0 and not count for n, count in zip(longest, counts)):
        raise FieldError("sojourns", f"{counts}, but the delay reaches {len(longest) - 1}")
    first = np.concatenate([[0], np.cumsum(counts)])[delays]
    labels = first + np.minimum(slots, np.asarray(counts)[delays]) - 1
    return DelayChain(transition=states.matrix, delays=delays, labels=labels, between=between)


def initial_laws(e: Experiment) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Return the distributions of the modes of both delay chains in slot 0, None where a law has no chain."""
    sc, ca = delay_states(e.links.sc.law), delay_states(e.links.ca.law)
    return None if sc is None or ca is None else (sc.initial, ca.initial)


def gains_over(controller: GainTable, model: LoopModel, sc: Any, ca: Any) -> NDArray[np.float64]:
    """Return K[tau, row, m, p] for the delays that two chains reach; a table may cover more (``max_age``)."""
    K = controller.table(model)[: int(sc.label.max()) + 1]
    return K[:, : ca.max_delay + 1] if controller.selection in ("generated", "applied", "previous") else K
