"""The joint mode of both networks: (S-C mode, C-A mode, C-A mode before or -1), and how it changes."""

from __future__ import annotations

import numpy as np

from design.processes.delay_chain import Array, DelayChain

JointModes = list[tuple[int, int, int]]


def joint_modes(sc: DelayChain, ca: DelayChain, *, with_previous: bool = False) -> tuple[JointModes, Array]:
    """Return the joint modes and their transition matrix (N, N): the two chains are independent.

    Args:
        sc, ca: the delay chains.
        with_previous: a mode keeps the C-A mode before, too.
    """
    if with_previous:
        triples = [(s, c, b) for s in range(sc.modes) for c in range(ca.modes) for b in range(ca.modes) if ca.bounds[1][b, c] > 0]
        return triples, _joint(triples, sc.matrix, ca.matrix)
    pairs = [(s, c, -1) for s in range(sc.modes) for c in range(ca.modes)]
    return pairs, _joint(pairs, sc.matrix, ca.matrix)


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
