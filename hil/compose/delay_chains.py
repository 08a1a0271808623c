"""The network laws of an experiment as the delay chains over which its controller is designed, certified and predicted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from design.controllers import GainTable, LoopModel, sojourns_told
from hil.experiment import Experiment
from transport.laws.age import ConstantAge, IidAge, MarkovAge
from transport.laws.semi_markov import SemiMarkovAge, augmented_chain


def delay_chains(e: Experiment) -> tuple[Any | None, Any | None]:
    """Return the delay chains of both directions, with the labels that the controller tells apart.

    Raises:
        ValueError: the controller asks for more than it can measure over this law.
    """
    return delay_chain(e.links.sc.law, sojourns_told(e.controller)), delay_chain(e.links.ca.law)


def delay_chain(law: Any, sojourns: int | Sequence[int] = ()) -> Any | None:
    """Return the delay chain of a network law, None where it has none (packet laws, traces).

    Args:
        law: the network law.
        sojourns: semi-Markov laws: so many lengths of stay get labels of their own, in all or per delay 0, 1, ...

    Raises:
        ValueError: lengths of stay that nobody can measure, or that say nothing over this law.
    """
    from design.processes.delay_chain import DelayChain

    most = sojourns if isinstance(sojourns, int) else max(sojourns, default=1)
    if most > 1 and not isinstance(law, SemiMarkovAge):
        raise ValueError("sojourns: for a semi-Markov law only; over any other the delay says all that its length of stay could")
    if isinstance(law, SemiMarkovAge):
        augmented = augmented_chain(law)
        delays = np.asarray(law.mode_ages)[augmented.modes]
        if most == 1:
            return DelayChain(transition=augmented.matrix, delays=delays)
        if len(set(law.mode_ages)) < len(law.mode_ages):
            raise ValueError(f"sojourns: modes share a delay (ages {list(law.mode_ages)}), whose length of stay is not theirs")
        longest = [int(augmented.slots[delays == d].max(initial=0)) for d in range(int(delays.max()) + 1)]
        counts = [min(n, most) for n in longest] if isinstance(sojourns, int) else list(sojourns)
        if len(counts) < len(longest) or any(n > 0 and not count for n, count in zip(longest, counts)):
            raise ValueError(f"sojourns: {counts}, but the delay reaches {len(longest) - 1}")
        first = np.concatenate([[0], np.cumsum(counts)])[delays]
        labels = first + np.minimum(augmented.slots, np.asarray(counts)[delays]) - 1
        return DelayChain(transition=augmented.matrix, delays=delays, labels=labels)
    if isinstance(law, ConstantAge | IidAge | MarkovAge):
        return DelayChain(transition=law.transition_matrix(), delays=np.asarray(law.mode_ages))
    return None


def gains_over(controller: GainTable, model: LoopModel, sc: Any, ca: Any) -> NDArray[np.float64]:
    """Return K[tau, row, m, p] for the delays that two chains reach; a table may cover more (``max_age``)."""
    K = controller.table(model)[: int(sc.label.max()) + 1]
    return K[:, : ca.max_delay + 1] if controller.selection in ("generated", "applied", "previous") else K
