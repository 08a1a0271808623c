"""Chapter 7: synthesis of tracking gains for a loop over two delay chains.

Here is what a design is asked for: plant, network, objective; and what its gains may depend on, and how large they may be.

Information pattern        selection    free gains
constant                   constant     one for all
tau                        constant     one per tau
previous, generated,       the same     one per (tau, row)
applied, both
total                      applied      one per total age tau + d

A bound G on every entry is kept by K = G sin(v): smooth, and the bound can be reached.
"""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt
from msgspec import Struct, structs

from design.controllers.gain_rows import steady_state
from design.errors import FieldError, check_above_zero
from design.networked_loop.affine_loop import LoopStructure
from design.networked_loop.closed_loop import loop_structure
from design.processes.delay_chain import Array, DelayChain, Index, as_chain

Information = Literal["constant", "tau", "previous", "generated", "applied", "both", "total"]
INFORMATION: tuple[str, ...] = get_args(Information)


def selection_of(information: str) -> str:
    """Row rule by which the loop runs gains of an information pattern.

    Raises:
        ValueError: unknown pattern.
    """
    if information not in INFORMATION:
        raise FieldError("information", f"{information!r}, expected one of {', '.join(INFORMATION)}")
    return {"tau": "constant", "total": "applied"}.get(information, information)


COARSER: dict[str, str] = {
    "tau": "constant", "total": "constant", "previous": "tau", "generated": "tau", "applied": "tau", "both": "applied",
}  # fmt: skip
"""For each pattern one whose gains are a special case of its own: its optimum is a start that cannot lose."""


