"""The joint mode of both networks: (S-C mode, C-A mode, C-A mode before or -1), and how it changes."""

from __future__ import annotations

import numpy as np

from design.processes.delay_chain import Array, DelayChain

JointModes = list[tuple[int, int, int]]


def joint_modes(sc: DelayChain, ca: DelayChain, *, with_previous: bool = False) -> tuple[JointModes, Array]:
    """Return the joint modes and their transition matrix (N, N): the two chains are independent.

    Where a chain says in which modes it begins, only the pairs count that come about from there: two cycles keep their phase.

    Args:
        sc, ca: the delay chains.
        with_previous: a mode keeps the C-A mode before, too.
    """
    if with_previous:
        triples = [(s, c, b) for s in range(sc.modes) for c in range(ca.modes) for b in range(ca.modes) if ca.bounds[1][b, c] > 0]
        return _met(triples, sc, ca)
    return _met([(s, c, -1) for s in range(sc.modes) for c in range(ca.modes)], sc, ca)


def _met(modes: JointModes, sc: DelayChain, ca: DelayChain) -> tuple[JointModes, Array]:
    """The joint modes that are ever met, and their transition matrix."""
    if sc.begins is None and ca.begins is None:
        return modes, _joint(modes, sc.matrix, ca.matrix)
    every = [np.ones(chain.modes, dtype=np.bool_) if chain.begins is None else np.asarray(chain.begins) for chain in (sc, ca)]
    follows = [[np.flatnonzero(row) for row in chain.bounds[1] > 0.0] for chain in (sc, ca)]
    front = {(s, c) for s in np.flatnonzero(every[0]).tolist() for c in np.flatnonzero(every[1]).tolist()}
    met = set(front)
    while front:
        front = {(int(i), int(j)) for s, c in front for i in follows[0][s] for j in follows[1][c]} - met
        met |= front
    kept = [mode for mode in modes if mode[:2] in met and (mode[2] < 0 or mode[2] in {c for _, c in met})]
    return kept, _joint(kept, sc.matrix, ca.matrix)


def joint_bounds(sc: DelayChain, ca: DelayChain, modes: JointModes) -> tuple[Array, Array] | None:
    """Return entrywise bounds of the joint transition probabilities where a mode of a chain stands for many, else None."""
    if sc.between is None and ca.between is None:
        return None
    (sc_low, sc_high), (ca_low, ca_high) = sc.bounds, ca.bounds
    return _joint(modes, sc_low, ca_low), _joint(modes, sc_high, ca_high)


def joint_stays(sc: DelayChain, ca: DelayChain, modes: JointModes) -> tuple[Array, ...]:
    """Return least transition probabilities (N, N) while one chain, the other, or both are in a stay that has lasted long.

    See `DelayChain.stays`; none where no limit is known.
    """
    sides = [[sc.bounds[0], sc.long_stays], [ca.bounds[0], ca.long_stays]]
    found = (_joint(modes, sides[0][s], sides[1][c]) for s, c in ((1, 0), (0, 1), (1, 1)))
    return tuple(stays for stays in found if stays.any())


def _joint(modes: JointModes, sc: Array, ca: Array) -> Array:
    """Products of the two chains' entries; a mode that keeps the C-A mode before follows only where that fits."""
    s, c, before = np.array(modes, dtype=np.int64).T
    joint = np.asarray(sc[np.ix_(s, s)] * ca[np.ix_(c, c)], dtype=np.float64)
    return joint if before[0] < 0 else np.where(before[None, :] == c[:, None], joint, 0.0)
