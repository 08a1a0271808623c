r"""What runs inside a loop: controllers that answer one sensor packet with one *send-all* packet.

Importing this module imports numpy and nothing heavier, because a process that keeps time imports it.

A controller plug-in is a frozen dataclass of parameters with ``start(model)``; what it returns answers, once a slot,

.. math:: (k, \tau_k, y(k-\tau_k), \bar r) \mapsto u(k, \tau_k, \cdot), \qquad \text{one row of } m \text{ values per row index}

and says by ``selection`` how the actuator picks the row that it applies (thesis, Section 7.2, (7.9)-(7.13)):

========== ============================== =================================================
selection  row applied in slot k          where the packet was generated in slot g = k - d_k
========== ============================== =================================================
constant   0                              no information about d
generated  d_g                            the printed rule (7.13)
applied    d_k                            what the actuator knows when it applies
previous   d_{g-1}                        Zhang and Shi [53]
both       d_g (d_max + 1) + d_k          all of it
========== ============================== =================================================

With S `row_sojourns`, ``applied`` is row d_k S + min(h_k, S) - 1, where h_k is for how many slots the actuator has measured d_k.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from design.controllers.sensor_nodes import SensorNodes, Uses, one_node
from design.errors import FieldError

if TYPE_CHECKING:
    from design.controllers.scheduled_gain import ScheduledGain

Selection = Literal["constant", "generated", "applied", "previous", "both"]
Rows = tuple[tuple[float, ...], ...]
Gains = tuple[tuple[tuple[tuple[float, ...], ...], ...], ...]  # [tau][row][m][p]
StateGains = tuple[tuple[tuple[float, ...], ...], ...]  # [tau][c][p + c]


def row_count(selection: Selection | str, d_max: int, row_sojourns: int = 1) -> int:
    """Return how many rows a send-all packet carries.

    Args:
        selection: how the actuator picks one.
        d_max: largest delay.
        row_sojourns: ``applied``: lengths of stay at d that have a row each.

    >>> [row_count(s, 1) for s in ("constant", "generated", "applied", "previous", "both")]
    [1, 2, 2, 2, 4]
    >>> row_count("applied", 1, 3)
    6
    """
    return {"constant": 1, "both": (d_max + 1) ** 2, "applied": (d_max + 1) * row_sojourns}.get(selection, d_max + 1)


class LoopModel(Struct, frozen=True, kw_only=True):
    """What a controller may know of its loop.

    Args:
        A, B, C: shapes (n, n), (n, m), (p, n). Nominal plant, zero-order hold at ``period_s``.
        period_s: sample period T, s.
        tau_max, d_max: largest sensor-to-controller and controller-to-actuator delays, samples.
        sensors: the sensor nodes, None where one measures every output and sends in every slot; read them as ``nodes``.
    """

    A: NDArray[np.float64]
    B: NDArray[np.float64]
    C: NDArray[np.float64]
    period_s: float
    tau_max: int
    d_max: int
    sensors: SensorNodes | None = None

    @property
    def nodes(self) -> SensorNodes:
        """The sensor nodes, by number: one or more."""
        return one_node(self.C.shape[0]) if self.sensors is None else self.sensors


class RunningController(Protocol):
    """A controller in the loop; called once a slot, in order."""

    selection: Selection

    def rows(self, k: int, tau: int, y: Sequence[float], r: Sequence[float]) -> Rows:
        """Return one row of m inputs per row index, for the sample y(k - tau) and the reference r.

        Where the parameters say ``samples = 2``, y holds y(k - tau), then y(k - tau - 1).
        """


class Sample(NamedTuple):
    """What one node measured in one slot.

    Attributes:
        node: number of the node, from 0.
        slot: slot of the measurement.
        values: one entry per output of the node, in the outputs' units.
    """

    node: int
    slot: int
    values: tuple[float, ...]


class Known(NamedTuple):
    """What a controller knows in a slot.

    Attributes:
        samples: what has arrived, newest first: of each node every sample that is at most `memory` slots old, and its newest one.
        reference: one entry per output.
    """

    samples: tuple[Sample, ...]
    reference: tuple[float, ...]


class KnownInBatch(NamedTuple):
    """What a controller knows in a slot of many runs.

    Args:
        started: whether a sample of every node has come, (runs,); once it has, a run stays started.
        ages: of the newest sample of every node, samples, (nodes, runs).
        y: what the newest packets hold, (width, runs).
        reference: of the slot, (p,).
        fresh: whether the sample of slot k - j of a node has come, (memory + 1, nodes, runs); empty without a memory.
        held: newest sample of every output from slot k - j or before that has come, 0 without one, (memory + 1, p, runs).
    """

    started: NDArray[np.bool_]
    ages: NDArray[np.intp]
    y: NDArray[np.float64]
    reference: Sequence[float]
    fresh: NDArray[np.bool_] = np.empty((0, 0, 0), dtype=np.bool_)
    held: NDArray[np.float64] = np.empty((0, 0, 0))


@runtime_checkable
class MultiSampleController(Protocol):
    """A running controller that knows which node measured what and when; any number of nodes serves it."""

    selection: Selection
    memory: int
    """Age in slots of the oldest sample that it uses."""

    def rows(self, k: int, known: Known) -> Rows:
        """Return one row of m inputs per row index; called once a slot, in order, once a sample is known."""


@runtime_checkable
class Controller(Protocol):
    """Parameters of a controller: a frozen dataclass that an experiment's ``[controller]`` table fills."""

    def start(self, model: LoopModel) -> RunningController | MultiSampleController:
        """Return the controller, ready for slot 0.

        Raises:
            FieldError: parameters that do not fit the loop.
        """


