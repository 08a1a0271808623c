"""The delay chains of several sensor nodes as one: every mode of the product says how old each output's newest sample is."""

from __future__ import annotations

from collections.abc import Sequence
from math import prod

import numpy as np

from design.errors import FieldError
from design.processes.delay_chain import Array, DelayChain

MOST_MODES = 1024


def product_chain(chains: Sequence[DelayChain], outputs: Sequence[Sequence[int]], told: Sequence[int] = ()) -> DelayChain:
    r"""Return the chain of (tau_1, ..., tau_q), the ages of the newest samples of q nodes with independent networks.

    .. math:: \Lambda = \Lambda_1 \otimes \cdots \otimes \Lambda_q

    Args:
        chains: the delay chain of each node.
        outputs: per node the indices of the outputs that it measures; together every output once.
        told: how many ages 0, 1, ... of each node have gains of their own, the last node's fastest; by default gains know the
            oldest of the ages only. A product of one chain is that chain.

    Raises:
        FieldError: outputs that do not fit, ages beyond those told apart, or more than `MOST_MODES` modes.

    >>> step = DelayChain(transition=[[0.5, 0.5], [1.0, 0.0]])
    >>> both = product_chain([step, step], [[0], [1]], told=(2, 2))
    >>> both.ages.tolist(), both.label.tolist(), both.delay.tolist()
    ([[0, 0], [0, 1], [1, 0], [1, 1]], [0, 1, 2, 3], [0, 1, 1, 1])
    """
    every = [output for own in outputs for output in own]
    if len(outputs) != len(chains) or sorted(every) != list(range(len(every))) or not every:
        raise FieldError("outputs", f"{[list(own) for own in outputs]}, expected every output once, on {len(chains)} nodes")
    if len(chains) == 1 and not told:
        return chains[0]
    modes = prod(chain.modes for chain in chains)
    if modes > MOST_MODES:
        raise FieldError("transition", f"the delays of {len(chains)} nodes have {modes} modes together, at most {MOST_MODES}")
    mode_of = np.indices([chain.modes for chain in chains]).reshape(len(chains), -1)
    own = np.array([chain.delay[at] for chain, at in zip(chains, mode_of)])  # (nodes, modes)
    ages = np.zeros((modes, len(every)), dtype=np.int64)
    for node, measured in enumerate(outputs):
        ages[:, list(measured)] = own[node][:, None]
    label = None
    if told:
        if len(told) != len(chains):
            raise FieldError("told", f"{len(told)} numbers for {len(chains)} nodes")
        for node, (count, chain) in enumerate(zip(told, chains)):
            if chain.max_delay >= count and chain.held is None:
                raise FieldError(f"told[{node}]", f"{count} ages, but the delay of this node reaches {chain.max_delay}")
        label = np.ravel_multi_index(tuple(np.minimum(own, np.array(told)[:, None] - 1)), tuple(told))
    exact = all(chain.between is None for chain in chains)
    low, high = ([chain.bounds[side] for chain in chains] for side in (0, 1))
    held = None
    if any(chain.held is not None for chain in chains):
        held = np.zeros(ages.shape, dtype=np.bool_)
        for measured, chain, at in zip(outputs, chains, mode_of):
            held[:, list(measured)] = chain.holds[at][:, None]
        label = np.array([chain.label[at] for chain, at in zip(chains, mode_of)]).max(axis=0) if label is None else label
    return DelayChain(
        transition=kron_of([chain.matrix for chain in chains]), delays=own.max(axis=0), labels=label,
        between=None if exact else (kron_of(low), kron_of(high)), ages=ages, held=held,
    )  # fmt: skip


def kron_of(factors: Sequence[Array]) -> Array:
    """Return the Kronecker product of vectors or matrices, the first one's index slowest."""
    product = factors[0]
    for factor in factors[1:]:
        product = np.asarray(np.kron(product, factor), dtype=np.float64)
    return product
