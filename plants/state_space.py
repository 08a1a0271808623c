"""A plant that is given by its matrices, with saturated actuators and noise where these are asked for."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from plants.errors import FieldError
from plants.parts.driven import DrivenRun
from plants.parts.exponential import Rows
from plants.parts.linear import LinearRun, Signal, StateSpace
from plants.parts.linear_many import LinearRuns
from plants.parts.noisy import NoisyRun
from plants.parts.protocols import PlantRun
from plants.parts.validation import require_not_negative, require_positive, require_rows, require_whole_nanoseconds

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
        saturation: largest magnitude that the actuator puts out, m entries above 0, in the input's unit. A certificate of the
            model is undecided for a plant with it.
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
                    raise FieldError(field, f"{name!r} is no name; expected lower-case letters, digits and _")
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

    def own_inputs(self) -> tuple[str, ...]:
        """Return the process noise, where there is one."""
        return ("process noise",) if any(self.process_noise) else ()

    def sensor_noise(self) -> NDArray[np.float64]:
        """Return the standard deviation of the noise on every output, (p,)."""
        return np.array(self.measurement_noise) if self.measurement_noise else np.zeros(len(self.C))

    def start(self, rng: np.random.Generator) -> PlantRun:
        """Return the plant at time 0. Without noise it draws nothing from ``rng``."""
        run: PlantRun = LinearRun(self.model(), self.initial_state)
        if self.saturation or any(self.process_noise):
            forces, sensors = rng.spawn(2) if any(self.process_noise) else (rng, rng)
            run = DrivenRun(
                self.model(), self.initial_state, limits=self.saturation, step_ns=round(self.noise_step_s * 1e9),
                intensity=self.process_noise if any(self.process_noise) else (), rng=forces,
            )  # fmt: skip
            rng = sensors
        return NoisyRun(run, self.measurement_noise, rng) if any(self.measurement_noise) else run

    def start_batch(self, runs: int) -> LinearRuns | None:
        """Return so many of them at time 0; None where they saturate or draw random numbers."""
        if self.saturation or any(self.process_noise) or any(self.measurement_noise):
            return None
        return LinearRuns(self.model(), self.initial_state, runs)