@runtime_checkable
class GainTable(Protocol):
    """A controller that is a table of gains; over delay chains its loop can be certified, predicted and designed for."""

    selection: Selection

    def start(self, model: LoopModel) -> RunningController | MultiSampleController: ...

    def table(self, model: LoopModel) -> NDArray[np.float64]:
        """Return K[tau, row, m, p]."""


@runtime_checkable
class ModeSchedule(Protocol):
    """A state feedback that is scheduled by the measured mode and its sojourn time; over a jump plant it can be certified."""

    def start(self, model: LoopModel) -> RunningController: ...

    def schedule_of_modes(self) -> ScheduledGain:
        """Return K(mode, h); the controller counts h from the sample that showed the mode first."""


@runtime_checkable
class StatesConstraint(Protocol):
    """A state feedback that is to meet a stochastic integral quadratic constraint (4.6); its certificate says whether it does."""

    def constraint_of_modes(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]] | None:
        """Return Gamma_11 (p, p), Gamma_12 (p, q) and Gamma_22 (q, q); None without one."""


@runtime_checkable
class HistoryGains(Protocol):
    """Gains over what scheduled nodes have sent: u(k) = sum_j K[i, j] y(k - j); certified where the state is measured."""

    uses: Uses

    def start(self, model: LoopModel) -> MultiSampleController | RunningController: ...

    def history(self) -> NDArray[np.float64]:
        """Return K[phase, j, m, p]; a phase is a turn of the cycle, or the node whose packet has just come."""


class AttributeProtocol(type(Protocol)):  # type: ignore[misc]
    """Looks for what a protocol of attributes alone names, as isinstance does, in a twentieth of the time of Python 3.11."""

    def __instancecheck__(cls, instance: object) -> bool:
        if cls.__bases__ != (Protocol,):  # a class or a protocol that is made of one
            return bool(super().__instancecheck__(instance))
        return all(hasattr(instance, name) for name in cls.__annotations__)


@runtime_checkable
class SeveralSamples(Protocol, metaclass=AttributeProtocol):
    """A controller that is sent more than the newest sample."""

    samples: int
    """Samples in one sensor packet: the newest, and so many less one before it."""


@runtime_checkable
class IntegralAction(Protocol, metaclass=AttributeProtocol):
    """A controller that may integrate the measured error: its gains have as many columns more as there are outputs."""

    integral: bool | float
    """Whether it integrates (a request: with which weight)."""