def embed(gains: Array, finer_rows: int) -> Array:
    """Gains of a coarser pattern (see `COARSER`) in the shape of the finer one, the loop being the same."""
    return np.asarray(np.tile(gains, (1, finer_rows // gains.shape[1], 1, 1)))


def state_gains_of(gains: Array, order: int) -> tuple[Array, Array]:
    """Return the rows of a packet, (labels, rows, m, p + c), and the gains of the controller's own state, (labels, c, p + c).

    Args:
        gains: as a `TrackingProblem` of that order has them.
        order: c.
    """
    rows = gains.shape[1] - -(-order // gains.shape[2])
    return gains[:, :rows], gains[:, rows:].reshape(len(gains), -1, gains.shape[3])[:, :order]


class GainParametrisation(Struct, frozen=True):
    """Coordinates v of the gains K: equal gains share coordinates, gains without effect are zero.

    Fields: `shape` of K, (sc labels, rows, m, py); `block` (sc labels, rows), index of the free gain, -1 where a
    gain has no effect; `bound` on every |entry| of K, or None.
    """

    shape: tuple[int, int, int, int]
    block: Index
    bound: float | None

    @property
    def size(self) -> int:
        """Number of coordinates."""
        return (int(self.block.max()) + 1) * self.shape[2] * self.shape[3]

    def gains(self, v: Array) -> Array:
        """K of coordinates v."""
        free = v.reshape(-1, *self.shape[2:])
        if self.bound is not None:
            free = self.bound * np.sin(free)
        gains = free[self.block]
        gains[self.block < 0] = 0.0
        return np.asarray(gains)

    def gradient(self, v: Array, gradient: Array) -> Array:
        """Derivative with respect to v from the one with respect to K."""
        total = np.zeros((int(self.block.max()) + 1, *self.shape[2:]))
        used = self.block >= 0
        np.add.at(total, self.block[used], gradient[used])
        flat = total.ravel()
        return flat if self.bound is None else flat * self.bound * np.cos(v)

    def curvature(self, v: Array, curvature: Array) -> Array:
        """Second derivative with respect to v from the one with respect to the free gains, where K bends less than the norm."""
        if self.bound is None:
            return curvature
        slope = self.bound * np.cos(v)
        return np.asarray(slope[:, None] * curvature * slope)

    def coordinates(self, gains: npt.ArrayLike) -> Array:
        """Coordinates of the nearest K in the space (means of gains that must be equal, clipped to the bound)."""
        K = np.asarray(gains, dtype=np.float64)
        blocks = int(self.block.max()) + 1
        mean = np.stack([K[self.block == b].mean(axis=0) for b in range(blocks)])
        if self.bound is not None:
            mean = np.arcsin(np.clip(mean / self.bound, -0.99, 0.99))
        return np.asarray(mean.ravel())


def gain_parametrisation(
    structure: LoopStructure, information: str, sc: DelayChain, ca: DelayChain, bound: float | None = None
) -> GainParametrisation:
    """The free gains of an information pattern on a loop structure made with `selection_of(information)`.

    Raises:
        ValueError: unknown pattern, or a bound that is not positive.
    """
    check_above_zero(gain_bound=bound)
    used = structure.used
    key, rows = np.arange(used.size).reshape(used.shape), structure.packet_rows
    if information == "constant":
        key = np.tile(np.arange(used.shape[1]), (len(used), 1))
    elif information == "total":
        key[:, :rows] = -1 - (sc.label_delay[:, None] + ca.label_delay[None, :])
    block = np.full(used.shape, -1, dtype=np.int64)
    block[used] = np.unique(key[used], return_inverse=True)[1]
    return GainParametrisation(structure.gain_shape, block, bound)


Objective = Literal["h2", "hinf", "mixed"]
Method = Literal["direct", "ccl"]
OBJECTIVES: tuple[str, ...] = get_args(Objective)
METHODS: tuple[str, ...] = get_args(Method)
DEFAULT_STARTS = {"h2": 2, "hinf": 4, "mixed": 2}
MOST_STARTS = 10_000
MOST_STATES = 16
KINDS: dict[str, type] = dict.fromkeys(("starts", "seed", "samples", "order"), Integral)
KINDS |= dict.fromkeys(("integral", "reference_weight", "gain_bound"), Real)


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackingProblem:
    """A static output feedback design over a network, (7.26), (7.31) or (7.33).

    It is validated once.

    Args:
        A, B, C: (n, n), (n, m), (p, n) discrete plant (7.1).
        sc, ca: S-C and C-A delay chains, or Lambda and Pi.
        objective: "h2", "hinf", or "mixed": smallest H2 norm with the H-infinity norm at most `hinf_bound`.
        information: what the gain may depend on, see `design.tracking`.
        Q, R: weights of z; defaults C and the row 0.01 .. 0.01.
        output: "stacked" or "sum".
        hinf_bound: bound of a mixed design; default 1.05 times the smallest H-infinity norm.
        gain_bound: bound on every |entry| of every gain; default none.
        samples: samples per sensor packet, 1 or 2.
        integral: weight of the integrated error in z, 0 for no integral.
        order: states of the controller's own; 0 for static gains. The last rows of the gains make them, see
            `design.networked_loop.closed_loop.loop_structure` and `state_gains_of`.
        reference_weight: size of a step of the reference, in every output, that is weighed in the norm beside an impulse at every
            input; 0 for none.
        initial: (modes,) distribution of the mode at the H2 impulse; default: uniform over plain chains, else stationary.
        seed, starts: of the multistart; `starts` 0 takes the objective's default.
        method: "direct", or "ccl" for the thesis's iterated linear matrix inequalities.

    Raises:
        FieldError: names the field at fault.
    """

    A: npt.ArrayLike
    B: npt.ArrayLike
    C: npt.ArrayLike
    sc: DelayChain | npt.ArrayLike
    ca: DelayChain | npt.ArrayLike
    objective: Objective | str = "h2"
    information: Information | str = "applied"
    Q: npt.ArrayLike | None = None
    R: npt.ArrayLike | None = None
    output: Literal["stacked", "sum"] = "stacked"
    hinf_bound: float | None = None
    gain_bound: float | None = None
    samples: int = 1
    integral: float = 0.0
    order: int = 0
    reference_weight: float = 0.0
    initial: npt.ArrayLike | None = None
    seed: int = 0
    starts: int = 0
    method: Method | str = "direct"

    def __post_init__(self) -> None:
        if self.objective not in OBJECTIVES:
            raise FieldError("objective", f"{self.objective!r}, expected one of {', '.join(OBJECTIVES)}")
        if self.method not in METHODS:
            raise FieldError("method", f"{self.method!r}, expected one of {', '.join(METHODS)}")
        if self.hinf_bound is not None and self.objective != "mixed":
            raise FieldError("hinf_bound", f"only a mixed design takes one, objective is {self.objective!r}")
        check_above_zero(hinf_bound=self.hinf_bound)
        for field, kind in KINDS.items():
            value = getattr(self, field)
            if not isinstance(value, kind) and not (value is None and field.endswith("_bound")):
                raise FieldError(field, f"{value!r:.40}, expected a {'whole ' * (kind is Integral)}number")
        for field in ("Q", "R", "initial"):
            try:
                np.asarray(getattr(self, field), dtype=np.float64)
            except (TypeError, ValueError):
                raise FieldError(field, f"{getattr(self, field)!r:.40}, expected numbers") from None
        if not 0 <= self.starts <= MOST_STARTS:
            raise FieldError("starts", f"{self.starts}, expected a number from 0 to {MOST_STARTS}")
        if not 0 <= self.reference_weight < math.inf:
            raise FieldError("reference_weight", f"{self.reference_weight:g}, expected a finite number >= 0")
        for field in ("order", "reference_weight"):
            if self.method == "ccl" and getattr(self, field):
                raise FieldError(field, "the thesis's iterated linear matrix inequalities have none, expected 0")
        if not 0 <= self.order <= MOST_STATES:
            raise FieldError("order", f"{self.order}, expected a number from 0 to {MOST_STATES}")
        if self.seed < 0:
            raise FieldError("seed", "expected a number >= 0")
        object.__setattr__(self, "sc", as_chain(self.sc, "Lambda"))
        object.__setattr__(self, "ca", as_chain(self.ca, "Pi"))
        space = self.space()  # refuses every shape that does not fit
        if self.initial is not None:
            self.structure().system(space.gains(np.zeros(space.size))).alpha(self.initial)

    @property
    def chains(self) -> tuple[DelayChain, DelayChain]:
        """The two delay chains."""
        return as_chain(self.sc, "Lambda"), as_chain(self.ca, "Pi")

    @property
    def selection(self) -> str:
        """Row rule by which the gains run."""
        return selection_of(self.information)

    def structure(self) -> LoopStructure:
        """The closed loop without its gains."""
        sc, ca = self.chains
        found = loop_structure(
            self.A, self.B, self.C, sc, ca, self.selection,
            Q=self.Q, R=self.R, output=self.output, samples=self.samples, integral=self.integral,
            order=self.order,
        )  # fmt: skip
        if not self.reference_weight:
            return found
        stepped = found.standing(np.asarray(self.C, dtype=np.float64)) @ steady_state(self.A, self.B, self.C).state
        drive = np.broadcast_to(self.reference_weight * stepped, (*found.B.shape[:2], stepped.shape[1]))
        return structs.replace(found, B=np.concatenate([found.B, drive], axis=2))

    def space(self) -> GainParametrisation:
        """The free gains."""
        return gain_parametrisation(self.structure(), self.information, *self.chains, bound=self.gain_bound)

    def alpha(self, structure: LoopStructure) -> Array:
        """Distribution of the mode at the impulse of the H2 norm, (modes,)."""
        return structure.default_initial if self.initial is None else np.asarray(self.initial, dtype=np.float64)

    def to_json(self) -> dict[str, object]:
        """Every number that decides the result, as plain data."""
        sc, ca = self.chains
        plain: dict[str, object] = {
            name: np.asarray(value, dtype=np.float64).tolist() if value is not None else None
            for name, value in (
                ("A", self.A), ("B", self.B), ("C", self.C), ("Q", self.Q), ("R", self.R), ("initial", self.initial),
            )
        }  # fmt: skip
        for name, chain in (("sc", sc), ("ca", ca)):
            plain[name] = {
                "transition": chain.matrix.tolist(), "delays": chain.delay.tolist(), "labels": chain.label.tolist(),
                **({} if chain.between is None else {"between": [bound.tolist() for bound in chain.bounds]}),
                **({} if chain.ages is None else {"ages": np.asarray(chain.ages).tolist()}),
                **({} if chain.held is None else {"held": chain.holds.tolist()}),
            }  # fmt: skip
        for name in (
            "objective", "information", "output", "hinf_bound", "gain_bound", "samples", "integral", "seed", "starts",
            "method",
        ):  # fmt: skip
            plain[name] = getattr(self, name)
        return plain | {name: value for name in ("order", "reference_weight") if (value := getattr(self, name))}

    def digest(self) -> str:
        """SHA-256 of the problem, equal for equal problems on any machine."""
        return hashlib.sha256(json.dumps(self.to_json(), sort_keys=True).encode()).hexdigest()


def row_sojourns_of(chain: DelayChain) -> int:
    """Return how many lengths of stay at every delay the labels of a chain distinguish; 1: the labels are the delays.

    Of S lengths of stay, d after h slots has the label and the row d S + min(h, S) - 1. A design has gains for the labels that
    its chain carries; a packet has a row for each of them, and for those between, of stays that never last so long.

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
