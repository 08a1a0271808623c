"""A running plant whose sensors add white noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from plants.parts.draws import Normals
from plants.parts.protocols import PlantRun


class NoisyRun:
    """A plant that measures y = C x + e, e normal and independent from sample to sample.

    The noise is drawn as time passes, so that two measurements at one instant agree.

    Args:
        run: the plant.
        noise_sd: standard deviation of every entry of e, or one for each, in the unit of the output.
        rng: source of the noise.
    """

    __slots__ = ("_noise", "_noise_sd", "_normals", "_run")

    def __init__(self, run: PlantRun, noise_sd: float | Sequence[float], rng: np.random.Generator) -> None:
        self._run, self._normals = run, Normals(rng)
        outputs = len(run.measure())
        self._noise_sd = (float(noise_sd),) * outputs if isinstance(noise_sd, int | float) else tuple(map(float, noise_sd))
        self._noise = self._draw()

    def advance(self, dt_ns: int, u: Sequence[float], w: Sequence[float] = ()) -> None:
        """Hold the input u + w for dt_ns.

        Args:
            dt_ns: time in nanoseconds, at least 0.
            u: commanded input, m entries.
            w: disturbance at the input, m entries, or nothing.
        """
        self._run.advance(dt_ns, u, w)
        if dt_ns:
            self._noise = self._draw()

    def measure(self) -> tuple[float, ...]:
        """Return y = C x + e."""
        return tuple(y + e for y, e in zip(self._run.measure(), self._noise))

    @property
    def state(self) -> tuple[float, ...]:
        """The state x, without noise."""
        return self._run.state

    @property
    def applied(self) -> tuple[float, ...]:
        """What the actuator put out in the last advance, without the disturbance."""
        return self._run.applied

    def _draw(self) -> tuple[float, ...]:
        return tuple(sd * v for sd, v in zip(self._noise_sd, self._normals.several(len(self._noise_sd))))
