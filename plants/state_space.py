"""Linear plants, by matrices or by a transfer function, with saturated actuators and noise where these are asked for.

Only `from_control` and `to_control` import python-control: no loop does.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from plants.errors import FieldError, PlantError, require_not_negative, require_positive, require_rows, require_whole_nanoseconds
from plants.parts import DiscreteStateSpace, Matrix, Signal, StateSpace, python_control
from plants.parts.exponential import Rows
from plants.parts.linear_run import DrivenRun, LinearRun, LinearRuns, NoisyRun
from plants.parts.protocols import Departure, PassiveElement, Plant, PlantRun

if TYPE_CHECKING:
    import control


LETTERS: Final = {"inputs": "u", "outputs": "y", "states": "x"}
_NAME: Final = re.compile(r"[a-z][a-z0-9_]*")


@dataclass(frozen=True, slots=True, kw_only=True)
class LinearPlant:
    """A linear plant: x' = A x + B (sat(u) + w) + G v, y = C x + e; sat, v and e are off by default.

    Args:
        A: n rows of n entries.
        B: n rows of m entries.
        C: p rows of n entries.
        inputs: name and unit of the m inputs; ("u1", "1"), ... if left out.
        outputs: name and unit of the p outputs; ("y1", "1"), ... if left out.
        states: name and unit of the n states; ("x1", "1"), ... if left out.
        initial_state: x at time 0, n entries; zero if left out.
        saturation: largest magnitude that the actuator puts out, m entries above 0, in the input's unit. The
            loop is then certified in a region of starts, or undecided.
        process_noise: intensity of white noise v on x', n entries, at least 0, in the state's unit per root of a second.
        noise_step_s: v is held over steps of this length, s.
        measurement_noise: standard deviation of white noise e on every output, new with every sample, p entries, at least 0.

    Raises:
        ValueError: where a shape does not fit, an entry is not finite, or a name is taken twice or not in lower case.

    >>> LinearPlant(A=((-1.0,),), B=((2.0,),), C=((1.0,),)).inputs
    (Signal(name='u1', unit='1'),)
    """

    A: Rows
    B: Rows
    C: Rows
    inputs: tuple[Signal, ...] = ()
    outputs: tuple[Signal, ...] = ()
    states: tuple[Signal, ...] = ()
    initial_state: tuple[float, ...] = ()
    saturation: tuple[float, ...] = ()
    process_noise: tuple[float, ...] = ()
    noise_step_s: float = 0.001
    measurement_noise: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        for name, rows in (("A", self.A), ("B", self.B), ("C", self.C)):
            require_rows(name, rows)
        model = self.model()
        n, m, p = model.A.shape[0], model.B.shape[1], model.C.shape[0]
        for field, given, size in (("inputs", self.inputs, m), ("outputs", self.outputs, p), ("states", self.states, n)):
            signals = given or tuple(Signal(f"{LETTERS[field]}{i + 1}", "1") for i in range(size))
            object.__setattr__(self, field, signals)
            names = [signal.name for signal in signals]
            if len(names) != size:
                raise FieldError(field, f"{len(names)} signals, but the matrices have {size}")
            for name in names:
                if not _NAME.fullmatch(name):
                    raise FieldError(field, f"{name!r} is no name; expected a letter, then lower-case letters, digits and _")
                if names.count(name) > 1:
                    raise FieldError(field, f"{name!r} is taken twice")
        start = self.initial_state or (0.0,) * n
        if len(start) != n or not np.isfinite(start).all():
            raise FieldError("initial_state", f"expected {n} finite numbers")
        object.__setattr__(self, "initial_state", tuple(map(float, start)))
        for i, limit in enumerate(self._sized("saturation", self.saturation, m)):
            require_positive(f"saturation[{i}]", limit)
        for field, noise, size in (("process_noise", self.process_noise, n), ("measurement_noise", self.measurement_noise, p)):
            for i, entry in enumerate(self._sized(field, noise, size)):
                require_not_negative(f"{field}[{i}]", entry)
        require_whole_nanoseconds("noise_step_s", self.noise_step_s)

    def _sized(self, field: str, given: tuple[float, ...], size: int) -> tuple[float, ...]:
        if given and len(given) != size:
            raise FieldError(field, f"{len(given)} entries, expected {size} or none")
        return given

    def model(self) -> StateSpace:
        """Return the matrices."""
        return StateSpace(A=self.A, B=self.B, C=self.C)

    def beyond_model(self) -> tuple[str, ...]:
        """Return what the matrices do not say; noise adds to a linear loop, and its variance stays bounded in a stable one."""
        return ("saturated actuators",) if self.saturation else ()

    def departures(self) -> tuple[Departure, ...]:
        """Return that actuators put out what is asked for, up to their limits."""
        asked = (0.0,) * len(self.inputs)
        return (Departure("saturated actuators", "input", asked, self.saturation, clips=True),) if self.saturation else ()

    def passive_elements(self) -> tuple[PassiveElement, ...]:
        """Return the saturated actuators: what they put out is cut off at their limits."""
        return tuple(PassiveElement("saturated actuators", limit) for limit in self.saturation)

    def own_inputs(self) -> tuple[str, ...]:
        """Return the process noise, where there is one."""
        return ("process noise",) if any(self.process_noise) else ()

    def sensor_noise(self) -> Matrix:
        """Return the standard deviation of the noise on every output, (p,)."""
        return np.array(self.measurement_noise) if self.measurement_noise else np.zeros(len(self.C))

    def start(self, rng: np.random.Generator) -> PlantRun:
        """Return the plant at time 0. Without noise it draws nothing from ``rng``; noise of size 0 may grow in a run."""
        run: PlantRun = LinearRun(self.model(), self.initial_state)
        if self.saturation or self.process_noise:
            forces, sensors = rng.spawn(2) if self.process_noise else (rng, rng)
            run = DrivenRun(
                self.model(), self.initial_state, limits=self.saturation, step_ns=round(self.noise_step_s * 1e9),
                intensity=self.process_noise, rng=forces,
            )  # fmt: skip
            rng = sensors
        return NoisyRun(run, self.measurement_noise, rng) if self.measurement_noise else run

    def may_change(self) -> tuple[str, ...]:
        """Return what another plant may have that takes over from one that runs: the limits and noises that this one has."""
        return tuple(name for name in ("saturation", "process_noise", "measurement_noise") if getattr(self, name))

    def own_way(self) -> tuple[str, ...]:
        """Return nothing: noise is part of what a certificate says."""
        return ()

    def go_on(self, run: PlantRun) -> PlantRun:
        """Return this plant where another one is, which runs.

        Raises:
            PlantError: the other one has not the same limits and noises, of whatever size.
        """
        inner = run.inner if isinstance(run, NoisyRun) else run
        if isinstance(inner, DrivenRun) and (self.saturation or self.process_noise):
            inner.change(self.model(), self.saturation, self.process_noise)
        elif not isinstance(inner, LinearRun) or self.saturation or self.process_noise:
            raise PlantError(f"go_on: a {type(inner).__name__}, expected a plant with the same limits and noises")
        if isinstance(run, NoisyRun):
            run.change(inner, self.measurement_noise)
        return run

    def start_batch(self, runs: int) -> LinearRuns | None:
        """Return so many of them at time 0; None where they saturate or draw random numbers."""
        if self.saturation or self.process_noise or self.measurement_noise:
            return None
        return LinearRuns(self.model(), self.initial_state, runs)


INPUT: Final = Signal("u", "1")
OUTPUT: Final = Signal("y", "1")


@dataclass(frozen=True, slots=True, kw_only=True)
class TransferFunction:
    """A linear plant: y(s) = num(s) / den(s) (u(s) + w(s)), realised in controllable canonical form, at rest at time 0.

    B has the largest coefficient of ``num`` and C the others as shares of it: without zeros the first state is the output.

    Args:
        num: coefficients of the numerator, the highest power of s first; of a lower degree than ``den``.
        den: coefficients of the denominator, the highest power of s first.
        input: name and unit of the input.
        output: name and unit of the output.

    Raises:
        ValueError: where a coefficient is not finite, ``den`` begins with 0, or ``num`` is 0 or not of a lower degree.

    >>> TransferFunction(num=(170.0,), den=(1.0, 20.0, 0.0)).model().A.tolist()
    [[0.0, 1.0], [-0.0, -20.0]]
    >>> TransferFunction(num=(170.0,), den=(1.0, 20.0, 0.0)).model().C.tolist()
    [[1.0, 0.0]]
    """

    num: tuple[float, ...]
    den: tuple[float, ...]
    input: Signal = INPUT
    output: Signal = OUTPUT

    def __post_init__(self) -> None:
        for name, values in (("num", self.num), ("den", self.den)):
            if not values or not np.isfinite(values).all():
                raise FieldError(name, "expected finite coefficients, and at least one")
        if not self.den[0]:
            raise FieldError("den", "begins with 0; expected the coefficient of the highest power of s")
        if not any(self.num):
            raise FieldError("num", "is 0: the input does not reach the output")
        if len(np.trim_zeros(self.num, "f")) >= len(self.den):
            raise FieldError("num", "is not of a lower degree than den; a rig measures y(k) before u(k) exists")
        self._realised()  # what its names and numbers lack is reported now

    def _realised(self) -> LinearPlant:
        n = len(self.den) - 1
        den = [a / self.den[0] for a in self.den[1:]]
        num = np.trim_zeros(self.num, "f")
        largest = max(num, key=abs)
        shares = [b / largest for b in num]
        shift = [tuple(float(j == i + 1) for j in range(n)) for i in range(n - 1)]
        return LinearPlant(
            A=(*shift, tuple(-a for a in reversed(den))),
            B=(*((0.0,),) * (n - 1), (largest / self.den[0],)),
            C=((*reversed(shares), *(0.0,) * (n - len(shares))),),
            inputs=(self.input,),
            outputs=(self.output,),
        )

    @property
    def inputs(self) -> tuple[Signal, ...]:
        """The input."""
        return (self.input,)

    @property
    def outputs(self) -> tuple[Signal, ...]:
        """The output."""
        return (self.output,)

    @property
    def states(self) -> tuple[Signal, ...]:
        """The states of the realisation."""
        return self._realised().states

    def model(self) -> StateSpace:
        """Return the realisation."""
        return self._realised().model()

    def start(self, rng: np.random.Generator) -> PlantRun:
        """Return the plant at time 0. It draws nothing from ``rng``."""
        return self._realised().start(rng)

    def start_batch(self, runs: int) -> LinearRuns | None:
        """Return so many of them at time 0."""
        return self._realised().start_batch(runs)


def from_control(
    system: control.StateSpace | control.TransferFunction,
    *,
    inputs: Sequence[Signal] = (),
    outputs: Sequence[Signal] = (),
    states: Sequence[Signal] = (),
    initial_state: Sequence[float] = (),
) -> LinearPlant:
    """Return the plant that a python-control model describes.

    Args:
        system: continuous time, strictly proper: a rig measures y(k) before u(k) exists. A transfer function is realised.
        inputs, outputs, states: names and units; see `LinearPlant`.
        initial_state: x at time 0, n entries; zero if left out.

    Raises:
        PlantError: for a model in discrete time, with a direct feedthrough, or without a state.
    """
    model = python_control().ss(system)
    if model.isdtime(strict=True):
        raise PlantError(f"from_control: the model has the period {model.dt}; a rig moves a plant in continuous time")
    if np.any(model.D):
        raise PlantError("from_control: D is not zero; a rig measures y(k) before u(k) exists")
    if not model.nstates:
        raise PlantError("from_control: the model has no state; a fixed gain is a controller")
    A, B, C = (tuple(tuple(map(float, row)) for row in np.asarray(M)) for M in (model.A, model.B, model.C))
    return LinearPlant(
        A=A, B=B, C=C, inputs=tuple(inputs), outputs=tuple(outputs), states=tuple(states), initial_state=tuple(initial_state)
    )


def to_control(plant: Plant | StateSpace | DiscreteStateSpace) -> control.StateSpace:
    """Return the linear model of a plant, or a model, as a `control.StateSpace`, with the names of its signals.

    Args:
        plant: a plant, whose model is taken, or a model in continuous or discrete time.
    """
    if isinstance(plant, StateSpace | DiscreteStateSpace):
        return plant.to_control()
    model = plant.model().to_control()
    model.set_inputs([s.name for s in plant.inputs])
    model.set_outputs([s.name for s in plant.outputs])
    if model.nstates == len(plant.states):
        model.set_states([s.name for s in plant.states])
    return model
