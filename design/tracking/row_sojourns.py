"""Rows of a packet for every d and for how long it has lasted, and the labels of the chain that they belong to.

Of S lengths of stay, d after h slots has the label and the row d S + min(h, S) - 1. A design has gains for the labels that its
chain carries; a packet has a row for each of them, and for those between, of stays that never last so long.
"""

from __future__ import annotations

import numpy as np

from design.errors import FieldError
from design.processes.delay_chain import Array, DelayChain


def row_sojourns_of(chain: DelayChain) -> int:
    """Return how many lengths of stay at every delay the labels of a chain distinguish; 1: the labels are the delays.

    Args:
        chain: of the actuator.

    Raises:
        FieldError: labels of another order.

    >>> row_sojourns_of(DelayChain(transition=[[0, 1, 0], [0, 0, 1], [1, 0, 0]], delays=[0, 0, 1], labels=[0, 1, 2]))
    2
    """
    if chain.held is not None or np.array_equal(chain.label, chain.delay):
        return 1
    least, longest = int(chain.label[chain.delay == chain.max_delay].min()), chain.max_delay
    stays = least // longest if longest else int(chain.label.max()) + 1
    if stays < 1 or not np.array_equal(chain.label // stays, chain.delay):
        raise FieldError("labels", f"{chain.label.tolist()}, expected d S + min(h, S) - 1 of S lengths h of stay at a delay d")
    return stays


def with_every_row(gains: Array, chain: DelayChain, stays: int) -> Array:
    """Return gains with a row for every delay and length of stay; a row of a stay that never comes repeats the last before it.

    Args:
        gains: with a row for each label, (tau labels, labels, m, py).
        chain: of the actuator.
        stays: lengths of stay that it distinguishes.

    Raises:
        FieldError: it distinguishes others.
    """
    if row_sojourns_of(chain) != stays:
        raise FieldError("row_sojourns", f"{stays}, but the chain of network.ca distinguishes {row_sojourns_of(chain)}")
    carried = np.unique(chain.label)
    last = np.searchsorted(carried, np.arange((chain.max_delay + 1) * stays), side="right") - 1
    return np.asarray(gains[:, carried[np.maximum(last, 0)]])
