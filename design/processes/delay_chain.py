"""Network delays as a finite Markov chain, of one sensor node or of several: each mode with its delays and its label.

Gains are looked up by the label. Every mode of several nodes together says how old each output's newest sample is.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import prod

import numpy as np
import numpy.typing as npt
from msgspec import Struct
from msgspec.structs import force_setattr

from design.errors import FieldError

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.int64]

ROW_SUM_TOLERANCE = 1e-9


def check_transition(matrix: npt.ArrayLike, field: str) -> Array:
    """Return `matrix` as a row-stochastic array, or refuse it with the row that is wrong.

    Args:
        matrix: (N, N) transition probabilities, row = present mode.
        field: path by which an error names the matrix.

    Raises:
        ValueError: not square, not finite, a negative entry, or a row that does not sum to 1.

    >>> check_transition([[0.5, 0.48], [0, 1]], "Pi")
    Traceback (most recent call last):
    design.errors.FieldError: Pi[0]: row sums to 0.98, expected 1
    """
    try:
        array = np.array(matrix, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise FieldError(field, f"expected a square matrix of numbers ({error})") from None
    if array.ndim != 2 or array.shape[0] != array.shape[1] or array.shape[0] == 0:
        raise FieldError(field, f"shape {array.shape}, expected a square matrix")
    for row, entries in enumerate(array):
        if not np.isfinite(entries).all():
            raise FieldError(f"{field}[{row}]", "not finite")
        if (entries < 0).any():
            raise FieldError(f"{field}[{row}][{int(entries.argmin())}]", f"{entries.min():g} is negative")
        if abs(entries.sum() - 1.0) > ROW_SUM_TOLERANCE:
            raise FieldError(f"{field}[{row}]", f"row sums to {entries.sum():.10g}, expected 1")
    array.setflags(write=False)
    return array


class DelayChain(Struct, frozen=True, kw_only=True):
    """A Markov chain of modes, with the delay of each mode and the label that selects its gain.

    A plain chain (7.3)-(7.5) has ``delays = labels = 0..N-1``. A semi-Markov chain whose modes are augmented by
    their age has several modes of one delay; ``labels`` then says whether a gain may tell them apart.

    Args:
        transition: (N, N) row-stochastic matrix.
        delays: (N,) delay of each mode, in samples; default 0..N-1.
        labels: (N,) gain index of each mode; default: the delays. Modes of one label must have one delay.
        between: lower and upper bound, (N, N) each, of every transition probability, where a mode stands for many whose
            probabilities differ (a tail that is cut); default: the probabilities are exact.
        stays: (N,) of a mode that stands for a tail, the limit of the probability to stay one slot more as the stay grows
            long: the tail's hazard comes arbitrarily near to it, and never ends a stay for sure. Default: 0, nothing is known.
        held: (N,) whether the receiver has nothing but what it had in the slot before: on the way to the controller its sample,
            on the way to the actuator the input that it applied; (N, p) of every output where several nodes measure. The delay of
            such a mode says how long ago at least. Default: never. Over a chain that says so, one label may have several delays.
        ages: (N, p) age in samples of every output's newest sample in each mode, where several nodes measure, and the delay is
            the largest of them; default: all outputs are as old as the delay. See `design.processes.delay_chain`.
        begins: (N,) whether the chain may be in a mode in slot 0: of two chains that know it, only the pairs of modes count that
            come about together. Default: in any mode.

    Raises:
        FieldError: names the field at fault.

    >>> DelayChain(transition=[[0.5, 0.5], [0.7, 0.3]]).stationary.round(4).tolist()
    [0.5833, 0.4167]
    """

    transition: npt.ArrayLike
    delays: npt.ArrayLike | None = None
    labels: npt.ArrayLike | None = None
    between: tuple[npt.ArrayLike, npt.ArrayLike] | None = None
    ages: npt.ArrayLike | None = None
    held: npt.ArrayLike | None = None
    stays: npt.ArrayLike | None = None
    begins: npt.ArrayLike | None = None

    def __post_init__(self) -> None:
        matrix = check_transition(self.transition, "transition")
        modes = matrix.shape[0]
        force_setattr(self, "transition", matrix)
        delays = np.arange(modes) if self.delays is None else np.asarray(self.delays)
        labels = delays if self.labels is None else np.asarray(self.labels)
        for name, values in (("delays", delays), ("labels", labels)):
            if values.shape != (modes,) or not np.issubdtype(values.dtype, np.integer) or (values < 0).any():
                raise FieldError(name, f"expected {modes} integers >= 0, got {values.tolist()}")
        for label in sorted(set(labels.tolist())):  # np.unique would bring numpy.ma into every run
            if self.held is None and len(set(delays[labels == label].tolist())) > 1:
                raise FieldError(f"labels[{label}]", "modes of one label must have one delay")
        if self.between is not None:
            low, high = (np.array(bound, dtype=np.float64) for bound in self.between)
            if low.shape != matrix.shape or high.shape != matrix.shape:
                raise FieldError("between", f"shapes {low.shape} and {high.shape}, expected {matrix.shape}")
            if not ((low >= 0.0) & (low <= matrix) & (matrix <= high) & (high <= 1.0)).all():
                raise FieldError("between", "expected 0 <= lower <= transition <= upper <= 1 in every entry")
            force_setattr(self, "between", (low, high))
        if self.stays is not None:
            stays = np.asarray(self.stays, dtype=np.float64)
            if stays.shape != (modes,) or not ((stays >= 0.0) & (stays <= self.bounds[1].diagonal())).all():
                raise FieldError("stays", f"expected {modes} probabilities, none above the upper bound of staying")
            force_setattr(self, "stays", stays)
        if self.ages is not None:
            ages = np.asarray(self.ages)
            if ages.ndim != 2 or len(ages) != modes or not np.issubdtype(ages.dtype, np.integer) or not ages.size:
                raise FieldError("ages", f"shape {ages.shape}, expected integers for {modes} modes and every output")
            if (ages < 0).any() or not np.array_equal(ages.max(axis=1), delays):
                raise FieldError("ages", "expected ages >= 0, the largest of every mode its delay")
            force_setattr(self, "ages", ages.astype(np.int64))
        if self.held is not None:
            held = np.asarray(self.held)
            shapes = ((modes,),) if self.ages is None else ((modes,), np.shape(self.ages))
            if held.shape not in shapes or held.dtype != np.bool_:
                raise FieldError("held", f"expected {modes} flags, or as many rows with one for every output that has an age")
            force_setattr(self, "held", held)
        if self.begins is not None:
            begins = np.asarray(self.begins)
            if begins.shape != (modes,) or begins.dtype != np.bool_ or not begins.any():
                raise FieldError("begins", f"expected {modes} flags, one of them set")
            force_setattr(self, "begins", begins)
        force_setattr(self, "delays", delays.astype(np.int64))
        force_setattr(self, "labels", labels.astype(np.int64))

    @property
    def matrix(self) -> Array:
        """The (N, N) transition matrix."""
        return np.asarray(self.transition)

    @property
    def delay(self) -> Index:
        """(N,) delay of each mode in samples."""
        return np.asarray(self.delays)

    @property
    def label(self) -> Index:
        """(N,) gain index of each mode."""
        return np.asarray(self.labels)

    @property
    def modes(self) -> int:
        """Number of modes."""
        return int(self.matrix.shape[0])

    @property
    def holds(self) -> npt.NDArray[np.bool_]:
        """(N,) whether the receiver holds what it had before, of some output at least; see `held`."""
        if self.held is None:
            return np.zeros(self.modes, dtype=np.bool_)
        return np.asarray(np.asarray(self.held).reshape(self.modes, -1).any(axis=1))

    def held_outputs(self, outputs: int) -> npt.NDArray[np.bool_]:
        """(N, outputs) whether the receiver holds its sample of an output, see `held`."""
        own = self.holds if self.held is None else np.asarray(self.held)
        return np.array(np.broadcast_to(own.reshape(self.modes, -1), (self.modes, outputs)))

    @property
    def long_stays(self) -> Array:
        """(N, N) transition probabilities of stays that have lasted long, as far as their limit is known, see `stays`."""
        return np.zeros_like(self.matrix) if self.stays is None else np.diag(np.asarray(self.stays))

    @property
    def max_delay(self) -> int:
        """Largest delay in samples."""
        return int(self.delay.max())

    def output_ages(self, outputs: int) -> Index:
        """(N, outputs) age in samples of every output's newest sample in each mode.

        Raises:
            FieldError: the chain is of another number of outputs.
        """
        if self.ages is None:
            return np.repeat(self.delay[:, None], outputs, axis=1)
        ages = np.asarray(self.ages)
        if ages.shape[1] != outputs:
            raise FieldError("ages", f"{ages.shape[1]} outputs, but the plant has {outputs}")
        return ages

    @property
    def label_delay(self) -> Index:
        """(L,) smallest delay of each label, -1 for a label that no mode carries."""
        delays = np.full(int(self.label.max()) + 1, -1, dtype=np.int64)
        order = np.argsort(-self.delay, kind="stable")
        delays[self.label[order]] = self.delay[order]
        return delays

    @property
    def sojourns(self) -> tuple[int, ...]:
        """How many labels every delay 0, 1, ... has: one each, where the delays are the labels."""
        if self.held is not None:
            return (1,) * (int(self.label.max()) + 1)
        if np.array_equal(self.label, self.delay):
            return (1,) * (self.max_delay + 1)
        carried = self.label_delay
        return tuple(np.bincount(carried[carried >= 0]).tolist())

    @property
    def is_plain(self) -> bool:
        """Whether every mode has a delay of its own, or ages of its own."""
        if self.held is not None:
            return False
        if self.ages is not None:
            return len(set(map(tuple, np.asarray(self.ages).tolist()))) == self.modes
        return len(set(self.delay.tolist())) == self.modes

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Entrywise lower and upper bound, (N, N) each; both are the transition matrix where it is exact."""
        low, high = (self.transition, self.transition) if self.between is None else self.between
        return np.asarray(low), np.asarray(high)

    @property
    def open(self) -> bool:
        """Whether it says which modes may follow a mode, and not how likely: every bound is 0 or 1, and several follow one."""
        low, high = self.bounds
        return self.between is not None and bool(np.isin(low, (0.0, 1.0)).all() and np.isin(high, (0.0, 1.0)).all())

    @property
    def stationary(self) -> Array:
        """(N,) stationary distribution (of the recurrent part; the chain should have one recurrent class)."""
        system = np.vstack([self.matrix.T - np.eye(self.modes), np.ones(self.modes)])
        solution: Array = np.linalg.lstsq(system, np.append(np.zeros(self.modes), 1.0), rcond=None)[0]
        return np.maximum(solution, 0.0)


