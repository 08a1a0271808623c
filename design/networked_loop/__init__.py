"""Plant + delay chains + row rule = a jump-linear system (7.14): closed loop, prediction, uncertainty, bounds.

Here is what the loop over two networks is put together from: joint modes, checked shapes, packet registers, the ideal response.
A joint mode is (S-C mode, C-A mode, C-A mode before or -1). `design.networked_loop.affine_loop` builds its matrices of these
parts, in deviations from the ideal plant response: state and input at which the output equals the reference, (7.6)-(7.7).
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt

from design.errors import FieldError, TooLarge
from design.jump_linear.certificate import too_large
from design.processes.delay_chain import DelayChain

JointModes = list[tuple[int, int, int]]
MOST_MODES = 8000
"""Joint modes that are computed with: a matrix of their transition probabilities has 512 MB."""


def check_size(modes: int, order: int) -> None:
    """Refuse a loop whose second moments are not computed, before its matrices fill the memory.

    Args:
        modes: joint ones.
        order: number of states.

    Raises:
        TooLarge: with both numbers and the limit.
    """
    if why := too_large(modes, order):
        raise TooLarge(why)


def joint_modes(sc: DelayChain, ca: DelayChain, *, order: int, with_previous: bool = False) -> tuple[JointModes, Array]:
    """Return the joint modes and their transition matrix (N, N): the two chains are independent.

    Where a chain says in which modes it begins, only the pairs count that come about from there: two cycles keep their phase.

    Args:
        sc, ca: the delay chains.
        order: number of states of the loop over them.
        with_previous: a mode keeps the C-A mode before, too.

    Raises:
        TooLarge: more than `MOST_MODES`, or more second moments than are computed: before the matrix is made.
    """
    pairs = sc.modes * (int(np.count_nonzero(ca.bounds[1] > 0)) if with_previous else ca.modes)
    if pairs > 100 * MOST_MODES:  # of chains that begin somewhere few pairs may be met, but all are looked at
        raise _too_many(pairs)
    if with_previous:
        triples = [(s, c, b) for s in range(sc.modes) for c in range(ca.modes) for b in range(ca.modes) if ca.bounds[1][b, c] > 0]
        modes = _met(triples, sc, ca)
    else:
        modes = _met([(s, c, -1) for s in range(sc.modes) for c in range(ca.modes)], sc, ca)
    if len(modes) > MOST_MODES:
        raise _too_many(len(modes))
    check_size(len(modes), order)
    return modes, _joint(modes, sc.matrix, ca.matrix)


def _met(modes: JointModes, sc: DelayChain, ca: DelayChain) -> JointModes:
    """The joint modes that are ever met."""
    if sc.begins is None and ca.begins is None:
        return modes
    every = [np.ones(chain.modes, dtype=np.bool_) if chain.begins is None else np.asarray(chain.begins) for chain in (sc, ca)]
    follows = [[np.flatnonzero(row) for row in chain.bounds[1] > 0.0] for chain in (sc, ca)]
    front = {(s, c) for s in np.flatnonzero(every[0]).tolist() for c in np.flatnonzero(every[1]).tolist()}
    met = set(front)
    while front:
        front = {(int(i), int(j)) for s, c in front for i in follows[0][s] for j in follows[1][c]} - met
        met |= front
    before = {c for _, c in met}
    return [mode for mode in modes if mode[:2] in met and (mode[2] < 0 or mode[2] in before)]


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


def _too_many(modes: int) -> TooLarge:
    return TooLarge(
        f"the network has {modes} joint modes, more than the {MOST_MODES} that are computed with: laws with fewer ages or modes "
        "are decided"
    )


def _joint(modes: JointModes, sc: Array, ca: Array) -> Array:
    """Products of the two chains' entries; a mode that keeps the C-A mode before follows only where that fits."""
    s, c, before = np.array(modes, dtype=np.int64).T
    if before[0] < 0 and len(modes) == len(sc) * len(ca):  # every pair: the same products, without two matrices that are picked
        return np.asarray(np.kron(sc, ca), dtype=np.float64)
    joint = np.asarray(sc[np.ix_(s, s)] * ca[np.ix_(c, c)], dtype=np.float64)
    return joint if before[0] < 0 else np.where(before[None, :] == c[:, None], joint, 0.0)