@runtime_checkable
class ClampedIntegral(Protocol, metaclass=AttributeProtocol):
    """A controller whose sums of errors are clamped."""

    integral_limit: Sequence[float]
    """Largest size of the sum of each output's errors; empty: no clamp."""


@runtime_checkable
class OwnState(Protocol, metaclass=AttributeProtocol):
    """A table of gains with a state xi of the controller's own, of size c: its gains have c columns more, of xi."""

    state_gains: StateGains
    """[tau][c][p + c]: xi(k+1) of the samples, their sum where it integrates, and xi(k), for every table; empty: no state."""


@runtime_checkable
class SojournDependent(Protocol, metaclass=AttributeProtocol):
    """A controller whose gains depend on how long the measured delay has lasted."""

    sojourns: int | Sequence[int]
    """How many lengths of stay it distinguishes, in all or per delay 0, 1, ..."""


@runtime_checkable
class RowsOfStays(Protocol, metaclass=AttributeProtocol):
    """A controller whose packets have a row for every d and for how long it has lasted, by the rule ``applied``."""

    row_sojourns: int
    """Lengths of stay at d that have a row each, the last for all longer ones; 1: one row for every d."""


@runtime_checkable
class DistinguishesAges(Protocol, metaclass=AttributeProtocol):
    """A table of gains that distinguishes the ages of several sensor nodes."""

    ages: Sequence[int]
    """How many ages 0, 1, ... of each node have gains of their own; empty: gains by the oldest age."""


class ControllerTraits(Struct, frozen=True, kw_only=True):
    """What a controller says of its packets and gains; the defaults are those of one that says nothing.

    Args:
        samples: how many one sensor packet carries, see `SeveralSamples`.
        integrates: whether it integrates the measured error, see `IntegralAction`.
        integral_limit: size at which the sum of each output's errors is clamped, see `ClampedIntegral`; empty: no clamp.
        state_gains: by which its own state goes on, see `OwnState`; empty: it has none.
        sojourns: lengths of stay at the measured delay that it distinguishes, see `SojournDependent`; empty: none.
        row_sojourns: lengths of stay at d that have a row each, see `RowsOfStays`.
        ages: how many ages of each node it distinguishes, see `DistinguishesAges`; empty: none.
    """

    samples: int = 1
    integrates: bool = False
    integral_limit: tuple[float, ...] = ()
    state_gains: StateGains = ()
    sojourns: int | Sequence[int] = ()
    row_sojourns: int = 1
    ages: tuple[int, ...] = ()

    @property
    def order(self) -> int:
        """Size of its own state."""
        return len(self.state_gains[0]) if self.state_gains else 0


def controller_traits(controller: object) -> ControllerTraits:
    """Return what a controller says of its packets and gains."""
    return ControllerTraits(
        samples=int(controller.samples) if isinstance(controller, SeveralSamples) else 1,
        integrates=isinstance(controller, IntegralAction) and bool(controller.integral),
        integral_limit=tuple(controller.integral_limit) if isinstance(controller, ClampedIntegral) else (),
        state_gains=tuple(tuple(tuple(map(float, row)) for row in own) for own in controller.state_gains)
        if isinstance(controller, OwnState) else (),
        sojourns=controller.sojourns if isinstance(controller, SojournDependent) else (),
        row_sojourns=int(controller.row_sojourns) if isinstance(controller, RowsOfStays) else 1,
        ages=tuple(controller.ages) if isinstance(controller, DistinguishesAges) else (),
    )  # fmt: skip


def check_row_sojourns(row_sojourns: int, rule: str, field: str) -> None:
    """Refuse lengths of stay at d that no rule of rows distinguishes.

    Args:
        row_sojourns: lengths of stay.
        rule: row rule, or information pattern.
        field: of the rule.

    Raises:
        FieldError: fewer than 1, or several with another rule than ``applied``.
    """
    if row_sojourns < 1:
        raise FieldError("row_sojourns", f"{row_sojourns}, expected at least 1")
    if row_sojourns > 1 and rule != "applied":
        said = f"{row_sojourns}, but {field} is {rule!r}; it needs 'applied', as the actuator counts the stay"
        raise FieldError("row_sojourns", said)