def as_chain(chain: DelayChain | npt.ArrayLike, field: str) -> DelayChain:
    """Return `chain`, or the plain Markov chain of a transition matrix; errors name `field`."""
    if isinstance(chain, DelayChain):
        return chain
    return DelayChain(transition=check_transition(chain, field))


MOST_MODES = 1024


def product_chain(chains: Sequence[DelayChain], outputs: Sequence[Sequence[int]], label_counts: Sequence[int] = ()) -> DelayChain:
    r"""Return the chain of (tau_1, ..., tau_q), the ages of the newest samples of q nodes with independent networks.

    .. math:: \Lambda = \Lambda_1 \otimes \cdots \otimes \Lambda_q

    Args:
        chains: the delay chain of each node.
        outputs: per node the indices of the outputs that it measures; together every output once.
        label_counts: how many ages 0, 1, ... of each node have gains of their own, the last fastest; an older sample has those
            of the last. By default gains know the oldest of the ages only. A product of one chain is that chain.

    Raises:
        FieldError: outputs or counts that do not fit, or more than `MOST_MODES` modes.

    >>> step = DelayChain(transition=[[0.5, 0.5], [1.0, 0.0]])
    >>> both = product_chain([step, step], [[0], [1]], label_counts=(2, 2))
    >>> both.ages.tolist(), both.label.tolist(), both.delay.tolist()
    ([[0, 0], [0, 1], [1, 0], [1, 1]], [0, 1, 2, 3], [0, 1, 1, 1])
    """
    every = [output for own in outputs for output in own]
    if len(outputs) != len(chains) or sorted(every) != list(range(len(every))) or not every:
        raise FieldError("outputs", f"{[list(own) for own in outputs]}, expected every output once, on {len(chains)} nodes")
    if len(chains) == 1 and not label_counts:
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
    if label_counts:
        if len(label_counts) != len(chains):
            raise FieldError("label_counts", f"{len(label_counts)} numbers for {len(chains)} nodes")
        label = labels_of(own, label_counts)
    exact = all(chain.between is None for chain in chains)
    low, high = ([chain.bounds[side] for chain in chains] for side in (0, 1))
    held = None
    shared = bool(label_counts) and any(chain.max_delay >= count for chain, count in zip(chains, label_counts))
    if shared or any(chain.held is not None for chain in chains):  # then one label may have several delays
        held = np.zeros(ages.shape, dtype=np.bool_)
        for measured, chain, at in zip(outputs, chains, mode_of):
            held[:, list(measured)] = chain.holds[at][:, None]
        label = np.array([chain.label[at] for chain, at in zip(chains, mode_of)]).max(axis=0) if label is None else label
    return DelayChain(
        transition=kron_of([chain.matrix for chain in chains]), delays=own.max(axis=0), labels=label,
        between=None if exact else (kron_of(low), kron_of(high)), ages=ages, held=held,
    )  # fmt: skip


def labels_of(ages: Index, counts: int | Sequence[int]) -> Index:
    """Return the label (modes,) of each mode of several nodes.

    Args:
        ages: (nodes, modes) age of every node's newest sample.
        counts: how many ages 0, 1, ... have labels of their own, of the oldest sample or of every node's, the last fastest; an
            older sample has the last.

    >>> labels_of(np.array([[0, 1, 1], [0, 0, 3]]), (2, 2)).tolist()
    [0, 2, 3]
    """
    if isinstance(counts, int):
        return np.asarray(np.minimum(ages.max(axis=0), counts - 1))
    return np.asarray(np.ravel_multi_index(tuple(np.minimum(ages, np.array(counts)[:, None] - 1)), tuple(counts)))


def kron_of(factors: Sequence[Array]) -> Array:
    """Return the Kronecker product of vectors or matrices, the first one's index slowest."""
    product = factors[0]
    for factor in factors[1:]:
        product = np.asarray(np.kron(product, factor), dtype=np.float64)
    return product