def default_initial(sc: DelayChain, ca: DelayChain, modes: JointModes) -> tuple[Array, Literal["uniform", "stationary"]]:
    """Return the distribution over the joint modes (S-C mode, C-A mode, C-A mode before or -1), (N,), and its name.

    A plain delay chain has one mode per delay, and the thesis takes them as equally likely. Where several modes have one
    delay (a semi-Markov law counts its slots) their number depends on where a tail is cut, and with it every norm that
    weighs them equally; there the stationary distribution is taken, which no cut moves.

    Args:
        sc, ca: the delay chains.
        modes: the joint modes.
    """
    if sc.is_plain and ca.is_plain:
        return np.full(len(modes), 1.0 / len(modes)), "uniform"
    s, c, before = np.array(modes, dtype=np.int64).T
    of_ca = ca.stationary[c] if before[0] < 0 else ca.stationary[before] * ca.matrix[before, c]
    weights = sc.stationary[s] * of_ca
    return np.asarray(weights / weights.sum(), dtype=np.float64), "stationary"


Array = npt.NDArray[np.float64]


def check_gains(gains: npt.ArrayLike, shape: tuple[int, int, int, int]) -> Array:
    """Return gains as an array of `shape` (sc labels, rows, m, p), or refuse them.

    Raises:
        ValueError: wrong shape or not finite; the message names the entry.
    """
    try:
        array = np.array(gains, dtype=np.float64)
    except (TypeError, ValueError):
        raise FieldError("gains", f"expected a regular nested list of shape {shape} [tau][row][m][p]") from None
    if array.shape != tuple(shape):
        raise FieldError("gains", f"shape {array.shape}, expected {tuple(shape)} [tau][row][m][p]")
    if not np.isfinite(array).all():
        raise FieldError(f"gains{np.argwhere(~np.isfinite(array))[0].tolist()}", "not finite")
    return array


def check_plant_shapes(A: npt.ArrayLike, B: npt.ArrayLike, C: npt.ArrayLike) -> tuple[Array, Array, Array]:
    """Return A (n, n), B (n, m), C (p, n) as arrays.

    Raises:
        ValueError: wrong shape or not finite; the message starts with the matrix's name.
    """
    arrays = []
    for name, value in (("A", A), ("B", B), ("C", C)):
        array = np.asarray(value, dtype=np.float64)
        if array.ndim != 2 or not np.isfinite(array).all():
            raise FieldError(name, f"expected a finite matrix, got shape {array.shape}")
        arrays.append(array)
    A_, B_, C_ = arrays
    n = A_.shape[0]
    if A_.shape != (n, n):
        raise FieldError("A", f"shape {A_.shape}, expected a square matrix")
    if B_.shape[0] != n:
        raise FieldError("B", f"{B_.shape[0]} rows, expected {n}")
    if C_.shape[1] != n:
        raise FieldError("C", f"{C_.shape[1]} columns, expected {n}")
    return A_, B_, C_


def packet_registers(selection: str, ca: DelayChain, start: int, m: int) -> dict[int, tuple[int, int]]:
    """Lay out shift registers of packet rows under way: (first state, length in samples) by the label that each serves.

    They begin at state `start`.

    The controller knows which row will be applied (`constant`, `generated`, `previous`): one register as long as the
    largest delay, at least one sample because z needs u1(k-1). The actuator chooses (`applied`, `both`): one register
    per label of the C-A delay, as long as that label's delay.
    """
    if selection not in ("applied", "both"):
        return {0: (start, max(ca.max_delay, 1))}
    found = {}
    for label, delay in enumerate(ca.label_delay.tolist()):
        if delay > 0:
            found[label] = (start, delay)
            start += delay * m
    return found or {0: (start, 1)}
