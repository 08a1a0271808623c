"""The protocols of a plant: a class that fulfils them is run, designed for and certified like ours."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal, NamedTuple, Protocol, Self, runtime_checkable

import numpy as np

from plants.parts import DiscreteStateSpace, Matrix, Signal, StateSpace

if TYPE_CHECKING:
    from plants.parts.semi_markov import JumpModel, JumpRates


class PlantRun(Protocol):
    """A plant that runs; its time is what it was advanced by."""

    def advance(self, dt_ns: int, u: Sequence[float], w: Sequence[float] = ()) -> None:
        """Hold u + w for dt_ns."""

    def measure(self) -> Sequence[float]:
        """Return the outputs now; measuring changes nothing."""

    @property
    def state(self) -> tuple[float, ...]: ...

    @property
    def applied(self) -> tuple[float, ...]: ...


@runtime_checkable
class Plant(Protocol):
    """Parameters of a plant: a frozen dataclass that an experiment's ``[plant]`` table fills."""

    @property
    def inputs(self) -> tuple[Signal, ...]: ...

    @property
    def outputs(self) -> tuple[Signal, ...]: ...

    @property
    def states(self) -> tuple[Signal, ...]: ...

    def model(self) -> StateSpace | DiscreteStateSpace:
        """Return the linear model that a designer sees."""

    def start(self, rng: np.random.Generator) -> PlantRun:
        """Return the plant at time 0; all randomness comes from ``rng``."""


@runtime_checkable
class JumpPlant(Plant, Protocol):
    """A plant whose matrices jump at random instants; it measures its state and, last, the mode seen (1, 2, ...)."""

    def jump_system(self) -> JumpModel:
        """Return the matrices of every mode, as they run."""

    def jump_process(self) -> JumpRates:
        """Return the rates of the modes, as they run."""


@runtime_checkable
class BeyondModel(Protocol):
    """A plant that says what acts on it and is not in its model; a claim about the model is then undecided for the plant."""

    def beyond_model(self) -> tuple[str, ...]:
        """Return what it has beyond its model, each a noun phrase; empty: the model is the plant."""


@runtime_checkable
class MovesOtherwise(Protocol):
    """A plant that moves by other matrices than a designer sees, and says by which; claims are of these."""

    def motion(self) -> StateSpace | DiscreteStateSpace:
        """Return the linear model by which it moves, in the states, inputs and outputs of `model`."""


class Departure(NamedTuple):
    """What a plant does beyond its motion, and never by more than a bound, whatever it does.

    Attributes:
        name: noun phrase, as in `BeyondModel.beyond_model`.
        at: ``input``: acts beside the input at any instant; ``output``: adds to what is measured.
        bounds: largest magnitude, one entry per input in its unit, or per output in its unit.
        within: largest command, one entry per input in its unit, up to which the bounds hold; empty: at any.
        clips: whether a command beyond `within` acts as the largest one, and a disturbance that would take the input beyond it
            by a share of itself, as where a supply saturates, or does not pass the limit at all.
    """

    name: str
    at: Literal["input", "output"]
    bounds: tuple[float, ...]
    within: tuple[float, ...] = ()
    clips: bool = False


@runtime_checkable
class HasDepartures(Protocol):
    """A plant that says which of what it has beyond its model is bounded: a loop over it ends within a bound, or is undecided."""

    def departures(self) -> tuple[Departure, ...]:
        """Return them, each by the name that `beyond_model` gives it; states are those of the model."""


class PassiveElement(NamedTuple):
    """What a device has at its port beyond its motion, and what of it a proof of passivity may rest on.

    Attributes:
        name: noun phrase, as in `BeyondModel.beyond_model`.
        largest: largest magnitude of the force that is put out, in its unit: more is cut off there. None: it is no such limit,
            and whatever it does only takes energy.
    """

    name: str
    largest: float | None = None


@runtime_checkable
class HasPassiveElements(Protocol):
    """A device that says which of what it has beyond its model is passive at its port: a wall's certificate holds with it."""

    def passive_elements(self) -> tuple[PassiveElement, ...]:
        """Return them, each by the name that `beyond_model` gives it."""


@runtime_checkable
class HasOwnInputs(Protocol):
    """A plant that says what pushes it from within, as time passes and whatever it does itself: loads, hands, gusts, noise."""

    def own_inputs(self) -> tuple[str, ...]:
        """Return what pushes it, each a noun phrase; of bounded size (noise: of bounded variance), and no state of its own."""


@runtime_checkable
class HasStateDelays(Protocol):
    """A plant in slots whose own past states act on it: its model is x(k+1) = A x(k) + A_1 x(k-1) + ... + B u(k)."""

    def state_delays(self) -> Matrix:
        """Return A_1, ..., A_tau, (tau, n, n)."""


@runtime_checkable
class HasCost(Protocol):
    """A plant that says what deviation and effort cost: J is the sum of x' Xi x + u' Xi_u u."""

    def cost_weights(self) -> tuple[Matrix, Matrix]:
        """Return Xi, (n, n), and Xi_u, (m, m)."""


@runtime_checkable
class HasStateHistory(Protocol):
    """A plant with delayed states that says what they were before slot 0; of one that does not, they were zero."""

    def state_history(self) -> Matrix:
        """Return x(-1), ..., x(-h), (h, n)."""


@runtime_checkable
class HasSensorNoise(Protocol):
    """A plant that says how noisy its sensors are: white noise, new with every sample, independent from output to output."""

    def sensor_noise(self) -> Matrix:
        """Return the standard deviations, (p,)."""


@runtime_checkable
class GoesOn(Protocol):
    """A plant that takes over from another of its class while that runs, with other parameters."""

    def may_change(self) -> tuple[str, ...]:
        """Return the fields that may be other ones then, such as ``friction``."""

    def own_way(self) -> tuple[str, ...]:
        """Return those of them that only lead it from within, as `HasOwnInputs` says: no equation depends on them."""

    def go_on(self, run: PlantRun) -> PlantRun:
        """Return it in the state and at the instant of another run, whose random numbers go on.

        Raises:
            PlantError: the other run is of another class.
        """


@runtime_checkable
class ReferencesFiles(Protocol):
    """A plant that names files, which are relative to the experiment's folder."""

    def with_files(self, folder: str) -> Self:
        """Return the same plant with its files found and checked.

        Raises:
            PlantError: a file is missing or faulty.
        """
