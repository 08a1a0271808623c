"""Semi-Markov network delays as Markov chains on (mode, age), for the same designs as plain chains (Section 8.2.1).

A semi-Markov chain stays in mode i for h >= 1 samples, Pr{h} = f_i(h), and then goes to mode j with probability r_ij
(r_ii = 0). With the age a, the samples spent in the mode so far, it is a Markov chain:

    (i, a) -> (i, a + 1)  with 1 - q_i(a),      (i, a) -> (j, 1)  with q_i(a) r_ij,      q_i(a) = f_i(a) / Pr{h >= a}

The controller measures the delay and can count its age, so a gain may depend on both (`by_age`), or on the delay only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from design.delay_chain import Array, DelayChain, Index, check_transition

TAIL = 1e-12


@dataclass(frozen=True, slots=True, kw_only=True)
class SemiMarkovDelays:
    """A semi-Markov delay process.

    Args:
        embedded: (N, N) row-stochastic with zero diagonal: which mode follows.
        sojourns: per mode f_i(1), f_i(2), ..., probabilities of lasting 1, 2, .. samples. A sum below 1 means a
            geometric tail: from the last entry on, the hazard stays what it was there.
        delays: (N,) delay of each mode in samples; default 0..N-1.

    Raises:
        ValueError: message starts with the field at fault.
    """

    embedded: npt.ArrayLike
    sojourns: Sequence[npt.ArrayLike]
    delays: npt.ArrayLike | None = None

    def __post_init__(self) -> None:
        matrix = check_transition(self.embedded, "embedded")
        N = matrix.shape[0]
        if np.diagonal(matrix).any():
            i = int(np.argmax(np.diagonal(matrix)))
            raise ValueError(f"embedded[{i}][{i}]: {matrix[i, i]:g}, expected 0 (the sojourn says how long)")
        if len(self.sojourns) != N:
            raise ValueError(f"sojourns: {len(self.sojourns)} laws, expected one per mode, {N}")
        laws = []
        for i, law in enumerate(self.sojourns):
            f = np.atleast_1d(np.asarray(law, dtype=np.float64))
            if f.ndim != 1 or not np.isfinite(f).all() or (f < 0).any() or f.sum() > 1.0 + 1e-9 or f.sum() <= 0.0:
                raise ValueError(f"sojourns[{i}]: expected probabilities of 1, 2, .. samples with a sum in (0, 1]")
            laws.append(f)
        delays = np.arange(N) if self.delays is None else np.asarray(self.delays)
        if delays.shape != (N,) or not np.issubdtype(delays.dtype, np.integer) or (delays < 0).any():
            raise ValueError(f"delays: expected {N} integers >= 0, got {delays.tolist()}")
        object.__setattr__(self, "embedded", matrix)
        object.__setattr__(self, "sojourns", tuple(laws))
        object.__setattr__(self, "delays", delays.astype(np.int64))

    @property
    def hazards(self) -> list[Array]:
        """Per mode q_i(1), q_i(2), .., up to the age from which the hazard is constant or 1."""
        found = []
        for law in self.sojourns:
            f = np.asarray(law)
            survivor = 1.0 - np.concatenate([[0.0], np.cumsum(f)[:-1]])
            keep = survivor > TAIL
            q = np.clip(f[keep] / survivor[keep], 0.0, 1.0)
            if f.sum() >= 1.0 - TAIL:
                q[-1] = 1.0
            found.append(np.asarray(q))
        return found

    def states(self) -> tuple[Index, Index]:
        """Mode and age (from 1) of every state of the augmented chain."""
        lengths = [q.size for q in self.hazards]
        mode = np.repeat(np.arange(len(lengths)), lengths)
        age = np.concatenate([np.arange(1, n + 1) for n in lengths])
        return mode.astype(np.int64), age.astype(np.int64)

    def chain(self, *, by_age: bool = True, ages: int | None = None) -> DelayChain:
        """The augmented Markov chain.

        Args:
            by_age: gains may depend on mode and age; else on the delay only.
            ages: tell apart only this many ages of a mode, older ones share a gain; default all.
        """
        mode, age = self.states()
        first = np.flatnonzero(age == 1)
        N = mode.size
        matrix = np.zeros((N, N))
        embedded = np.asarray(self.embedded)
        for s, (i, a) in enumerate(zip(mode, age, strict=True)):
            q = self.hazards[i][a - 1]
            stays = s + 1 if s + 1 < N and mode[s + 1] == i else s
            matrix[s, stays] += 1.0 - q
            matrix[s, first] += q * embedded[i]
        delays = np.asarray(self.delays)[mode]
        if not by_age:
            return DelayChain(transition=matrix, delays=delays)
        kept = age if ages is None else np.minimum(age, ages)
        labels = np.unique(np.stack([mode, kept]), axis=1, return_inverse=True)[1].reshape(-1)
        return DelayChain(transition=matrix, delays=delays, labels=labels)

    def fitted(self) -> DelayChain:
        """The plain Markov chain on the delays with the same stationary one-step frequencies: what a fit would find."""
        full = self.chain(by_age=False)
        weight = full.stationary
        values = np.unique(full.delay)
        if not np.array_equal(values, np.arange(values.size)):
            raise ValueError(f"delays: {values.tolist()}, a fit needs 0..{values.size - 1}")
        member = full.delay[:, None] == values[None, :]
        flow = member.T @ (weight[:, None] * full.matrix) @ member
        return DelayChain(transition=flow / flow.sum(axis=1, keepdims=True))


def discrete_weibull(scale: float, shape: float, longest: int = 200) -> Array:
    """f(h) = exp(-((h-1)/scale)^shape) - exp(-(h/scale)^shape), h = 1, 2, ..; shape 1 is geometric.

    >>> discrete_weibull(2.0, 3.0).round(4)[:3].tolist()
    [0.1175, 0.5146, 0.3337]
    """
    edges = np.exp(-((np.arange(longest + 1) / scale) ** shape))
    law = edges[:-1] - edges[1:]
    return np.asarray(law[: int(np.flatnonzero(edges[:-1] > TAIL)[-1]) + 1])
